"""MuJoCo as physics: the person as MJCF, and the wrench that a motion needs from the ground.

``mj_inverse`` gives the generalised force on the free joint of the pelvis; nothing touches anything in MuJoCo. Every
result is compared with the rate of change of the momentum that MuJoCo reports.
"""

from dataclasses import dataclass, field

import mujoco
import numpy as np
from scipy.interpolate import make_interp_spline

from mujoco_laboratory.body import JOINTS, Person

GRAVITY = 9.80665
RATE = 100.0
"""Frames per second of motions [Hz]."""
FREE = 7
"""Numbers in qpos that place the pelvis."""
TURNS: dict[str, tuple[tuple[str, str], ...]] = {
    "lower_spine": (("flexion", "y"), ("bending", "x"), ("rotation", "z")),
    "upper_spine": (("flexion", "y"), ("bending", "x"), ("rotation", "z")),
    "neck": (("flexion", "y"), ("bending", "x"), ("rotation", "z")),
    "shoulder": (("flexion", "-y"), ("abduction", "x"), ("rotation", "z")),
    "elbow": (("flexion", "-elbow"), ("pronation", "z")),
    "wrist": (("flexion", "x"), ("deviation", "y")),
    "hip": (("flexion", "-y"), ("abduction", "x"), ("rotation", "z")),
    "knee": (("flexion", "knee"),),
    "ankle": (("flexion", "-ankle"), ("inversion", "-subtalar")),
}
"""Coordinates of each joint in order and their axes on the left side; the right side's are mirrored."""


@dataclass(frozen=True)
class Extra:
    """What an effect adds to the body itself."""

    payloads: tuple[tuple[str, float, np.ndarray], ...] = ()
    """Segment, mass [kg], point in its axes [m]."""
    lighter: dict[str, float] = field(default_factory=dict)
    """Mass taken out of a segment at its centre of mass [kg]."""
    joints: tuple[tuple[str, str, str, np.ndarray], ...] = ()
    """Segment, name, ``hinge`` or ``slide``, axis: freedoms of a joint that no model has. Slides come before the
    joint's own turns (so their axes are the parent's), hinges behind them."""


def mjcf(person: Person, extra: Extra) -> str:
    """The body as MJCF text."""
    bodies = "".join(_body(person, extra, name) for name, s in person.segments.items() if not s.parent)
    return (
        '<mujoco><compiler angle="radian" autolimits="false" inertiafromgeom="false"/>'
        '<option><flag contact="disable" constraint="disable"/></option>'
        f"<worldbody>{bodies}</worldbody></mujoco>"
    )


def _body(person: Person, extra: Extra, name: str) -> str:
    segment = person.segments[name]
    children = "".join(_body(person, extra, child) for child, s in person.segments.items() if s.parent == name)
    sites = "".join(
        f'<site name="{label}" pos="{_text(m.place)}"/>' for label, m in person.markers.items() if m.segment == name
    )
    return (
        f'<body name="{name}" pos="{_text(segment.centre)}">{_joints(person, extra, name)}'
        f"{_inertial(segment.mass - extra.lighter.get(name, 0.0), segment.com, segment.inertia)}{sites}{children}"
        f"{''.join(_payload(*p[1:]) for p in extra.payloads if p[0] == name)}</body>"
    )


def _joints(person: Person, extra: Extra, name: str) -> str:
    if not person.segments[name].parent:
        return '<freejoint name="pelvis"/>'
    own = "".join(f'<joint name="{n}" type="hinge" axis="{_text(a)}"/>' for n, a in turns(person, name))
    texts = {"hinge": "", "slide": ""}
    for segment, label, kind, axis in extra.joints:
        texts[kind] += f'<joint name="{label}" type="{kind}" axis="{_text(axis)}"/>' if segment == name else ""
    return texts["slide"] + own + texts["hinge"]


def turns(person: Person, name: str) -> list[tuple[str, np.ndarray]]:
    """Names and axes of the turns that carry a segment on its parent."""
    stem, side = (name[:-2], name[-1]) if name[-2:] in ("_l", "_r") else (name, "")
    joint = JOINTS[stem] + (f"_{side}" if side else "")
    mirror = np.array([-1.0, 1.0, -1.0]) if side == "r" else np.ones(3)
    found = []
    for label, text in TURNS[JOINTS[stem]]:
        sign, which = (-1.0, text[1:]) if text[0] == "-" else (1.0, text)
        axis = mirror * np.eye(3)["xyz".index(which)] if which in "xyz" else person.axes[f"{which}_{side}"]
        found.append((f"{joint}_{label}", sign * axis))
    return found


def _inertial(mass: float, com: np.ndarray, inertia: np.ndarray) -> str:
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = inertia
    full = _text(np.array([xx, yy, zz, xy, xz, yz]))
    return f'<inertial pos="{_text(com)}" mass="{mass:.17g}" fullinertia="{full}"/>'


