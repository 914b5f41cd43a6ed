"""Evidence of models that are linear in inertia, nuisances and effects, all integrated out.

In coordinates in which every prior is a unit normal, a model with columns I has log evidence (up to what all models
share) b' L^-1 b / 2 - log det L / 2 with L = G_II + 1. A candidate's gain over a base follows from the Schur
complement of the base: one factorisation serves the whole catalogue.

Reference: MacKay, Neural Computation 4 (1992), on evidence; Chib, JASA 90 (1995), on its chain rule over trials.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import groupby

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchid.diagnosis.design import Candidate, Design, narrower, positions
from torchid.model.model import InertialPrior


@dataclass(frozen=True)
class Raw:
    """What one trial's whitened rows say of z: what could happen in another trial alone has no columns in them."""

    live: Int[Tensor, " live"]
    """Columns of the design that this trial has, in order."""
    gram: Float[Tensor, "live+1 live+1"]
    """Its last row and column, zero, are those of all columns that do not live."""
    moment: Float[Tensor, " live+1"]

    def at(self, columns: Int[Tensor, "*some"]) -> Int[Tensor, "*some"]:
        """Where columns of the design stand."""
        at = torch.searchsorted(self.live, columns)
        return torch.where(self.live[at.clamp(max=len(self.live) - 1)] == columns, at, len(self.live))

    def only(self, some: Int[Tensor, " fewer"]) -> "Raw":
        """Of a design that kept these columns of this one."""
        at, live = positions(self.live, some)
        where = torch.cat([at, at.new_tensor([len(self.live)])])
        return Raw(live, self.gram[where][:, where], self.moment[where])


@dataclass(frozen=True)
class Prior:
    """theta = mean + factor z with z unit normal."""

    mean: Float[Tensor, " all"]
    inertia: Float[Tensor, "params params"]
    """Lower Cholesky factor of the inertial parameters."""
    scale: Float[Tensor, " more"]

    def standard(
        self, gram: Float[Tensor, "live live"], moment: Float[Tensor, " live"], live: Int[Tensor, " live"]
    ) -> Raw:
        """Sums over theta in terms of z."""
        n, L = len(self.inertia), len(live)
        scale, left = self.scale[live[n:] - n], moment - gram @ self.mean[live]
        both = gram.new_zeros(L + 1, L + 1)
        both[n:L, n:L] = (scale[:, None] * gram[n:, n:]).mul_(scale)
        both[:n, :n] = self.inertia.T @ gram[:n, :n] @ self.inertia
        both[:n, n:L] = (self.inertia.T @ gram[:n, n:]).mul_(scale)
        both[n:L, :n] = both[:n, n:L].T
        return Raw(live, both, torch.cat([self.inertia.T @ left[:n], scale * left[n:], left.new_zeros(1)]))

    def widened(self, design: Design) -> "Prior":
        """The same of inertia, for another design."""
        n = len(self.inertia)
        return Prior(torch.cat([self.mean[:n], design.mean.to(self.mean)]), self.inertia, design.scale.to(self.mean))

    def theta(self, z: Float[Tensor, " all"]) -> Float[Tensor, " all"]:
        """Back to the parameters."""
        n = len(self.inertia)
        return self.mean + torch.cat([self.inertia @ z[:n], self.scale * z[n:]])


def make_prior(inertia: InertialPrior, omega: float, design: Design) -> Prior:
    """Of all columns of a design; ``omega`` weighs the inertial prior as the inertial fit did."""
    factor = torch.linalg.cholesky(inertia.covariance / omega)
    scale = design.scale.to(factor)
    return Prior(torch.cat([inertia.mean.reshape(-1), design.mean.to(factor)]), factor, scale)


