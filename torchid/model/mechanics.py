"""Joints and inertia as model files state them: axes in the child's own frame, mass about a centre.

A body's joint, however it is made, is X_PB(q) = T(offset) R_PB T(sum_i u_i s_i) prod_i exp(u_i q_i) with unit axes u_i
in the body's axes at zero coordinates (product of exponentials; Lynch & Park 2017, Modern Robotics, section 4.1).
URDF, MJCF and OpenSim all say this; the tree says it with turns about coordinate axes, leans and constant rotations.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from torchid.conventions import INERTIA_PAIRS, Inertial
from torchid.errors import DataError
from torchid.model.tree import Body, Rotation

Array = NDArray[np.float64]
MarkerTable = Mapping[str, tuple[str, Sequence[float]]]
"""label: (segment, p_BM_B [m])."""


@dataclass(frozen=True)
class ZeroPose:
    """A joint at zero coordinates."""

    R_PB: Array
    slides: tuple[tuple[int, Array], ...]
    """Row of q and direction, in the body's axes."""
    turns: tuple[tuple[int, Array], ...]
    """Row of q and axis, in the body's axes, signs included."""


def zero_pose(body: Body, hinge: Sequence[float]) -> ZeroPose:
    """The joint of ``body`` at zero coordinates, its constant rotations gathered in R_PB."""
    R, axes = np.eye(3), []
    for turn in body.turns:
        if turn.moving:
            axes.append((turn.row, turn.sign * R[:, turn.axis]))
        else:
            R = R @ axis_rotation(turn.axis, turn.sign * hinge[turn.row])
    R_JB = R @ as_matrix(body.R_JB)
    slides = tuple((slide.row, R_JB[slide.axis].copy()) for slide in body.slides)
    return ZeroPose(as_matrix(body.R_PJ) @ R_JB, slides, tuple((row, R_JB.T @ axis) for row, axis in axes))


def as_matrix(rotation: Rotation | None) -> Array:
    """A constant rotation of the tree as an array."""
    return np.eye(3) if rotation is None else np.array(rotation, dtype=np.float64)


def as_rotation(matrix: Array) -> Rotation | None:
    """An array as a constant rotation of the tree; None for the identity."""
    if np.abs(matrix - np.eye(3)).max() < 1e-15:
        return None
    a, b, c = ((float(row[0]), float(row[1]), float(row[2])) for row in matrix)
    return a, b, c


def axis_rotation(axis: int, angle: float) -> Array:
    """Rotation about coordinate axis 0, 1 or 2."""
    R, (i, j) = np.eye(3), ((axis + 1) % 3, (axis + 2) % 3)
    R[i, i] = R[j, j] = math.cos(angle)
    R[j, i] = math.sin(angle)
    R[i, j] = -R[j, i]
    return R


def rpy_to_matrix(roll: float, pitch: float, yaw: float) -> Array:
    """Rotation of URDF's roll, pitch, yaw: Rz(yaw) Ry(pitch) Rx(roll)."""
    return axis_rotation(2, yaw) @ axis_rotation(1, pitch) @ axis_rotation(0, roll)


def matrix_to_rpy(R: Array) -> Array:
    """Roll, pitch, yaw of a rotation; exact also at pitch 90 degrees, because each angle is read behind the last."""
    yaw = math.atan2(R[1, 0], R[0, 0])
    rest = axis_rotation(2, -yaw) @ R
    return np.array([math.atan2(-rest[1, 2], rest[1, 1]), math.atan2(-rest[2, 0], rest[0, 0]), yaw])


def pose(R: Array | None = None, p: Sequence[float] | Array | None = None) -> Array:
    """Homogeneous 4 x 4 matrix."""
    X = np.eye(4)
    if R is not None:
        X[:3, :3] = R
    if p is not None:
        X[:3, 3] = p
    return X


def pseudo_inertia(mass: float, I_C: Array, X_BC: Array) -> Array:
    """Pseudo-inertia (4, 4) about B of a mass with inertia ``I_C`` about its centre, in the centre's axes.

    Moves by congruence, P_A = X_AB P_B X_AB', and adds (Wensing, Kim, Slotine, IEEE RA-L 3(1), 2018).
    """
    P = np.zeros((4, 4))
    P[:3, :3] = 0.5 * np.trace(I_C) * np.eye(3) - I_C
    P[3, 3] = mass
    return X_BC @ P @ X_BC.T


def pseudo_to_phi(P: Array) -> Array:
    """Ten inertial parameters of a pseudo-inertia."""
    inertia = np.trace(P[:3, :3]) * np.eye(3) - P[:3, :3]
    return np.array([P[3, 3], *P[:3, 3], *(inertia[i, j] for i, j in INERTIA_PAIRS)])


def phi_to_centre(phi: Array, name: str) -> tuple[float, Array, Array]:
    """Mass, centre of mass p_BC_B and inertia about it in body axes, of ten parameters.

    Raises:
        DataError: ``model.massless`` where a body called ``name`` has no positive mass.
    """
    mass = float(phi[Inertial.M])
    if not mass > 0.0:
        raise DataError(
            "model.massless", "a body without mass cannot be written", place=name, found=f"{mass:g} kg",
            remedy="Give the body a mass, or join it with its parent by a fixed joint",
        )  # fmt: skip
    centre, inertia = phi[Inertial.MCX : Inertial.MCZ + 1] / mass, np.zeros((3, 3))
    for k, (i, j) in enumerate(INERTIA_PAIRS):
        inertia[i, j] = inertia[j, i] = phi[Inertial.IXX + k]
    return mass, centre, inertia - mass * (centre @ centre * np.eye(3) - np.outer(centre, centre))
