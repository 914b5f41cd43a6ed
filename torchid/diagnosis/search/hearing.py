"""Witnesses are heard on what a search names: they know of no body model, and a body model knows of no witness."""

from collections.abc import Sequence

from jaxtyping import Float
from torch import Tensor

from torchid.diagnosis.candidates.candidate import Candidate
from torchid.diagnosis.search.estimates import internal
from torchid.diagnosis.search.result import SearchResult
from torchid.model_free.panel import Panel
from torchid.model_free.testimony import Claim, Testimony, hear
from torchid.observation.trial import TrialObservation


def testimonies(
    panel: Panel | None, found: SearchResult, observed: Sequence[TrialObservation]
) -> tuple[Testimony | None, ...]:
    """Return what witnesses say of each chosen effect, beside all others; None where it is not of forces.

    Args:
        panel: the witnesses; None: nobody says anything.
        found: result of a search.
        observed: its fit trials.
    """
    forceful = [k for k, one in enumerate(found.chosen) if not one.effect.moves_markers]
    if panel is None or not forceful:
        return (None,) * len(found.chosen)
    names = [w.rows.name for w in observed]
    heard = dict(zip(forceful, hear(panel, [_claim(found, k, names) for k in forceful]), strict=True))
    return tuple(heard.get(k) for k in range(len(found.chosen)))


def _claim(found: SearchResult, k: int, names: Sequence[str]) -> Claim:
    """Return the k-th chosen effect as a claim; what is there throughout is there in static trials too."""
    one, theta = found.chosen[k], internal(found, k).view(len(found.chosen[k].blocks), -1)
    everywhere = one.trials == found.model.statistics.all and not one.effect.per_trial

    def acting(trial: str) -> Float[Tensor, " params"] | None:
        if trial in names:
            return _of_trial(one, theta, names.index(trial))
        return theta[0] if everywhere else None

    return Claim(one.effect, one.place, acting)


def _of_trial(one: Candidate, theta: Float[Tensor, "blocks params"], trial: int) -> Float[Tensor, " params"] | None:
    """Return the parameters of an effect in one of the fit trials; None where it does not act."""
    return next((own for own, block in zip(theta, one.blocks, strict=True) if trial in block), None)
