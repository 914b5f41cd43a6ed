"""The order in which a tree is walked: bodies level by level, equal turns side by side.

The lean recursion keeps frames last, so that every operation streams over contiguous memory, and applies one turn of
many bodies at once. A ``Plan`` is that order, made once per tree; it holds plain Python and no tensors.
"""

from dataclasses import dataclass
from functools import lru_cache

from torchid.model.tree import BASE_DOFS, Body, Rotation, Tree

CYCLE = {0: (1, 2), 1: (2, 0), 2: (0, 1)}
"""A turn about axis a by t maps columns (u, v) = CYCLE[a] to (c u + s v, c v - s u)."""


@dataclass(frozen=True)
class Step:
    """One turn (or slide) of the bodies ``start`` to ``stop`` of a level."""

    axis: int
    start: int
    stop: int
    first: int
    """Number of the first of its turns (or slides) in plan order."""
    moving: bool = True


@dataclass(frozen=True)
class Level:
    """Bodies at the same depth."""

    start: int
    stop: int
    """Plan positions of its bodies."""
    parents: tuple[int, ...]
    """Positions of their parents within the level above."""
    slides: tuple[Step, ...]
    turns: tuple[Step, ...]
    before: tuple[Rotation | None, ...]
    after: tuple[Rotation | None, ...]


@dataclass(frozen=True)
class Column:
    """What one coordinate moves: the subtree of ``body`` (tree index), by a turn or a slide."""

    row: int
    """Row of q, or of the hinge angles."""
    body: int
    sign: float
    slide: bool = False


@dataclass(frozen=True)
class Plan:
    """A tree in walking order."""

    tree: Tree
    order: tuple[int, ...]
    """Tree index of each plan position."""
    levels: tuple[Level, ...]
    turns: tuple[Column, ...]
    """Moving turns in plan order."""
    hinges: tuple[Column, ...]
    """Turns by hinge angles in plan order."""
    slides: tuple[Column, ...]

    @property
    def position(self) -> tuple[int, ...]:
        """Plan position of each body of the tree."""
        place = [0] * len(self.order)
        for position, body in enumerate(self.order):
            place[body] = position
        return tuple(place)

    @property
    def motion(self) -> tuple[Column, ...]:
        """Columns of motion behind the six of the base: turns, then slides, in the order of ``motion_order``."""
        both = self.turns + self.slides
        return tuple(both[k] for k in self.motion_order)

    @property
    def motion_order(self) -> tuple[int, ...]:
        """Order of turns and slides in which whatever moves more stands before what it moves."""
        position, both = self.position, self.turns + self.slides
        if not self.slides:
            return tuple(range(len(both)))
        return tuple(sorted(range(len(both)), key=lambda k: position[both[k].body]))


@lru_cache(maxsize=32)
def plan_tree(tree: Tree) -> Plan:
    """Walking order of ``tree``."""
    depth = [len(above) - 1 for above in tree.ancestors]
    # Longest sequences first: the bodies that still turn at step k stay side by side.
    signature = [tuple((turn.axis, turn.moving) for turn in body.turns) for body in tree.bodies]
    order = sorted(range(len(tree.bodies)), key=lambda k: (depth[k], -len(signature[k]), signature[k], k))
    turns: list[Column] = []
    hinges: list[Column] = []
    slides: list[Column] = []
    levels = []
    for d in range(max(depth) + 1):
        members = [k for k in order if depth[k] == d]
        levels.append(_level(tree, order, members, turns, hinges, slides))
    covered = sorted(column.row for column in turns + slides)
    assert covered == list(range(BASE_DOFS, len(tree.dofs))), "every dof but the base's drives exactly one joint axis"
    return Plan(tree, tuple(order), tuple(levels), tuple(turns), tuple(hinges), tuple(slides))


def _level(
    tree: Tree, order: list[int], members: list[int], turns: list[Column], hinges: list[Column], slides: list[Column]
) -> Level:
    bodies = [tree.bodies[k] for k in members]
    above = [
        k for k in order if bodies[0].parent >= 0 and len(tree.ancestors[k]) == len(tree.ancestors[members[0]]) - 1
    ]
    return Level(
        start=order.index(members[0]),
        stop=order.index(members[-1]) + 1,
        parents=tuple(above.index(body.parent) for body in bodies if body.parent >= 0),
        slides=tuple(_slide_steps(bodies, members, slides)),
        turns=tuple(_turn_steps(bodies, members, turns, hinges)),
        before=tuple(body.R_PJ for body in bodies),
        after=tuple(body.R_JB for body in bodies),
    )


def _turn_steps(bodies: list[Body], members: list[int], turns: list[Column], hinges: list[Column]) -> list[Step]:
    steps = []
    for k in range(max(len(body.turns) for body in bodies)):
        start = 0
        while start < len(bodies):
            stop = start
            while stop < len(bodies) and _kind(bodies[stop], k) == _kind(bodies[start], k):
                stop += 1
            if _kind(bodies[start], k) is not None:
                turn = bodies[start].turns[k]
                columns = turns if turn.moving else hinges
                steps.append(Step(turn.axis, start, stop, len(columns), turn.moving))
                columns += [
                    Column(b.turns[k].row, m, b.turns[k].sign)
                    for b, m in zip(bodies[start:stop], members[start:stop], strict=True)
                ]
            start = stop
    return steps


def _kind(body: Body, k: int) -> tuple[int, bool] | None:
    return (body.turns[k].axis, body.turns[k].moving) if k < len(body.turns) else None


def _slide_steps(bodies: list[Body], members: list[int], slides: list[Column]) -> list[Step]:
    steps = []
    for position, (body, member) in enumerate(zip(bodies, members, strict=True)):
        for slide in body.slides:
            steps.append(Step(slide.axis, position, position + 1, len(slides)))
            slides.append(Column(slide.row, member, 1.0, slide=True))
    return steps
