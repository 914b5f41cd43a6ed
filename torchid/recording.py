"""What a laboratory measured, in W, SI units and float64: the one form that everything after ``io`` may trust."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.errors import Note


@dataclass(frozen=True)
class Markers:
    """Marker trajectories of one trial."""

    labels: tuple[str, ...]
    """Names without subject prefix, unique."""
    time: Float[Tensor, " frames"]
    """Uniform clock of the file [s]."""
    position: Float[Tensor, "frames markers 3"]
    """p_WM_W [m]; NaN where a marker was not seen."""

    @property
    def rate(self) -> float:
        """Frames per second."""
        return float((len(self.time) - 1) / (self.time[-1] - self.time[0]))

    def select(self, labels: tuple[str, ...]) -> "Markers":
        """The markers named, in that order; one that the trial lacks is NaN throughout."""
        position = self.position.new_full((len(self.time), len(labels), 3), torch.nan)
        known = [(k, self.labels.index(label)) for k, label in enumerate(labels) if label in self.labels]
        for k, source in known:
            position[:, k] = self.position[:, source]
        return replace(self, labels=labels, position=position)

    def having(self, labels: Iterable[str]) -> "Markers":
        """All markers, and those named that the trial lacks behind them, NaN throughout."""
        lacking = tuple(dict.fromkeys(label for label in labels if label not in self.labels))
        return self.select((*self.labels, *lacking)) if lacking else self

    def frames(self, index: Tensor | slice) -> "Markers":
        """Some of the frames."""
        return replace(self, time=self.time[index], position=self.position[index])


@dataclass(frozen=True)
class Plate:
    """One force plate (or one instrumented belt, or one foot of a file that stores forces by foot)."""

    name: str
    """Channel or column name in the file, such as ``plate 2`` or ``ground_force_1``."""
    corners: Float[Tensor, "4 3"] | None = None
    """Corners in W [m], None when the file has none (MOT)."""
    origin: Float[Tensor, " 3"] | None = None
    """From the transducer to the centre of the surface, in the plate's axes [m]; None where the file tells none."""
    moment_length: float = 1.0
    """Length in which the file's moments are stored: 0.001 for N mm [m]."""
    number: int | None = None
    """Number by which a config names it; None before reading has counted all plates of the file."""


@dataclass(frozen=True)
class Forces:
    """Wrenches of the force plates of one trial, each on the subject, about the world's origin, in W."""

    time: Float[Tensor, " samples"]
    """Uniform clock of the file, the same zero as the markers' [s]."""
    wrench: Float[Tensor, "samples plates 6"]
    """Force [N] and moment about the origin of W [N m] on the subject."""
    plates: tuple[Plate, ...]
    zeroed: Float[Tensor, "samples plates"] | None = None
    """Share of each sample that no plate read, but a program wrote as zero; None: as ``wrench`` has exact zeros."""

    @property
    def rate(self) -> float:
        """Samples per second."""
        return float((len(self.time) - 1) / (self.time[-1] - self.time[0]))

    @property
    def zeroed_share(self) -> Float[Tensor, "samples plates"]:
        """Share of each sample that a program wrote as zero: what a plate reads by mistake is not in it."""
        return (self.wrench == 0.0).all(2).to(self.wrench) if self.zeroed is None else self.zeroed

    def samples(self, part: slice) -> "Forces":
        """Some of the samples."""
        zeroed = None if self.zeroed is None else self.zeroed[part]
        return replace(self, time=self.time[part], wrench=self.wrench[part], zeroed=zeroed)

    def of(self, kept: Sequence[int]) -> "Forces":
        """Return the forces of some plates, by their columns, in that order."""
        wrench, plates = self.wrench[:, list(kept)], tuple(self.plates[k] for k in kept)
        zeroed = None if self.zeroed is None else self.zeroed[:, list(kept)]
        return replace(self, wrench=wrench, plates=plates, zeroed=zeroed)

    @property
    def total(self) -> Float[Tensor, "samples 6"]:
        """Sum over the plates."""
        return self.wrench.sum(dim=1)

    def centre_of_pressure(self, threshold: float = 20.0) -> Float[Tensor, "samples plates 3"]:
        """Points on each plate's plane (z of its corners, else 0) where the moment has no horizontal part [m].

        NaN where the vertical force is below ``threshold`` [N].
        """
        force, moment = self.wrench[..., :3], self.wrench[..., 3:]
        height = force.new_tensor([0.0 if p.corners is None else float(p.corners[:, 2].mean()) for p in self.plates])
        fz = torch.where(force[..., 2].abs() > threshold, force[..., 2], torch.nan)
        x = (-moment[..., 1] + height * force[..., 0]) / fz
        y = (moment[..., 0] + height * force[..., 1]) / fz
        return torch.stack([x, y, height.expand_as(x) + 0.0 * fz], dim=-1)


@dataclass(frozen=True)
class Event:
    """A named instant of a trial, such as a foot strike."""

    label: str
    side: str
    time: float


@dataclass(frozen=True)
class Trial:
    """One recording: markers, the forces that belong to it, and what reading it had to say."""

    name: str
    markers: Markers
    forces: Forces | None = None
    role: str = "fit"
    """static | fit | heldout."""
    events: tuple[Event, ...] = ()
    notes: tuple[Note, ...] = field(default=())
    """What was repaired, chosen or suspicious."""
    parameters: dict[str, str] = field(default_factory=dict)
    """Facts that the file states (axes, units, subject), for ``torchid check`` and the report."""
    computed: tuple[str, ...] = ()
    """Labels that were left out because they move as if computed from others; no markers in other trials either."""
