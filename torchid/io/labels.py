"""Which of a file's points are markers: prefixes, unlabelled points, duplicates and outputs of other programs."""

import re
from collections import Counter
from dataclasses import dataclass

from torchid.errors import InputError, Note
from torchid.io.output_names import loose, named_outputs

UNLABELLED = re.compile(r"([*#]\d*|U_\d+|uname\d*\**\d*|unlabel\w*\W*\d*|unnamed\W*\d*)?", re.IGNORECASE)
OUTPUT_LISTS = ("ANGLES", "FORCES", "MOMENTS", "POWERS", "SCALARS", "REACTIONS")
FORCE_COLUMN = re.compile(r"ground_(force|torque|moment)|(^|_)[vpm][xyz]$", re.IGNORECASE)


@dataclass(frozen=True)
class Selection:
    """Markers of a file and where they stand in it."""

    labels: tuple[str, ...]
    columns: tuple[int, ...]
    notes: tuple[Note, ...]
    duplicates: tuple[str, ...] = ()
    subjects: tuple[str, ...] = ()


def select_markers(
    labels: list[str],
    source: str,
    outputs: frozenset[str] = frozenset(),
    prefix: str | None = None,
    wanted: frozenset[str] = frozenset(),
) -> Selection:
    """The markers among ``labels``; what is left out is counted and named in the notes.

    Args:
        labels: one per point, as in the file.
        source: the file, for notes and errors.
        outputs: labels that the file itself lists as angles, forces, moments, powers or scalars.
        prefix: the subject to read, None where the file holds one.
        wanted: labels that are markers whatever they are called (``ReadOptions.wanted``).

    Raises:
        InputError: ``markers.subjects`` where several subjects are present and none is chosen, or the chosen is absent.
    """
    notes: list[Note] = []
    plain = [label.split(":")[-1].strip() for label in labels]
    unlabelled = [k for k, label in enumerate(plain) if UNLABELLED.fullmatch(label)]
    computed = _outputs(labels, plain, outputs, wanted)
    left = {*unlabelled, *computed}
    subjects = sorted({label.split(":")[0] for k, label in enumerate(labels) if ":" in label and k not in left})
    columns = _of_subject([k for k in range(len(labels)) if k not in left], labels, subjects, prefix, source, notes)
    if unlabelled:
        notes.append(Note("markers.unlabelled", f"{len(unlabelled)} unlabelled points left out", source))
    notes += _said(computed, plain, source)
    final, duplicates = _unique([plain[k] for k in columns])
    if duplicates:
        text = f"labels occur more than once, later ones are numbered: {_listed(duplicates)}"
        notes.append(Note("markers.duplicates", text, source))
    return Selection(final, tuple(columns), tuple(notes), tuple(duplicates), tuple(subjects))


def refuse_forces(labels: list[str], source: str) -> None:
    """Refuse a marker file whose columns are ground reaction forces.

    Raises:
        InputError: ``trc.forces``.
    """
    named = [label for label in labels if FORCE_COLUMN.search(label)]
    if named:
        raise InputError(
            "trc.forces",
            "these are forces, not markers",
            source=source,
            place="label line",
            found=_listed(named),
            remedy="Name the file under forces: and give the marker file under file:",
        )


def _outputs(labels: list[str], plain: list[str], listed: frozenset[str], wanted: frozenset[str]) -> dict[int, str]:
    """Points that are no markers, with what says so: the file's own lists, or their names."""
    names = {name.split(":")[-1].strip() for name in listed} - {""}
    told = {k: "by their names" for k in named_outputs(plain)}
    told |= {k: "listed as outputs by the file" for k, name in enumerate(plain) if name in names}
    asked = {loose(name) for name in wanted}
    return {k: why for k, why in sorted(told.items()) if loose(plain[k]) not in asked}


def _said(outputs: dict[int, str], plain: list[str], source: str) -> list[Note]:
    if not outputs:
        return []
    counts = " and ".join(f"{n} {why}" for why, n in sorted(Counter(outputs.values()).items()))
    text = f"{len(outputs)} computed points and outputs left out, {counts}: {_listed([plain[k] for k in outputs])}"
    return [Note("markers.outputs", text, source)]


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
