"""Segments as ellipsoids of even density that have their mass, centre of mass and inertia."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

THINNEST_M = 0.008
"""Choice. Least half axis that is drawn: an inertia that no even solid has, or none at all, still shows where it is."""


@dataclass(frozen=True)
class Solids:
    """Ellipsoids, one for every body."""

    names: tuple[str, ...]
    """Of the bodies."""
    mass: Float[np.ndarray, " bodies"]
    """[kg]."""
    centre: Float[np.ndarray, "bodies 3"]
    """p_BC_B, centre of mass in the body's axes [m]."""
    axes: Float[np.ndarray, "bodies 3 3"]
    """R_BE, principal axes as columns, right-handed."""
    radius: Float[np.ndarray, "bodies 3"]
    """Half axes [m]."""


def solids(
    names: tuple[str, ...], mass: Float[np.ndarray, " bodies"], centre: Float[np.ndarray, "bodies 3"],
    inertia: Float[np.ndarray, "bodies 3 3"],
) -> Solids:  # fmt: skip
    """Ellipsoids with given inertia: I_x = m (r_y^2 + r_z^2) / 5 and so on, solved for the half axes r.

    Args:
        mass: of each [kg].
        centre: of mass, in the body's axes [m].
        inertia: about the centre of mass [kg m^2].

    Returns:
        The ellipsoids; half axes are at least ``THINNEST_M``.
    """
    moments, axes = np.linalg.eigh(inertia)
    axes = axes * np.where(np.linalg.det(axes) < 0.0, -1.0, 1.0)[:, None, None]
    square = 2.5 * (moments.sum(1, keepdims=True) - 2.0 * moments) / np.maximum(mass, 1e-9)[:, None]
    return Solids(names, mass, centre, axes, np.sqrt(np.maximum(square, THINNEST_M**2)))


def placed(
    some: Solids, X_WB: Float[np.ndarray, "bodies 4 4"]
) -> tuple[Float[np.ndarray, "bodies 3"], Float[np.ndarray, "bodies 4"]]:
    """Centres of ellipsoids in W [m], and their turns as quaternions wxyz."""
    R_WB = X_WB[:, :3, :3]
    centre = np.einsum("bij,bj->bi", R_WB, some.centre) + X_WB[:, :3, 3]
    return centre, quaternion(R_WB @ some.axes)


def centre_of_mass(some: Solids, X_WB: Float[np.ndarray, "bodies 4 4"]) -> Float[np.ndarray, " 3"]:
    """Return the centre of mass of all bodies together, in W [m]."""
    return some.mass @ placed(some, X_WB)[0] / some.mass.sum()


def quaternion(R: Float[np.ndarray, "some 3 3"]) -> Float[np.ndarray, "some 4"]:
    """Return rotations as unit quaternions wxyz (Bar-Itzhack, J Guid Control Dyn 23:1085 (2000)).

    The quaternion is the eigenvector of the largest eigenvalue of a symmetric matrix: no case is special.
    """
    K = np.empty((len(R), 4, 4))
    K[:, 0, 0] = np.trace(R, axis1=1, axis2=2)
    K[:, 1:, 1:] = R + R.transpose(0, 2, 1) - np.eye(3) * K[:, 0, 0, None, None]
    K[:, 0, 1:] = K[:, 1:, 0] = np.stack([R[:, 2, 1] - R[:, 1, 2], R[:, 0, 2] - R[:, 2, 0], R[:, 1, 0] - R[:, 0, 1]], 1)
    return np.linalg.eigh(K)[1][:, :, -1]


def sticks(
    parents: Sequence[int], X_WB: Float[np.ndarray, "bodies 4 4"], ends: Float[np.ndarray, "bodies 3"]
) -> Float[np.ndarray, "sticks 2 3"]:
    """Return sticks from every joint to the next, and from the last ones to where their body ends [m].

    Args:
        parents: of the bodies, -1 for the root.
        X_WB: poses of the bodies.
        ends: far end of every body, in its axes [m].
    """
    above = np.asarray(parents)
    origin, child = X_WB[:, :3, 3], np.flatnonzero(above >= 0)
    last = np.setdiff1d(np.arange(len(above)), above)
    tips = np.einsum("bij,bj->bi", X_WB[last, :3, :3], ends[last]) + origin[last]
    return np.concatenate([np.stack([origin[above[child]], origin[child]], 1), np.stack([origin[last], tips], 1)])
