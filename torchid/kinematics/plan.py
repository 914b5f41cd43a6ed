"""The order in which a tree is walked, and its joints as rotations about constant axes.

A constant turn between two moving ones tilts every axis behind it until it is undone: C Rot(a, t) C' = Rot(C a, t).
Every joint is therefore a product of at most a few rotations about axes that geometry alone decides, times a constant
remainder that most joints lack. First turns of all bodies, second turns and so on are each one batch.

A ``Plan`` is made once per tree; it holds plain Python and no tensors.
"""

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

from torchid.model.tree import BASE_DOFS, Body, Rotation, Tree


@dataclass(frozen=True)
class Tilt:
    """A constant rotation: about an axis by ``sign`` times a hinge angle, or one that the tree fixes."""

    axis: int = 0
    row: int = -1
    """Row of the hinge angles."""
    sign: float = 1.0
    fixed: Rotation | None = None

    def undone_by(self, other: "Tilt") -> bool:
        """Whether ``other`` straight behind it leaves nothing."""
        same = (self.axis, self.row, -self.sign) == (other.axis, other.row, other.sign)
        return same and self.fixed is None and other.fixed is None


@dataclass(frozen=True)
class MotionColumn:
    """What one coordinate moves: the subtree of ``body`` (tree index), by a turn or a slide."""

    row: int
    """Row of q, or of the hinge angles."""
    body: int
    axis: int
    sign: float
    tilts: tuple[Tilt, ...]
    """Constant rotations that the axis has behind it, outermost first."""
    slot: int = 0
    """Number of moving turns of the same body before it."""
    before: int = -1
    """The last of them, by its place among ``Plan.turns``; -1 for none."""
    slide: bool = False


@dataclass(frozen=True)
class Level:
    """Bodies at the same depth: plan positions ``start`` to ``stop``, and their parents' positions."""

    start: int
    stop: int
    parents: tuple[int, ...]


@dataclass(frozen=True, eq=False)
class Plan:
    """A tree in walking order; equal only to itself, so that it is a cheap key."""

    tree: Tree
    order: tuple[int, ...]
    """Tree index of each plan position."""
    levels: tuple[Level, ...]
    """The root's first."""
    turns: tuple[MotionColumn, ...]
    """Moving turns: first ones of all bodies, then second ones and so on; bodies in plan order."""
    hinges: tuple[MotionColumn, ...]
    """Turns by hinge angles."""
    slides: tuple[MotionColumn, ...]
    remainders: tuple[tuple[Tilt, ...], ...]
    """Of each plan position the constant rotations that nothing undoes."""

    @cached_property
    def position(self) -> tuple[int, ...]:
        """Plan position of each body of the tree."""
        place = [0] * len(self.order)
        for position, body in enumerate(self.order):
            place[body] = position
        return tuple(place)

    @cached_property
    def branches(self) -> tuple[tuple[int, ...], ...]:
        """Plan positions of the bodies of each limb; limbs meet only through what is in none of them, the core."""
        tree, position = self.tree, self.position
        if tree.coupling:  # coordinates may move several limbs
            return ()
        moving = {column.body for column in (*self.turns, *self.slides)}
        alive = [bool(moving & set(tree.subtree(k))) for k in range(len(tree.bodies))]
        living = [body.parent for k, body in enumerate(tree.bodies) if alive[k]]
        forks = {0} | {k for k in range(len(tree.bodies)) if living.count(k) > 1}
        core = {k for k in range(len(tree.bodies)) if forks & set(tree.subtree(k))}
        tops = [k for k, body in enumerate(tree.bodies) if k not in core and body.parent in core and alive[k]]
        return tuple(tuple(position[k] for k in tree.subtree(top)) for top in tops)

    @cached_property
    def motion_order(self) -> tuple[int, ...]:
        """Order of turns and slides (numbered behind them): the core, then limb by limb; who carries stands first."""
        position, both = self.position, self.turns + self.slides
        limb = {body: k for k, bodies in enumerate(self.branches) for body in bodies}

        def key(k: int) -> tuple[int, int, bool, int]:
            at = position[both[k].body]
            return limb.get(at, -1), at, not both[k].slide, both[k].slot

        return tuple(sorted(range(len(both)), key=key))

    @property
    def motion(self) -> tuple[MotionColumn, ...]:
        """Columns of motion behind the six of the base, in ``motion_order``."""
        both = self.turns + self.slides
        return tuple(both[k] for k in self.motion_order)


@lru_cache(maxsize=32)
def plan_tree(tree: Tree) -> Plan:
    """Walking order of ``tree``."""
    depth = [len(above) - 1 for above in tree.ancestors]
    order = tuple(sorted(range(len(tree.bodies)), key=lambda k: (depth[k], k)))
    joints = [_Joint(tree.bodies[k], k) for k in order]
    place: dict[tuple[int, int], int] = {}
    for slot in range(max(len(joint.turns) for joint in joints)):
        for joint in joints:
            if slot < len(joint.turns):
                place[joint.body, slot] = len(place)
    turns = sorted((c for joint in joints for c in joint.turns), key=lambda c: place[c.body, c.slot])
    slides = tuple(c for joint in joints for c in joint.slides)
    covered = sorted(column.row for column in (*turns, *slides))
    rows = list(range(BASE_DOFS, tree.n_axes))
    alone = covered == sorted(set(covered) & set(rows)) if tree.coupling else covered == rows
    assert alone, "every axis value but the base's drives exactly one joint axis"
    return Plan(
        tree,
        order,
        tuple(_level(tree, order, d, depth) for d in range(max(depth) + 1)),
        tuple(_linked(c, place) for c in turns),
        tuple(_linked(c, place) for joint in joints for c in joint.hinges),
        slides,
        tuple(joint.remainder for joint in joints),
    )


def _level(tree: Tree, order: tuple[int, ...], d: int, depth: list[int]) -> Level:
    members = [position for position, k in enumerate(order) if depth[k] == d]
    parents = tuple(order.index(tree.bodies[order[p]].parent) for p in members) if d else ()
    return Level(members[0], members[-1] + 1, parents)


def _linked(column: MotionColumn, place: dict[tuple[int, int], int]) -> MotionColumn:
    return replace(column, before=place.get((column.body, column.slot - 1), -1))


class _Joint:
    """One body's joint walked from its parent: what tilts every axis, and what is left at the end."""

    def __init__(self, body: Body, index: int) -> None:
        self.body = index
        self.turns: list[MotionColumn] = []
        self.hinges: list[MotionColumn] = []
        open_: list[Tilt] = [Tilt(fixed=body.R_PJ)] if body.R_PJ else []
        self.slides = [MotionColumn(s.row, index, s.axis, 1.0, tuple(open_), slide=True) for s in body.slides]
        for turn in body.turns:
            column = MotionColumn(turn.row, index, turn.axis, turn.sign, tuple(open_), len(self.turns))
            if turn.moving:
                self.turns.append(column)
                continue
            self.hinges.append(column)
            tilt = Tilt(turn.axis, turn.row, turn.sign)
            if open_ and open_[-1].undone_by(tilt):
                open_.pop()
            else:
                open_.append(tilt)
        self.remainder = (*open_, Tilt(fixed=body.R_JB)) if body.R_JB else tuple(open_)
