"""The whole body's tree: 16 bodies, 41 coordinates of motion, and how their signs read.

Bodies' axes are parallel (X forward, Y left, Z up) in the neutral standing pose, arms hanging, palms to the thighs.
Signs follow ISB (Wu et al. 2002, J Biomech 35:543; 2005, 38:981): flexion, adduction, internal rotation, dorsiflexion,
inversion, pronation and ulnar deviation are positive on both sides, so that equal coordinates left and right are
mirrored poses; spine and neck: flexion, bending to the right, turning to the left are positive.

Three-axis joints turn about Y, X, Z in that order (flexion, adduction, rotation); the shoulder about Y, Z, X, because
the first sequence is singular at 90 degrees of abduction, an everyday pose, and this one only at 90 degrees of
rotation of the hanging arm. The subtalar axis leans 42 degrees up and 23 degrees inwards on average (Inman 1976, The
Joints of the Ankle; ranges 20-68 and 4-47).
Limits: American Academy of Orthopaedic Surgeons 1965 (Joint Motion), Roaas & Andersson 1982 (Acta Orthop Scand 53:205),
White & Panjabi 1990 for the spine, widened by about 10-20 degrees, since they act on an Euler sequence and bound
searches, not diagnoses. Posture scatter is weak; it settles how two spine joints share a bend that markers do not.
"""

import math
from dataclasses import dataclass

from torchid.model.tree import Body, Dof, Tree, Turn

SIDES = ("l", "r")
SEGMENTS = ("pelvis", "abdomen", "thorax", "head") + tuple(
    f"{part}_{side}" for side in SIDES for part in ("upper_arm", "forearm", "hand", "thigh", "shank", "foot")
)
X, Y, Z = 0, 1, 2
BASE_SD = 100.0
"""Scatter of the base's coordinates [m, rad]: no prior worth the name."""


@dataclass(frozen=True)
class JointAxis:
    """One coordinate of a joint: name, axis, sign on the right side, whether it mirrors, limits and scatter [deg]."""

    name: str
    axis: int
    sign: float
    mirrored: bool
    lower: float
    upper: float
    sd: float


@dataclass(frozen=True)
class Lean:
    """A hinge angle in front of a moving axis and undone behind it, mirrored between the sides."""

    name: str
    axis: int
    sign: float
    mirrored: bool


@dataclass(frozen=True)
class TemplateJoint:
    """A joint of the template: ``child`` on ``parent``, its axes in order, leans of its first or last axis."""

    name: str
    child: str
    parent: str
    axes: tuple[JointAxis, ...]
    leans: tuple[tuple[Lean, ...], ...] = ()
    """One tuple per axis; empty tuples for axes that do not lean."""


def _hinge(name: str) -> tuple[Lean, ...]:
    """Lean of a flexion axis: ``axis_x`` lowers its lateral end, ``axis_z`` brings its lateral end forward."""
    return (Lean(f"{name}_axis_x", X, 1.0, True), Lean(f"{name}_axis_z", Z, 1.0, True))


