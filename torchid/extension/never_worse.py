"""Whether one model predicts worse than another beyond chance, from their errors in the same blocks."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import scipy.stats

from torchid.diagnosis.options import NeverWorseOptions
from torchid.extension.block_errors import BlockErrors, Group

TINY = 1e-12
"""Resolution. Error below which there is none."""


@dataclass(frozen=True)
class Growth:
    """How much larger the errors of one model are than those of another, in one group of blocks."""

    where: str
    """Held-out trials, or fit trials."""
    kind: str
    """``force``, ``moment`` or ``markers``."""
    log: float
    """Logarithm of the ratio of errors, of the RMS over all frames."""
    least_log: float
    """What it is at least, but for chance."""
    blocks: int
    """Number of blocks."""
    worse: bool
    """True if errors grow by more than the margin, beyond chance."""

    @property
    def part(self) -> float:
        """Part by which errors grow."""
        return math.expm1(self.log)


def growth(where: Group, reference: BlockErrors, other: BlockErrors, options: NeverWorseOptions) -> Growth:
    """Compare two models in the same blocks.

    A one-sided t-test on the logarithm of the ratio of the RMS over all blocks, to which each adds by its energy: a
    trial with little to be explained decides little. The variance between blocks, paired, has a scaled inverse
    chi-squared prior of ``prior_blocks`` that scatter by ``margin_part`` (Gelman et al., Bayesian Data Analysis, 3rd
    ed. (2013), section 3.3), so that few blocks are no certainty and one is no excuse.

    Args:
        where: group of the blocks.
        reference: errors of the model that the other is compared with.
        other: errors of the other, in the same blocks.
        options: margin, prior and level.
    """
    n = len(reference.rms)
    assert n == len(other.rms) > 0, "models are compared in the same blocks"
    ratio = ((other.rms + TINY) / (reference.rms + TINY)).log()
    energy = reference.frames * (reference.rms + TINY).square()
    share = energy / energy.sum()
    log = 0.5 * math.log(float((share * (2.0 * ratio).exp()).sum()))
    free = options.prior_blocks + n - 1.0
    expected = options.prior_blocks * options.margin_part**2
    scatter = math.sqrt((expected + float((ratio - ratio.mean()).square().sum())) / free)
    chance = float(scipy.stats.t.ppf(1.0 - options.level, free)) * scatter
    least = log - chance * float(share.square().sum().sqrt())
    return Growth(*where, log, least, n, least > math.log1p(options.margin_part))


def compare(
    reference: Mapping[Group, BlockErrors], other: Mapping[Group, BlockErrors], options: NeverWorseOptions
) -> tuple[Growth, ...]:
    """Compare two models in every group of blocks.

    Args:
        reference: errors of the model that the other is compared with.
        other: errors of the other.
        options: margin, prior and level.
    """
    return tuple(growth(group, own, other[group], options) for group, own in reference.items())
