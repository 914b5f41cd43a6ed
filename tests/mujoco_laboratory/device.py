"""A person with a device as a MuJoCo model, parts as bodies and springs as springs, and its inverse dynamics.

Nothing of ``torchid.devices`` computes here: only its numbers are read.
"""

from dataclasses import dataclass

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from torchid.conventions import GRAVITY
from torchid.devices import Device, Element
from torchid.devices.device import Coordinate, Path
from torchid.model.mechanics import phi_to_centre, zero_pose
from torchid.model.model import Geometry
from torchid.model.tree import Tree

FREE = 7
"""Numbers in qpos that place the root."""


@dataclass(frozen=True)
class Worn:
    """A MuJoCo model and where the coordinates of a torchid tree are in it."""

    model: mujoco.MjModel
    tree: Tree


@dataclass(frozen=True)
class Truth:
    """What MuJoCo says of a motion; first axis frames."""

    ground: np.ndarray
    """Wrench that the ground supplies, about the origin of W, in W (frames, 6)."""
    human: np.ndarray
    """Torque of the person's joints (frames, dofs), base rows zero; contact and device taken off."""
    device: np.ndarray
    """Torque of the device on the coordinates (frames, dofs)."""
    length: dict[str, np.ndarray]
    """Length or angle of each element with a spring or a motor (frames,)."""
    force: dict[str, np.ndarray]
    """Tension of its path, or torque on its coordinate (frames,)."""


def worn(tree: Tree, geometry: Geometry, phi: np.ndarray, device: Device) -> Worn:
    """Build a MuJoCo model of a bare body (bodies, 10) that wears a device whose numbers are all known."""
    hinge, offset = geometry.hinge.tolist(), geometry.offset.numpy()
    body = _body(0, tree, offset, hinge, phi, device)
    tendons = "".join(_tendon(e) for e in device.elements if isinstance(e.line, Path))
    text = (
        '<mujoco><compiler angle="radian" autolimits="false" inertiafromgeom="false" balanceinertia="false"/>'
        f'<option gravity="0 0 {-GRAVITY}"><flag contact="disable" constraint="disable"/></option>'
        f"<worldbody>{_sites('world', device)}{body}</worldbody><tendon>{tendons}</tendon></mujoco>"
    )
    return Worn(mujoco.MjModel.from_xml_string(text), tree)


def _body(k: int, tree: Tree, offset: np.ndarray, hinge: list[float], phi: np.ndarray, device: Device) -> str:
    body, joint = tree.bodies[k], zero_pose(tree.bodies[k], hinge)
    quat = Rotation.from_matrix(joint.R_PB).as_quat()[[3, 0, 1, 2]]
    inner = '<freejoint name="root"/>' if k == 0 else "".join(
        f'<joint name="{tree.dofs[row].name}" type="{kind}" axis="{_text(axis)}" '
        f"{_spring(tree.dofs[row].name, device)}/>"
        for kind, axes in (("slide", joint.slides), ("hinge", joint.turns))
        for row, axis in axes
    )  # fmt: skip
    parts = "".join(_part(p) for p in device.parts if p.segment == body.name)
    children = "".join(_body(j, tree, offset, hinge, phi, device) for j, b in enumerate(tree.bodies) if b.parent == k)
    return (
        f'<body name="{body.name}" pos="{_text(offset[k])}" quat="{_text(quat)}">{inner}'
        f"{_inertial(*phi_to_centre(phi[k], body.name))}{_sites(body.name, device)}{parts}{children}</body>"
    )


def _spring(dof: str, device: Device) -> str:
    for e in device.elements:
        if isinstance(e.line, Coordinate) and e.line.name == dof and e.law is not None:
            return f'stiffness="{e.law.stiffness.value!r}" springref="{e.law.rest.value!r}"'
    return ""


def _tendon(e: Element) -> str:
    law, ends = e.law, "".join(f'<site site="{e.name}_{k}"/>' for k in range(len(e.line.points)))
    rest = f"0 {law.rest.value!r}" if law.tension_only else f"{law.rest.value!r}"
    damping = f'damping="{law.damping.value!r}"'
    return (
        f'<spatial name="{e.name}" stiffness="{law.stiffness.value!r}" springlength="{rest}" {damping}>{ends}</spatial>'
    )


