"""Which of a file's points are markers: prefixes, unlabelled points, duplicates and outputs of other programs.

The lists of names that modelling programs give to what they compute follow what the programs write: Plug-in Gait and
the Oxford foot model (Vicon), CGM 1 and 2 (pyCGM2), QCMAS, Visual3D, Theia, QTM, OpenCap. ``torchid.io.computed`` finds
outputs under other names by how they move.
"""

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

from torchid.errors import InputError, Note

CENTRES = re.compile(
    r"[LR]?_?(HJC|KJC|AJC|SJC|EJC|WJC)(_\w+)?|(HJC|KJC|AJC|SJC|EJC|WJC)_?[LR]?|\w*HJC\w*|Cent(re|er)OfMass\w*"
    r"|(Left|Right|[LR])?_?(Hip|Knee|Ankle|Shoulder|Elbow|Wrist)_?(Joint)?_?Cent(re|er)\w*|\w+LegLength|proj\w+"
    r"|mid_?(ASIS|PSIS|HJC|KJC|AJC|Hip)|(\w+_)?(COM|CoM|COG|CoG|COP|CoP)(_\w+)?|\w+_4X4"
)
"""Joint centres, centres of mass and of pressure, midpoints, poses and lengths."""
QUANTITIES = re.compile(
    r"[A-Za-z]\w*(Angle|Force|Moment|Power|Torque|GRF|Velocity|Acceleration|Momentum)s?(_[A-Z0-9]{1,4})?"
)
"""Angles, forces, moments and powers, also with a suffix for the model's variant (``LHipAngles_M``)."""
AXIS_ENDS = (tuple("OALP"), tuple("OXYZ"), ("ORIGIN", "X", "Y", "Z"))
"""An origin and the ends of three axes: Plug-in Gait's letters, and those of other programs."""
SEGMENT = re.compile(r"(HED|PEL|TRX|[LR](CL|FE|FO|HN|HU|RA|TI|TO))(_[A-Z0-9]{0,3})?")
"""What stands before Plug-in Gait's letters, such as ``PEL`` in ``PELO`` and ``PEL_M`` in ``PEL_MO``."""
OXFORD_FOOT = re.compile(r"[LR](FOF|HDF|HLX|TIB|HE|ANK|D1M)\d|[LR](PROXFF|KAX|ArchHeight|HFplantar)")
"""Outputs of the Oxford foot model; such names may be markers elsewhere, so they count only beside its axis points."""
FOOT_AXES = ("FOF", "HDF", "HLX")
"""Segments of which the Oxford foot model stores the origin (0) and the ends of the axes (1 to 3)."""
AUGMENTED = "_study"
"""OpenCap ends the names of markers that it estimates by this; they count where the marker itself is in the file, as
spelt but for capitals: ``RKnee`` is a joint in the video, and not ``r_knee_study``'s marker."""


def loose(label: str) -> str:
    """A label as it is compared: without case, blanks, dots, dashes and underscores."""
    return re.sub(r"[\s._\-]+", "", label).casefold()


def named_outputs(names: Sequence[str]) -> set[int]:
    """Which of a file's points are outputs by their names.

    Args:
        names: one per point, without the subject's prefix.

    Returns:
        Their indices. Names that only look like an axis or a foot model's point count in complete sets alone.
    """
    present = set(names)
    axes = {stem + end for ends in AXIS_ENDS for stem in _stems(present, ends) for end in ends}
    feet = {side + part for side in "LR" for part in FOOT_AXES if all(f"{side}{part}{k}" in present for k in range(4))}
    axes |= {f"{foot}{k}" for foot in feet for k in range(4)}
    plain = {name.casefold() for name in present}
    return {
        k
        for k, name in enumerate(names)
        if name in axes
        or CENTRES.fullmatch(name)
        or QUANTITIES.fullmatch(name)
        or (feet and OXFORD_FOOT.fullmatch(name))
        or (name.endswith(AUGMENTED) and name.removesuffix(AUGMENTED).casefold() in plain)
    }


def _stems(present: set[str], ends: tuple[str, ...]) -> set[str]:
    """Segments that have an origin and all axes; any name will do where the letters are set off by ``_``."""
    stems = {name.removesuffix(ends[0]) for name in present if name.endswith(ends[0])}
    stems = {stem for stem in stems if all(stem + end in present for end in ends)}
    return {stem for stem in stems if SEGMENT.fullmatch(stem) or (ends[1] == "X" and stem.endswith("_"))}


UNLABELLED = re.compile(r"([*#]\d*|U_\d+|uname\d*\**\d*|unlabel\w*\W*\d*|unnamed\W*\d*)?", re.IGNORECASE)
OUTPUT_LISTS = ("ANGLES", "FORCES", "MOMENTS", "POWERS", "SCALARS", "REACTIONS")


@dataclass(frozen=True)
class LabelSelection:
    """Markers of a file and where they stand in it."""

    labels: tuple[str, ...]
    columns: tuple[int, ...]
    notes: tuple[Note, ...]
    subjects: tuple[str, ...] = ()


