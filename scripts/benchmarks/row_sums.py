"""Normal equations of base rows, chunk by chunk, without the rows themselves."""

from collections.abc import Iterable

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.dynamics.equations_of_motion import BodyRows
from torchid.kinematics.plan import Plan

BLOCKS = 4
"""Of rows in a Gram matrix, of which only the lower half is worked out: more of them make the products too thin."""


def base_gram(
    plan: Plan, stream: Iterable[tuple[BodyRows, Float[Tensor, "6 frames"]]]
) -> tuple[Float[Tensor, "params params"], Float[Tensor, " params"]]:
    """Y_O' Y_O and Y_O' F summed over chunks of frames, without Y_O; the order of parameters of ``base_rows``.

    Six of ten columns of the force rows are zero: their product is left out (a third of the work). So is the upper
    half of every product, until the end.
    """
    bodies, sums = len(plan.order), {}
    for rows, wrench in stream:
        for kind, columns, side in (("moment", rows.moment, wrench[3:]), ("force", rows.force, wrench[:3])):
            flat = columns.flatten(2).flatten(0, 1)
            if kind not in sums:
                sums[kind] = flat.new_zeros(len(flat), len(flat)), flat.new_zeros(len(flat))
            _add_self_product(sums[kind][0], flat)
            sums[kind][1].addmv_(flat, side.reshape(-1))
    assert sums, "a stream of no frames has no sums"
    position = list(plan.position)
    gram, rhs = (x.new_zeros(bodies, 10, *([bodies, 10] if x.dim() == 2 else [])) for x in sums["moment"])
    for square, vector in sums.values():
        own = len(vector) // bodies
        whole = torch.tril(square) + torch.tril(square, -1).T
        gram[:, :own, :, :own] += whole.view(bodies, own, bodies, own)
        rhs[:, :own] += vector.view(bodies, own)
    return gram[position][:, :, position].reshape(10 * bodies, -1), rhs[position].reshape(-1)


def _add_self_product(out: Tensor, rows: Tensor) -> None:
    """Add rows rows' to ``out``, of which only the lower triangle of a grid of blocks is worked out."""
    step = -(-len(rows) // BLOCKS)
    for start in range(0, len(rows), step):
        few = rows[start : start + step]
        out[start : start + step, : start + step].addmm_(few, rows[: start + step].T)
