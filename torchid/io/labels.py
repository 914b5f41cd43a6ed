"""Which of a file's points are markers: prefixes, unlabelled points, duplicates and outputs of other programs."""

import re
from collections import Counter
from dataclasses import dataclass

from torchid.errors import InputError, Note

UNLABELLED = re.compile(r"([*#]\d*|U_\d+|uname\d*\**\d*|unlabel\w*\W*\d*|unnamed\W*\d*)?", re.IGNORECASE)
COMPUTED = re.compile(
    r"[LR]?_?(HJC|KJC|AJC|SJC|EJC|WJC)(_\w+)?|(HJC|KJC|AJC|SJC|EJC|WJC)_?[LR]?|\w*HJC\w*|Cent(re|er)OfMass\w*"
    r"|(Left|Right|[LR])?_?(Hip|Knee|Ankle|Shoulder|Elbow|Wrist)_?(Joint)?_?Cent(re|er)\w*|\w+LegLength|proj\w+"
)
"""Joint centres, centres of mass and lengths that modelling programs store among the points."""
OXFORD_FOOT = re.compile(r"[LR](FOF|HDF|HLX|TIB|HE|ANK|D1M)\d|[LR](PROXFF|KAX|ArchHeight|HFplantar)")
"""Outputs of the Oxford foot model; such names may be markers elsewhere, so they count only beside its axis points."""
BONE = re.compile(r"(HED|PEL|TRX|[LR](?:CL|FE|FO|HN|HU|RA|TI|TO))[OALP]")
BONE_SUFFIXES = "OALP"
"""Plug-in Gait stores the origin and axis ends of its segments as NAME + O, A, L, P; only all four are taken."""
OUTPUT_LISTS = ("ANGLES", "FORCES", "MOMENTS", "POWERS", "SCALARS", "REACTIONS")


@dataclass(frozen=True)
class Selection:
    """Markers of a file and where they stand in it."""

    labels: tuple[str, ...]
    columns: tuple[int, ...]
    notes: tuple[Note, ...]
    duplicates: tuple[str, ...] = ()
    subjects: tuple[str, ...] = ()


def select_markers(
    labels: list[str], source: str, outputs: frozenset[str] = frozenset(), prefix: str | None = None
) -> Selection:
    """The markers among ``labels``; what is left out is counted and named in the notes.

    Args:
        labels: one per point, as in the file.
        source: the file, for notes and errors.
        outputs: labels that the file itself lists as angles, forces, moments, powers or scalars.
        prefix: the subject to read, None where the file holds one.

    Raises:
        InputError: ``markers.subjects`` where several subjects are present and none is chosen, or the chosen is absent.
    """
    notes: list[Note] = []
    plain = [label.split(":")[-1].strip() for label in labels]
    unlabelled = [k for k, label in enumerate(plain) if UNLABELLED.fullmatch(label)]
    computed = _computed(labels, plain, outputs)
    left = set(unlabelled) | computed
    subjects = sorted({label.split(":")[0] for k, label in enumerate(labels) if ":" in label and k not in left})
    columns = _of_subject([k for k in range(len(labels)) if k not in left], labels, subjects, prefix, source, notes)
    if unlabelled:
        notes.append(Note("markers.unlabelled", f"{len(unlabelled)} unlabelled points left out", source))
    if computed:
        names = _listed([plain[k] for k in sorted(computed)])
        notes.append(Note("markers.outputs", f"{len(computed)} computed points and outputs left out: {names}", source))
    final, duplicates = _unique([plain[k] for k in columns])
    if duplicates:
        text = f"labels occur more than once, later ones are numbered: {_listed(duplicates)}"
        notes.append(Note("markers.duplicates", text, source))
    return Selection(final, tuple(columns), tuple(notes), tuple(duplicates), tuple(subjects))


def _computed(labels: list[str], plain: list[str], outputs: frozenset[str]) -> set[int]:
    present = set(plain)
    stems = {match[1] for match in map(BONE.fullmatch, plain) if match}
    quads = {stem for stem in stems if all(stem + s in present for s in BONE_SUFFIXES)}
    frames = {name[:-1] for name in plain if name and all(f"{name[:-1]}{k}" in present for k in range(4))}
    bones = {stem + s for stem in quads for s in BONE_SUFFIXES}
    axes = {f"{stem}{k}" for stem in frames & {s + n for s in "LR" for n in ("FOF", "HDF", "HLX")} for k in range(4)}
    listed = {name.split(":")[-1].strip() for name in outputs} - {""}
    return {
        k
        for k, name in enumerate(plain)
        if labels[k] in outputs
        and labels[k]
        or name in listed
        or name in bones
        or COMPUTED.fullmatch(name)
        or (axes and OXFORD_FOOT.fullmatch(name))
    }


def _of_subject(
    columns: list[int], labels: list[str], subjects: list[str], prefix: str | None, source: str, notes: list[Note]
) -> list[int]:
    if prefix is not None:
        kept = [k for k in columns if ":" not in labels[k] or labels[k].split(":")[0] == prefix]
        if subjects and prefix not in subjects:
            raise _which_subject("the subject asked for is not in the file", subjects, source)
        if len(kept) < len(columns):
            notes.append(Note("markers.subjects", f"{len(columns) - len(kept)} markers of others left out", source))
        return kept
    if len(subjects) > 1:
        raise _which_subject("the file holds several subjects", subjects, source)
    if subjects:
        notes.append(Note("markers.prefix", f"prefix {subjects[0]}: removed from the labels", source))
    return columns


def _which_subject(message: str, subjects: list[str], source: str) -> InputError:
    return InputError(
        "markers.subjects",
        message,
        source=source,
        place="labels",
        found=_listed(subjects),
        remedy="Choose one of them with prefix:",
    )


def _unique(names: list[str]) -> tuple[tuple[str, ...], list[str]]:
    """Names made unique by #2, #3, ... and those that had to be."""
    seen: Counter[str] = Counter()
    taken, unique, repeated = set(names), [], []
    for name in names:
        seen[name] += 1
        numbered = name
        while seen[name] > 1 and (numbered == name or numbered in taken):
            numbered = f"{name}#{seen[name]}"
            seen[name] += numbered in taken
        if numbered != name:
            repeated.append(name)
            taken.add(numbered)
        unique.append(numbered)
    return tuple(unique), sorted(set(repeated))


def _listed(names: list[str], most: int = 12) -> str:
    return ", ".join(names[:most]) + (f", ... ({len(names)})" if len(names) > most else "")
