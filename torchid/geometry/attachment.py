"""This module puts the markers of a subject on the bodies of a model, and settles the bodies that no marker sees."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchid.errors import Note
from torchid.model.marker_set import MarkerSpec, marker_prior
from torchid.model.model import Model
from torchid.model.tree import Tree
from torchid.model.whole_body import lock_bodies

FIRM = 0.1
"""A body without markers between marked ones has joint angles that scatter this much about rest [rad]; chosen."""
HINGES = 2
"""Coordinates between marked bodies that need no holding; chosen: markers on both sides tell an ankle and a subtalar
joint apart, but three turns only with three good markers on either side."""


@dataclass(frozen=True)
class Attachment:
    """The markers of a subject on the bodies of a tree, with the prior of their places."""

    labels: tuple[str, ...]
    body: Int[Tensor, " markers"]
    """Each marker's segment as its index in the tree."""
    mean: Float[Tensor, "markers 3"]
    """Prior mean of p_BM_B [m]."""
    sd: Float[Tensor, "markers 3"]
    """Prior scatter [m]; large for markers that are free on their segment."""
    landmark: tuple[str | None, ...]
    """Each marker's landmark on the template; None for markers that are free on their segment."""

    @property
    def known(self) -> Tensor:
        """Return the mask of the markers on a landmark, whose places on the template are known (markers,)."""
        return torch.tensor([name is not None for name in self.landmark], device=self.body.device)


def settle_bare(model: Model, marked: set[str]) -> tuple[Model, tuple[Note, ...]]:
    """Lock bodies without markers at the ends to their parents, and hold those between marked ones by a firm prior."""
    tree = model.tree
    bare = [k for k, name in enumerate(tree.names) if k and name not in marked]
    between = [k for k in bare if any(tree.names[below] in marked for below in tree.subtree(k))]
    model, said = lock_bodies(model, tuple(tree.names[k] for k in bare if k not in between))
    names = [tree.names[k] for k in between if _undetermined(tree, k, marked)]
    if not names:
        return model, said
    rows = {row for k, name in enumerate(model.tree.names) if name in names for row in model.tree.driving(k)}
    dofs = tuple(replace(dof, sd=FIRM) if row in rows else dof for row, dof in enumerate(model.tree.dofs))
    message = f"{', '.join(names)} without markers of its own: its joint is held within about {FIRM} rad of rest"
    return replace(model, tree=replace(model.tree, dofs=dofs)), (*said, Note("model.between", message))


def _undetermined(tree: Tree, body: int, marked: set[str]) -> bool:
    """Return whether more than ``HINGES`` coordinates lie between the marked bodies above and below an unmarked one."""

    def bare_above(k: int) -> list[int]:
        parent = tree.bodies[k].parent
        return [k, *(bare_above(parent) if parent > 0 and tree.names[parent] not in marked else [])]

    ends = [k for k in tree.subtree(body) if tree.names[k] in marked and body in bare_above(k)]
    return any(len({row for k in bare_above(end) for row in tree.driving(k)}) > HINGES for end in ends)


def attach(model: Model, specs: Mapping[str, MarkerSpec]) -> Attachment:
    """Return the markers of ``specs`` with their places on the model's bodies as the prior has them."""
    mean, sd = marker_prior(model, specs.values())
    body = torch.tensor([model.tree.index(spec.segment) for spec in specs.values()])
    return Attachment(tuple(specs), body, mean, sd, tuple(spec.landmark for spec in specs.values()))
