"""Evidence of models that are linear in inertia, nuisances and effects, all integrated out.

In coordinates in which every prior is a unit normal, a model with columns I has log evidence (up to what all models
share) b' L^-1 b / 2 - log det L / 2 with L = G_II + 1. A candidate's gain over a base follows from the Schur
complement of the base: one factorisation serves the whole catalogue.

Reference: MacKay, Neural Computation 4 (1992), on evidence; Chib, JASA 90 (1995), on its chain rule over trials.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchid.diagnosis.design import Candidate
from torchid.diagnosis.sums import Raw, Sums, blocks_of

SMALLER = (1.0, 0.25, 0.0625)
"""Widths of priors against those by which effects are named, which are those of large ones."""


@dataclass(frozen=True)
class Fitted:
    """Posterior of one model: chosen effects, factor of L, whitened moment; base columns first."""

    chosen: tuple[Candidate, ...]
    seen: frozenset[int]
    """Trials it was fitted to."""
    factor: Float[Tensor, "n n"]
    whitened: Float[Tensor, " n"]

    @property
    def log_evidence(self) -> float:
        """Up to what all models of the same rows share."""
        return float(0.5 * self.whitened @ self.whitened - self.factor.diagonal().log().sum())

    @property
    def mean(self) -> Float[Tensor, " n"]:
        """Of z."""
        return torch.linalg.solve_triangular(self.factor.T, self.whitened[:, None], upper=True)[:, 0]

    @property
    def covariance(self) -> Float[Tensor, "n n"]:
        """Of z."""
        return torch.cholesky_inverse(self.factor)

    def z(self, columns: int, trial: int) -> Float[Tensor, " all"]:
        """Mean over all columns of the design in one trial."""
        found = self.shares(columns, trial).sum(0)
        base = len(self.factor) - sum(c.size for c in self.chosen)
        # Candidates may share the columns of nuisances.
        found[:base] += self.mean[:base]
        return found

    def shares(self, columns: int, trial: int) -> Float[Tensor, "chosen all"]:
        """Of it, each chosen effect's."""
        mean = self.mean
        found = mean.new_zeros(len(self.chosen), columns)
        at = len(mean) - sum(c.size for c in self.chosen)
        for k, one in enumerate(self.chosen):
            for block in one.blocks:
                if trial in block:
                    found[k, one.columns] = one.relative.to(mean) * mean[at : at + len(one.columns)]
                at += len(one.columns)
        return found


def assembled(
    sums: Sums, chosen: Sequence[Candidate], seen: frozenset[int]
) -> tuple[Float[Tensor, "n n"], Float[Tensor, " n"]]:
    """Gram matrix and moment of the base and these effects."""
    blocks = [sums.cross(chosen, slice(sums.base), seen)]
    moments = [sums.moment(slice(sums.base), seen)]
    for own, scale, block in blocks_of(chosen):
        relative = scale.to(blocks[0])
        blocks.append(sums.cross(chosen, own, block & seen) * relative)
        moments.append(relative * sums.moment(own, block & seen))
    return torch.cat(blocks, 1), torch.cat(moments)


def fit(sums: Sums, chosen: Sequence[Candidate] = (), seen: frozenset[int] | None = None) -> Fitted:
    """The model with these effects, on some trials or all."""
    seen = sums.all if seen is None else seen
    L, moment = assembled(sums, chosen, seen)
    factor = torch.linalg.cholesky(L + torch.eye(len(L)).to(L))
    whitened = torch.linalg.solve_triangular(factor, moment[:, None], upper=False)[:, 0]
    return Fitted(tuple(chosen), seen, factor, whitened)


def gains(sums: Sums, base: Fitted, candidates: Sequence[Candidate]) -> Float[Tensor, "2 candidates"]:
    """Log evidence that each candidate alone would add to a base, on the trials of the base.

    The second row is half the whitened energy that it would take away: the evidence without its price.
    """
    found = base.factor.new_zeros(2, len(candidates))
    for rows, told, left in informed(sums, base, candidates):
        found[:, rows] = _gains(told, left, [candidates[k] for k in rows])
    return found


