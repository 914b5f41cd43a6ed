"""This module says which coordinate moves which markers, by the index tables behind the arrow's normal matrix.

Every coordinate, of motion or of geometry, moves the markers of one subtree with a twist that all of them share
(a marker's own place moves that marker alone). Supports are therefore nested or disjoint, and the entry of J^T J
for two coordinates is the wrench of the smaller support against the twist of the larger: the mass matrix of point
masses at the markers (composite-rigid-body algorithm; Featherstone 2008, section 6.2).
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from torchid.geometry.problem import MarkerProblem
from torchid.kinematics.plan import Plan
from torchid.model.coupling import Coupling
from torchid.model.tree import BASE_DOFS


@dataclass(frozen=True)
class ArrowLayout:
    """The index tables of a problem, in which bodies are numbered by their position in the plan.

    *Columns* are those of ``twists.Twists``. *Motion* is the subset that q drives, whatever moves more first.
    *Entries* are the rest: one for each (named parameter, subtree that it moves), then three for each free marker.
    """

    motion: Tensor
    """Column of each coordinate of motion where geometry has columns too."""
    motion_alone: Tensor
    """Column of each coordinate of motion where geometry has none."""
    axis_rows: Tensor
    """Row of the axis values that drives each column of motion."""
    dof_rows: Tensor
    """Row of q of each coordinate of motion: the same rows, or all of q where a coupling makes axis values of it."""
    coupling: Coupling | None
    """Coupling of the tree; columns of motion are folded into coordinates by it (``normal_blocks.Pieces.fold``)."""
    motion_body: Tensor
    """Body whose subtree each coordinate of motion moves; the root for the six of the base."""
    entries: Tensor
    """Column of each entry."""
    entry_body: Tensor
    """Body whose subtree each entry moves, or that carries the entry's marker."""
    entry_xi: Tensor
    """Row of xi that each entry belongs to."""
    geometric: int
    """Number of entries of named parameters; those of the markers follow."""
    turn_order: Tensor
    """The plan's turns in the order of their columns: the core's, then limb by limb."""
    turning_body: Tensor
    """Body of each turn and hinge entry."""
    sliding_body: Tensor
    """Body of each slide and offset entry."""
    hinge_map: Tensor
    """Matrix (hinge entries, hinge turns) from the axes of the turns to those of the entries."""
    offset_map: Tensor
    """Matrix (offset entries, 3 * bodies) from the columns of all R_WB to the directions of the entries."""
    above: Tensor
    """Matrix (bodies, bodies) with 1 where the row is the column or an ancestor of it."""
    subtree: Tensor
    """Matrix (bodies, markers) with 1 where the marker is on or below the body."""
    composite: Tensor
    """Matrix (36, 10) from mass, first and second moments (``twists.moments``) to the spatial inertia about the
    origin, forces first."""

    def of_entries(self, x: Tensor) -> Tensor:
        """Return the entries' columns of x (frames, columns, 6), as a view where they stand side by side."""
        first, n = (int(self.entries[0]) if len(self.entries) else 0), len(self.entries)
        return x[:, first:] if first + n == x.shape[1] else x.index_select(1, self.entries)

    def within(self, inner: Tensor, outer: Tensor) -> Tensor:
        """Return the matrix (inner, outer) with 1 where the subtree of the inner body lies within that of the outer."""
        return self.above[outer][:, inner].T.contiguous()

    def nesting(self, body: Tensor) -> tuple[Tensor, Tensor]:
        """Compare the subtrees of some bodies (rows) with those of all entries (columns).

        Returns:
            Two matrices (body, entries) with 1 where the row lies within the column, and where the column lies strictly
            within the row.
        """
        inside = self.within(body, self.entry_body)
        inside[:, self.geometric :] = 0.0
        return inside, self.within(self.entry_body, body).T * (1.0 - inside)


def _motion_columns(plan: Plan, first_slide: int) -> tuple[list[int], list[int], list[int]]:
    """Return the turns in order, and the column of each coordinate of motion beside geometry and alone."""
    turns = len(plan.turns)
    order = [k for k in plan.motion_order if k < turns]
    rank = {k: place for place, k in enumerate(order)}
    column = [BASE_DOFS + rank[k] if k < turns else first_slide + k - turns for k in plan.motion_order]
    return order, column, [BASE_DOFS + rank.get(k, k) for k in plan.motion_order]


