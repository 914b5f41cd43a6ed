"""Random trees and their twins in other libraries, for tests."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import roma
import torch
from scipy.spatial.transform import Rotation as R

from torchid.model.coupling import CoupledAxis, Coupling
from torchid.model.mechanics import phi_to_centre, zero_pose
from torchid.model.model import Geometry
from torchid.model.opensim.functions import (
    Constant,
    Function,
    LinearFunction,
    Polynomial,
    ScaledFunction,
    Sine,
    simm_spline,
)
from torchid.model.tree import Body, Dof, Slide, Tree, Turn

BASE = tuple(Dof(name, "m" if k < 3 else "rad") for k, name in enumerate(("x", "y", "z", "rx", "ry", "rz")))


def random_tree(rng: np.random.Generator, bodies: int = 9, constant: bool = True) -> tuple[Tree, Geometry]:
    """A tree with turns about any axes and signs, hinge angles, slides and constant rotations."""
    dofs, hinges, made = list(BASE), [], [Body("b0", -1)]
    for k in range(1, bodies):
        turns: list[Turn] = []
        for _ in range(int(rng.integers(0, 4))):
            turns.append(Turn(int(rng.integers(3)), len(dofs), sign=float(rng.choice([-1, 1]))))
            dofs.append(Dof(f"q{len(dofs)}", "rad"))
        if rng.random() < 0.5:
            axis = int(rng.integers(3))
            turns = [Turn(axis, len(hinges), False), *turns, Turn(axis, len(hinges), False, -1.0)]
            hinges.append(f"h{len(hinges)}")
        slides = ()
        if rng.random() < 0.3:
            slides = (Slide(int(rng.integers(3)), len(dofs)),)
            dofs.append(Dof(f"q{len(dofs)}", "m"))
        before, after = (_rotation(rng) if constant and rng.random() < 0.4 else None for _ in range(2))
        made.append(Body(f"b{k}", int(rng.integers(max(0, k - 4), k)), tuple(turns), slides, before, after))
    offset = torch.tensor(rng.normal(size=(bodies, 3)) * 0.2)
    offset[0] = 0.0
    hinge = torch.tensor(rng.normal(size=len(hinges)) * 0.2)
    return Tree(tuple(made), tuple(dofs), tuple(hinges)), Geometry(offset, hinge)


def coupled_tree(rng: np.random.Generator, tree: Tree) -> Tree:
    """The same tree, about every other coordinate now a function of those that are left, or of followers before it."""
    rows = list(range(6, len(tree.dofs)))
    held = [row for row in rows[1:] if rng.random() < 0.5] or rows[1:2]
    kept = [row for row in range(len(tree.dofs)) if row not in held]
    place = {row: k for k, row in enumerate((*kept, *held))}
    followers = []
    for k, row in enumerate(held):
        function = _function(rng, len(kept) - 6 + k)
        given = rng.permutation(np.arange(6, len(kept) + k))[: function.n_arguments]
        followers.append(CoupledAxis(tree.dofs[row].name, tuple(given.tolist()), function))
    bodies = [
        replace(
            body,
            turns=tuple(replace(t, row=place[t.row]) if t.moving else t for t in body.turns),
            slides=tuple(replace(one, row=place[one.row]) for one in body.slides),
        )
        for body in tree.bodies
    ]
    coupling = Coupling(str(rng.integers(2**62)), len(kept), tuple(followers))
    return Tree(tuple(bodies), tuple(tree.dofs[row] for row in kept), tree.hinges, coupling)


def _function(rng: np.random.Generator, known: int) -> Function:
    # Knots well apart: between close ones a spline bends too much for differences to tell its slope.
    x = torch.tensor(np.linspace(-1.5, 1.5, 6) + rng.uniform(-0.2, 0.2, size=6))
    options = [
        Constant(float(rng.normal())),
        Polynomial(torch.tensor(0.5 * rng.normal(size=4))),
        ScaledFunction(simm_spline(x, torch.tensor(0.3 * rng.normal(size=6))), float(rng.normal())),
        Sine(0.3, 1.3, 0.2, -0.1),
        LinearFunction(torch.tensor(rng.normal(size=min(2, known))), 0.1),
    ]
    return options[int(rng.integers(len(options)))]


def random_motion(rng: np.random.Generator, tree: Tree, frames: int) -> tuple[torch.Tensor, ...]:
    """Independent q, v, a, each (frames, dofs)."""
    return tuple(torch.tensor(rng.normal(size=(frames, len(tree.dofs)))) for _ in range(3))


def random_inertia(rng: np.random.Generator, bodies: int) -> torch.Tensor:
    """Physically consistent ten parameters per body, about the body's origin."""
    rows = []
    for _ in range(bodies):
        m, c = rng.uniform(0.5, 10.0), rng.normal(size=3) * 0.1
        A = rng.normal(size=(3, 3)) * 0.1
        second = A @ A.T * m + m * np.outer(c, c)
        I = np.trace(second) * np.eye(3) - second
        rows.append([m, *(m * c), I[0, 0], I[0, 1], I[1, 1], I[0, 2], I[1, 2], I[2, 2]])
    return torch.tensor(np.array(rows))