def unsized(sums: Sums, base: Fitted, candidates: Sequence[Candidate]) -> Float[Tensor, " candidates"]:
    """The same where not even the order of magnitude of a size is known: the mean over ``SMALLER``."""
    found = base.factor.new_zeros(len(candidates))
    for rows, told, left in informed(sums, base, candidates):
        some = [candidates[k] for k in rows]
        each = torch.stack([_gains(told, left, some, scale)[0] for scale in SMALLER])
        found[rows] = torch.logsumexp(each, 0) - math.log(len(SMALLER))
    return found


def informed(
    sums: Sums, base: Fitted, candidates: Sequence[Candidate]
) -> Iterator[tuple[list[int], Float[Tensor, "some n n"], Float[Tensor, "some n"]]]:
    """Candidates of one size that act in the same trials, information on their parameters beside a base, and moment."""
    groups: dict[tuple[tuple[frozenset[int], ...], int], list[int]] = {}
    for k, one in enumerate(candidates):
        blocks = tuple(block & base.seen for block in one.blocks if block & base.seen)
        if blocks:
            groups.setdefault((blocks, len(one.columns)), []).append(k)
    for (blocks, _), rows in groups.items():
        yield rows, *_informed(sums, base, [candidates[k] for k in rows], blocks)


def _grams_of(raw: Raw, index: Int[Tensor, "some columns"]) -> Float[Tensor, "some columns columns"]:
    at = raw.at(index)
    return raw.gram[at[:, :, None], at[:, None, :]]


def _informed(
    sums: Sums, base: Fitted, some: Sequence[Candidate], blocks: tuple[frozenset[int], ...]
) -> tuple[Float[Tensor, "some n n"], Float[Tensor, "some n"]]:
    """Blocks of trials have parameters of their own."""
    index = torch.stack([c.columns for c in some])
    relative = torch.stack([c.relative for c in some]).to(base.factor)
    parts, lefts, owns = [], [], []
    for block in blocks:
        cross = sums.cross(base.chosen, index.flatten(), block) * relative.flatten()
        shared = torch.linalg.solve_triangular(base.factor, cross, upper=False)
        moment = relative.flatten() * sums.moment(index.flatten(), block)
        lefts.append((moment - shared.T @ base.whitened).view(index.shape))
        parts.append(shared.unflatten(1, index.shape).permute(1, 2, 0))
        own = sums.summed(block, lambda raw: _grams_of(raw, index))
        owns.append(own * relative[:, :, None] * relative[:, None, :])
    part = torch.cat(parts, 1)
    own = torch.stack([torch.block_diag(*(o[k] for o in owns)) for k in range(len(some))])
    return own - part @ part.mT, torch.cat(lefts, 1)


def _gains(
    told: Float[Tensor, "some n n"], left: Float[Tensor, "some n"], some: Sequence[Candidate], scale: float = 1.0
) -> Float[Tensor, "2 some"]:
    L = torch.linalg.cholesky(scale**2 * told + torch.eye(told.shape[1]).to(told))
    u = torch.linalg.solve_triangular(L, scale * left[..., None], upper=False)[..., 0]
    energy = 0.5 * u.square().sum(1)
    gain = energy - L.diagonal(dim1=1, dim2=2).log().sum(1)
    if positive := [k for k, c in enumerate(some) if c.effect.positives(c.place)]:
        # A parameter known to be positive has half the prior space: twice the density, and only its upper side counts.
        # Of several, each for itself: exact where they are told apart.
        mean = torch.linalg.solve_triangular(L.mT, u[..., None], upper=True)[positive, :, 0]
        sd = torch.cholesky_inverse(L[positive]).diagonal(dim1=1, dim2=2).sqrt()
        counts = mean.new_tensor([some[k].effect.positives(some[k].place) for k in positive])
        counted = torch.arange(mean.shape[1]).to(mean) < counts[:, None]
        gain[positive] += torch.where(counted, math.log(2.0) + torch.special.log_ndtr(mean / sd), 0.0).sum(1)
    # What is there in full or not at all has no other size to be averaged over.
    whole = torch.tensor([c.effect.whole for c in some], device=gain.device)
    return torch.stack([torch.where(whole, left[:, 0] - 0.5 * told[:, 0, 0], gain), energy])