AXIAL = (
    TemplateJoint(
        "lower_spine", "abdomen", "pelvis",
        (
            JointAxis("lower_spine_flexion", Y, 1.0, False, -40.0, 75.0, 25.0),
            JointAxis("lower_spine_bending", X, 1.0, False, -40.0, 40.0, 20.0),
            JointAxis("lower_spine_rotation", Z, 1.0, False, -35.0, 35.0, 15.0),
        ),
    ),
    TemplateJoint(
        "upper_spine", "thorax", "abdomen",
        (
            JointAxis("upper_spine_flexion", Y, 1.0, False, -40.0, 65.0, 25.0),
            JointAxis("upper_spine_bending", X, 1.0, False, -45.0, 45.0, 20.0),
            JointAxis("upper_spine_rotation", Z, 1.0, False, -55.0, 55.0, 20.0),
        ),
    ),
    TemplateJoint(
        "neck", "head", "thorax",
        (
            JointAxis("neck_flexion", Y, 1.0, False, -80.0, 80.0, 30.0),
            JointAxis("neck_bending", X, 1.0, False, -60.0, 60.0, 20.0),
            JointAxis("neck_rotation", Z, 1.0, False, -95.0, 95.0, 35.0),
        ),
    ),
)  # fmt: skip
LIMBS = (
    TemplateJoint(
        "shoulder", "upper_arm", "thorax",
        (
            JointAxis("shoulder_flexion", Y, -1.0, False, -90.0, 190.0, 60.0),
            JointAxis("shoulder_rotation", Z, 1.0, True, -85.0, 85.0, 45.0),
            JointAxis("shoulder_adduction", X, 1.0, True, -190.0, 75.0, 60.0),
        ),
    ),
    TemplateJoint(
        "elbow", "forearm", "upper_arm",
        (
            JointAxis("elbow_flexion", Y, -1.0, False, -15.0, 160.0, 60.0),
            JointAxis("elbow_pronation", Z, 1.0, True, -105.0, 105.0, 50.0),
        ),
        (_hinge("elbow"), ()),
    ),
    TemplateJoint(
        "wrist", "hand", "forearm",
        (
            JointAxis("wrist_flexion", X, 1.0, True, -90.0, 95.0, 30.0),
            JointAxis("wrist_deviation", Y, 1.0, False, -35.0, 50.0, 15.0),
        ),
    ),
    TemplateJoint(
        "hip", "thigh", "pelvis",
        (
            JointAxis("hip_flexion", Y, -1.0, False, -45.0, 145.0, 45.0),
            JointAxis("hip_adduction", X, 1.0, True, -70.0, 50.0, 20.0),
            JointAxis("hip_rotation", Z, 1.0, True, -65.0, 65.0, 20.0),
        ),
    ),
    TemplateJoint("knee", "shank", "thigh", (JointAxis("knee_flexion", Y, 1.0, False, -15.0, 165.0, 50.0),),
    (_hinge("knee"),)),
    TemplateJoint(
        "ankle", "foot", "shank",
        (
            JointAxis("ankle_flexion", Y, -1.0, False, -70.0, 50.0, 25.0),
            JointAxis("ankle_inversion", X, 1.0, True, -45.0, 55.0, 15.0),
        ),
        (
            _hinge("ankle"),
            # The azimuth comes first, so that the elevation is that of the axis itself.
            (Lean("subtalar_axis_z", Z, 1.0, True), Lean("subtalar_axis_y", Y, -1.0, False)),
        ),
    ),
)  # fmt: skip


def _sided(joint: TemplateJoint, side: str) -> TemplateJoint:
    """The joint of one side: names take ``_l`` or ``_r``, mirrored signs turn on the left."""
    flip = -1.0 if side == "l" else 1.0

    def name(text: str) -> str:
        stem, _, tail = text.partition("_")
        return f"{stem}_{side}_{tail}"

    return TemplateJoint(
        f"{joint.name}_{side}",
        f"{joint.child}_{side}",
        joint.parent if joint.parent in SEGMENTS else f"{joint.parent}_{side}",
        tuple(
            JointAxis(name(a.name), a.axis, a.sign * (flip if a.mirrored else 1.0), a.mirrored, a.lower, a.upper, a.sd)
            for a in joint.axes
        ),
        tuple(
            tuple(Lean(name(n.name), n.axis, n.sign * (flip if n.mirrored else 1.0), n.mirrored) for n in leans)
            for leans in joint.leans
        ),
    )


JOINTS = AXIAL + tuple(_sided(joint, side) for side in SIDES for joint in LIMBS)
"""Joints of the whole body; the n-th carries the n-th segment after the pelvis."""


def whole_body_tree(hip_height: float) -> Tree:
    """Tree of the whole body; ``hip_height`` [m] is where the base rests.

    The base's three rotations are a rotation vector; its three positions are the midpoint of the hips.
    """
    hinges = tuple(lean.name for joint in JOINTS for leans in joint.leans for lean in leans)
    dofs = _base_dofs(hip_height)
    bodies = [Body("pelvis", -1)]
    for joint in JOINTS:
        turns: list[Turn] = []
        for k, axis in enumerate(joint.axes):
            leans = joint.leans[k] if joint.leans else ()
            tilt = [Turn(n.axis, hinges.index(n.name), moving=False, sign=n.sign) for n in leans]
            undo = [Turn(t.axis, t.row, moving=False, sign=-t.sign) for t in reversed(tilt)]
            turns += [*tilt, Turn(axis.axis, len(dofs), sign=axis.sign), *undo]
            dofs.append(_dof(axis))
        bodies.append(Body(joint.child, SEGMENTS.index(joint.parent), tuple(turns)))
    return Tree(tuple(bodies), tuple(dofs), hinges)


def _base_dofs(hip_height: float) -> list[Dof]:
    rest = {"pelvis_z": hip_height}
    return [
        Dof(f"pelvis_{axis}", unit, rest=rest.get(f"pelvis_{axis}", 0.0), sd=BASE_SD)
        for unit, axes in (("m", ("x", "y", "z")), ("rad", ("rx", "ry", "rz")))
        for axis in axes
    ]


def _dof(axis: JointAxis) -> Dof:
    return Dof(axis.name, "rad", math.radians(axis.lower), math.radians(axis.upper), 0.0, math.radians(axis.sd))
