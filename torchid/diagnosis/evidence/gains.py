"""Log evidence that candidates add to a model, all of them by one factorisation of the model.

The evidence is that of linear models (MacKay, Neural Computation 4:415 (1992)); the gain follows from the Schur
complement of the base in the Gram matrix of both.
"""

import math
from collections.abc import Iterator, Sequence

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchid.diagnosis.candidates.candidate import Candidate
from torchid.diagnosis.evidence.posterior import Posterior
from torchid.diagnosis.evidence.statistics import Statistics, TrialStatistics

SMALLER = (1.0, 0.25, 0.0625)
"""Resolution. Widths of priors against those by which effects are named, which are those of large ones."""


def gains(statistics: Statistics, base: Posterior, candidates: Sequence[Candidate]) -> Float[Tensor, "2 candidates"]:
    """Return the log evidence that each candidate alone would add to a base, on the trials of the base [nat].

    The second row is half the whitened energy that it would take away: the evidence without its price.

    Args:
        statistics: statistics of all trials.
        base: posterior of the base.
        candidates: candidates, of the same design.
    """
    found = base.factor.new_zeros(2, len(candidates))
    for rows, told, left in informed(statistics, base, candidates):
        found[:, rows] = _gains(told, left, [candidates[k] for k in rows])
    return found


def scale_averaged_gains(
    statistics: Statistics, base: Posterior, candidates: Sequence[Candidate]
) -> Float[Tensor, " candidates"]:
    """Return the log evidence where not even the order of magnitude of a size is known [nat]: the mean over
    ``SMALLER``.

    Args:
        statistics: statistics of all trials.
        base: posterior of the base.
        candidates: candidates, of the same design.
    """
    found = base.factor.new_zeros(len(candidates))
    for rows, told, left in informed(statistics, base, candidates):
        some = [candidates[k] for k in rows]
        each = torch.stack([_gains(told, left, some, scale)[0] for scale in SMALLER])
        found[rows] = torch.logsumexp(each, 0) - math.log(len(SMALLER))
    return found


def informed(
    statistics: Statistics, base: Posterior, candidates: Sequence[Candidate]
) -> Iterator[tuple[list[int], Float[Tensor, "some n n"], Float[Tensor, "some n"]]]:
    """Yield groups of candidates of one size that act in the same trials: indices, information and moment.

    Both are of their parameters in units of their priors, beside the base. Candidates that act in no trial of the base
    are left out.

    Args:
        statistics: statistics of all trials.
        base: posterior of the base.
        candidates: candidates, of the same design.
    """
    groups: dict[tuple[tuple[frozenset[int], ...], int], list[int]] = {}
    for k, one in enumerate(candidates):
        blocks = tuple(block & base.seen for block in one.blocks if block & base.seen)
        if blocks:
            groups.setdefault((blocks, len(one.columns)), []).append(k)
    for (blocks, _), rows in groups.items():
        yield rows, *_informed(statistics, base, [candidates[k] for k in rows], blocks)


def _grams_of(raw: TrialStatistics, index: Int[Tensor, "some columns"]) -> Float[Tensor, "some columns columns"]:
    """Return the Gram matrix of each candidate's columns in one trial."""
    at = raw.at(index)
    return raw.gram[at[:, :, None], at[:, None, :]]


def _informed(
    statistics: Statistics, base: Posterior, some: Sequence[Candidate], blocks: tuple[frozenset[int], ...]
) -> tuple[Float[Tensor, "some n n"], Float[Tensor, "some n"]]:
    """Return information and moment of candidates; blocks of trials have parameters of their own."""
    index = torch.stack([c.columns for c in some])
    relative = torch.stack([c.relative for c in some]).to(base.factor)
    parts, lefts, owns = [], [], []
    for block in blocks:
        cross = statistics.cross(base.chosen, index.flatten(), block) * relative.flatten()
        shared = torch.linalg.solve_triangular(base.factor, cross, upper=False)
        moment = relative.flatten() * statistics.moment(index.flatten(), block)
        lefts.append((moment - shared.T @ base.whitened).view(index.shape))
        parts.append(shared.unflatten(1, index.shape).permute(1, 2, 0))
        own = statistics.summed(block, lambda raw: _grams_of(raw, index))
        owns.append(own * relative[:, :, None] * relative[:, None, :])
    part = torch.cat(parts, 1)
    own = owns[0] if len(owns) == 1 else torch.stack([torch.block_diag(*each) for each in zip(*owns, strict=True)])
    return own - part @ part.mT, torch.cat(lefts, 1)


def _gains(
    told: Float[Tensor, "some n n"], left: Float[Tensor, "some n"], some: Sequence[Candidate], scale: float = 1.0
) -> Float[Tensor, "2 some"]:
    """Return the gains of candidates whose prior standard deviations are multiplied by a scale, and half the
    energies."""
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
    whole = torch.tensor([c.effect.all_or_nothing for c in some], device=gain.device)
    return torch.stack([torch.where(whole, left[:, 0] - 0.5 * told[:, 0, 0], gain), energy])
