"""Names that modelling programs give to what they compute and store among the points of a file.

The lists follow what the programs write: Plug-in Gait and the Oxford foot model (Vicon), CGM 1 and 2 (pyCGM2), QCMAS,
Visual3D, Theia, QTM, OpenCap. ``torchid.io.computed`` finds outputs under other names by how they move.
"""

import re
from collections.abc import Sequence

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
"""OpenCap ends the names of markers that it estimates by this; they count where the marker itself is in the file."""


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
    plain = {loose(name) for name in present}
    return {
        k
        for k, name in enumerate(names)
        if name in axes
        or CENTRES.fullmatch(name)
        or QUANTITIES.fullmatch(name)
        or (feet and OXFORD_FOOT.fullmatch(name))
        or (name.endswith(AUGMENTED) and loose(name.removesuffix(AUGMENTED)) in plain)
    }


def _stems(present: set[str], ends: tuple[str, ...]) -> set[str]:
    """Segments that have an origin and all axes; any name will do where the letters are set off by ``_``."""
    stems = {name.removesuffix(ends[0]) for name in present if name.endswith(ends[0])}
    stems = {stem for stem in stems if all(stem + end in present for end in ends)}
    return {stem for stem in stems if SEGMENT.fullmatch(stem) or (ends[1] == "X" and stem.endswith("_"))}
