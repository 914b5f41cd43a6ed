"""Linear constraints on inertial parameters: centre-of-mass boxes, bounding ellipsoids, an exact total mass.

All but the last are homogeneous, C phi >= 0. A body whose mass lies inside the ellipsoid {x : [x; 1]' Q [x; 1] >= 0}
has tr(P Q) >= 0, the integral of that form over its mass; together with P >= 0 this is also enough for such a mass
distribution to exist ("density realisability").

Reference: Wensing, Kim, Slotine, IEEE RA-L 3(1), 2018 (density realisability).
"""

import numpy as np
import torch
from jaxtyping import Float
from scipy.optimize import lsq_linear
from torch import Tensor

from torchid.conventions import Inertial
from torchid.errors import ConfigError
from torchid.model.pseudo import params_to_pseudo

_FLAT = 1e-12
"""Eigenvalue of an ellipsoid's matrix, over its largest, that counts as zero."""
_OUTSIDE = 1e-9
"""Squared relative distance beyond 1 up to which a box still touches an ellipsoid."""


def box_rows(com_box: Tensor | None, bodies: int, like: Tensor) -> Float[Tensor, "boxes params"]:
    """Rows C with C phi >= 0: m c - low m and high m - m c, linear in phi."""
    if com_box is None:
        return like.new_zeros((0, 10 * bodies))
    if com_box.shape != (bodies, 2, 3) or not bool((com_box[:, 0] < com_box[:, 1]).all()):
        raise ConfigError(
            "inertia.com_box", "every box needs a lower corner below its upper corner", found=str(tuple(com_box.shape)),
            remedy=f"Give com_box of shape ({bodies}, 2, 3): lower and upper corner of each body [m]",
        )  # fmt: skip
    infinite = com_box.isinf().nonzero().tolist()
    if infinite:
        raise ConfigError(
            "inertia.com_box", "a corner of a box is infinite", found=f"at (body, corner, axis) {tuple(infinite[0])}",
            remedy="Give every corner in metres; one that is a metre away bounds no body",
        )  # fmt: skip
    rows = like.new_zeros((bodies, 2, 3, bodies, 10))
    for body in range(bodies):
        for axis in range(3):
            for side, sign in enumerate((1.0, -1.0)):
                rows[body, side, axis, body, Inertial.MCX + axis] = sign
                rows[body, side, axis, body, Inertial.M] = -sign * com_box[body, side, axis]
    return rows.reshape(-1, 10 * bodies)


def ellipsoid_rows(
    ellipsoids: Float[Tensor, "bodies 4 4"] | None, bodies: int, like: Tensor
) -> Float[Tensor, "ellipsoids params"]:
    """Rows C with (C phi)_b = tr(P(phi_b) Q_b)."""
    if ellipsoids is None:
        return like.new_zeros((0, 10 * bodies))
    units = params_to_pseudo(torch.eye(10, dtype=like.dtype, device=like.device))
    return torch.block_diag(*torch.einsum("kij,bij->bk", units, ellipsoids)[:, None])


def total_mass_row(bodies: int, like: Tensor) -> Float[Tensor, " params"]:
    """Row whose product with phi is the mass of all bodies."""
    row = like.new_zeros(10 * bodies)
    row[Inertial.M :: len(Inertial)] = 1.0
    return row


def ellipsoid_matrix(
    centre: Float[Tensor, "*batch 3"],
    semi_axes: Float[Tensor, "*batch 3"],
    R: Float[Tensor, "*batch 3 3"] | None = None,
) -> Float[Tensor, "*batch 4 4"]:
    """Q of the ellipsoid |diag(1/semi_axes) R' (x - centre)| <= 1, so that [x; 1]' Q [x; 1] >= 0 inside.

    Args:
        centre: in body axes from the body's origin [m].
        semi_axes: [m]; infinite where the body is not bounded.
        R: principal axes as columns, in body axes; None for the body's own axes.
    """
    stretch = torch.diag_embed(1 / semi_axes.square())
    A = stretch if R is None else R @ stretch @ R.mT
    Q = centre.new_zeros((*centre.shape[:-1], 4, 4))
    pull = (A @ centre[..., None]).squeeze(-1)
    Q[..., :3, :3], Q[..., :3, 3], Q[..., 3, :3] = -A, pull, pull
    Q[..., 3, 3] = 1 - (centre * pull).sum(-1)
    return Q


def check_ellipsoids(ellipsoids: Float[Tensor, "bodies 4 4"], names: tuple[str, ...]) -> None:
    """ConfigError naming the first body whose matrix is no ellipsoid with points inside.

    The set is convex when the upper left block has no positive eigenvalue; the form is then positive somewhere with
    last component one exactly when Q has a positive eigenvalue.
    """
    for name, Q in zip(names, ellipsoids, strict=True):
        size = float(Q.abs().max())
        asymmetry = float((Q - Q.mT).abs().max())
        block, whole = torch.linalg.eigvalsh(Q[:3, :3]), torch.linalg.eigvalsh(Q)
        if asymmetry > _FLAT * size or float(block[-1]) > _FLAT * size or float(whole[-1]) <= _FLAT * size:
            raise ConfigError(
                "rows.ellipsoid",
                "the matrix is no ellipsoid that holds a body: no point x has [x; 1]' Q [x; 1] > 0, or it is unbounded "
                "to the wrong side", place=f"ellipsoids, body {name}",
                found=f"asymmetry {asymmetry:.1e}, eigenvalues of Q {_list(whole)}, of its 3 x 3 block {_list(block)}",
                remedy="Build Q with torchid.inertia.linear.ellipsoid_matrix: its 3 x 3 block is negative definite",
            )  # fmt: skip


def check_boxes_meet(
    com_box: Float[Tensor, "bodies 2 3"], ellipsoids: Float[Tensor, "bodies 4 4"], names: tuple[str, ...]
) -> None:
    """ConfigError naming the first body whose box lies outside its ellipsoid: the centre of mass is inside both."""
    for name, (low, high), Q in zip(names, com_box.cpu().numpy(), ellipsoids.cpu().numpy(), strict=True):
        values, vectors = np.linalg.eigh(-Q[:3, :3])
        root = np.sqrt(values.clip(0))[:, None] * vectors.T
        solid = values > _FLAT * max(values[-1], np.finfo(float).tiny)
        target = np.where(solid, vectors.T @ Q[:3, 3] / np.sqrt(np.where(solid, values, 1.0)), 0.0)
        nearest = lsq_linear(root, target, bounds=(low, high), method="bvls").x
        point = np.append(nearest, 1.0)
        inside = float(point @ Q @ point)
        if inside < -_OUTSIDE * float(np.abs(point) @ np.abs(Q) @ np.abs(point)):
            raise ConfigError(
                "rows.bounds_conflict", "the box of the centre of mass does not meet the bounding ellipsoid",
                place=f"com_box and ellipsoids, body {name}",
                found=f"[x; 1]' Q [x; 1] = {inside:.3g} at the box's best point {np.round(nearest, 4).tolist()} m",
                remedy="Widen one of the two, or check that both are in the body's axes, about its origin, in metres",
            )  # fmt: skip


def _list(values: Tensor) -> str:
    return "(" + ", ".join(f"{value:.2g}" for value in values.tolist()) + ")"
