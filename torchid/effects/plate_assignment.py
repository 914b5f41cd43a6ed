"""Plates whose cables are swapped."""

from collections.abc import Sequence
from dataclasses import replace
from typing import final

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.conventions import LOADED_N
from torchid.effects.kinds import ReadingEffect
from torchid.effects.marker_scene import View
from torchid.effects.parameter import Parameter
from torchid.effects.place import Place
from torchid.effects.plate_map import plate_names, to_plate, to_world
from torchid.effects.quantities import NamedEffect
from torchid.effects.scene import Reading
from torchid.effects.traits import Response, Site


@final
class PlateAssignment(ReadingEffect):
    """Two plates' cables are swapped: the channels of each are read with the other's geometry.

    The parameter is how much of the swap is there: one, or nothing.
    """

    name = "plate_assignment"
    mistaken = 0.0
    response = Response.ALL_OR_NOTHING
    site = Site.PLATE
    link = "of"
    parameters = (Parameter("share", 1.0, positive=True, source="by construction: one where cables are swapped"),)
    noun = "swapped cables"
    advice = "a step on one plate at a time, called out"

    def places(self, views: Sequence[View]) -> tuple[Place, ...]:
        """All pairs of plates."""
        names = plate_names(views)
        return tuple(Place((a, b)) for k, a in enumerate(names) for b in names[k + 1 :])

    def read(self, reading: Reading, place: Place, theta: Float[Tensor, " params"]) -> Reading:
        """Each plate's wrench as the other's channels give it with its geometry; a plate that bears nothing reads its
        own noise."""
        a, b = (reading.index(name) for name in place.where)
        if a is None or b is None:
            return reading
        # Where a plate bears nothing, its noise would be swapped, and the noise in what is read explained by itself.
        true = [reading.wrench[:, k] * (reading.wrench[:, k, 2:3] > LOADED_N) for k in (a, b)]
        first, second = reading.frames[a], reading.frames[b]
        there = to_world(first, to_plate(second, true[1])), to_world(second, to_plate(first, true[0]))
        reading = reading.with_plate(a, reading.wrench[:, a] + theta * (there[0] - true[0]))
        reading = reading.with_plate(b, reading.wrench[:, b] + theta * (there[1] - true[1]))
        if reading.zeroed is None:
            return reading
        order = list(range(len(reading.frames)))
        order[a], order[b] = b, a
        return replace(reading, zeroed=reading.zeroed + theta * (reading.zeroed[:, order] - reading.zeroed))

    def undone(self, reading: Reading, place: Place, theta: Float[Tensor, " params"]) -> Reading:
        """Swapped once more, everything is in its place."""
        return self.read(reading, place, theta)

    def named(self, place: Place, theta: Float[Tensor, " params"]) -> dict[str, Tensor]:
        return {}

    def internal(self, place: Place, values: dict[str, Tensor]) -> Float[Tensor, " params"]:
        return torch.ones(1, dtype=torch.float64)

    def sentence(self, finding: NamedEffect) -> str:
        swapped = self.located(finding.where)
        return f"the cables of {swapped} are swapped: each is read with the other's geometry"
