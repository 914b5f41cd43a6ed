"""Sizes from which the last round of a search, which named nothing, would have named what was still open."""

from collections.abc import Sequence

from torchid.diagnosis.candidates.candidate import Candidate
from torchid.diagnosis.evidence.detectable import Detectable, detectable, extremes
from torchid.diagnosis.evidence.model import LinearModel
from torchid.diagnosis.options import NamingOptions
from torchid.diagnosis.search.result import without
from torchid.diagnosis.search.still_open import closed_by


def sizes_shown(
    model: LinearModel, chosen: Sequence[Candidate], left: Sequence[Candidate], naming: NamingOptions
) -> tuple[Detectable, ...]:
    """Return the smallest size of each effect that would have been named.

    What a chosen effect keeps from being named is asked in its place, against it.

    Args:
        model: model of the last round.
        chosen: effects in it.
        left: candidates that could still be named.
        naming: thresholds.
    """
    asked: list[tuple[Sequence[Candidate], Sequence[Candidate], Sequence[Candidate]]] = [(tuple(chosen), left, ())]
    asked += [(tuple(without(chosen, one)), closed_by(model.design, chosen, one), (one,)) for one in chosen]
    found = [detectable(model.statistics, beside, some, naming, rivals) for beside, some, rivals in asked if some]
    return extremes([one for own in found for one in own])