def _payload(mass: float, point: np.ndarray) -> str:
    """A ball of 4 cm radius of gyration, which is nearly a point."""
    tiny = np.full(3, mass * 0.04**2)
    inertial = f'<inertial pos="0 0 0" mass="{mass:.17g}" diaginertia="{_text(tiny)}"/>'
    return f'<body pos="{_text(point)}">{inertial}</body>'


def _text(values: np.ndarray) -> str:
    return " ".join(f"{v:.17g}" for v in values)


@dataclass(frozen=True)
class Moved:
    """A motion and what it needs; W axes, first axis frames."""

    time: np.ndarray
    wrench: np.ndarray
    """From the ground on the subject about the origin of W (frames, 6) [N, N m]."""
    names: dict[str, int]
    """Row of each body."""
    p: np.ndarray
    """Origins (frames, bodies, 3) [m]."""
    R: np.ndarray
    """(frames, bodies, 3, 3)"""
    com: np.ndarray
    """Centres of mass of the bodies (frames, bodies, 3) [m]."""
    w: np.ndarray
    """Angular velocities (frames, bodies, 3) [rad/s]."""
    markers: np.ndarray
    """(frames, markers, 3) [m]"""
    mass: float
    """Of all bodies [kg]."""
    body_com: np.ndarray
    """Of all bodies together (frames, 3) [m]."""
    miss: float
    """Largest disagreement with the rate of change of momentum, part of the weight (and of that times a metre)."""


def derivative(values: np.ndarray, order: int = 1) -> np.ndarray:
    """Time derivative along the first axis, of the quintic spline through the frames."""
    clock = np.arange(len(values)) / RATE
    return make_interp_spline(clock, values, k=5).derivative(order)(clock)


def velocities(q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """MuJoCo's qvel and qacc of positions (frames, nq); the pelvis' angular ones are in its own axes."""
    qd, qdd = derivative(q), derivative(q, 2)
    velocity, acceleration = (
        np.concatenate([d[:, :3], _local(q[:, 3:FREE], d[:, 3:FREE]), d[:, FREE:]], 1) for d in (qd, qdd)
    )
    return velocity, acceleration


def _local(wxyz: np.ndarray, rate: np.ndarray) -> np.ndarray:
    """Vector part of 2 conj(q) * rate: angular velocity in body axes, and acceleration for the second derivative."""
    s, v, ds, dv = wxyz[:, :1], wxyz[:, 1:], rate[:, :1], rate[:, 1:]
    return 2.0 * (s * dv - ds * v - np.cross(v, dv))


def inverse(model: mujoco.MjModel, time: np.ndarray, q: np.ndarray, gravity: np.ndarray) -> Moved:
    """What a motion needs from the ground.

    Args:
        model: of the person.
        time: of the frames [s].
        q: MuJoCo positions (frames, nq).
        gravity: at each frame (frames, 3) [m/s^2]; it moves where the laboratory shakes.
    """
    qvel, qacc = velocities(q)
    data = mujoco.MjData(model)
    seen: list[list[np.ndarray]] = []
    for k in range(len(time)):
        model.opt.gravity[:] = gravity[k]
        data.qpos[:], data.qvel[:], data.qacc[:] = q[k], qvel[k], qacc[k]
        mujoco.mj_inverse(model, data)
        mujoco.mj_subtreeVel(model, data)
        seen.append([a.copy() for a in (data.qfrc_inverse[:6], data.xpos, data.xmat, data.xipos, data.cvel,
                     data.site_xpos, data.subtree_com[0], data.subtree_linvel[0], data.subtree_angmom[0])])  # fmt: skip
    force, p, R, com, cvel, markers, middle, velocity, spin = (np.array(part) for part in zip(*seen, strict=True))
    R = R.reshape(*R.shape[:2], 3, 3)
    wrench = _at_origin(force, R[:, 1], q[:, :3])
    mass = float(model.body_mass.sum())
    miss = _disagreement(wrench, mass, middle, velocity, spin, gravity)
    names = {model.body(k).name: k for k in range(model.nbody) if model.body(k).name}
    return Moved(time, wrench, names, p, R, com, cvel[..., :3], markers, mass, middle, miss)


def _at_origin(force: np.ndarray, R: np.ndarray, p: np.ndarray) -> np.ndarray:
    """Wrench about the origin of W from a free joint's: its torque is in body axes about the body's origin."""
    moment = np.einsum("tij,tj->ti", R, force[:, 3:]) + np.cross(p, force[:, :3])
    return np.concatenate([force[:, :3], moment], 1)


def _disagreement(
    wrench: np.ndarray, mass: float, com: np.ndarray, velocity: np.ndarray, spin: np.ndarray, gravity: np.ndarray
) -> float:
    """Wrench against the rate of change of linear and angular momentum less gravity's pull; ends left out."""
    linear = mass * velocity
    needed = derivative(np.concatenate([linear, spin + np.cross(com, linear)], 1))
    weight = mass * gravity
    needed -= np.concatenate([weight, np.cross(com, weight)], 1)
    return float(np.abs(wrench - needed)[20:-20].max() / (mass * GRAVITY))
