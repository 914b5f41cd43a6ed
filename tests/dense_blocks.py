"""Dense blocks of the arrow's normal matrix, against which its elimination by branches is tested."""

from dataclasses import dataclass

import torch
from torch import Tensor

from torchid.geometry.arrow.index_tables import ArrowLayout
from torchid.geometry.arrow.normal_blocks import fold_rows, lower_mask, make_pieces, shared_block
from torchid.geometry.problem import MarkerProblem


@dataclass(frozen=True)
class NormalBlocks:
    """The quadratic model of the cost of a chunk, with frames first and the columns of motion as in the layout."""

    g_q: Tensor
    """Gradient of motion (frames, motion)."""
    H_qq: Tensor
    """Lower triangle of the block of motion (frames, motion, motion)."""
    H_qx: Tensor
    """Mixed block (frames, motion, xi)."""
    g_x: Tensor
    """Gradient of xi (frames, xi)."""
    H_xx: Tensor
    """Block of xi (xi, xi), summed over the frames."""


def assemble(problem: MarkerProblem, layout: ArrowLayout, q: Tensor, xi: Tensor) -> NormalBlocks:
    """The dense blocks of all frames of a problem at q (dofs, frames)."""
    pieces = make_pieces(problem, layout, problem.evaluate(q, problem.shape(xi)), shared=True)
    S, F = pieces.columns.S[:, layout.motion], pieces.columns.F[:, layout.motion]
    H_qq, g_q = torch.bmm(F, S.mT) * lower_mask(layout, layout.motion_body), pieces.columns.g[:, layout.motion, None]
    if pieces.fold is not None:
        H_qq, g_q = fold_rows(pieces.fold, H_qq, g_q)
    torch.diagonal(H_qq, dim1=1, dim2=2).add_(pieces.curvature)
    Se, Fe = pieces.columns.S[:, layout.entries], pieces.columns.F[:, layout.entries]
    inside, around = layout.nesting(layout.motion_body)
    fold = torch.nn.functional.one_hot(layout.entry_xi, len(xi)).to(S)
    H_qx = (torch.bmm(F, Se.mT) * inside + torch.bmm(S, Fe.mT) * around) @ fold
    H_qx = H_qx if pieces.fold is None else pieces.fold.mT @ H_qx
    g_x = pieces.columns.g[:, layout.entries] @ fold
    H_xx = fold.T @ shared_block(layout, pieces) @ fold
    return NormalBlocks(g_q[:, :, 0] + pieces.pull, H_qq, H_qx, g_x, H_xx)
