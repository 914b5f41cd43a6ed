"""Where the markers on bony landmarks sit on the scaled template.

Places are centres of markers: ``COVER`` from the bone (7 mm radius of the marker and base, 5 mm of skin; Harrington et
al. 2007 and Bell et al. 1990, J Biomech 23:617, find the same order). Pelvis: the anterior iliac spines stand before
and above the hip centres as in Harrington's regression for the mean pelvis tilted by 10 degrees. Breadths of knee,
ankle, elbow, wrist, head and foot: Gordon et al. 2014 (ANSUR II). Spinal and sternal levels: van Sint Jan 2007 (Color
Atlas of Skeletal Landmark Definitions). Scatter, a choice: 5-15 mm for palpation (on its precision: Della Croce et al.
1999, Med Biol Eng Comput 37:155) and anatomy of similar size; more where a point is badly defined or a segment bends.
Acromion, toe, xiphoid, posterior spines and the breadths of elbow and wrist were moved towards eleven trials of public
recordings; with pose and lengths free under their priors the mean square of those trials' standardised residuals is
then 0.3 to 0.7 per coordinate, which is a fit, not a test.
"""

import math

from torchid.model.model import Landmark
from torchid.model.proportions import Proportions

COVER = 0.012
"""From the bone to the centre of a marker [m]."""
PELVIC_TILT = math.radians(10.0)
"""Of the line from posterior to anterior iliac spines in the neutral pose, front down."""
PELVIS_DEPTH = 0.095
"""From anterior to posterior iliac spines, fraction of stature."""
ANKLE_FROM_HEEL = 0.235
"""Fraction of the foot's length."""

KNUCKLE = 0.0495
"""From the wrist to the head of the third metacarpal, fraction of stature (de Leva, J Biomech 29:1223, 1996)."""

_Place = tuple[str, tuple[float, float, float], tuple[float, float, float]]
"""Segment, place (x forward, y outward, z up) [m], scatter [mm]."""
SIDED = (
    "asis", "psis", "trochanter", "knee_lateral", "knee_medial", "ankle_lateral", "ankle_medial", "heel", "toe", "mt1",
    "mt5", "acromion", "elbow_lateral", "elbow_medial", "wrist_radial", "wrist_ulnar", "head_front", "head_back",
    "tuberosity", "knuckle",
)  # fmt: skip
CENTRAL = ("c7", "t10", "jugular_notch", "xiphoid")
LANDMARKS = CENTRAL + tuple(f"{name}_{side}" for name in SIDED for side in ("l", "r"))


def whole_body_landmarks(shape: Proportions, height: float) -> dict[str, Landmark]:
    """Landmarks of the template of that stature [m], left and right mirrored."""
    found: dict[str, Landmark] = {}
    for name, (segment, place, sd) in _central(shape, height).items():
        found[name] = _landmark(segment, place, sd)
    for name, (segment, place, sd) in (_pelvis(shape, height) | _leg(shape, height) | _arm(shape, height)).items():
        for side, sign in (("l", 1.0), ("r", -1.0)):
            own = segment if segment in ("pelvis", "thorax", "head") else f"{segment}_{side}"
            found[f"{name}_{side}"] = _landmark(own, (place[0], sign * place[1], place[2]), sd)
    return found


def _landmark(segment: str, place: tuple[float, float, float], sd: tuple[float, float, float]) -> Landmark:
    return Landmark(segment, place, (1e-3 * sd[0], 1e-3 * sd[1], 1e-3 * sd[2]))


def _pelvis(p: Proportions, h: float) -> dict[str, _Place]:
    asis = (p.asis_x * h, 0.5 * p.asis_width * h, p.asis_z * h)
    depth = PELVIS_DEPTH * h
    psis = (asis[0] - depth * math.cos(PELVIC_TILT), 0.027 * h, asis[2] + depth * math.sin(PELVIC_TILT))
    return {
        "asis": ("pelvis", (asis[0] + COVER, asis[1], asis[2]), (12.0, 12.0, 12.0)),
        "psis": ("pelvis", (psis[0] - COVER, psis[1], psis[2]), (12.0, 13.0, 12.0)),
    }


