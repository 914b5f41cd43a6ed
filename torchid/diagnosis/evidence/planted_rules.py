"""The rules by which a round names, for effects of growing size, and the size from which most of them are named."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from torchid.diagnosis.candidates.candidate import Candidate
from torchid.diagnosis.evidence.apparent import SIZES, has_appearance, shares_of
from torchid.diagnosis.evidence.planted_moments import Mixture, Moments, stacked
from torchid.diagnosis.options import NamingOptions

CHANCE = 0.8
"""Wording. Share of cases in which an effect of the stated size would be named: the usual power of a study (Cohen,
Statistical Power Analysis for the Behavioral Sciences (1988))."""
STEPS = 10
"""Resolution. Bisections of the logarithm of a size over three orders of magnitude: to 0.7 %."""


@dataclass(frozen=True)
class PlantedRules:
    """Numbers that the rules of a round weigh of candidates of one effect, by size."""

    odds: Float[Tensor, " some"]
    """Odds of the places."""
    positives: int
    """Number of parameters that are never negative."""
    moments: Moments
    """Moments of all rows."""
    evidence: Mixture
    """Log evidence."""
    apparent: Mixture | None
    """Log evidence of the appearance; None: the effect has none."""
    rivals: tuple[tuple[Int[Tensor, " _"], "PlantedRules"], ...] = ()
    """Rules of what else would explain the effect, with the place that each is a rival of; none: nothing else would."""

    @classmethod
    def of(
        cls,
        some: Sequence[Candidate],
        whole: Moments,
        bare: Moments | None = None,
        rivals: Iterable[Iterable[tuple[Candidate, Moments]]] = (),
    ) -> "PlantedRules":
        """Return the rules for moments of all rows, and of those without statements.

        Args:
            some: candidates of one effect.
            whole: moments of all rows.
            bare: moments of the rows without statements; None: the appearance is not asked about.
            rivals: what else would explain each of them, with the moments that it gets.
        """
        effect, one = some[0].effect, whole.value.new_ones(1)
        asked = bare if has_appearance(effect) else None
        seems = asked and asked.evidence(one.new_tensor(SIZES).square(), shares_of(effect).to(one).log())
        positives = effect.positives(some[0].place)
        odds, evidence = one.new_tensor([c.odds for c in some]), whole.evidence(one, 0.0 * one)
        groups: dict[tuple[int, int], list[tuple[int, Candidate, Moments]]] = {}
        for place, each in enumerate(rivals):
            for c, own in each:
                groups.setdefault((c.effect.positives(c.place), own.value.shape[1]), []).append((place, c, own))
        others = []
        for group in groups.values():
            places, own, moments = zip(*group, strict=True)
            others.append((torch.tensor(places, device=one.device), cls.of(own, stacked(moments))))
        return cls(odds, positives, whole, evidence, seems, tuple(others))

    def named(self, size: Float[Tensor, " some"], naming: NamingOptions) -> Bool[Tensor, " some"]:
        """Return where effects of a size would be named in ``CHANCE`` of the draws, see ``Round``.

        Args:
            size: size at each place, against the directions' own.
            naming: thresholds.
        """
        odds, score = self.odds[:, None], self._score(size)
        shown = score >= self._best_rival(size) + naming.very_strong_nats
        if self.apparent is not None:
            # The effect's other places have no appearance of it.
            seems = self.apparent.at(size).clamp(min=0.0) + odds.log()
            score = score - torch.logaddexp(seems, (1.0 - odds).clamp(min=0.0).log()).clamp(min=0.0)
        return (shown & (score >= naming.named_nats)).double().mean(1) >= CHANCE

    def _score(self, size: Float[Tensor, " some"]) -> Float[Tensor, "some draws"]:
        """Return the log odds of each place [nat], but for what is told by other proof, and consent."""
        return self.evidence.at(size) + self.odds.log()[:, None] + self.moments.halved(self.positives, size)

    def _best_rival(self, size: Float[Tensor, " some"]) -> Float[Tensor, "some draws"]:
        """Return the log odds of what else explains each place best; minus infinity where nothing does."""
        best = size.new_full((len(size), self.moments.noise.shape[1]), -math.inf)
        for places, rivals in self.rivals:
            best.scatter_reduce_(0, places[:, None].expand(-1, best.shape[1]), rivals._score(size[places]), "amax")
        return best


def smallest(rules: PlantedRules, naming: NamingOptions) -> Float[Tensor, " some"]:
    """Return the part of the directions' length that ``CHANCE`` of the draws need to be named; infinite where all of
    it is not enough.

    Args:
        rules: what is weighed.
        naming: thresholds.
    """
    high = rules.odds.new_zeros(len(rules.odds))
    low, enough = high - math.log(1000.0), rules.named(high.exp(), naming)
    for _ in range(STEPS if bool(enough.any()) else 0):
        middle = 0.5 * (low + high)
        shown = rules.named(middle.exp(), naming)
        low, high = torch.where(shown, low, middle), torch.where(shown, middle, high)
    return torch.where(enough, high.exp(), math.inf)
