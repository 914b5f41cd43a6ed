"""This module divides the coordinates of a frame into branches that touch each other only through a core.

Limbs share no marker: their blocks of the normal matrix are coupled by the root and the trunk alone. Eliminating each
branch by itself leaves out the zeros between them (sparsity of a tree's mass matrix; Featherstone 2008, section 6.4).
"""

from dataclasses import dataclass, replace
from itertools import chain

import torch
from torch import Tensor

from torchid.geometry.arrow.index_tables import ArrowLayout
from torchid.kinematics.plan import Plan
from torchid.model.tree import BASE_DOFS

Pick = slice | Tensor
"""Columns as a slice where they stand side by side, else as indices."""


@dataclass(frozen=True)
class LimbGroup:
    """The coordinates of motion that are eliminated together, with the columns of xi that meet them."""

    size: int
    """Number of coordinates of motion."""
    motion: Pick
    """Coordinates of motion, as rows of ``layout.motion``."""
    columns: Pick
    """Columns in ``Twists`` of the coordinates of motion."""
    core: Pick
    """Columns in ``Twists`` of the core's motion; none for the core itself."""
    entries: Tensor
    """Columns in ``Twists`` that make the columns of xi: the first of each, then those to be added."""
    extra: tuple[tuple[int, int], ...]
    """Pairs (column of xi, position in ``entries``) of those to be added."""
    inside: Tensor
    """Matrix (motion; motion, core, entries), lower where square: 1 where the row's support lies in the column's."""
    around: Tensor
    """Matrix (motion, entries) with 1 where the column's support lies strictly within the row's."""
    own: slice
    """Columns of xi, in the order of the elimination, that belong to the branch alone."""
    xi: Tensor
    """Columns of xi that meet the group, in the order of the elimination."""


@dataclass(frozen=True)
class Partition:
    """The branches and the core of all coordinates, with the order in which they are eliminated."""

    branches: tuple[LimbGroup, ...]
    core: LimbGroup
    dof_rows: Tensor
    """Rows of q in the order of the elimination: branches one by one, then the core."""
    motion: Tensor
    """Coordinates of motion in the order of the elimination."""
    xi: Tensor
    """Rows of xi in the order of the elimination: each branch's own, parameters of the core, markers of the core."""
    common: slice
    """Parameters of the core, which all branches may meet, in that order."""


def pick(x: Tensor, columns: Pick) -> Tensor:
    """Return some columns of x (frames, columns, ...), as a view where they stand side by side."""
    return x[:, columns] if isinstance(columns, slice) else x.index_select(1, columns)


def _as_slice(columns: Tensor) -> Pick:
    """Return the columns as a slice where they stand side by side."""
    first, n = int(columns[0]) if len(columns) else 0, len(columns)
    together = bool((columns == torch.arange(first, first + n, device=columns.device)).all())
    return slice(first, first + n) if together else columns


def make_partition(plan: Plan, layout: ArrowLayout, n_xi: int) -> Partition:
    """Divide the coordinates of a problem into branches and core.

    Args:
        n_xi: number of entries of xi; 0 leaves xi out.
    """
    branches = plan.branches
    owner = {body: k for k, bodies in enumerate(branches) for body in bodies}
    core = len(branches)
    motion: list[list[int]] = [[] for _ in range(core + 1)]
    for k, body in enumerate(layout.motion_body.tolist()):
        motion[owner.get(body, core) if k >= BASE_DOFS else core].append(k)
    own, markers = _owners(layout, owner, core, n_xi)
    own[core] += markers
    order, groups, start = list(chain(*own)), [], 0
    common = slice(len(order) - len(own[core]), len(order) - len(markers))
    for k in range(core):
        mine = slice(start, start + len(own[k]))
        where = [*range(mine.start, mine.stop), *range(common.start, common.stop)]
        groups.append(_group(layout, motion[k], motion[core], order, where, mine))
        start = mine.stop
    rows = torch.tensor(list(chain(*motion)), device=layout.motion.device)
    everything = _group(layout, motion[core], [], order, list(range(len(order))), common)
    xi = torch.tensor(order, device=rows.device, dtype=torch.long)
    if layout.coupling is not None:  # columns of motion, all in the core, are folded into the coordinates
        n = len(layout.dof_rows)
        rows, everything = torch.arange(n, device=rows.device), replace(everything, size=n, motion=slice(0, n))
    return Partition(tuple(groups), everything, layout.dof_rows[rows], rows, xi, common)


def _owners(layout: ArrowLayout, owner: dict[int, int], core: int, n_xi: int) -> tuple[list[list[int]], list[int]]:
    """Return the columns of xi of each branch and of the core's parameters and, apart, those of the core's markers."""
    homes: list[set[int]] = [set() for _ in range(n_xi)]
    first_marker = layout.entry_xi[layout.geometric] if layout.geometric < len(layout.entry_xi) else n_xi
    if n_xi:
        for k, body in zip(layout.entry_xi.tolist(), layout.entry_body.tolist(), strict=True):
            homes[k].add(owner.get(body, core))
    own: list[list[int]] = [[] for _ in range(core + 1)]
    markers: list[int] = []
    for k, home in enumerate(homes):
        at = home.pop() if len(home) == 1 else core
        (markers if at == core and k >= int(first_marker) else own[at]).append(k)
    return own, markers


def _group(
    layout: ArrowLayout, motion: list[int], core: list[int], order: list[int], where: list[int], own: slice
) -> LimbGroup:
    """Build the group of some coordinates of motion.

    Args:
        core: coordinates of motion of the core; none for the core itself.
        order: xi in the order of the elimination.
        where: places in that order of the columns of xi that meet the group.
        own: places in that order of the columns that belong to the group alone.
    """
    like = layout.motion
    rows, carriers = (torch.tensor(x, device=like.device, dtype=torch.long) for x in (motion, core))
    body = layout.motion_body[rows]
    inside, around = layout.nesting(body)
    first, extra = _entries_of_columns(layout, ((inside + around) > 0).any(0).tolist(), [order[w] for w in where])
    chosen = torch.tensor(first + [entry for _, entry in extra], device=like.device, dtype=torch.long)
    column = layout.motion if order else layout.motion_alone
    lower = torch.tril(layout.within(body, body))
    return LimbGroup(
        size=len(rows),
        motion=_as_slice(rows),
        columns=_as_slice(column[rows]),
        core=_as_slice(column[carriers]),
        entries=layout.entries[chosen],
        extra=tuple((column, len(first) + k) for k, (column, _) in enumerate(extra)),
        inside=torch.cat([lower, layout.within(body, layout.motion_body[carriers]), inside[:, chosen]], dim=1),
        around=around[:, chosen],
        own=own,
        xi=torch.tensor(where, device=like.device, dtype=torch.long),
    )


def _entries_of_columns(
    layout: ArrowLayout, relevant: list[bool], columns: list[int]
) -> tuple[list[int], list[tuple[int, int]]]:
    """Return one entry for each column of xi, and (position, entry) of its others that matter."""
    of: dict[int, list[int]] = {}
    for entry, k in enumerate(layout.entry_xi.tolist()):
        of.setdefault(k, []).append(entry)
    first, extra = [], []
    for position, k in enumerate(columns):
        found = [e for e in of[k] if relevant[e]] or of[k][:1]
        first.append(found[0])
        extra += [(position, entry) for entry in found[1:]]
    return first, extra