def _sites(segment: str, device: Device) -> str:
    return "".join(
        f'<site name="{e.name}_{k}" pos="{_text(point.place)}"/>'
        for e in device.elements if isinstance(e.line, Path)
        for k, point in enumerate(e.line.points) if point.segment == segment
    )  # fmt: skip


def _part(part) -> str:
    inertia = [x.value for x in part.inertia_kgm2]
    xx, xy, yy, xz, yz, zz = inertia
    I = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    place = [x.value for x in part.com_m]
    return f'<body pos="{_text(place)}">{_inertial(part.mass_kg.value, np.zeros(3), I)}</body>'


def _inertial(mass: float, com: np.ndarray, inertia: np.ndarray) -> str:
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = inertia
    full = _text([xx, yy, zz, xy, xz, yz])
    return f'<inertial pos="{_text(com)}" mass="{float(mass)!r}" fullinertia="{full}"/>'


def _text(values) -> str:
    return " ".join(repr(float(v)) for v in values)


def _positions(own: Worn, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """MuJoCo's qpos, qvel, qacc; angular ones of the root are in its own axes."""
    tree, model = own.tree, own.model
    qpos, qvel, qacc = np.zeros((len(q), model.nq)), np.zeros((len(q), model.nv)), np.zeros((len(q), model.nv))
    R = Rotation.from_rotvec(q[:, 3:6])
    qpos[:, :3], qpos[:, 3:FREE] = q[:, :3], R.as_quat()[:, [3, 0, 1, 2]]
    for out, rate in ((qvel, v), (qacc, a)):
        out[:, :3], out[:, 3:6] = rate[:, :3], R.inv().apply(rate[:, 3:6])
    for row, dof in enumerate(tree.dofs[6:], start=6):
        joint = model.joint(dof.name)
        qpos[:, joint.qposadr[0]] = q[:, row]
        qvel[:, joint.dofadr[0]], qacc[:, joint.dofadr[0]] = v[:, row], a[:, row]
    return qpos, qvel, qacc


def inverse(
    own: Worn, q: np.ndarray, v: np.ndarray, a: np.ndarray, feet: dict[str, np.ndarray], motors: dict[str, np.ndarray]
) -> Truth:
    """What a motion needs from ground and joints.

    Args:
        own: the model.
        q, v, a: as of torchid (frames, dofs).
        feet: wrench on a segment about the origin of W (frames, 6).
        motors: torque of the device's motors on a coordinate (frames,).
    """
    model, data = own.model, mujoco.MjData(own.model)
    qpos, qvel, qacc = _positions(own, q, v, a)
    rows = {dof.name: model.joint(dof.name).dofadr[0] for dof in own.tree.dofs[6:]}
    out = Truth(np.zeros((len(q), 6)), np.zeros_like(q), np.zeros_like(q), {}, {})
    lengths = np.zeros((len(q), model.ntendon))
    for t in range(len(q)):
        data.qpos[:], data.qvel[:], data.qacc[:] = qpos[t], qvel[t], qacc[t]
        mujoco.mj_inverse(model, data)
        need = data.qfrc_inverse.copy()
        R = data.xmat[1].reshape(3, 3)
        out.ground[t] = np.concatenate([need[:3], R @ need[3:6] + np.cross(q[t, :3], need[:3])])
        for segment, wrench in feet.items():
            held = np.zeros(model.nv)
            mujoco.mj_applyFT(model, data, wrench[t, :3], wrench[t, 3:], np.zeros(3), model.body(segment).id, held)
            need -= held
        for row, dof in enumerate(own.tree.dofs[6:], start=6):
            out.device[t, row] = data.qfrc_passive[rows[dof.name]] + motors.get(dof.name, _zero(len(q)))[t]
            out.human[t, row] = need[rows[dof.name]] - motors.get(dof.name, _zero(len(q)))[t]
        lengths[t] = data.ten_length
    for k in range(model.ntendon):
        out.length[model.tendon(k).name] = lengths[:, k]
    return out


def _zero(n: int) -> np.ndarray:
    return np.zeros(n)
