"""What a plan looks like as tensors: index tables of its tree, and the joints' axes that a geometry gives it."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, fields
from functools import lru_cache
from itertools import chain, pairwise

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchid.kinematics.plan import Plan, Tilt
from torchid.model.model import Geometry
from torchid.model.rotation import generators, rodrigues

EYE = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


@dataclass(frozen=True, eq=False)
class Tables:
    """Constants of a plan; bodies by plan position, turns, hinges and slides in the plan's order."""

    order: Int[Tensor, " bodies"]
    first: int
    """Number of first turns."""
    slots: tuple[tuple[int, int, Tensor], ...]
    """Of second and later turns: start, stop, and which of the slot before are the turns before them."""
    turn_before: Int[Tensor, " later"]
    """Turn before each of the second and later ones."""
    parents: tuple[tuple[int, int, Tensor], ...]
    """Of every level below the root: start, stop, and which of the level above are the parents."""
    parent: Int[Tensor, " links"]
    """Parent of every body but the root."""
    last: Int[Tensor, " links"]
    """Last turn of every body but the root; one beyond the turns where it has none."""
    all_turn: bool
    """Every body but the root has a turn."""
    turn_row: Int[Tensor, " turns"]
    turn_parent: Int[Tensor, " turns"]
    hinge_parent: Int[Tensor, " hinges"]
    hinge_before: Int[Tensor, " hinges"]
    """The turn of the same body that moves the hinge's axis; one beyond the turns where none does."""
    slide_row: Int[Tensor, " slides"]
    slide_link: Int[Tensor, " slides"]
    """Number of the sliding body among the links."""
    above: Float[Tensor, "bodies bodies"]
    """1 where the column's body is the row's or an ancestor of it."""
    turns_above: Float[Tensor, "bodies turns"]
    """1 where the turn moves the body."""
    unit: Float[Tensor, "axes 3"]
    """Axes of turns, hinges and slides and the columns of remainders, before any tilt."""
    tilts: Int[Tensor, "axes depth"]
    """What tilts each of them, innermost first: hinge tilts, then fixed ones, then none."""
    hinge_generators: Float[Tensor, "hinge_tilts 9 3"]
    hinge_row: Int[Tensor, " hinge_tilts"]
    fixed: Float[Tensor, "others 3 3"]
    """Columns of the tilts that the tree fixes; the last is the identity."""
    remaining: Int[Tensor, " remainders"]
    """Links whose remainder is not the identity."""


@dataclass(frozen=True)
class Joints:
    """Joint axes that a geometry gives a plan, in the axes of the parent and before any motion."""

    tables: Tables
    offset: Float[Tensor, "links 3"]
    generators: Float[Tensor, "turns 9 3"]
    turn: Float[Tensor, "turns 3"]
    hinge: Float[Tensor, "hinges 3"]
    slide: Float[Tensor, "slides 3"]
    remainder: Float[Tensor, "remainders 3 3"]
    """Columns of the constant rotations behind some joints."""

    def to(self, dtype: torch.dtype) -> "Joints":
        """The axes in another precision."""
        return Joints(self.tables, *(getattr(self, f.name).to(dtype) for f in fields(self)[1:]))


def make_joints(plan: Plan, geometry: Geometry) -> Joints:
    """Axes of all joints at ``geometry``."""
    tables = make_tables(plan, geometry.offset.dtype, geometry.offset.device)
    angle = geometry.hinge.index_select(0, tables.hinge_row)[:, None]
    rotations = torch.cat([rodrigues(tables.hinge_generators, angle)[..., 0], tables.fixed])
    axes = tables.unit
    for depth in range(tables.tilts.shape[1]):
        axes = (rotations.index_select(0, tables.tilts[:, depth]) * axes[:, :, None]).sum(1)
    turn, hinge, slide, rest = axes.split(
        [len(plan.turns), len(plan.hinges), len(plan.slides), 3 * len(tables.remaining)]
    )
    offset = geometry.offset.index_select(0, tables.order[1:])
    return Joints(tables, offset, generators(turn), turn, hinge, slide, rest.view(-1, 3, 3))


