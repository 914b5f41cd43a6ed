"""This module holds templates of other sizes, for a person whose stature nobody states."""

from collections.abc import Iterator
from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.model.model import Model
from torchid.model.tree import Tree

TOPS = (1.0, 0.94, 0.83, 0.57)
"""Height of the highest marker as a share of the stature, chosen: on the head, on a band about it, on a shoulder, on
the pelvis."""
SMALLEST_M, TALLEST_M = 0.6, 2.3
"""Statures of people [m]; chosen."""
ALIKE = 0.02
"""Sizes that differ by less than this part are one; chosen."""


def of_sizes(model: Model, position: Float[Tensor, "frames markers 3"]) -> Iterator[Model]:
    """Yield the template, and templates of the statures that the height of the highest marker allows.

    Args:
        model: template.
        position: of the markers of one who stands, or of frames of motion; NaN where missing [m].
    """
    yield model
    high = position[..., 2][position[..., 2].isfinite()]
    tall = float(high.max() - high.min()) if len(high) else 0.0
    for share in TOPS:
        if SMALLEST_M < tall / share < TALLEST_M and abs(tall / share / model.height - 1.0) > ALIKE:
            yield scaled(model, tall / share / model.height)


def scaled(model: Model, factor: float) -> Model:
    """Return a template with all lengths multiplied; masses stay.

    Args:
        model: template.
        factor: by which its stature changes.
    """
    prior, n = model.geometry, model.geometry.n_offset
    long = torch.tensor([factor if unit == "m" else 1.0 for unit in prior.units]).to(prior.mean)
    constant = torch.cat([factor * prior.constant[:n], prior.constant[n:]])
    mean = model.inertia.mean.clone()
    mean[:, 1:4] *= factor
    mean[:, 4:] *= factor**2
    landmarks = {
        name: replace(one, p_BM_B=tuple(factor * x for x in one.p_BM_B)) for name, one in model.landmarks.items()
    }
    return replace(
        model,
        tree=_raised(model.tree, factor),
        geometry=replace(prior, mean=long * prior.mean, constant=constant),
        inertia=replace(model.inertia, mean=mean),
        landmarks=landmarks,
        height=factor * model.height,
    )


def _raised(tree: Tree, factor: float) -> Tree:
    """Return a tree whose root rests as much higher."""
    dofs = tuple(replace(dof, rest=factor * dof.rest) if dof.unit == "m" else dof for dof in tree.dofs)
    return replace(tree, dofs=dofs)
