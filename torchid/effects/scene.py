"""A trial as effects see it: bodies that move and carry inertia, and plates that read."""

from collections.abc import Callable, Hashable
from dataclasses import dataclass, field, replace

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.conventions import GRAVITY
from torchid.dynamics.equations_of_motion import DynamicState, body_rows, body_wrenches, dynamic_state
from torchid.effects.place import Place, edge, within
from torchid.filters import Smoother
from torchid.kinematics.recursion import cross
from torchid.model.model import Geometry
from torchid.model.tree import Tree
from torchid.motion import Motion
from torchid.recording import Forces


@dataclass(frozen=True)
class BodyPoint:
    """A point of a body; W axes, frames last."""

    p: Float[Tensor, "3 frames"]
    v: Float[Tensor, "3 frames"]
    a: Float[Tensor, "3 frames"]


@dataclass(frozen=True)
class Scene:
    """Motion and inertia of the bodies of one trial."""

    trial: str
    time: Float[Tensor, " frames"]
    tree: Tree
    q: Float[Tensor, "dofs frames"]
    state: DynamicState
    phi: Float[Tensor, "bodies 10"]
    smoother: Smoother
    """The filter that its motion and what plates read have passed."""
    recorded_kg: float = float("nan")
    """Mass of the body before any force was seen."""
    ends: "Scene | None" = None
    """First and last frame between which parameters were found, of a scene that shows other frames; None: its own."""
    _points: dict[tuple[str, tuple[float, ...]], BodyPoint] = field(
        default_factory=dict, init=False, repr=False, compare=False
    )
    """Points that were asked for: a catalogue asks for the same few thousands of times."""
    _courses: dict[Hashable, Tensor] = field(default_factory=dict, init=False, repr=False, compare=False)
    """Courses that have passed the filter, kept as long as the scene."""

    @property
    def rate(self) -> float:
        """Frames per second."""
        return float((len(self.time) - 1) / (self.time[-1] - self.time[0]))

    @property
    def span(self) -> "Scene":
        """The scene whose first and last frame are those between which parameters were found. Effects that begin with a
        recording, or take a course in it, count from there."""
        return self.ends or self

    def at(self, segment: str) -> int:
        """Plan position of a body."""
        return self.state.plan.position[self.tree.index(segment)]

    def centre(self, segment: str) -> Float[Tensor, " 3"]:
        """Centre of mass p_BC_B of a body."""
        own = self.phi[self.tree.index(segment)]
        return own[1:4] / own[0]

    def point(self, segment: str, p_BM_B: Float[Tensor, " 3"]) -> BodyPoint:
        """Place, velocity and acceleration of a point that a body carries; no gradient passes to ``p_BM_B``."""
        key = segment, tuple(p_BM_B.tolist())
        if key not in self._points:
            self._points[key] = self._point(segment, p_BM_B)
        return self._points[key]

    def _point(self, segment: str, p_BM_B: Float[Tensor, " 3"]) -> BodyPoint:
        k, motion = self.at(segment), self.state.motion
        arm = self.turned(segment, p_BM_B)
        w, swing = motion.w[k], cross(motion.w[k], arm)
        a = motion.a[k] + cross(motion.alpha[k], arm) + cross(w, swing)
        return BodyPoint(self.state.at.p[k] + arm, motion.v[k] + swing, a)

    def turned(self, segment: str, b: Float[Tensor, " 3"]) -> Float[Tensor, "3 frames"]:
        """A vector b in the axes of a segment, turned to W: R_WB b."""
        return torch.einsum("crt,c->rt", self.state.at.R[self.at(segment)], b)

    def passed(
        self, key: Hashable, course: Callable[[], Float[Tensor, "*some frames"]]
    ) -> Float[Tensor, "*some frames"]:
        """A course in time that no motion gives, as it is behind the filter that plates' readings have passed; no
        gradient passes.

        Args:
            key: tells it from other courses; no parameter that is sought may enter it.
            course: as it would be without the filter.
        """
        if key not in self._courses:
            self._courses[key] = self.smoother(course().movedim(-1, 0)).movedim(0, -1)
        return self._courses[key]

    @property
    def mass(self) -> Tensor:
        """Mass of all bodies [kg]."""
        return self.phi[:, 0].sum()

    @property
    def centre_of_mass(self) -> Float[Tensor, "3 frames"]:
        """Centre of mass of all bodies, in W [m]."""
        moment = sum(self.phi[k, 0] * self.point(name, self.centre(name)).p for k, name in enumerate(self.tree.names))
        return torch.as_tensor(moment) / self.mass

    def needed(self) -> Float[Tensor, "6 frames"]:
        """Wrench about the origin of W that the motion needs, gravity carried [N, N m]."""
        return self.needed_by(self.phi)[0]

    def needed_by(self, *bodies: Float[Tensor, "bodies 10"]) -> list[Float[Tensor, "6 frames"]]:
        """Wrenches that the same motion would need of bodies of other inertia [N, N m]."""
        rows, root = body_rows(self.state), self.state.at.p[0]
        totals = [body_wrenches(self.state.plan, rows, phi).sum(0) for phi in bodies]
        return [torch.cat([total[:3], total[3:] + cross(root, total[:3])]) for total in totals]