@lru_cache(maxsize=64)
def make_tables(plan: Plan, dtype: torch.dtype, device: torch.device) -> Tables:
    """Constants of ``plan``."""
    position, bodies = plan.position, len(plan.order)

    def index(values: Iterable[int]) -> Tensor:
        return torch.tensor(list(values), dtype=torch.long, device=device)

    def number(values: list) -> Tensor:
        return torch.tensor(values, dtype=dtype, device=device)

    last = {position[turn.body]: k for k, turn in enumerate(plan.turns)}
    above = number([[float(k in plan.tree.ancestors[body]) for k in plan.order] for body in plan.order])
    turn_body = index(position[c.body] for c in plan.turns)
    remaining = [k for k, rest in enumerate(plan.remainders) if rest]
    unit, stacks = _axes(plan, remaining)
    hinged, fixed, tilts = _number_tilts(stacks)
    return Tables(
        order=index(plan.order),
        first=sum(c.slot == 0 for c in plan.turns),
        slots=tuple((start, stop, index(before)) for start, stop, before in _slots(plan)),
        turn_before=index(c.before for c in plan.turns if c.slot),
        parents=tuple((start, stop, index(parents)) for start, stop, parents in _parents(plan)),
        parent=index(p for level in plan.levels[1:] for p in level.parents),
        last=index(last.get(k, len(plan.turns)) for k in range(1, bodies)),
        all_turn=len(last) == bodies - 1,
        turn_row=index(c.row for c in plan.turns),
        turn_parent=index(position[plan.tree.parents[c.body]] for c in plan.turns),
        hinge_parent=index(position[plan.tree.parents[c.body]] for c in plan.hinges),
        hinge_before=index(c.before if c.before >= 0 else len(plan.turns) for c in plan.hinges),
        slide_row=index(c.row for c in plan.slides),
        slide_link=index(position[c.body] - 1 for c in plan.slides),
        above=above,
        turns_above=above[:, turn_body],
        unit=number(unit).view(-1, 3),
        tilts=index(chain(*tilts)).view(len(tilts), max(map(len, tilts), default=0)),
        hinge_generators=generators(number([_signed(t.axis, t.sign) for t in hinged]).view(-1, 3)),
        hinge_row=index(t.row for t in hinged),
        fixed=number([t.fixed for t in fixed] + [EYE]).mT.contiguous(),
        remaining=index(k - 1 for k in remaining),
    )


def _axes(plan: Plan, remaining: list[int]) -> tuple[list[list[float]], list[tuple[Tilt, ...]]]:
    """Axes of turns, hinges and slides and the columns of remainders, and the tilts that each has behind it."""
    columns = (*plan.turns, *plan.hinges, *plan.slides)
    unit = [_signed(c.axis, c.sign) for c in columns] + [_signed(a, 1.0) for _ in remaining for a in range(3)]
    return unit, [c.tilts for c in columns] + [plan.remainders[k] for k in remaining for _ in range(3)]


def _number_tilts(stacks: list[tuple[Tilt, ...]]) -> tuple[list[Tilt], list[Tilt], list[list[int]]]:
    """Tilts by hinges, those that the tree fixes, and each stack, innermost first, as numbers among both.

    The number beyond the last fills stacks up to the deepest.
    """
    known = list(dict.fromkeys(tilt for stack in stacks for tilt in stack))
    hinged, fixed = [t for t in known if t.fixed is None], [t for t in known if t.fixed is not None]
    depth = max((len(stack) for stack in stacks), default=0)
    place = {tilt: k for k, tilt in enumerate((*hinged, *fixed))}
    padded = [[place[t] for t in reversed(stack)] + [len(known)] * (depth - len(stack)) for stack in stacks]
    return hinged, fixed, padded


def _signed(axis: int, sign: float) -> list[float]:
    return [sign * float(k == axis) for k in range(3)]


def _parents(plan: Plan) -> Iterator[tuple[int, int, list[int]]]:
    for above, level in pairwise(plan.levels):
        yield level.start, level.stop, [p - above.start for p in level.parents]


def _slots(plan: Plan) -> Iterator[tuple[int, int, list[int]]]:
    slots = [c.slot for c in plan.turns]
    for slot in range(1, max(slots, default=0) + 1):
        start, stop = slots.index(slot), len(slots) - slots[::-1].index(slot)
        yield start, stop, [c.before - slots.index(slot - 1) for c in plan.turns[start:stop]]
