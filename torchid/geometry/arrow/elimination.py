"""This module eliminates the motion of each frame from the normal equations, branch by branch, then the core.

With H = L L' (a block Cholesky factor in the order branches, core) and V = L^-1 [H_qx g_q], what is left for xi is
H_xx - V_x' V_x and g_x - V_x' V_g, and L' d = -(V_g + V_x dx) gives the step d of the motion. Both the factor and V
are zero between branches, so neither is ever formed as a whole.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from torchid.geometry.arrow.limb_partition import LimbGroup, Partition, pick
from torchid.geometry.arrow.normal_blocks import BlockPieces, fold_rows

ROUNDING = (1e-3, 0.1, 10.0, 1e8)
"""Damping, relative to the diagonal, that a block made indefinite by rounding gets, one after the other; chosen. The
last is beyond what rounding in single precision can take away: it holds the block still until the frame's own damping
has grown."""


@dataclass(frozen=True)
class Eliminated:
    """The factors of one chunk of frames, for each branch and, last, for the core."""

    L: list[Tensor]
    """Cholesky factors (frames, motion, motion)."""
    V: list[Tensor]
    """L^-1 times the columns of the core's motion (branches only), xi and the gradient (frames, motion, columns)."""
    diagonal: Tensor
    """Diagonal that the damping multiplies (frames, motion in the order of the elimination)."""
    damping: Tensor
    """Damping of each frame (frames,)."""
    g_x: Tensor
    """Gradient (frames, xi in the order of the elimination)."""


def eliminate(partition: Partition, pieces: BlockPieces, damping: Tensor) -> Eliminated:
    """Factorise every frame's damped block; a coordinate that nothing determines stays where it is.

    Args:
        damping: Levenberg-Marquardt damping, relative to the diagonal, (frames,).
    """
    core, columns = partition.core, pieces.columns
    g_x = columns.g.index_select(1, core.entries)
    for column, entry in core.extra:
        g_x[:, column] += g_x[:, entry]
    g_x = g_x[:, : len(core.xi)]
    floor = 1e-9 * columns.F[:, 0, 0] + 1e-12
    system, weight = _group_rows(core, pieces, floor, damping)
    n, kept, diagonals = core.size, [], []
    for group in partition.branches:
        own, diagonal = _group_rows(group, pieces, floor, damping)
        L, V = _factorise(own, group.size, diagonal)
        kept.append((L, V))
        diagonals.append(diagonal)
        _subtract(system, torch.bmm(V[:, :, :n].mT, V), group, partition.common, n)
    kept.append(_factorise(system, n, weight))
    return Eliminated(
        [L for L, _ in kept],
        [V for _, V in kept],
        torch.cat([*diagonals, weight], dim=1),
        damping,
        g_x,
    )


def _group_rows(group: LimbGroup, pieces: BlockPieces, floor: Tensor, damping: Tensor) -> tuple[Tensor, Tensor]:
    """Return the rows [H_qq damped, H_q,core, H_qx, g_q] of a group, and the diagonal that the damping multiplies."""
    columns = pieces.columns
    S = pick(columns.S, group.columns)
    wide = torch.cat([S, pick(columns.S, group.core), columns.S.index_select(1, group.entries)], dim=1)
    H = torch.bmm(pick(columns.F, group.columns), wide.mT).mul_(group.inside)
    if len(group.entries):
        Fe = columns.F.index_select(1, group.entries)
        H[:, :, -len(group.entries) :] += torch.bmm(S, Fe.mT).mul_(group.around)
    g = pick(columns.g, group.columns)
    if pieces.fold is not None:
        n = H.shape[1]
        H, beside = fold_rows(pieces.fold, H[:, :, :n], torch.cat([H[:, :, n:], g[:, :, None]], dim=2))
        H, g = torch.cat([H, beside[:, :, :-1]], dim=2), beside[:, :, -1]
    diagonal = torch.diagonal(H, dim1=1, dim2=2)
    diagonal += pick(pieces.curvature, group.motion)
    scale = diagonal + floor[:, None]
    diagonal += damping[:, None] * scale + floor[:, None]
    start = H.shape[2] - len(group.entries)
    for column, entry in group.extra:
        H[:, :, start + column] += H[:, :, start + entry]
    g = g + pick(pieces.pull, group.motion)
    return torch.cat([H[:, :, : start + len(group.xi)], g[:, :, None]], dim=2), scale


