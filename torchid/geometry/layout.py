"""Which coordinate moves which markers: the index tables behind the arrow's normal matrix.

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


@dataclass(frozen=True)
class Layout:
    """Index tables of a problem; bodies by plan position, motion columns in plan order behind the six of the base."""

    dof_rows: Tensor
    """Row of q of each motion column."""
    motion_body: Tensor
    """Body of each motion column behind the base's six."""
    motion_order: Tensor
    """Order of turns and slides in the motion columns."""
    subtree: Tensor
    """(bodies, markers): 1 where the marker is on or below the body."""
    shared_body: Tensor
    """Body whose subtree each geometry entry moves."""
    offset_parent: Tensor
    """Parent body of each offset entry."""
    offset_axis: Tensor
    hinge_turn: Tensor
    """Turn number of each hinge entry."""
    is_offset: Tensor
    """Mask over geometry entries; the others are hinges."""
    coefficient: Tensor
    """Derivative of the raw number with respect to the named parameter."""
    parameter: Tensor
    """Named parameter of each entry; the first n_named entries are parameters 0, 1, ... in order."""
    motion_over_motion: Tensor
    """(motion, motion): 1 where the row's support lies within the column's (lower triangle of H)."""
    shared_in_motion: Tensor
    """(motion, entries): the entry's support lies within the coordinate's."""
    motion_in_shared: Tensor
    """(motion, entries): strictly the reverse."""
    shared_in_shared: Tensor
    """(entries, entries): 1 where the row's support lies within the column's; one half for equal supports."""
    marker_in_motion: Tensor
    """(motion, 3 free markers)."""
    marker_in_shared: Tensor
    """(entries, 3 free markers)."""


def make_layout(problem: MarkerProblem) -> Layout:
    """Index tables of ``problem`` on its device."""
    plan, like = problem.plan, problem.target
    position = plan.position
    above = _above(plan).to(like)
    base = [0] * 6
    motion_body = torch.tensor([position[c.body] for c in plan.motion], device=like.device, dtype=torch.long)
    every = torch.cat([torch.tensor(base, device=like.device), motion_body])
    entries = _entries(problem)
    shared = torch.tensor([e[0] for e in entries], device=like.device, dtype=torch.long)
    marker_body = problem.body[problem.free].repeat_interleave(3)
    within = above[every][:, shared]
    strictly = above[shared][:, every].T * (1.0 - within)
    both = above[shared][:, shared]
    columns = len(every)
    lower = torch.tril(torch.ones(columns, columns, dtype=like.dtype, device=like.device))
    motion = above[every][:, every].T
    equal = motion * motion.T
    tables = torch.tensor([e[1:4] for e in entries], device=like.device, dtype=torch.long).reshape(-1, 3)
    offset = torch.tensor([e[1] >= 0 for e in entries], device=like.device, dtype=torch.bool)
    return Layout(
        dof_rows=torch.tensor([*range(6), *(c.row for c in plan.motion)], device=like.device),
        motion_body=motion_body,
        motion_order=torch.tensor(plan.motion_order, device=like.device, dtype=torch.long),
        subtree=above[:, problem.body].contiguous(),
        shared_body=shared,
        offset_parent=tables[offset, 0],
        offset_axis=tables[offset, 1],
        hinge_turn=tables[~offset, 2],
        is_offset=offset,
        coefficient=like.new_tensor([e[4] for e in entries]),
        parameter=torch.tensor([e[5] for e in entries], device=like.device, dtype=torch.long),
        motion_over_motion=torch.where(equal > 0, lower, motion),
        shared_in_motion=within,
        motion_in_shared=strictly,
        shared_in_shared=both.T - 0.5 * both.T * both,
        marker_in_motion=above[every][:, marker_body],
        marker_in_shared=above[shared][:, marker_body],
    )


def _above(plan: Plan) -> Tensor:
    """(bodies, bodies) by plan position: 1 where the row is the column or an ancestor of it."""
    n, position = len(plan.order), plan.position
    above = torch.zeros(n, n)
    for body, ancestors in enumerate(plan.tree.ancestors):
        for ancestor in ancestors:
            above[position[ancestor], position[body]] = 1.0
    return above


Entry = tuple[int, int, int, int, float, int]
"""Body moved, parent (-1: hinge), axis, hinge turn, coefficient, parameter."""


def _entries(problem: MarkerProblem) -> list[Entry]:
    """One entry for each (named parameter, raw number it moves); the first of every parameter in front."""
    plan, prior = problem.plan, problem.geometry
    position, parents = plan.position, plan.tree.parents
    first, extra = [], []
    for j in range(problem.n_named):
        found: list[Entry] = []
        for raw in prior.map[:, j].nonzero()[:, 0].tolist():
            coefficient = float(prior.map[raw, j])
            if raw < prior.n_offset:
                body, axis = divmod(raw, 3)
                found.append((position[body], position[parents[body]], axis, -1, coefficient, j))
            else:
                found += [
                    (position[column.body], -1, 0, k, coefficient, j)
                    for k, column in enumerate(plan.hinges)
                    if column.row == raw - prior.n_offset
                ]
        assert found, f"geometric parameter {prior.names[j]} moves nothing"
        first.append(found[0])
        extra += found[1:]
    return first + extra
