"""How sure a verdict may be of a model that the data contradict, or that nothing can check."""

from collections.abc import Iterable, Sequence
from dataclasses import replace

from torchid.diagnosis.candidates.candidate import Candidate
from torchid.diagnosis.evidence.adequacy import P_VALUE, Adequacy
from torchid.diagnosis.search.elimination import PLAIN, stands_out
from torchid.diagnosis.search.result import SearchResult
from torchid.diagnosis.verdict.records import Cause
from torchid.effects.session import SESSION
from torchid.observation.trial import TrialObservation

ALONE = 0.5
"""Times the confidence of what forces of a single short trial tell."""
BENT = 0.5
"""Times the confidence of a named force that a field beside it contradicts."""


def trust(rest: Adequacy) -> float:
    """Times the confidence of what forces told a model that leaves such a residual."""
    if rest.alone:
        return ALONE
    return 1.0 - 0.5 * rest.share_of_residual if rest.p_value < P_VALUE else 1.0


def with_trust(
    found: SearchResult, observed: Sequence[TrialObservation], rest: Adequacy, causes: Iterable[Cause]
) -> list[Cause]:
    """A model that the data contradict is sure of nothing that the contradicted forces told: what bodies do and cameras
    see is none of that.

    So is one that nothing can check. Too little of it to be flagged leaves in doubt what is small beside it: at a share
    of 0.31, a harness of 9 N that nobody wore had stayed at 1.00.
    """
    if not (rest.p_value < P_VALUE or rest.alone):
        return list(causes)
    sure = [
        one.effect.moves_markers and one.effect.bodily if rest.significant
        else visible(one) if rest.alone
        else one.effect.moves_markers or one.effect.intermittent or stands_out(found, observed, k) > PLAIN
        for k, one in enumerate(found.chosen)
    ]  # fmt: skip
    both = zip(causes, sure, strict=True)
    return [c if plain else replace(c.scaled(trust(rest)), doubted=True) for c, plain in both]


def visible(one: Candidate) -> bool:
    """Markers alone tell it: where all of them do it, only forces disagree, and in one short trial nothing agrees."""
    return one.effect.moves_markers and not one.effect.whole_body and one.place != SESSION
