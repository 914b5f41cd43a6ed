"""Wrenches in the axes of plates, and effects that map what single plates read."""

from abc import abstractmethod
from collections.abc import Callable, Iterator, Sequence
from typing import ClassVar, final

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.effects.effect import Ordinary
from torchid.effects.kinds import ReadingEffect
from torchid.effects.marker_scene import View
from torchid.effects.place import Place
from torchid.effects.scene import PlateFrame, Reading
from torchid.effects.traits import ColumnNoise, Site
from torchid.geometry.result import GeometryFit


def to_plate(frame: PlateFrame, wrench: Float[Tensor, "samples 6"]) -> Float[Tensor, "samples 6"]:
    """A wrench about the origin of W, taken about the plate's origin and in its axes [N, N m]."""
    force, moment = wrench[:, :3], wrench[:, 3:]
    moment = moment - torch.linalg.cross(frame.p_WF.expand_as(force), force)
    return torch.cat([force @ frame.R_WF, moment @ frame.R_WF], 1)


def to_world(frame: PlateFrame, wrench: Float[Tensor, "samples 6"]) -> Float[Tensor, "samples 6"]:
    """The inverse of ``to_plate``."""
    force, moment = wrench[:, :3] @ frame.R_WF.T, wrench[:, 3:] @ frame.R_WF.T
    return torch.cat([force, moment + torch.linalg.cross(frame.p_WF.expand_as(force), force)], 1)


def plate_names(views: Sequence[View]) -> list[str]:
    """Names of all plates of a session, in order."""
    return sorted({frame.name for view in views for frame in view.reading.frames})


def mapped(reading: Reading, place: Place, mapping: Callable[[Reading, int], Float[Tensor, "samples 6"]]) -> Reading:
    """The reading with that of each plate of a place mapped, which is known by its column; about the origin of W."""
    for name in place.where:
        k = reading.index(name)
        if k is not None:
            reading = reading.with_plate(k, mapping(reading, k))
    return reading


class PlateMap(ReadingEffect):
    """An effect on what each single plate reads; its places are the plates."""

    site = Site.PLATE
    link = "of"
    column_noise = ColumnNoise.CORRECTED

    @final
    def places(self, views: Sequence[View]) -> tuple[Place, ...]:
        return tuple(Place((name,)) for name in plate_names(views))

    @final
    def read(self, reading: Reading, place: Place, theta: Float[Tensor, " params"]) -> Reading:
        return mapped(reading, place, lambda own, k: self.map(own, k, theta))

    @abstractmethod
    def map(self, bears: Reading, k: int, theta: Float[Tensor, " params"]) -> Float[Tensor, "samples 6"]:
        """Return a plate's reading of the wrench that it bears, about the origin of W [N, N m].

        Args:
            bears: what the plates bear.
            k: column of the plate.
            theta: internal parameters.
        """


class ZeroError(PlateMap):
    """A wrench that is added to all that a plate reads, and that an unloaded plate shows by itself, unless a program
    has written zeros there."""

    column_noise = ColumnNoise.NEGLECTED
    usual: ClassVar[float]
    """Part of the prior as an effect that every plate is expected to have of it, which is nobody's discovery."""

    @abstractmethod
    def zero(self, time: Float[Tensor, " samples"], theta: Float[Tensor, " params"]) -> Float[Tensor, "samples 6"]:
        """Return the reading of a plate that bears nothing, about its own origin and in its axes [N, N m]."""

    @final
    def map(self, bears: Reading, k: int, theta: Float[Tensor, " params"]) -> Float[Tensor, "samples 6"]:
        zero = to_world(bears.frames[k], self.zero(bears.elapsed, theta))
        return bears.wrench[:, k] + bears.read_by(k)[:, None] * zero

    @final
    def ordinary(self, views: Sequence[View], fit: GeometryFit | None) -> Iterator[Ordinary]:
        for place in self.places(views):
            scale = self.scale(place)
            yield Ordinary(place, (0.0,) * len(scale), tuple(self.usual * s for s in scale))