def make_layout(problem: MarkerProblem, dtype: torch.dtype | None = None) -> ArrowLayout:
    """Build the index tables of a problem on its device.

    Args:
        problem: tree, free parameters and markers.
        dtype: precision of the matrices; None takes that of the problem.
    """
    plan, like = problem.plan, problem.target[:0].to(dtype or problem.target.dtype)
    position, (hinge, offset) = plan.position, _entries(problem)
    turns, slides = len(plan.turns), len(plan.slides)

    def index(values: list[int]) -> Tensor:
        return torch.tensor(values, dtype=torch.long, device=like.device)

    base, first_slide, markers = list(range(BASE_DOFS)), BASE_DOFS + turns + len(hinge), range(3 * len(problem.free))
    first_marker = first_slide + slides + len(offset)
    turn_order, column, alone = _motion_columns(plan, first_slide)
    above, rows = _ancestor_matrix(plan).to(like), base + [c.row for c in plan.motion]
    return ArrowLayout(
        motion=index(base + column),
        motion_alone=index(base + alone),
        axis_rows=index(rows),
        dof_rows=index(list(range(len(plan.tree.dofs))) if plan.tree.coupling else rows),
        coupling=plan.tree.coupling,
        motion_body=index([0] * BASE_DOFS + [position[c.body] for c in plan.motion]),
        entries=index(
            [BASE_DOFS + turns + k for k in range(len(hinge))]
            + [first_slide + slides + k for k in range(len(offset))]
            + [first_marker + k for k in markers]
        ),
        entry_body=torch.cat(
            [index([b for _, b in (*hinge, *offset)]), problem.body[problem.free].repeat_interleave(3)]
        ),
        entry_xi=index([parameter for parameter, _ in (*hinge, *offset)] + [problem.n_named + k for k in markers]),
        geometric=len(hinge) + len(offset),
        turn_order=index(turn_order),
        turning_body=index([position[plan.turns[k].body] for k in turn_order] + [body for _, body in hinge]),
        sliding_body=index([position[c.body] for c in plan.slides] + [body for _, body in offset]),
        hinge_map=_coefficient_table(hinge, len(plan.hinges), like),
        offset_map=_coefficient_table(offset, 3 * len(plan.order), like),
        above=above,
        subtree=above[:, problem.body].contiguous(),
        composite=_composite_inertia().to(like),
    )


def _ancestor_matrix(plan: Plan) -> Tensor:
    """Return the matrix (bodies, bodies) with 1 where the row is the column or an ancestor of it."""
    n, position = len(plan.order), plan.position
    above = torch.zeros(n, n)
    for body, ancestors in enumerate(plan.tree.ancestors):
        for ancestor in ancestors:
            above[position[ancestor], position[body]] = 1.0
    return above


def _composite_inertia() -> Tensor:
    """Return the matrix (36, 10) of Featherstone 2008, eq. 2.63, with the rotational inertia from second moments."""
    inertia = torch.zeros(6, 6, 10)
    inertia[range(3), range(3), 0] = 1.0
    for k in range(3):
        i, j = (k + 1) % 3, (k + 2) % 3
        inertia[3 + j, i, 1 + k] = inertia[i, 3 + j, 1 + k] = 1.0
        inertia[3 + i, j, 1 + k] = inertia[j, 3 + i, 1 + k] = -1.0
        inertia[3 + k, 3 + k, [4, 7, 9]] = 1.0
    for k, (i, j) in enumerate(((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))):
        inertia[3 + i, 3 + j, 4 + k] -= 1.0
        if i != j:
            inertia[3 + j, 3 + i, 4 + k] -= 1.0
    return inertia.view(36, 10)


Entries = dict[tuple[int, int], dict[int, float]]
"""Coefficients of the hinge turns, or of the columns of all rotations, by (named parameter, body that it moves)."""


def _entries(problem: MarkerProblem) -> tuple[Entries, Entries]:
    """Return the hinge entries and the offset entries of the free parameters."""
    plan, prior = problem.plan, problem.geometry
    position, parents = plan.position, plan.tree.parents
    hinge: Entries = {}
    offset: Entries = {}
    for raw, parameter in prior.map.nonzero().tolist():
        coefficient = float(prior.map[raw, parameter])
        if raw < prior.n_offset:
            body, axis = divmod(raw, 3)
            if body:
                source = 3 * position[parents[body]] + axis
                offset.setdefault((parameter, position[body]), {})[source] = coefficient
            continue
        for turn, column in enumerate(plan.hinges):
            if column.row == raw - prior.n_offset:
                hinge.setdefault((parameter, position[column.body]), {})[turn] = coefficient
    missing = set(range(problem.n_named)) - {parameter for parameter, _ in (*hinge, *offset)}
    assert not missing, f"geometric parameters {[prior.names[k] for k in missing]} move nothing"
    return hinge, offset


def _coefficient_table(entries: Entries, width: int, like: Tensor) -> Tensor:
    """Return the coefficients of the entries as a matrix (entries, width)."""
    table = like.new_zeros(len(entries), width)
    for row, sources in enumerate(entries.values()):
        for column, coefficient in sources.items():
            table[row, column] = coefficient
    return table
