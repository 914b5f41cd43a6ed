"""What witnesses say of causes that other evidence names."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.effects.effect import Effect
from torchid.effects.place import Place
from torchid.witnesses.panel import Panel


@dataclass(frozen=True)
class Claim:
    """A cause with its size, as it acts on each trial."""

    effect: Effect
    place: Place
    theta: Callable[[str], Float[Tensor, " params"] | None]
    """Internal parameters in a trial; None where it does not act."""


@dataclass(frozen=True)
class Testimony:
    """What the statements of a session say of one claim, beside all others."""

    nats: float
    """Log likelihood of the statements with the claim over that without it [nat]."""
    loudness_sd: float
    """What the claim would have witnesses say, in standard deviations of theirs: below about three nobody hears it."""


def hear(panel: Panel, claims: Sequence[Claim]) -> list[Testimony]:
    """Return what the witnesses say of each claim.

    Args:
        panel: the statements.
        claims: all that are made at once.
    """
    said = [_said(panel, one) for one in claims]
    together = sum(said, start=torch.zeros_like(panel.value))
    whole = panel.log_density(together)
    L = torch.linalg.cholesky(panel.likeliest())
    found = []
    for own in said:
        loud = float(torch.linalg.solve_triangular(L, own[:, None], upper=False).norm())
        found.append(Testimony(whole - panel.log_density(together - own), loud))
    return found


def _said(panel: Panel, one: Claim) -> Float[Tensor, " some"]:
    """Return the change that a claim made to the statements: what they are, less what they would be without it."""
    acting = [(trial, one.theta(trial.name)) for trial in panel.trials]
    return -panel.change([t if x is None else t.without(one.effect, one.place, x) for t, x in acting])
