"""The tree of bodies and one-axis joints that every kinematic and dynamic computation walks.

A body hangs on its parent by: a translation to the proximal joint centre (the *offset*, geometry), a constant
rotation ``R_PJ``, a sequence of *turns* about single axes, *slides* along axes, and a constant rotation ``R_JB``.
A turn is driven by a coordinate of motion (``q``) or by an angle of geometry (a *hinge angle*, which tilts the axis
that follows it and is undone behind it). One description feeds the lean recursion and the pytorch-kinematics chain.

Where joints are driven by functions of coordinates, turns and slides are driven by axis values, which a ``Coupling``
makes of the coordinates; without one, axis values are the coordinates.
"""

from dataclasses import dataclass
from functools import cached_property

from torch import Tensor

from torchid.model.coupling import Coupling

BASE_DOFS = 6
Rotation = tuple[tuple[float, float, float], tuple[float, float, float], tuple[float, float, float]]


@dataclass(frozen=True)
class Turn:
    """Rotation by ``sign * value`` about axis 0, 1 or 2 (x, y, z) of the axes reached so far."""

    axis: int
    row: int
    """Row of the axis values when ``moving``, else row of the hinge angles."""
    moving: bool = True
    sign: float = 1.0


@dataclass(frozen=True)
class Slide:
    """Translation by axis value ``row`` along axis 0, 1 or 2 of the joint's axes, before its turns."""

    axis: int
    row: int


@dataclass(frozen=True)
class Body:
    """One rigid segment and the joint that carries it."""

    name: str
    parent: int
    """Index of the parent, smaller than its own; -1 for the floating root."""
    turns: tuple[Turn, ...] = ()
    slides: tuple[Slide, ...] = ()
    R_PJ: Rotation | None = None
    R_JB: Rotation | None = None


@dataclass(frozen=True)
class Dof:
    """One coordinate of motion."""

    name: str
    unit: str
    """rad or m."""
    lower: float = -float("inf")
    upper: float = float("inf")
    rest: float = 0.0
    """Value in the neutral standing pose."""
    sd: float = 2.0
    """Scatter of the weak posture prior about ``rest`` [unit]."""


@dataclass(frozen=True)
class Tree:
    """Topology only, hashable; the tensors of its geometry stand beside it.

    Rows 0-5 of q belong to the root: position of its origin in W [m] and rotation vector of R_WB [rad]; the matching
    rows of v and a are linear and angular velocity and acceleration of the root in W.
    """

    bodies: tuple[Body, ...]
    dofs: tuple[Dof, ...]
    hinges: tuple[str, ...] = ()
    """Names of the hinge angles [rad]."""
    coupling: Coupling | None = None
    """Axis values that are functions of coordinates; None where each coordinate drives one axis."""

    def __post_init__(self) -> None:
        assert self.coupling is None or self.coupling.n_dofs == len(self.dofs), "a coupling of other coordinates"
        assert self.bodies[0].parent == -1, "the first body is the root"
        assert all(0 <= b.parent < k for k, b in enumerate(self.bodies) if k), "parents precede children"

    @property
    def names(self) -> tuple[str, ...]:
        """Body names."""
        return tuple(body.name for body in self.bodies)

    @property
    def parents(self) -> tuple[int, ...]:
        """Parent index of each body, -1 for the root."""
        return tuple(body.parent for body in self.bodies)

    @property
    def dof_names(self) -> tuple[str, ...]:
        """Names of the rows of q."""
        return tuple(dof.name for dof in self.dofs)

    @property
    def n_axes(self) -> int:
        """Number of axis values: coordinates and followers."""
        return len(self.dofs) + (len(self.coupling.followers) if self.coupling else 0)

    def axes(self, q: Tensor) -> Tensor:
        """Axis values (axes, frames) of coordinates (dofs, frames)."""
        return q if self.coupling is None else self.coupling.axes(q)

    def rates(self, q: Tensor, v: Tensor, a: Tensor) -> tuple[Tensor, Tensor]:
        """Rates and accelerations of the axis values (axes, frames) from those of the coordinates (dofs, frames)."""
        return (v, a) if self.coupling is None else self.coupling.rates(q, v, a)

    def fold(self, q: Tensor, x: Tensor) -> Tensor:
        """What belongs to the coordinates (dofs, ..., frames) of covectors of the axes (axes, ..., frames)."""
        return x if self.coupling is None else self.coupling.fold(q, x)

    @cached_property
    def uncoupled(self) -> "Tree":
        """The tree whose coordinates are this one's axis values, for formats that know no functions."""
        if self.coupling is None:
            return self
        followers = tuple(Dof(one.name, "rad") for one in self.coupling.followers)
        return Tree(self.bodies, (*self.dofs, *followers), self.hinges)

    def driving(self, body: int) -> tuple[int, ...]:
        """Rows of q that move a body's joint, by themselves or through followers."""
        own = self.bodies[body]
        rows = [turn.row for turn in own.turns if turn.moving] + [slide.row for slide in own.slides]
        if self.coupling is not None:
            n, leads = len(self.dofs), self.coupling.leads
            rows = [row for k in rows for row in (sorted(leads[k - n]) if k >= n else (k,))]
        return tuple(dict.fromkeys(rows))

    def own_turns(self, body: int) -> list[Turn]:
        """Moving turns of a body's joint whose coordinate drives that turn and nothing else."""
        n = len(self.dofs)
        busy = frozenset().union(*self.coupling.leads) if self.coupling else frozenset()
        return [turn for turn in self.bodies[body].turns if turn.moving and turn.row < n and turn.row not in busy]

    def index(self, body: str) -> int:
        """Index of the body called ``body``."""
        return self.names.index(body)

    @cached_property
    def ancestors(self) -> tuple[frozenset[int], ...]:
        """For each body itself and all bodies above it."""
        found: list[frozenset[int]] = []
        for k, body in enumerate(self.bodies):
            found.append(frozenset({k}) | (found[body.parent] if body.parent >= 0 else frozenset()))
        return tuple(found)

    def subtree(self, body: int) -> tuple[int, ...]:
        """Indices of ``body`` and everything below it."""
        return tuple(k for k, above in enumerate(self.ancestors) if body in above)
