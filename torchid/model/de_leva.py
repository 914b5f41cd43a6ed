"""How the mass of a person lies in the segments: fractions, centres and extents by a published table.

de Leva 1996 (J Biomech 29:1223), Table 4: mass fractions, centres along the segment, radii of gyration, joint
centres as ends. The trunk's three parts are cut elsewhere than our joints: the lower part (to the omphalion, level with
L4 and the iliac crests) is the pelvis, the middle part (omphalion to xiphoid) is cut at the T12/L1 joint, below it the
abdomen, above it, with the upper part, the thorax. So the sum and the first moment of de Leva's trunk are kept.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from torchid.model.model import Geometry
from torchid.model.proportions import proportions
from torchid.model.skeleton import SEGMENTS, SIDES


@dataclass(frozen=True)
class Row:
    """A segment of de Leva's Table 4."""

    mass: float
    """Fraction of the body mass."""
    com: float
    """Centre of mass from the proximal (upper; foot: rear) end, fraction of the length."""
    length: float
    """Length in the table [m], for the mean stature there; radii are fractions of it."""
    sagittal: float
    transverse: float
    longitudinal: float
    """Radii of gyration about the axes of the anatomical position, fractions of the length."""


DE_LEVA: dict[str, dict[str, Row]] = {
    "male": {
        "head": Row(0.0694, 0.5002, 0.2429, 0.303, 0.315, 0.261),
        "upper_trunk": Row(0.1596, 0.5066, 0.2421, 0.505, 0.320, 0.465),
        "middle_trunk": Row(0.1633, 0.4502, 0.2155, 0.482, 0.383, 0.468),
        "lower_trunk": Row(0.1117, 0.6115, 0.1457, 0.615, 0.551, 0.587),
        "upper_arm": Row(0.0271, 0.5772, 0.2817, 0.285, 0.269, 0.158),
        "forearm": Row(0.0162, 0.4574, 0.2689, 0.276, 0.265, 0.121),
        "hand": Row(0.0061, 0.7900, 0.0862, 0.628, 0.513, 0.401),
        "thigh": Row(0.1416, 0.4095, 0.4222, 0.329, 0.329, 0.149),
        "shank": Row(0.0433, 0.4395, 0.4403, 0.251, 0.246, 0.102),
        "foot": Row(0.0137, 0.4415, 0.2581, 0.257, 0.245, 0.124),
    },
    "female": {
        "head": Row(0.0668, 0.4841, 0.2437, 0.271, 0.295, 0.261),
        "upper_trunk": Row(0.1545, 0.5050, 0.2280, 0.466, 0.314, 0.449),
        "middle_trunk": Row(0.1465, 0.4512, 0.2053, 0.433, 0.354, 0.415),
        "lower_trunk": Row(0.1247, 0.4920, 0.1815, 0.433, 0.402, 0.444),
        "upper_arm": Row(0.0255, 0.5754, 0.2751, 0.278, 0.260, 0.148),
        "forearm": Row(0.0138, 0.4559, 0.2643, 0.261, 0.257, 0.094),
        "hand": Row(0.0056, 0.7474, 0.0780, 0.531, 0.454, 0.335),
        "thigh": Row(0.1478, 0.3612, 0.3685, 0.369, 0.364, 0.162),
        "shank": Row(0.0481, 0.4352, 0.4386, 0.267, 0.263, 0.092),
        "foot": Row(0.0129, 0.4014, 0.2283, 0.299, 0.279, 0.139),
    },
}
"""Head from vertex to cervicale, upper trunk from cervicale to xiphoid, shank between joint centres (lower half of the
table). The fractions sum to 1 (male) and 0.9999 (female, rounding) and are divided by their sum."""
STATURE_OF_TABLE = {"male": 1.741, "female": 1.735}


@dataclass(frozen=True)
class Segment:
    """A segment's distribution of mass in body axes."""

    fraction: float
    com: tuple[float, float, float]
    """From the body's origin [m]."""
    extent: tuple[float, float, float]
    """Root of the second moment per mass about the centre, along each axis [m]."""


def segments(geometry: Geometry, height: float, sex: str, cuts: tuple[float, float] = (0.0, 0.0)) -> list[Segment]:
    """Distribution of mass of all segments, in the order of ``SEGMENTS``.

    Args:
        geometry: joint centres.
        height: stature [m].
        sex: whose table.
        cuts: how much higher pelvis and abdomen, and abdomen and thorax, are cut than they are here [m].
    """
    table, scale = DE_LEVA[sex], height / STATURE_OF_TABLE[sex]
    offset = dict(zip(SEGMENTS, geometry.offset.tolist(), strict=True))
    found = _trunk(offset, height, sex, cuts) | {"head": _head(table["head"], height, scale)}
    for side in SIDES:
        for part, child in (("upper_arm", "forearm"), ("forearm", "hand"), ("thigh", "shank"), ("shank", "foot")):
            found[f"{part}_{side}"] = _long(table[part], offset[f"{child}_{side}"], scale, sex, part, height)
        row = table["hand"]
        sagittal, transverse, along = (r * row.length * scale for r in _extents(row))
        found[f"hand_{side}"] = Segment(
            row.mass, (0.0, 0.0, -row.com * row.length * scale), (transverse, sagittal, along)
        )
        found[f"foot_{side}"] = _foot(table["foot"], height, sex)
    total = sum(segment.fraction for segment in found.values())
    return [Segment(found[n].fraction / total, found[n].com, found[n].extent) for n in SEGMENTS]


