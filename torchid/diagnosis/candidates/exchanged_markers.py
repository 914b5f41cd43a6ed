"""Labels that carry each other's marker, as the distances between markers tell before anything is searched.

Their samples are gaps in the recordings that are searched, so that no search could find them.
"""

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.checks.marker_tracks.statement import TrackFault, TrackStatement
from torchid.effects.catalogue import CATALOGUE
from torchid.effects.marker_swap import MarkerSwap
from torchid.effects.place import Interval, Place

EFFECT = next(one for one in CATALOGUE.values() if isinstance(one, MarkerSwap))
"""The effect as which they are named."""


@dataclass(frozen=True)
class ExchangedMarkers:
    """Two labels of one trial."""

    statement: TrackStatement
    """Statement of distances about them."""
    place: Place
    """The labels, and when they are exchanged."""

    @property
    def theta(self) -> Float[Tensor, " params"]:
        """Return the internal parameters of ``EFFECT``."""
        return torch.ones(1, dtype=torch.float64)

    @property
    def odds_nats(self) -> float:
        """Return the log likelihood of the distances, exchanged against as labelled, for one distance of normal
        scatter: all that are off together say more."""
        own = self.statement
        return 0.5 * (own.size_mm**2 - own.left_mm**2) / own.sd_mm**2

    @property
    def confidence(self) -> float:
        """Return the probability of the exchange by these odds alone."""
        return 1.0 / (1.0 + math.exp(-self.odds_nats))


def exchanged_markers(statement: TrackStatement, time: Float[Tensor, " frames"]) -> ExchangedMarkers:
    """Return an exchange as a place of ``EFFECT``.

    Args:
        statement: of kind ``TrackFault.EXCHANGED``.
        time: of the trial's frames [s].
    """
    assert statement.kind is TrackFault.EXCHANGED
    times = statement.when or ((float(time[0]), float(time[-1])),)
    when = tuple(Interval(statement.trial, *span) for span in times)
    return ExchangedMarkers(statement, Place(statement.labels, when))
