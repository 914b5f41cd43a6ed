"""A person drawn from tables of anthropometry: joint centres, axes, inertia and markers of 16 segments.

Nothing here comes from torchid. Tables: Winter 2009 (Biomechanics and Motor Control of Human Movement, Table 4.1) and
de Leva 1996 (J Biomech 29:1223, Table 4), between which the means lie; Gordon et al. 2014 (ANSUR II) for breadths.
Axes of all segments are parallel in the neutral stance (x forward, y left, z up), arms hanging, palms to the thighs.
Lengths are metres for a stature of 1.74 m and scale with it; y is outward on the left side and mirrored on the right.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

SIDES = ("l", "r")
TABLE_STATURE = 1.74
"""Stature that the tables' metres belong to [m]."""
STATURE = {"male": (1.75, 0.065), "female": (1.63, 0.060)}
Vector = tuple[float, float, float]

PARENTS = {"pelvis": "", "abdomen": "pelvis", "thorax": "abdomen", "head": "thorax", "upper_arm": "thorax",
           "forearm": "upper_arm", "hand": "forearm", "thigh": "pelvis", "shank": "thigh", "foot": "shank"}  # fmt: skip
JOINTS = {"abdomen": "lower_spine", "thorax": "upper_spine", "head": "neck", "upper_arm": "shoulder", "hand": "wrist",
          "forearm": "elbow", "thigh": "hip", "shank": "knee", "foot": "ankle"}  # fmt: skip
CENTRES: dict[str, tuple[Vector, Vector]] = {
    "abdomen": ((-0.024, 0.0, 0.112), (0.008, 0.0, 0.008)),
    "thorax": ((-0.012, 0.0, 0.194), (0.009, 0.0, 0.008)),
    "head": ((0.008, 0.0, 0.286), (0.009, 0.0, 0.009)),
    "upper_arm": ((0.026, 0.174, 0.171), (0.009, 0.008, 0.012)),
    "forearm": ((0.0, 0.0, -0.284), (0.003, 0.003, 0.009)),
    "hand": ((0.0, 0.0, -0.267), (0.003, 0.003, 0.008)),
    "thigh": ((0.0, 0.0905, 0.0), (0.0, 0.004, 0.0)),
    "shank": ((0.0, 0.0, -0.413), (0.003, 0.003, 0.012)),
    "foot": ((0.0, 0.0, -0.424), (0.003, 0.003, 0.012)),
}
"""Joint centre of each segment in its parent's axes: mean and scatter [m]."""
ANKLE_HEIGHT = 0.072
"""Ankle centre over the sole [m]."""
MIDFOOT = 0.055
"""Where a foot bears at ease, ahead of the ankle [m]."""

INERTIA: dict[str, tuple[float, Vector, Vector]] = {
    "pelvis": (0.118, (-0.008, 0.0, 0.052), (0.058, 0.074, 0.052)),
    "abdomen": (0.100, (0.020, 0.0, 0.060), (0.060, 0.078, 0.042)),
    "thorax": (0.222, (0.030, 0.0, 0.138), (0.064, 0.086, 0.084)),
    "head": (0.069, (0.028, 0.0, 0.118), (0.050, 0.043, 0.061)),
    "upper_arm": (0.0272, (0.0, 0.0, -0.157), (0.031, 0.031, 0.072)),
    "forearm": (0.0160, (0.0, 0.0, -0.121), (0.022, 0.022, 0.069)),
    "hand": (0.0060, (0.0, 0.0, -0.066), (0.031, 0.013, 0.042)),
    "thigh": (0.1330, (0.0, 0.004, -0.172), (0.046, 0.046, 0.128)),
    "shank": (0.0440, (-0.004, 0.0, -0.186), (0.031, 0.031, 0.102)),
    "foot": (0.0138, (0.050, 0.0, -0.039), (0.061, 0.025, 0.021)),
}
"""Share of the mass, centre of mass [m], root of the second moment per mass along each axis [m]."""
MASS_SCATTER, COM_SCATTER, EXTENT_SCATTER, LEAN_SCATTER = 0.08, 0.006, 0.06, np.radians(4.0)
"""Of the logarithm of a share, a coordinate [m], the logarithm of an extent, and principal axes [rad]."""

LEANS: dict[str, tuple[Vector, Vector]] = {
    "elbow": ((0.0, 1.0, 0.0), (0.09, 0.0, 0.09)),
    "knee": ((0.0, 1.0, 0.0), (0.07, 0.0, 0.08)),
    "ankle": ((-0.10, 0.99, -0.12), (0.09, 0.0, 0.07)),
    "subtalar": ((0.70, -0.28, 0.66), (0.0, 0.09, 0.08)),
}
"""Axes of the hinges on the left side, pointing outward or forward, and scatter of their components (Inman 1976)."""

