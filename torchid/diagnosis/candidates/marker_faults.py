"""Faults of markers that the distances between them tell, beside all that is searched.

Exchanged labels are gaps in the recordings that are searched; and whatever moved between standing and all motion that
is searched moves the model's marker along. No search of the motion could find either.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.checks.marker_tracks.moved import MOVED_SHARE
from torchid.checks.marker_tracks.statement import TrackFault, TrackStatement
from torchid.effects.catalogue import CATALOGUE
from torchid.effects.effect import Effect
from torchid.effects.marker_swap import MarkerSwap
from torchid.effects.markers import MarkerShift
from torchid.effects.place import Interval, Place

EXCHANGED = next(one for one in CATALOGUE.values() if isinstance(one, MarkerSwap))
"""The effect as which exchanged labels are named."""
MOVED = next(one for one in CATALOGUE.values() if isinstance(one, MarkerShift))
"""The effect as which a marker that moved is named."""


@dataclass(frozen=True)
class MarkerFault:
    """An effect at a place that distances tell."""

    effect: Effect
    """``EXCHANGED`` or ``MOVED``."""
    place: Place
    """The labels, and when."""
    theta: Float[Tensor, " params"]
    """Internal parameters of the effect."""
    covariance: Float[Tensor, "params params"]
    """Covariance of these."""
    confidence: float
    """Probability by distances alone."""
    rule: str
    """Name of the rule in the trace."""
    numbers: Mapping[str, float]
    """Numbers that it compared."""

    @property
    def trials(self) -> tuple[str, ...]:
        """Names of the trials in which it acts."""
        return tuple(dict.fromkeys(one.trial for one in self.place.when or ()))


def exchanged_markers(statement: TrackStatement, time: Float[Tensor, " frames"]) -> MarkerFault:
    """Return two labels of one trial that carry each other's marker.

    Args:
        statement: of kind ``TrackFault.EXCHANGED``.
        time: of the trial's frames [s].
    """
    assert statement.kind is TrackFault.EXCHANGED
    times = statement.when or ((float(time[0]), float(time[-1])),)
    when = tuple(Interval(statement.trial, *span) for span in times)
    # For one distance of normal scatter: all that are off together say more.
    nats = 0.5 * (statement.size_mm**2 - statement.left_mm**2) / statement.sd_mm**2
    numbers = {
        "misfit_mm": statement.size_mm, "undone_mm": statement.left_mm, "sd_mm": statement.sd_mm,
        "share_part": statement.share,
    }  # fmt: skip
    one = torch.ones(1, dtype=torch.float64)
    confidence = 1.0 / (1.0 + math.exp(-nats))
    place = Place(statement.labels, when)
    return MarkerFault(EXCHANGED, place, one, 0.0 * one[None], confidence, "exchanged_distances", numbers)


def moved_marker(
    place: Place, nats: float, shift_B: Float[Tensor, "3"], covariance_B: Float[Tensor, "3 3"]
) -> MarkerFault:
    """Return a marker that sits elsewhere on its segment than when the subject stood.

    Args:
        place: its label, and the trials.
        nats: log likelihood ratio that distances are worth (``evidence.other_proof.borne_out``) [nat].
        shift_B: its displacement in axes of the segment [m].
        covariance_B: covariance of that [m^2].
    """
    odds = MOVED_SHARE / (1.0 - MOVED_SHARE) * math.exp(nats)
    numbers = {"evidence_nats": nats, "shift_mm": 1e3 * float(shift_B.norm())}
    return MarkerFault(MOVED, place, shift_B, covariance_B, odds / (1.0 + odds), "moved_distances", numbers)