def pinocchio_twin(tree: Tree, geometry: Geometry, inertia: torch.Tensor | None = None):
    """The tree in Pinocchio: single-axis joints in the order of the chain; one frame for each body."""
    model = pin.Model()
    model.gravity.linear = np.array([0.0, 0.0, -9.80665])
    joint = {0: model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "root")}
    place = {0: pin.SE3.Identity()}
    for k, body in enumerate(tree.bodies):
        if k:
            at, X = joint[body.parent], place[body.parent] * pin.SE3(np.eye(3), geometry.offset[k].numpy())
            X = X * pin.SE3(np.array(body.R_PJ) if body.R_PJ else np.eye(3), np.zeros(3))
            for slide in body.slides:
                kind = [pin.JointModelPX, pin.JointModelPY, pin.JointModelPZ][slide.axis]()
                at, X = model.addJoint(at, kind, X, f"q{slide.row}"), pin.SE3.Identity()
            for turn in body.turns:
                unit = np.eye(3)[turn.axis] * turn.sign
                if turn.moving:
                    at = model.addJoint(at, pin.JointModelRevoluteUnaligned(unit), X, f"q{turn.row}")
                    X = pin.SE3.Identity()
                else:
                    X = X * pin.SE3(R.from_rotvec(unit * float(geometry.hinge[turn.row])).as_matrix(), np.zeros(3))
            X = X * pin.SE3(np.array(body.R_JB) if body.R_JB else np.eye(3), np.zeros(3))
            joint[k], place[k] = at, X
        if inertia is not None:
            m, h, I = inertia[k, 0].item(), inertia[k, 1:4].numpy(), inertia[k, 4:].numpy()
            full = np.array([[I[0], I[1], I[3]], [I[1], I[2], I[4]], [I[3], I[4], I[5]]])
            c = h / m
            about_com = full - m * (c @ c * np.eye(3) - np.outer(c, c))
            model.appendBodyToJoint(joint[k], pin.Inertia(m, c, about_com), place[k])
        model.addFrame(pin.Frame(tree.bodies[k].name, joint[k], 0, place[k], pin.FrameType.OP_FRAME))
    return model


def pinocchio_state(model, tree: Tree, q, v, a) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """One frame of our coordinates in Pinocchio's (base velocity and spatial acceleration in base axes)."""
    Q, V, A = pin.neutral(model), np.zeros(model.nv), np.zeros(model.nv)
    R_WB = roma.rotvec_to_rotmat(q[3:6]).numpy()
    Q[:3], Q[3:7] = q[:3], pin.Quaternion(R_WB).coeffs()
    V[:3], V[3:6] = R_WB.T @ v[:3].numpy(), R_WB.T @ v[3:6].numpy()
    A[:3] = R_WB.T @ a[:3].numpy() - np.cross(V[3:6], V[:3])
    A[3:6] = R_WB.T @ a[3:6].numpy()
    for k in range(6, len(tree.dofs)):
        j = model.joints[model.getJointId(f"q{k}")]
        Q[j.idx_q], V[j.idx_v], A[j.idx_v] = q[k], v[k], a[k]
    return Q, V, A


def mjcf_of(tree: Tree, geometry: Geometry, phi: torch.Tensor) -> str:
    """The tree as MJCF: joints of a body one after the other, about axes in its own frame."""
    children = {k: [j for j, body in enumerate(tree.bodies) if body.parent == k] for k in range(-1, len(tree.bodies))}

    def spelt(values) -> str:
        return " ".join(f"{float(x):.17g}" for x in values)

    def body(k: int) -> str:
        joint = zero_pose(tree.bodies[k], geometry.hinge.tolist())
        quat = np.roll(R.from_matrix(joint.R_PB).as_quat(), 1)
        mass, centre, inertia = phi_to_centre(phi[k].numpy(), tree.names[k])
        full = [inertia[i, j] for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))]
        moving = (
            "<freejoint/>"
            if k == 0
            else "".join(
                f'<joint name="{tree.dofs[row].name}" type="{kind}" axis="{spelt(axis)}"/>'
                for kind, axes in (("slide", joint.slides), ("hinge", joint.turns))
                for row, axis in axes
            )
        )
        own = f'<inertial mass="{mass:.17g}" pos="{spelt(centre)}" fullinertia="{spelt(full)}"/>'
        inside = "".join(body(child) for child in children[k])
        place = spelt(geometry.offset[k] if k else np.zeros(3))
        return f'<body name="{tree.names[k]}" pos="{place}" quat="{spelt(quat)}">{moving}{own}{inside}</body>'

    option = '<option gravity="0 0 -9.80665"><flag contact="disable"/></option>'
    return f'<mujoco><compiler angle="radian"/>{option}<worldbody>{body(0)}</worldbody></mujoco>'


def _rotation(rng: np.random.Generator):
    M = R.random(random_state=int(rng.integers(2**31))).as_matrix()
    return tuple(tuple(float(x) for x in row) for row in M)