MARKERS: dict[str, tuple[str, str, str, Vector]] = {
    "C7": ("thorax", "c7", "head", (-0.065, 0.0, -0.008)),
    "T10": ("thorax", "t10", "", (-0.070, 0.0, 0.045)),
    "CLAV": ("thorax", "jugular_notch", "", (0.078, 0.0, 0.200)),
    "STRN": ("thorax", "xiphoid", "", (0.128, 0.0, 0.048)),
    "BACK": ("thorax", "", "", (-0.095, -0.090, 0.130)),
    "BELF": ("abdomen", "", "", (0.125, 0.020, 0.080)),
    "BELB": ("abdomen", "", "", (-0.065, -0.010, 0.085)),
    "BELL": ("abdomen", "", "", (0.030, 0.150, 0.070)),
    "BELR": ("abdomen", "", "", (0.040, -0.150, 0.095)),
    "SACR": ("pelvis", "", "", (-0.108, 0.0, 0.060)),
    "?ASI": ("pelvis", "asis", "", (0.070, 0.120, 0.074)),
    "?PSI": ("pelvis", "psis", "", (-0.112, 0.048, 0.098)),
    "?FHD": ("head", "head_front", "", (0.102, 0.070, 0.137)),
    "?BHD": ("head", "head_back", "", (-0.058, 0.066, 0.134)),
    "?SHO": ("thorax", "acromion", "upper_arm", (-0.011, -0.003, 0.057)),
    "?UPA": ("upper_arm", "", "", (0.010, 0.060, -0.130)),
    "?ELB": ("upper_arm", "elbow_lateral", "forearm", (0.0, 0.041, 0.0)),
    "?ELM": ("upper_arm", "elbow_medial", "forearm", (0.0, -0.040, 0.0)),
    "?FRA": ("forearm", "", "", (-0.015, 0.048, -0.120)),
    "?WRA": ("forearm", "wrist_radial", "hand", (0.034, 0.0, 0.0)),
    "?WRB": ("forearm", "wrist_ulnar", "hand", (-0.033, 0.0, 0.0)),
    "?FIN": ("hand", "", "", (0.020, 0.026, -0.095)),
    "?HAR": ("hand", "", "", (0.040, 0.020, -0.072)),
    "?HAU": ("hand", "", "", (-0.036, 0.022, -0.064)),
    "?THI": ("thigh", "", "", (0.025, 0.092, -0.230)),
    "?THF": ("thigh", "", "", (0.090, 0.015, -0.165)),
    "?KNE": ("thigh", "knee_lateral", "shank", (0.0, 0.060, 0.0)),
    "?KNM": ("thigh", "knee_medial", "shank", (0.0, -0.059, 0.0)),
    "?TIB": ("shank", "", "", (0.015, 0.064, -0.190)),
    "?TIF": ("shank", "", "", (0.058, 0.0, -0.130)),
    "?ANK": ("shank", "ankle_lateral", "foot", (-0.003, 0.048, -0.004)),
    "?ANM": ("shank", "ankle_medial", "foot", (0.003, -0.047, 0.004)),
    "?HEE": ("foot", "heel", "", (-0.076, 0.0, -0.039)),
    "?TOE": ("foot", "toe", "", (0.145, -0.005, -0.025)),
    "?MT1": ("foot", "mt1", "", (0.128, -0.046, -0.034)),
    "?MT5": ("foot", "mt5", "", (0.106, 0.053, -0.046)),
}
"""Segment, landmark, the joint (by its child) from which the place is measured, place [m]; ``?`` becomes L and R."""
LANDMARK_SCATTER, FREE_SCATTER = 0.006, 0.010
"""Of each coordinate of a marker's place [m]."""


@dataclass(frozen=True)
class Segment:
    """A rigid part, in its own axes from its proximal joint centre."""

    parent: str
    centre: np.ndarray
    """Its joint centre in the parent's axes (3,) [m]."""
    mass: float
    com: np.ndarray
    """(3,) [m]"""
    inertia: np.ndarray
    """About the centre of mass (3, 3) [kg m^2]."""


@dataclass(frozen=True)
class Marker:
    """A marker glued to a segment."""

    segment: str
    landmark: str
    """Empty where it sits on none."""
    place: np.ndarray
    """In the segment's axes (3,) [m]."""


@dataclass(frozen=True)
class Person:
    """The truth about a body."""

    sex: str
    height: float
    mass: float
    segments: dict[str, Segment]
    axes: dict[str, np.ndarray]
    """Unit vectors of leaning hinges by joint, as ``knee_l`` (3,)."""
    markers: dict[str, Marker]
    ankle_height: float
    scale: float
    """Stature over that of the tables."""


