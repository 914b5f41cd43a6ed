"""Whether one model predicts worse than another beyond chance, from their errors in the same blocks."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import scipy.stats

from torchid.experiment.block_errors import BlockErrors, Group

MARGIN = 0.02
"""Choice. Part by which errors may grow that nobody would call worse; also the scatter of growth between blocks that is
expected before any is seen, which decides where there are one or two of them."""
WEIGHT = 2.0
"""Choice. Number of blocks that this expectation counts for: with one block, growth beyond 8 % is worse, with two that
agree 5 %."""
LEVEL = 0.05
"""Choice. Chance that errors which grow by ``MARGIN`` are called worse."""
TINY = 1e-12
"""Resolution. Error below which there is none."""


@dataclass(frozen=True)
class Growth:
    """How much larger the errors of one model are than those of another, in one group of blocks."""

    where: str
    """Held-out trial, or fit trials."""
    kind: str
    """``force``, ``moment`` or ``markers``."""
    log: float
    """Logarithm of the ratio of errors: of the RMS over all frames, or the mean over blocks if that is worse."""
    least_log: float
    """What it is at least, but for the chance of ``LEVEL``."""
    blocks: int
    """Number of blocks."""

    @property
    def worse(self) -> bool:
        """True if errors grow by more than ``MARGIN``, beyond chance."""
        return self.least_log > math.log1p(MARGIN)

    @property
    def part(self) -> float:
        """Part by which errors grow."""
        return math.expm1(self.log)


def growth(where: Group, reference: BlockErrors, other: BlockErrors) -> Growth:
    """Compare two models in the same blocks.

    One-sided t-tests on the logarithm of the ratio of errors, paired by block: on its mean, which asks most blocks, and
    on the ratio of the RMS over all of them, to which each adds by its energy. The variance between blocks has a scaled
    inverse chi-squared prior of ``WEIGHT`` blocks that scatter by ``MARGIN`` (Gelman et al., Bayesian Data Analysis,
    3rd ed. (2013), section 3.3), so that few blocks are no certainty and one is no excuse.

    Args:
        where: group of the blocks.
        reference: errors of the model that the other is compared with.
        other: errors of the other, in the same blocks.
    """
    n = len(reference.rms)
    assert n == len(other.rms) > 0, "models are compared in the same blocks"
    ratio = ((other.rms + TINY) / (reference.rms + TINY)).log()
    energy = reference.frames * (reference.rms + TINY).square()
    share = energy / energy.sum()
    mean, whole = float(ratio.mean()), 0.5 * math.log(float((share * (2.0 * ratio).exp()).sum()))
    free = WEIGHT + n - 1.0
    scatter = math.sqrt((WEIGHT * MARGIN**2 + float((ratio - mean).square().sum())) / free)
    chance = float(scipy.stats.t.ppf(1.0 - LEVEL, free)) * scatter
    usual = mean - chance / math.sqrt(n), mean
    total = whole - chance * float(share.square().sum().sqrt()), whole
    least, log = max(usual, total)
    return Growth(*where, log, least, n)


def compare(reference: Mapping[Group, BlockErrors], other: Mapping[Group, BlockErrors]) -> tuple[Growth, ...]:
    """Compare two models in every group of blocks.

    Args:
        reference: errors of the model that the other is compared with.
        other: errors of the other.
    """
    return tuple(growth(group, own, other[group]) for group, own in reference.items())