def _leg(p: Proportions, h: float) -> dict[str, _Place]:
    thigh, shank, ankle, foot = (
        f * h for f in (p.thigh_length, p.shank_length, p.ankle_height, p.foot_length)
    )  # fmt: skip
    knee, malleoli = 0.0275 * h + COVER, 0.0205 * h + COVER

    def sole(x: float, y: float, z: float) -> tuple[float, float, float]:
        """From the heel, the foot's midline and the sole, in fractions of the foot's length."""
        return ((x - ANKLE_FROM_HEEL) * foot, y * foot, z * foot - ankle)

    return {
        "trochanter": ("thigh", (-0.005 * h, 0.041 * h + COVER, -0.010 * h), (15.0, 12.0, 18.0)),
        "knee_lateral": ("thigh", (0.0, knee, -thigh), (10.0, 8.0, 10.0)),
        "knee_medial": ("thigh", (0.0, -knee, -thigh), (10.0, 8.0, 10.0)),
        "tuberosity": ("shank", (0.025 * h + COVER, 0.0, -0.030 * h), (15.0, 15.0, 20.0)),
        "ankle_lateral": ("shank", (-0.002 * h, malleoli, -shank - 0.0026 * h), (8.0, 7.0, 8.0)),
        "ankle_medial": ("shank", (0.002 * h, -malleoli, -shank + 0.0026 * h), (8.0, 7.0, 8.0)),
        "heel": ("foot", (sole(-0.01, 0.0, 0.0)[0] - COVER, 0.0, sole(0.0, 0.0, 0.13)[2]), (12.0, 10.0, 15.0)),
        "toe": (
            "foot",
            (sole(0.79, 0.0, 0.0)[0], sole(0.0, -0.02, 0.0)[1], sole(0.0, 0.0, 0.14)[2] + COVER),
            (30.0, 16.0, 12.0),
        ),
        "mt1": (
            "foot",
            (sole(0.73, 0.0, 0.0)[0], sole(0.0, -0.18, 0.0)[1], sole(0.0, 0.0, 0.10)[2] + COVER),
            (18.0, 12.0, 12.0),
        ),
        "mt5": (
            "foot",
            (sole(0.64, 0.0, 0.0)[0], sole(0.0, 0.18, 0.0)[1] + 0.5 * COVER, sole(0.0, 0.0, 0.10)[2]),
            (18.0, 12.0, 12.0),
        ),
    }


def _arm(p: Proportions, h: float) -> dict[str, _Place]:
    shoulder = (p.shoulder_x * h, p.shoulder_y * h, p.shoulder_z * h)
    elbow, wrist = 0.0165 * h + COVER, 0.0125 * h + COVER
    upper, fore = p.upper_arm_length * h, p.forearm_length * h
    return {
        "acromion": (
            "thorax",
            (shoulder[0] - 0.006 * h, shoulder[1] - 0.001 * h, shoulder[2] + 0.026 * h + COVER),
            (15.0, 15.0, 15.0),
        ),
        "elbow_lateral": ("upper_arm", (0.0, elbow, -upper), (10.0, 10.0, 10.0)),
        "elbow_medial": ("upper_arm", (0.0, -elbow, -upper), (10.0, 10.0, 10.0)),
        "wrist_radial": ("forearm", (wrist, 0.0, -fore), (10.0, 12.0, 10.0)),
        "wrist_ulnar": ("forearm", (-wrist, 0.0, -fore), (10.0, 12.0, 10.0)),
        "knuckle": ("hand", (0.0, 0.008 * h + COVER, -KNUCKLE * h), (20.0, 15.0, 20.0)),
        "head_front": ("head", (0.060 * h, 0.038 * h + 0.5 * COVER, 0.080 * h), (20.0, 15.0, 20.0)),
        "head_back": ("head", (-0.032 * h, 0.034 * h + 0.5 * COVER, 0.078 * h), (20.0, 15.0, 20.0)),
    }


def _central(p: Proportions, h: float) -> dict[str, _Place]:
    neck = (p.neck_x * h, p.neck_z * h)
    return {
        "c7": ("thorax", (neck[0] - 0.030 * h - COVER, 0.0, neck[1] - 0.004 * h), (12.0, 8.0, 12.0)),
        "t10": ("thorax", (-0.032 * h - COVER, 0.0, 0.025 * h), (18.0, 8.0, 28.0)),
        "jugular_notch": ("thorax", (0.038 * h + COVER, 0.0, p.shoulder_z * h + 0.014 * h), (15.0, 8.0, 15.0)),
        "xiphoid": ("thorax", (0.068 * h + COVER, 0.0, 0.026 * h), (20.0, 8.0, 22.0)),
    }
