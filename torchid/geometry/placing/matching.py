"""This module matches markers with landmarks, softly and one to one; who is left alone has a price.

Reference: Gold, Rangarajan, Lu, Pappu, Mjolsness, Pattern Recognition 31:1019 (1998): softassign.
"""

from collections.abc import Mapping

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from torchid.model.marker_set import MarkerSpec
from torchid.model.model import Model

LONE_MARKER, LONE_LANDMARK = -3.0, -1.0
"""Prices of a marker on no landmark and of a landmark without marker, as log odds; chosen on eleven recordings
(``python -m batteries.unlisted --seed 77``): half of a laboratory's markers are on no landmark."""
NEVER = -1e6
"""Resolution. Log odds of what cannot be."""
SWEEPS = 20
"""Resolution. Normalisations of a match."""


def matched(odds: Float[Tensor, "markers landmarks starts"], sweeps: int = SWEEPS) -> Tensor:
    """Return the probabilities of pairs, each marker and landmark in one or in none (Sinkhorn).

    Args:
        odds: log odds of pairs, of hypotheses side by side.
        sweeps: normalisations.
    """
    markers, landmarks, starts = odds.shape
    table = torch.cat([odds, odds.new_full((markers, 1, starts), LONE_MARKER)], dim=1)
    last = torch.cat([odds.new_full((1, landmarks, starts), LONE_LANDMARK), odds.new_full((1, 1, starts), NEVER)], 1)
    table = torch.cat([table, last])
    for _ in range(sweeps):
        table[:markers] -= table[:markers].logsumexp(1, keepdim=True)
        table[:, :landmarks] -= table[:, :landmarks].logsumexp(0, keepdim=True)
    return table[:markers, :landmarks].exp()


def allowed(model: Model, markers: int, known: Mapping[int, MarkerSpec]) -> Bool[Tensor, "markers landmarks"]:
    """Return whether a marker may be on a landmark by what is known of it.

    Args:
        known: segments of some markers, and landmarks where they are known, by the markers' indices.
    """
    found = torch.ones(markers, len(model.landmarks), dtype=torch.bool)
    for row, spec in known.items():
        for column, (name, one) in enumerate(model.landmarks.items()):
            found[row, column] = one.segment == spec.segment and spec.landmark in (None, name)
    return found


def variance(model: Model, scatter: float) -> Float[Tensor, " landmarks"]:
    """Return the variance of a marker about a landmark along an axis, with a scatter beside its own [m^2]."""
    own = torch.tensor([one.sd for one in model.landmarks.values()], dtype=torch.float64).reshape(-1, 3)
    return scatter**2 + own.square().mean(1)


def bodies(model: Model) -> Int[Tensor, " landmarks"]:
    """Return the body of each landmark, as its index in the tree."""
    return torch.tensor([model.tree.index(one.segment) for one in model.landmarks.values()], dtype=torch.long)


def places(model: Model) -> Float[Tensor, "landmarks 3"]:
    """Return the places of the landmarks on their bodies [m]."""
    return torch.tensor([one.p_BM_B for one in model.landmarks.values()], dtype=torch.float64).reshape(-1, 3)


def matched_on_bodies(
    model: Model, place: Float[Tensor, "bodies markers 3"], allowed: Bool[Tensor, "markers landmarks"], scatter: float
) -> Float[Tensor, "markers landmarks"]:
    """Return the probabilities of pairs by where markers mostly are in the axes of the landmarks' bodies.

    Args:
        place: of every marker seen from every body; NaN where unknown [m].
        allowed: whether a marker may be on a landmark.
        scatter: of markers about the template's landmarks, beside the landmarks' own [m].
    """
    square = (place[bodies(model)] - places(model)[:, None]).square().sum(2).T
    odds = torch.where(allowed & square.isfinite(), -0.5 * square / variance(model, scatter), NEVER)
    return matched(odds[:, :, None])[:, :, 0]