def _factorise(rows: Tensor, n: int, scale: Tensor) -> tuple[Tensor, Tensor]:
    """Return L of the first n columns, damped further where rounding made them indefinite, and L^-1 of the others."""
    L, info = torch.linalg.cholesky_ex(rows[:, :, :n])
    for more in ROUNDING:
        if not info.any():
            break
        # In single precision a frame may hardly determine its pose: damped more, it takes a shorter step downhill.
        torch.diagonal(rows[:, :, :n], dim1=1, dim2=2).add_(torch.where(info > 0, more, 0.0)[:, None] * scale)
        L, info = torch.linalg.cholesky_ex(rows[:, :, :n])
    assert not info.any(), "a Gauss-Newton block is positive semidefinite by construction"
    # The system is solved from the right on the transpose: row-major here is column-major there, and nothing is copied.
    return L, torch.linalg.solve_triangular(L.mT, rows[:, :, n:].mT, upper=True, left=False).mT


def _subtract(system: Tensor, update: Tensor, group: LimbGroup, common: slice, n: int) -> None:
    """Take a branch's update from the core's rows [H, H_qx, g]."""
    own = group.own.stop - group.own.start
    system[:, :, :n] -= update[:, :, :n]
    system[:, :, n + group.own.start : n + group.own.stop] -= update[:, :, n : n + own]
    system[:, :, n + common.start : n + common.stop] -= update[:, :, n + own : -1]
    system[:, :, -1] -= update[:, :, -1]


def reduce_shared(partition: Partition, eliminated: Eliminated, S: Tensor, rhs: Tensor) -> None:
    """Subtract V_x' V_x from S and V_x' V_g from rhs, in place.

    Args:
        S: normal matrix of xi (xi, xi), in the order of the elimination.
        rhs: gradient of xi (xi,), in the order of the elimination.
    """
    for group, V in zip((*partition.branches, partition.core), eliminated.V, strict=True):
        flat = V.reshape(-1, V.shape[2])[:, V.shape[2] - len(group.xi) - 1 :]
        gram = flat.T @ flat
        S[group.xi[:, None], group.xi] -= gram[:-1, :-1]
        rhs[group.xi] -= gram[:-1, -1]


def back_substitute(partition: Partition, eliminated: Eliminated, dx: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Return the step of the motion that belongs to a step of xi.

    From L' d = -y with y = V_g + V_x dx follow d' (H + damping) d = y' y and d' H_qx dx = -y' (y - V_g).

    Args:
        dx: step of xi (xi,), in the order of the elimination.

    Returns:
        The step (frames, motion in the order of the elimination) and, per frame, the fall of the cost that the
        quadratic model predicts (without the part of xi alone) and the size of the model's quadratic term.
    """
    steps: list[Tensor] = []
    yy = yg = torch.zeros_like(eliminated.damping)
    core_step = None
    n = partition.core.size
    groups = (*partition.branches, partition.core)
    for group, L, V in zip(groups[::-1], eliminated.L[::-1], eliminated.V[::-1], strict=True):
        width = V.shape[2] - len(group.xi) - 1
        y = V[:, :, -1] + V[:, :, width:-1] @ dx[group.xi] if len(group.xi) else V[:, :, -1]
        yy, yg = yy + y.square().sum(1), yg + (y * V[:, :, -1]).sum(1)
        if core_step is not None:
            y = y + (V[:, :, :n] @ core_step[:, :, None])[:, :, 0]
        d = -torch.linalg.solve_triangular(L.mT, y[:, :, None], upper=True)[:, :, 0]
        core_step = d if core_step is None else core_step
        steps.insert(0, d)
    d = torch.cat(steps, dim=1)
    held = 0.5 * eliminated.damping * (eliminated.diagonal * d.square()).sum(1)
    return d, 0.5 * yy + held - eliminated.g_x @ dx, yg - 0.5 * yy - held