@dataclass(frozen=True)
class Sums:
    """Gram matrices and moments of z, trial by trial."""

    base: int
    """Columns of inertia and nuisances, which every trial has; those of the candidates' sources follow."""
    shared: int
    """Columns that every trial has; those follow that are one trial's."""
    trials: tuple[Raw, ...]
    constant: float = 0.0
    """Log density of all rows but for what models of one noise differ in."""

    @property
    def all(self) -> frozenset[int]:
        """Every trial."""
        return frozenset(range(len(self.trials)))

    def only(self, design: Design, some: Sequence[Candidate]) -> "Sums":
        """Of a design of these candidates alone."""
        small, _, which = narrower(design, some)
        return replace(self, shared=small.shared, trials=tuple(raw.only(which.all) for raw in self.trials))

    def block(
        self, rows: slice | Tensor, columns: slice | Tensor, seen: frozenset[int]
    ) -> Float[Tensor, "rows columns"]:
        """Part of the Gram matrix, summed over some trials."""
        # Symmetric: rows of a matrix lie together in memory, columns do not.
        return self.summed(seen, lambda raw: raw.gram[_of(raw, columns)][:, _of(raw, rows)]).mT

    def moment(self, columns: slice | Tensor, seen: frozenset[int]) -> Float[Tensor, " columns"]:
        """Part of the moment, summed over some trials."""
        return self.summed(seen, lambda raw: raw.moment[_of(raw, columns)])

    def summed(self, seen: frozenset[int], part: Callable[[Raw], Tensor]) -> Tensor:
        """A linear part of what some trials say together."""
        left = self.all - seen
        if 0 < len(left) < len(seen):
            # All but a few: what those say taken off.
            return self.summed(self.all, part) - sum(part(self.trials[k]) for k in left)
        if left or len(self.trials) == 1:
            zero = torch.zeros_like(part(self.trials[0]))
            return sum((part(self.trials[k]) for k in seen), start=zero)
        return part(self._whole)

    @cached_property
    def _whole(self) -> Raw:
        """Of the shared columns: what is one trial's is never summed."""
        n, first = self.shared, self.trials[0]
        gram, moment = first.gram.new_zeros(n + 1, n + 1), first.moment.new_zeros(n + 1)
        for raw in self.trials:
            gram[:n, :n] += raw.gram[:n, :n]
            moment[:n] += raw.moment[:n]
        return Raw(first.live[:n], gram, moment)

    def cross(self, chosen: Sequence[Candidate], columns: slice | Tensor, seen: frozenset[int]) -> Tensor:
        """Rows of the base and of chosen candidates against columns, summed over the trials in which they act."""
        rows = [self.block(slice(self.base), columns, seen)]
        for own, relative, block in _blocks(chosen):
            rows.append(relative.to(rows[0])[:, None] * self.block(own, columns, block & seen))
        return torch.cat(rows)


def _of(raw: Raw, some: slice | Tensor) -> slice | Tensor:
    """Slices are of columns that every trial has."""
    return some if isinstance(some, slice) else raw.at(some)


def _blocks(
    chosen: Sequence[Candidate],
) -> Iterator[tuple[Int[Tensor, " columns"], Float[Tensor, " columns"], frozenset[int]]]:
    """Columns and relative scales of neighbours that act in the same trials, and these."""
    for block, some in groupby(((one, block) for one in chosen for block in one.blocks), key=lambda both: both[1]):
        own = [one for one, _ in some]
        yield torch.cat([c.columns for c in own]), torch.cat([c.relative for c in own]), block


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
    for own, scale, block in _blocks(chosen):
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


def _blocks_of(raw: Raw, index: Int[Tensor, "some columns"]) -> Float[Tensor, "some columns columns"]:
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
        own = sums.summed(block, lambda raw: _blocks_of(raw, index))
        owns.append(own * relative[:, :, None] * relative[:, None, :])
    part = torch.cat(parts, 1)
    own = torch.stack([torch.block_diag(*(o[k] for o in owns)) for k in range(len(some))])
    return own - part @ part.mT, torch.cat(lefts, 1)


def _gains(
    told: Float[Tensor, "some n n"], left: Float[Tensor, "some n"], some: Sequence[Candidate]
) -> Float[Tensor, "2 some"]:
    L = torch.linalg.cholesky(told + torch.eye(told.shape[1]).to(told))
    u = torch.linalg.solve_triangular(L, left[..., None], upper=False)[..., 0]
    energy = 0.5 * u.square().sum(1)
    gain = energy - L.diagonal(dim1=1, dim2=2).log().sum(1)
    if positive := [k for k, c in enumerate(some) if c.effect.parameters[0].positive]:
        # A parameter known to be positive has half the prior space: twice the density, and only its upper side counts.
        first = torch.linalg.solve_triangular(L.mT, u[..., None], upper=True)[positive, 0, 0]
        sd = torch.cholesky_inverse(L[positive])[:, 0, 0].sqrt()
        gain[positive] += math.log(2.0) + torch.special.log_ndtr(first / sd)
    # What is there in full or not at all has no other size to be averaged over.
    whole = torch.tensor([c.effect.whole for c in some])
    return torch.stack([torch.where(whole, left[:, 0] - 0.5 * told[:, 0, 0], gain), energy])
