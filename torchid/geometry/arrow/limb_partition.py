"""How the coordinates of a frame fall into branches that touch each other only through a core.

Limbs share no marker: their blocks of the normal matrix are coupled by the root and the trunk alone. Eliminating each
branch by itself leaves out the zeros between them (sparsity of a tree's mass matrix; Featherstone 2008, section 6.5).
"""

from dataclasses import dataclass
from itertools import chain

import torch
from torch import Tensor

from torchid.geometry.arrow.index_tables import Layout
from torchid.kinematics.plan import Plan
from torchid.model.tree import BASE_DOFS

Pick = slice | Tensor
"""Columns that stand side by side, or any columns."""


@dataclass(frozen=True)
class Group:
    """Coordinates of motion that are eliminated together, and the columns of xi that meet them."""

    size: int
    motion: Pick
    """Which coordinates of motion (rows of ``layout.motion``)."""
    columns: Pick
    """Their columns in ``Twists``."""
    core: Pick
    """Columns in ``Twists`` of the core's motion; none for the core itself."""
    entries: Tensor
    """Columns in ``Twists`` that make the columns of xi: the first of each, then those to be added."""
    extra: tuple[tuple[int, int], ...]
    """(column of xi, entry) of those to be added."""
    inside: Tensor
    """(motion; itself, the core, entries) 1 where the row's support lies within the column's; lower where square."""
    around: Tensor
    """(motion, entries) strictly the reverse."""
    own: slice
    """Columns of xi, in the order of the elimination, that belong to the branch alone."""
    xi: Tensor
    """Columns of xi that meet the group, in the order of the elimination."""


@dataclass(frozen=True)
class Partition:
    """All branches and the core."""

    branches: tuple[Group, ...]
    core: Group
    dof_rows: Tensor
    """Rows of q in the order of the elimination: branches one by one, then the core."""
    motion: Tensor
    """The same as coordinates of motion."""
    xi: Tensor
    """xi in the order of the elimination: own columns of each branch, parameters of the core, markers of the core."""
    common: slice
    """Parameters of the core, which all branches may meet, in that order."""


def pick(x: Tensor, columns: Pick) -> Tensor:
    """Some columns of (frames, columns, ...): a view where they stand side by side."""
    return x[:, columns] if isinstance(columns, slice) else x.index_select(1, columns)


def _side_by_side(columns: Tensor) -> Pick:
    first, n = int(columns[0]) if len(columns) else 0, len(columns)
    together = bool((columns == torch.arange(first, first + n, device=columns.device)).all())
    return slice(first, first + n) if together else columns


def make_partition(plan: Plan, layout: Layout, n_xi: int) -> Partition:
    """Branches and core; ``n_xi = 0`` leaves xi out."""
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
    return Partition(tuple(groups), everything, layout.dof_rows[rows], rows, xi, common)


def _owners(layout: Layout, owner: dict[int, int], core: int, n_xi: int) -> tuple[list[list[int]], list[int]]:
    """Columns of xi of each branch and of the core's parameters; apart from them, those of the core's markers."""
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


def _group(layout: Layout, motion: list[int], core: list[int], order: list[int], where: list[int], own: slice) -> Group:
    like = layout.motion
    rows, carriers = (torch.tensor(x, device=like.device, dtype=torch.long) for x in (motion, core))
    body = layout.motion_body[rows]
    inside, around = layout.nesting(body)
    first, extra = _gathered(layout, ((inside + around) > 0).any(0).tolist(), [order[w] for w in where])
    chosen = torch.tensor(first + [entry for _, entry in extra], device=like.device, dtype=torch.long)
    column = layout.motion if order else layout.motion_alone
    lower = torch.tril(layout.within(body, body))
    return Group(
        size=len(rows),
        motion=_side_by_side(rows),
        columns=_side_by_side(column[rows]),
        core=_side_by_side(column[carriers]),
        entries=layout.entries[chosen],
        extra=tuple((column, len(first) + k) for k, (column, _) in enumerate(extra)),
        inside=torch.cat([lower, layout.within(body, layout.motion_body[carriers]), inside[:, chosen]], dim=1),
        around=around[:, chosen],
        own=own,
        xi=torch.tensor(where, device=like.device, dtype=torch.long),
    )


def _gathered(layout: Layout, relevant: list[bool], columns: list[int]) -> tuple[list[int], list[tuple[int, int]]]:
    """For each column of xi one of its entries, and (position, entry) of the others that matter."""
    of: dict[int, list[int]] = {}
    for entry, k in enumerate(layout.entry_xi.tolist()):
        of.setdefault(k, []).append(entry)
    first, extra = [], []
    for position, k in enumerate(columns):
        found = [e for e in of[k] if relevant[e]] or of[k][:1]
        first.append(found[0])
        extra += [(position, entry) for entry in found[1:]]
    return first, extra
