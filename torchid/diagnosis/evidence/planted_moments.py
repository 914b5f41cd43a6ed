"""Moments that effects of growing size would give, and what they would say for these.

Where the data hold information A of an effect's parameters, parameters z give a moment b ~ N(A z, A). Rows of forces
and markers alone hold A' of it, with a moment b' ~ N(A' z, A'), of which b - b' is independent. Of a direction and
noise by lot, both are linear in the size, and every log evidence is a mixture of parabolas.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.diagnosis.candidates.candidate import Candidate

WIDEST = 3.0
"""Wording. Standard deviations of its prior for each component beyond which no size is stated: an effect that is not
named even then is not testable in the session."""
DRAWS = 200
"""Resolution. Directions and noises by lot: the share that is named has a standard deviation of 0.03."""


@dataclass(frozen=True)
class Mixture:
    """Log evidence of parameters whose variance is one of several, as parabolas in the size of what is there."""

    parabolas: Float[Tensor, "3 places draws variances"]
    """Coefficients of size to the powers of 0, 1 and 2."""
    shares: Float[Tensor, "*places variances"]
    """Logarithms of the shares of the variances."""

    def at(self, size: Float[Tensor, " places"]) -> Float[Tensor, "places draws"]:
        """Return the log evidence of each draw [nat].

        Args:
            size: size of what is there, against the directions' own.
        """
        constant, slope, square = self.parabolas
        size = size[:, None, None]
        return torch.logsumexp(constant + size * (slope + size * square) + self.shares[..., None, :], -1)


@dataclass(frozen=True)
class Moments:
    """Moments of effects at some places, by lot, along the vectors of their information."""

    value: Float[Tensor, "places n"]
    """Eigenvalues of the information."""
    vector: Float[Tensor, "places n n"]
    """Eigenvectors of the information."""
    noise: Float[Tensor, "places draws n"]
    """Moments that noise alone gives."""
    pushed: Float[Tensor, "places draws n"]
    """Moments that the effect adds at the size of the directions."""

    def evidence(self, variance: Float[Tensor, " tried"], shares: Float[Tensor, "*places tried"]) -> Mixture:
        """Return the log evidence of parameters with such variances against their priors, over none.

        Args:
            variance: the variances.
            shares: logarithms of their shares.
        """
        grown = 1.0 + variance * self.value[..., None]
        powers = torch.stack([self.noise.square(), 2.0 * self.noise * self.pushed, self.pushed.square()])
        found = 0.5 * powers @ (variance / grown)
        found[0] -= 0.5 * grown.log().sum(1)[:, None]
        return Mixture(found, shares)

    def halved(self, positives: int, size: Float[Tensor, " places"]) -> Float[Tensor, "places draws"]:
        """Return the log evidence that is added as the first parameters are never negative, see ``gains``.

        Args:
            positives: number of these.
            size: size of what is there.
        """
        if not positives:
            return self.noise.new_zeros(self.noise.shape[:2])
        shrunk = (self.noise + size[:, None, None] * self.pushed) / (1.0 + self.value[:, None])
        mean = (shrunk @ self.vector.mT)[..., :positives]
        sd = (self.vector.square() / (1.0 + self.value[:, None])).sum(2).sqrt()[:, None, :positives]
        return (math.log(2.0) + torch.special.log_ndtr(mean / sd)).sum(2)


def directions(one: Candidate, parts: Sequence[int], lot: torch.Generator) -> Float[Tensor, "draws n"]:
    """Return directions of some parameters by lot, ``WIDEST`` long for each of them.

    Args:
        one: candidate whose parameters they are.
        parts: those that are drawn; all others are zero.
        lot: generator.
    """
    half = torch.randn(DRAWS // 2, len(parts), generator=lot, dtype=torch.float64)
    drawn = torch.cat([half, half])
    drawn = WIDEST * math.sqrt(len(parts)) * drawn / drawn.norm(dim=1, keepdim=True)
    found = drawn.new_zeros(DRAWS, len(one.columns))
    found[:, parts] = drawn.abs() if parts[0] < one.effect.positives(one.place) else drawn
    return found


def moments_of(
    all_rows: Float[Tensor, "places n n"],
    unstated: Float[Tensor, "places n n"],
    direction: Float[Tensor, "draws n"],
    generator: torch.Generator,
) -> tuple[Moments, Moments]:
    """Return moments of all rows and of those without statements, by one lot, each noise with both signs.

    Args:
        all_rows: information that all rows hold of the parameters at each place, in units of their priors.
        unstated: information of the rows without what is stated without a body model.
        direction: parameters of each draw, in the same units.
        generator: of the noise.
    """
    half = torch.randn(2, len(direction) // 2, direction.shape[1], generator=generator, dtype=torch.float64)
    lots = torch.cat([half, -half], 1).to(all_rows)
    less = lots[0] @ _root(unstated)
    more = less + lots[1] @ _root(all_rows - unstated)
    both = (all_rows, more), (unstated, less)
    whole, bare = (moments_along(told, noise, direction @ told) for told, noise in both)
    return whole, bare


def _root(information: Float[Tensor, "places n n"]) -> Float[Tensor, "places n n"]:
    """Return the symmetric root of information."""
    value, vector = torch.linalg.eigh(information)
    return (vector * value.clamp(min=0.0).sqrt()[:, None]) @ vector.mT


def moments_along(
    information: Float[Tensor, "places n n"],
    noise: Float[Tensor, "places draws n"],
    pushed: Float[Tensor, "places draws n"],
) -> Moments:
    """Return moments along the vectors of the information.

    Args:
        information: what the data hold of the parameters at each place, in units of their priors.
        noise: moments that noise alone gives.
        pushed: moments that the effect adds at the size of the directions.
    """
    value, vector = torch.linalg.eigh(information)
    return Moments(value.clamp(min=0.0), vector, noise @ vector, pushed @ vector)


def stacked(some: Sequence[Moments]) -> Moments:
    """Return moments of effects with equally many parameters as those of one effect at all their places.

    Args:
        some: the moments.
    """
    parts = zip(*((one.value, one.vector, one.noise, one.pushed) for one in some), strict=True)
    return Moments(*map(torch.cat, parts))
