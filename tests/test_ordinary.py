"""What stands out among the places of an effect, and what is ordinary there."""

import math

import pytest
import torch
from rates import at_least

from torchid.diagnosis.evidence.background import SCALES, background_evidence
from torchid.diagnosis.options import NamingOptions

PLACES, PRIOR = 200, 1.0
DRAWS, SILENT, NAMED = 40, 0.99, 0.93
"""Draws, and the shares of them in which nothing is named where nothing stands out, and in which what does is.

Measured: 798 of 800 silent; named 381 of 400 without skin, 400 of 400 with."""
PRECISE = 1e5
"""Information on each component."""


def scattered(scale: float, seed: int) -> torch.Tensor:
    """Estimates of three components at every place: Student's t beside noise."""
    rng = torch.Generator().manual_seed(seed)
    normal = torch.randn(PLACES, 3, generator=rng, dtype=torch.float64)
    wide = (3.0 / torch.randn(PLACES, 3, generator=rng, dtype=torch.float64).square().sum(1)).sqrt()
    noise = torch.randn(PLACES, 3, generator=rng, dtype=torch.float64) / math.sqrt(PRECISE)
    return scale * wide[:, None] * normal + noise


def excess(found: torch.Tensor) -> torch.Tensor:
    """Log evidence of a named effect at each place over what is ordinary there."""
    told = PRECISE * torch.eye(3, dtype=torch.float64).expand(len(found), 3, 3)
    left = PRECISE * found
    grown = PRIOR**2 * PRECISE + 1.0
    named = 0.5 * (left.square().sum(1) * PRIOR**2 / grown) - 1.5 * math.log(grown)
    return named - background_evidence(told, left)


def evidence(score: torch.Tensor) -> float:
    """Of the effect, averaged over its places."""
    return float(torch.logsumexp(score, 0)) - math.log(PLACES)


def test_ordinary_is_students_t():
    """Against quadrature over the width, at the scale that most places have."""
    found = scattered(0.03, 1)
    told, left = PRECISE * torch.eye(3, dtype=torch.float64).expand(PLACES, 3, 3), PRECISE * found
    width = torch.logspace(-3.0, 6.0, 4001, dtype=torch.float64)
    weight = -1.5 * (width.log() + 1.0 / width)
    tried = {}
    for scale in SCALES.tolist():
        variance = scale**2 * width * PRECISE
        size = 0.5 * PRECISE * found.square().sum(1)[:, None]
        each = size * variance / (1.0 + variance) - 1.5 * torch.log1p(variance)
        tried[scale] = (torch.logsumexp(each + weight, 1) - torch.logsumexp(weight, 0)).clamp(min=0.0)
    least = min(float((background_evidence(told, left) - own).abs().max()) for own in tried.values())
    assert least < 0.02


@pytest.mark.parametrize("scale", [0.02, 0.06])
def test_what_is_everywhere_is_named_nowhere(seed, scale):
    """Some are far by chance. By noise alone, hundreds of nats would name the farthest."""
    scores = [excess(scattered(scale, seed + k)) for k in range(DRAWS)]
    silent = sum(evidence(score) <= NamingOptions().named_nats for score in scores)
    assert silent >= at_least(SILENT, DRAWS)


@pytest.mark.parametrize(("scale", "size"), [(0.0, 0.2), (0.02, 1.5)])
def test_what_stands_out_is_named(seed, scale, size):
    """A knocked marker among others, which drags its neighbours along; the more skin moves, the farther it must be."""
    named = 0
    for k in range(DRAWS):
        found = scattered(scale, seed + k)
        found[0] += size * torch.tensor([0.6, -0.8, 0.0], dtype=torch.float64)
        found[1:10] += 0.3 * size * torch.tensor([-0.6, 0.8, 0.0], dtype=torch.float64)
        score = excess(found)
        named += int(score.argmax()) == 0 and evidence(score) > NamingOptions().named_nats
    assert named >= at_least(NAMED, DRAWS)
