"""Linear models whose statistics are given, without rows."""

from dataclasses import replace

import torch

from torchid.diagnosis.columns.design import Design
from torchid.diagnosis.evidence.model import LinearModel
from torchid.diagnosis.evidence.noise import initial_noise
from torchid.diagnosis.evidence.prior import Prior
from torchid.diagnosis.evidence.statistics import Statistics
from torchid.dynamics.whitening import initial_whitening


def model_of(design: Design, prior: Prior, statistics: Statistics) -> LinearModel:
    """A model that has these statistics under any noise."""
    noise = initial_noise(initial_whitening(torch.ones(2).to(prior.mean)), len(statistics.trials))
    return LinearModel((), prior, design, noise).with_statistics(statistics)


def with_candidates(model: LinearModel, candidates: tuple) -> LinearModel:
    """The same with other candidates in its design."""
    return model_of(replace(model.design, candidates=candidates), model.prior, model.statistics)