def make_scene(trial: str, tree: Tree, geometry: Geometry, motion: Motion, phi: Float[Tensor, "bodies 10"]) -> Scene:
    """The scene of a motion."""
    q, v, a = (x.T.contiguous() for x in (motion.q, motion.v, motion.a))
    return Scene(trial, motion.time, tree, q, dynamic_state(tree, geometry, q, v, a), phi, motion.smoother)


def anchor(scene: Scene, place: Place) -> Float[Tensor, " 3"]:
    """The point of the place's segment where an effect acts, in its axes: by default the centre of mass [m]."""
    return scene.centre(place.where[0]) if place.point is None else scene.phi.new_tensor(place.point)


def passing(scene: Scene, place: Place) -> Float[Tensor, " frames"]:
    """Return the presence of what comes and goes at a place, from 0 to 1, behind the filter of the plates' readings."""
    if place.when is None:
        return torch.ones_like(scene.time)
    return scene.passed((place.when, edge(place)), lambda: within(place, scene.trial, scene.time))


@dataclass(frozen=True)
class PlateFrame:
    """The frame of a plate as the file has it: x along its first edge, z up."""

    name: str
    """``plate_1`` and so on, one list for the whole session."""
    p_WF: Float[Tensor, " 3"]
    R_WF: Float[Tensor, "3 3"]


def plate_frame(name: str, corners: Float[Tensor, "4 3"]) -> PlateFrame:
    """The frame at the centre of a plate's corners."""
    x = corners[0] - corners[1] if (corners[0] - corners[1]).norm() > 0 else corners[0] - corners[3]
    up = torch.linalg.cross(corners[1] - corners[0], corners[3] - corners[0])
    x, z = (torch.nn.functional.normalize(e, dim=0) for e in (x, torch.where(up[2] < 0, -up, up)))
    return PlateFrame(name, corners.mean(0), torch.stack([x, torch.linalg.cross(z, x), z], 1))


@dataclass(frozen=True)
class Reading:
    """Readings of the plates of one trial, on any clock, about the origin of W."""

    trial: str
    time: Float[Tensor, " samples"]
    wrench: Float[Tensor, "samples plates 6"]
    frames: tuple[PlateFrame, ...]
    unborne: Float[Tensor, "samples 6"] | None = None
    """Wrench that a body of tables needs beyond what the plates bore; None: no model reads this."""
    begin: float | None = None
    """Time from which effects that grow count, of a reading of other samples [s]; None: its first sample."""
    zeroed: Float[Tensor, "samples plates"] | None = None
    """Share of each sample that a program wrote as zero (``Forces.zeroed_share``), one where it is missing; None:
    plates read all."""

    @property
    def total(self) -> Float[Tensor, "6 samples"]:
        """Sum over the plates."""
        total = self.wrench.sum(1).T
        return total if self.unborne is None else total + self.unborne.T

    @property
    def elapsed(self) -> Float[Tensor, " samples"]:
        """Time since effects that grow began [s]."""
        return self.time - (self.time[0] if self.begin is None else self.begin)

    def read_by(self, k: int) -> Float[Tensor, " samples"]:
        """Return the share of each sample that plate k read itself; the rest a program wrote as zero, or is missing."""
        return torch.ones_like(self.time) if self.zeroed is None else 1.0 - self.zeroed[:, k]

    def index(self, plate: str) -> int | None:
        """Column of a plate, None where the trial lacks it."""
        names = [frame.name for frame in self.frames]
        return names.index(plate) if plate in names else None

    def samples(self, part: slice) -> "Reading":
        """Some of the samples."""
        unborne, zeroed = (None if one is None else one[part] for one in (self.unborne, self.zeroed))
        return replace(self, time=self.time[part], wrench=self.wrench[part], unborne=unborne, zeroed=zeroed)

    def with_plate(self, k: int, wrench: Float[Tensor, "samples 6"]) -> "Reading":
        """Return the reading with another one of one plate."""
        return replace(self, wrench=torch.cat([self.wrench[:, :k], wrench[:, None], self.wrench[:, k + 1 :]], 1))


def reading(trial: str, forces: Forces, frames: tuple[PlateFrame, ...]) -> Reading:
    """The reading of a recording's plates; NaN counts as nothing read."""
    zeroed = torch.where(forces.wrench.isfinite().all(2), forces.zeroed_share, 1.0)  # what is missing nobody read
    return Reading(
        trial, forces.time, torch.nan_to_num(forces.wrench), frames, zeroed=zeroed if bool(zeroed.any()) else None
    )


def at_origin(p: Float[Tensor, "3 #frames"], force: Float[Tensor, "3 frames"]) -> Float[Tensor, "6 frames"]:
    """Wrench about the origin of W of a force at ``p`` [N, N m]."""
    return torch.cat([force, cross(p.expand_as(force), force)])


def lift(like: Tensor) -> Float[Tensor, "3 1"]:
    """Minus the acceleration of gravity, in W [m/s^2]."""
    return like.new_tensor([0.0, 0.0, GRAVITY])[:, None]
