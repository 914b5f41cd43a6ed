"""Named parameters of chosen effects, with their standard deviations."""

from collections.abc import Iterator

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.diagnosis.candidates.candidate import Candidate
from torchid.diagnosis.search.result import SearchResult


def internal(found: SearchResult, k: int) -> Float[Tensor, " params"]:
    """Return the internal parameters of the k-th chosen effect, block after block of trials.

    Args:
        found: result of the search.
        k: index of the effect.
    """
    return parameter_map(found, k) @ found.posterior.mean


def parameter_map(found: SearchResult, k: int) -> Float[Tensor, "params n"]:
    """Return the matrix from the standardised parameters of the posterior to the internal parameters of an effect.

    What every plate or skin has a little of is part of an error that is named there: a drift is all of it, and known
    better than the share of it that is out of the ordinary.

    Args:
        found: result of the search.
        k: index of the effect.
    """
    one, at = found.chosen[k], found.model.design.base + sum(c.size for c in found.chosen[:k])
    scale = found.model.prior.mean.new_tensor(one.effect.scale(one.place) * len(one.blocks))
    factor = scale.new_zeros(one.size, len(found.posterior.factor))
    factor[:, at : at + one.size] = torch.diag(scale)
    if one.blocks == (found.model.statistics.all,):
        for columns, part in _ordinary(found, one):
            factor[:, columns] = part
    return factor


def _ordinary(found: SearchResult, one: Candidate) -> Iterator[tuple[slice, Float[Tensor, "params some"]]]:
    """Yield nuisances that are part of an effect: their columns, and its parameters in terms of theirs."""
    mean = found.model.prior.mean
    if one.source.columns.stop <= found.model.design.base:
        assert not any(one.source.mean), "errors of plates are about nothing"
        yield one.source.columns, torch.diag(mean.new_tensor(one.source.scale))
    for source in found.model.design.sources:
        part = source.effect.part_of(source.place, one.effect, one.place)
        if part is not None:
            yield source.columns, part * mean.new_tensor(source.scale)


def estimate(found: SearchResult, k: int) -> dict[str, tuple[Float[Tensor, "*size"], Float[Tensor, "*size"]]]:
    """Return named parameters of the k-th chosen effect by key: values and standard deviations, in the units of the
    keys.

    Args:
        found: result of the search.
        k: index of the effect.
    """
    one, theta, factor = found.chosen[k], internal(found, k), parameter_map(found, k)
    return one.effect.estimated(one.place, theta, factor @ found.posterior.covariance @ factor.T)


def instead(
    found: SearchResult, k: int, twin: Candidate
) -> dict[str, tuple[Float[Tensor, "*size"], Float[Tensor, "*size"]]]:
    """Return named parameters of another effect in the place of the k-th chosen one, as ``estimate`` does.

    Args:
        found: result of the search.
        k: index of the effect that gives way.
        twin: the other effect.
    """
    chosen = (*found.chosen[:k], twin, *found.chosen[k + 1 :])
    return estimate(found.having(chosen), k)