def _extents(row: Row) -> tuple[float, float, float]:
    """Extents along the sagittal (front), transverse (side) and longitudinal axis, fractions of the length.

    A radius of gyration about an axis is made of the extents along the two others.
    """
    s, t, l = row.sagittal**2, row.transverse**2, row.longitudinal**2
    return math.sqrt((t + l - s) / 2), math.sqrt((s + l - t) / 2), math.sqrt((s + t - l) / 2)


def _long(row: Row, end: list[float], scale: float, sex: str, part: str, height: float) -> Segment:
    """A segment from its joint to its child's. Radii keep their metres at the template's length.

    The forearm's table is for supination, a quarter turn from the neutral pose: its front and side change places.
    """
    stretch = math.sqrt(sum(v * v for v in end)) / (getattr(proportions(sex), f"{part}_length") * height)
    x, y, z = (e * row.length * scale for e in _extents(row))
    if part == "forearm":
        x, y = y, x
    com = (row.com * end[0], row.com * end[1], row.com * end[2])
    return Segment(row.mass, com, (x, y, z * stretch))


def _head(row: Row, height: float, scale: float) -> Segment:
    """Head and neck above the neck joint, which stands at the height of the cervicale; 3 cm before it at 1.74 m."""
    x, y, z = (e * row.length * scale for e in _extents(row))
    return Segment(row.mass, (0.017 * height, 0.0, (1 - row.com) * row.length * scale), (x, y, z))


def _foot(row: Row, height: float, sex: str) -> Segment:
    """Its long axis points forward; the ankle stands at 0.235 of the length from the heel; centre near the sole."""
    shape = proportions(sex)
    length = shape.foot_length * height
    along_side = _extents(row)
    com = ((row.com - 0.235) * length, 0.0, -0.58 * shape.ankle_height * height)
    # The table's sagittal axis is normal to the dorsum (the foot points down there): our vertical.
    return Segment(row.mass, com, (along_side[2] * length, along_side[1] * length, along_side[0] * length))


def _trunk(offset: dict[str, list[float]], height: float, sex: str, cuts: tuple[float, float]) -> dict[str, Segment]:
    """Pelvis, abdomen and thorax; de Leva's trunk is stretched to reach from the hips to our neck joint."""
    rows = [DE_LEVA[sex][f"{part}_trunk"] for part in ("lower", "middle", "upper")]
    low, mid, top = (offset[name] for name in ("abdomen", "thorax", "head"))
    joint, metres = low[2] + mid[2], height / STATURE_OF_TABLE[sex]
    stretch = (joint + top[2]) / sum(row.length for row in rows)
    slabs, bottom = [], 0.0
    for row in rows:
        slabs.append((_slab(row, bottom, row.length * stretch, metres), bottom, row.length * stretch))
        bottom += row.length * stretch
    (_, _, omphalion), (_, _, middle), _ = slabs
    usual = min(max(joint, omphalion + 0.05 * middle), omphalion + 0.95 * middle)
    least = 0.05 * middle
    first = min(max(omphalion + cuts[0], least), usual - least)
    second = min(max(usual + cuts[1], first + least), bottom - least)
    pelvis, abdomen, thorax = (_between(slabs, *ends) for ends in ((0.0, first), (first, second), (second, bottom)))
    # Front of the joints [m per m of stature]: belly and chest lie before the spine, the pelvis about over the hips.
    return {
        "pelvis": Segment(pelvis[0], (-0.005 * height, 0.0, pelvis[1]), pelvis[2]),
        "abdomen": Segment(abdomen[0], (0.014 * height, 0.0, abdomen[1] - low[2]), abdomen[2]),
        "thorax": Segment(thorax[0], (0.020 * height, 0.0, thorax[1] - joint), thorax[2]),
    }


_Slab = tuple[float, float, tuple[float, float, float]]
"""Mass fraction, height of the centre above the hips [m], extents [m]."""


def _slab(row: Row, bottom: float, thickness: float, metres: float) -> _Slab:
    x, y, z = (e * row.length * metres for e in _extents(row))
    return row.mass, bottom + (1 - row.com) * thickness, (x, y, z)


def _between(slabs: Sequence[tuple[_Slab, float, float]], low: float, high: float) -> _Slab:
    """What lies between two heights of slabs, each of uniform density shifted to its own centre of mass.

    Args:
        slabs: each with its bottom and its thickness [m].
        low, high: the heights [m].
    """
    found: _Slab | None = None
    for (mass, centre, (x, y, z)), bottom, thickness in slabs:
        start, stop = max(low, bottom), min(high, bottom + thickness)
        if stop > start:
            share = (stop - start) / thickness
            piece = mass * share, centre + 0.5 * (start + stop - 2.0 * bottom - thickness), (x, y, z * share)
            found = piece if found is None else _joined(found, piece)
    assert found is not None, "the heights are in order and within the slabs"
    return found


def _joined(a: _Slab, b: _Slab) -> _Slab:
    """Two slabs as one."""
    mass = a[0] + b[0]
    x, y, z = ((a[0] * p**2 + b[0] * q**2) / mass for p, q in zip(a[2], b[2], strict=True))
    z += a[0] * b[0] * (a[1] - b[1]) ** 2 / mass**2
    return mass, (a[0] * a[1] + b[0] * b[1]) / mass, (math.sqrt(x), math.sqrt(y), math.sqrt(z))