def select_markers(
    labels: list[str],
    source: str,
    outputs: frozenset[str] = frozenset(),
    subject: str | tuple[str, ...] | None = None,
    wanted: frozenset[str] = frozenset(),
) -> LabelSelection:
    """The markers among ``labels``; what is left out is counted and named in the notes.

    Args:
        labels: one per point, as in the file.
        outputs: labels that the file itself lists as angles, forces, moments, powers or scalars.
        subject: the prefix to read, or several of one person stored as several bodies; None where the file holds one.
        wanted: labels that are markers whatever they are called (``ReadOptions.wanted``).

    Raises:
        InputError: ``markers.subjects`` where several prefixes are present and none is chosen, a chosen one is absent,
            or chosen ones share a label.
    """
    notes: list[Note] = []
    plain = [label.split(":")[-1].strip() for label in labels]
    unlabelled = [k for k, label in enumerate(plain) if UNLABELLED.fullmatch(label)]
    computed = _outputs(labels, plain, outputs, wanted)
    left = {*unlabelled, *computed}
    subjects = sorted({label.split(":")[0] for k, label in enumerate(labels) if ":" in label and k not in left})
    columns = _of_subject([k for k in range(len(labels)) if k not in left], labels, subjects, subject, source, notes)
    if unlabelled:
        notes.append(Note("markers.unlabelled", f"{len(unlabelled)} unlabelled points left out", source))
        if not columns:
            notes.append(Note("markers.none", "no labelled markers", source))
    notes += _said(computed, plain, source)
    final, duplicates = _unique([plain[k] for k in columns])
    if duplicates:
        text = f"labels occur more than once, later ones are numbered: {_listed(duplicates)}"
        notes.append(Note("markers.duplicates", text, source))
    return LabelSelection(final, tuple(columns), tuple(notes), tuple(subjects))


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
    columns: list[int],
    labels: list[str],
    subjects: list[str],
    subject: str | tuple[str, ...] | None,
    source: str,
    notes: list[Note],
) -> list[int]:
    """Columns of the chosen prefixes and of labels without one."""
    chosen = (subject,) if isinstance(subject, str) else subject or ()
    if not subjects:
        if chosen:
            notes.append(Note("markers.subjects", "the labels have no prefixes, all are read", source))
        return columns
    absent = [name for name in chosen if name not in subjects]
    if absent:
        text = f"the subject asked for is not in the file: {_listed(absent)}"
        raise _which_subject(text, columns, labels, subjects, source)
    if not chosen and len(subjects) > 1:
        raise _which_subject(
            "the file holds several subjects, or one as several bodies", columns, labels, subjects, source
        )
    chosen = chosen or tuple(subjects)
    kept = [k for k in columns if ":" not in labels[k] or labels[k].split(":")[0] in chosen]
    shared = _shared(kept, labels)
    if shared and len(chosen) > 1:
        raise _colliding(shared, source)
    if len(kept) < len(columns):
        notes.append(Note("markers.subjects", f"{len(columns) - len(kept)} markers of others left out", source))
    notes.append(Note("markers.prefix", f"prefix {', '.join(chosen)}: removed from the labels", source))
    return kept


def _shared(columns: list[int], labels: list[str]) -> dict[str, list[str]]:
    """Labels that occur under several prefixes, each with these."""
    found: dict[str, list[str]] = {}
    for prefix, name in sorted(
        {(labels[k].split(":")[0], labels[k].split(":")[-1].strip()) for k in columns if ":" in labels[k]}
    ):
        found.setdefault(name, []).append(prefix)
    return {name: prefixes for name, prefixes in found.items() if len(prefixes) > 1}


def _which_subject(message: str, columns: list[int], labels: list[str], subjects: list[str], source: str) -> InputError:
    """The question, with the markers of each prefix, so that bodies of one person can be told from persons."""
    members = {
        name: [labels[k].split(":")[-1] for k in columns if labels[k].split(":")[0] == name] for name in subjects
    }
    listed = [f"{name} ({len(found)}: {_listed(found, 3)})" for name, found in members.items()]
    shared = _shared(columns, labels)
    together = f"{_listed(list(shared), 3)} under several of them" if shared else "no label under two of them"
    several = "" if shared else f", or several bodies of one person with subject: [{', '.join(subjects[:2])}]"
    return InputError(
        "markers.subjects", message, source=source, place="labels", found=f"{_listed(listed)}; {together}",
        remedy=f"Name it in the config, beside file:, with subject: {subjects[0]}{several}",
    )  # fmt: skip


def _colliding(shared: dict[str, list[str]], source: str) -> InputError:
    named = [f"{name} of {' and '.join(prefixes)}" for name, prefixes in shared.items()]
    return InputError(
        "markers.subjects", "the subjects asked for share labels, so they are not bodies of one person", source=source,
        place="labels", found=_listed(named),
        remedy=f"Name one of them with subject: {next(iter(shared.values()))[0]}, or rename the labels",
    )  # fmt: skip


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
