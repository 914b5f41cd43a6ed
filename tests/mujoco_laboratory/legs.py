"""Leg angles that keep the feet where they are meant to be: six unknowns for six conditions, all frames at once."""

from collections.abc import Callable
from dataclasses import dataclass

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

Glide = Callable[[np.ndarray], np.ndarray]
"""Changes positions (frames, nq) where some follow others, as joint centres that glide with an angle."""
LEG = ("thigh", "shank", "foot")
STEPS = 60
CLOSE = 1e-9
"""Miss of place [m] and direction [rad] at which the search ends."""
LARGEST = 0.25
"""Step of a search [rad]."""


@dataclass(frozen=True)
class Joint:
    """A MuJoCo joint in a chain."""

    address: int
    """In qpos."""
    slide: bool
    axis: np.ndarray
    free: bool
    """Whether the search may turn it."""


@dataclass(frozen=True)
class Chain:
    """Bodies from the pelvis to a foot: their places on their parents and their joints."""

    links: tuple[tuple[np.ndarray, tuple[Joint, ...]], ...]


def chain(model: mujoco.MjModel, side: str, solved: set[str]) -> Chain:
    """The leg of a side; ``solved`` names the joints that the search may turn."""
    links = []
    for part in LEG:
        body = model.body(f"{part}_{side}")
        joints = [model.joint(k) for k in range(body.jntadr[0], body.jntadr[0] + body.jntnum[0])]
        slide = mujoco.mjtJoint.mjJNT_SLIDE
        own = tuple(Joint(j.qposadr[0], j.type[0] == slide, j.axis.copy(), j.name in solved) for j in joints)
        links.append((body.pos.copy(), own))
    return Chain(tuple(links))


def foot_pose(
    leg: Chain, q: np.ndarray, p: np.ndarray, R: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[int]]:
    """Place (frames, 3), axes (frames, 3, 3), Jacobian (frames, 6, free) of a foot and its free joints' addresses."""
    axes, points, addresses = [], [], []
    for centre, joints in leg.links:
        p = p + R @ centre
        for joint in joints:
            axis = R @ joint.axis
            value = q[:, joint.address]
            if joint.slide:
                p = p + value[:, None] * axis
                continue
            if joint.free:
                axes.append(axis)
                points.append(p)
                addresses.append(joint.address)
            R = R @ Rotation.from_rotvec(value[:, None] * joint.axis).as_matrix()
    columns = [np.concatenate([np.cross(a, p - c), a], 1) for a, c in zip(axes, points, strict=True)]
    return p, R, np.stack(columns, 2), addresses


def plant(leg: Chain, q: np.ndarray, goal_p: np.ndarray, goal_R: np.ndarray, glide: Glide) -> np.ndarray:
    """Positions whose foot is at the goal, by Newton's method from ``q`` on.

    Args:
        leg: chain to the foot.
        q: MuJoCo positions (frames, nq) with the pelvis in place.
        goal_p: ankle centre (frames, 3) [m].
        goal_R: axes of the foot (frames, 3, 3).
        glide: called before every step.

    Raises:
        RuntimeError: a foot is out of reach.
    """
    q = q.copy()
    p, R = q[:, :3], Rotation.from_quat(q[:, [4, 5, 6, 3]]).as_matrix()
    for _ in range(STEPS):
        q = glide(q)
        at, turned, jacobian, addresses = foot_pose(leg, q, p, R)
        turn = Rotation.from_matrix(goal_R @ turned.transpose(0, 2, 1)).as_rotvec()
        miss = np.concatenate([goal_p - at, turn], 1)
        if np.abs(miss).max() < CLOSE:
            return q
        step = np.linalg.solve(jacobian, miss[:, :, None])[:, :, 0]
        q[:, addresses] += step * np.minimum(1.0, LARGEST / np.maximum(np.abs(step).max(1, keepdims=True), 1e-12))
    raise RuntimeError(f"a foot stays {1e3 * np.abs(miss[:, :3]).max():.1f} mm from its place: out of reach")