def draw_person(rng: np.random.Generator) -> Person:
    """A person of random sex, stature, mass and proportions."""
    sex = str(rng.choice(["male", "female"]))
    mean, sd = STATURE[sex]
    height = mean + sd * float(_normal(rng))
    scale, mass = height / TABLE_STATURE, (23.5 + 2.2 * float(_normal(rng))) * height**2
    centres = _centres(rng, scale)
    inertia = _inertia(rng, scale, mass, centres)
    segments = {name: Segment(sided(PARENTS[_stem(name)], name), centres[name], *inertia[name]) for name in centres}
    axes = {f"{joint}_{side}": _axis(rng, joint, side) for joint in LEANS for side in SIDES}
    markers = _markers(rng, scale, centres)
    ankle = ANKLE_HEIGHT * scale + 0.003 * float(_normal(rng))
    return Person(sex, height, mass, segments, axes, markers, ankle, scale)


def segment_names() -> list[str]:
    """All 16, parents before children."""
    paired = ("upper_arm", "forearm", "hand", "thigh", "shank", "foot")
    return ["pelvis", "abdomen", "thorax", "head"] + [f"{part}_{side}" for side in SIDES for part in paired]


def _stem(name: str) -> str:
    return name[:-2] if name[-2:] in ("_l", "_r") else name


def sided(stem: str, like: str) -> str:
    """The segment ``stem`` of the side of ``like``, where it has sides."""
    return stem if stem in ("", "pelvis", "abdomen", "thorax", "head") else stem + like[-2:]


def _normal(rng: np.random.Generator, size: int | None = None) -> np.ndarray:
    """Normal numbers within two standard deviations."""
    return np.clip(rng.normal(size=size), -2.0, 2.0)


def _outward(vector: np.ndarray, side: str) -> np.ndarray:
    return vector * np.array([1.0, -1.0, 1.0]) if side == "r" else vector


def _centres(rng: np.random.Generator, scale: float) -> dict[str, np.ndarray]:
    """Joint centres; sides share nine tenths of the variance of their lengths."""
    found = {"pelvis": np.zeros(3)}
    common = {part: _normal(rng, 3) for part in CENTRES}
    for name in segment_names()[1:]:
        mean, sd = (np.array(v) for v in CENTRES[_stem(name)])
        mix = np.array([0.3, 0.3, 0.95]) if name[-2:] in ("_l", "_r") and _stem(name) != "thigh" else np.ones(3)
        unit = mix * common[_stem(name)] + np.sqrt(1.0 - mix**2) * _normal(rng, 3)
        found[name] = _outward(scale * (mean + sd * unit), name[-1] if name[-2] == "_" else "l")
    return found


def _inertia(
    rng: np.random.Generator, scale: float, mass: float, centres: dict[str, np.ndarray]
) -> dict[str, tuple[float, np.ndarray, np.ndarray]]:
    """Mass, centre of mass and inertia of each segment; the masses sum to the person's."""
    common = {part: _normal(rng) for part in INERTIA}
    share = {
        name: INERTIA[_stem(name)][0] * np.exp(MASS_SCATTER * (0.9 * common[_stem(name)] + 0.43 * _normal(rng)))
        for name in centres
    }
    total = sum(share.values())
    found = {}
    for name in centres:
        _, com, extent = (np.array(v) for v in INERTIA[_stem(name)])
        own = share[name] / total * mass
        place = _outward(scale * com, name[-1] if name[-2] == "_" else "l") + COM_SCATTER * _normal(rng, 3)
        lean = Rotation.from_rotvec(LEAN_SCATTER * _normal(rng, 3)).as_matrix()
        second = own * np.diag((scale * extent * np.exp(EXTENT_SCATTER * _normal(rng, 3))) ** 2)
        found[name] = float(own), place, lean @ (np.trace(second) * np.eye(3) - second) @ lean.T
    return found


def _axis(rng: np.random.Generator, joint: str, side: str) -> np.ndarray:
    mean, sd = (np.array(v) for v in LEANS[joint])
    axis = mean + sd * 0.7 * _normal(rng, 3)
    # A hinge's axis is a pseudovector: mirrored, its y stays, so that equal flexions left and right are mirror images.
    mirror = np.array([-1.0, 1.0, -1.0]) if side == "r" else np.ones(3)
    return mirror * axis / np.linalg.norm(axis)


def _markers(rng: np.random.Generator, scale: float, centres: dict[str, np.ndarray]) -> dict[str, Marker]:
    found = {}
    for pattern, (part, landmark, origin, place) in MARKERS.items():
        for letter, side in (("L", "l"), ("R", "r")) if "?" in pattern else (("", ""),):
            segment = sided(part, f"_{side}")
            base = centres[sided(origin, f"_{side}")] if origin else np.zeros(3)
            scatter = LANDMARK_SCATTER if landmark else FREE_SCATTER
            at = base + _outward(scale * np.array(place), side) + scatter * _normal(rng, 3)
            name = f"{landmark}_{side}" if landmark and side else landmark
            found[pattern.replace("?", letter)] = Marker(segment, name, at)
    return found
