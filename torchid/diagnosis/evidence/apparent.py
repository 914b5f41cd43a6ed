"""The appearance of an effect: the amount that sessions without it seem to have of it.

Bodies are no linkages: what a model of rigid segments leaves of a sound recording looks a little like a clock, a tilt
or a pull, and in some recordings like a lot of it. Rows of forces do not know this, and speak for such an effect by any
number of nats. So an effect is held not against its absence alone but against its *appearance*, whose sizes are a
mixture of normal distributions as sound sessions have them (an empirical null: Efron, JASA 99:96 (2004)). What rows of
forces say for it ends where its appearance is as likely; statements that need no body model decide.
"""

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.diagnosis.candidates.candidate import Candidate
from torchid.diagnosis.evidence.gains import informed
from torchid.diagnosis.evidence.posterior import Posterior
from torchid.diagnosis.evidence.spread import evidence_of_sizes
from torchid.diagnosis.evidence.statistics import Statistics
from torchid.effects.effect import Effect

SIZES = (0.0, 0.03, 0.1, 0.3, 1.0)
"""Resolution. Standard deviations of appearances, against those of the effect itself."""
SHARES = (0.21, 0.48, 0.29, 0.02)
"""Estimator. Shares of sessions with each size but the last, whose share is the effect's own (``Traits.mistaken``):
thirteen public sessions of seven laboratories as recorded, none of them kept aside
(``python -m batteries.apparent``)."""


def apparent_evidence(
    statistics: Statistics, posterior: Posterior, candidates: Sequence[Candidate], largest: float | None = None
) -> list[float]:
    """Return the log evidence of the appearance of each candidate over nothing [nat]; at least zero.

    What bodies themselves do is no appearance, nor what is there in full or not at all (``Traits.mistaken``): zero.

    Args:
        statistics: of all trials, without what is stated without a body model.
        posterior: of the base, on these.
        candidates: candidates, of the same design.
        largest: share of those without an effect that seem to have as much of it as one that has it; None: the
            effect's own.
    """
    found = [0.0] * len(candidates)
    which = [k for k, c in enumerate(candidates) if has_appearance(c.effect)]
    sizes = torch.tensor(SIZES, dtype=torch.float64)
    for rows, told, left in informed(statistics, posterior, [candidates[k] for k in which]):
        nats = evidence_of_sizes(told, left, sizes.to(told))
        shares = torch.stack([shares_of(candidates[which[k]].effect, largest) for k in rows]).to(told)
        for k, x in zip(rows, torch.logsumexp(nats + shares.log(), 1).tolist(), strict=True):
            found[which[k]] = max(x, 0.0)
    return found


def has_appearance(effect: Effect) -> bool:
    """Return whether sessions without an effect can seem to have some of it.

    Args:
        effect: the effect.
    """
    return effect.mistaken > 0.0 and not effect.bodily


def shares_of(effect: Effect, largest: float | None = None) -> Float[Tensor, " sizes"]:
    """Return the share of sessions without an effect that seem to have each of ``SIZES`` of it.

    Args:
        effect: the effect.
        largest: share of the largest; None: the effect's own.
    """
    largest = effect.mistaken if largest is None else largest
    return torch.tensor([*((1.0 - largest) * share for share in SHARES), largest], dtype=torch.float64)
