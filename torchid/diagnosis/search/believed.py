"""Effects that seemed ordinary are named where they leave hardly more than noise.

Appearances are what bodies do that no column knows (``evidence/apparent.py``). Where columns know everything, nothing
appears, and evidence alone counts.
"""

import math
from collections.abc import Sequence
from dataclasses import replace

from torchid.diagnosis.evidence.adequacy import assess_adequacy
from torchid.diagnosis.evidence.residuals import residuals
from torchid.diagnosis.search.result import SearchResult, support
from torchid.diagnosis.search.rivals import named_in
from torchid.diagnosis.search.still_open import kind_of
from torchid.diagnosis.trace import StepKind, step
from torchid.observation.trial import TrialObservation


def believed(found: SearchResult, observed: Sequence[TrialObservation], limit: int) -> SearchResult:
    """Return the result with what is ordinary named as well, where its evidence is very strong and hardly more than
    noise is left with it.

    Args:
        found: result of a search.
        observed: fit trials.
        limit: number of effects at most of each kind (``kind_of``).
    """
    nats = {id(one): support(found.model.statistics, found.chosen, one) for one in found.chosen if one.ordinary}
    strong = [one for one in found.chosen if nats.get(id(one), 0.0) >= found.options.naming.very_strong_nats]
    if not strong:
        return found
    rest = assess_adequacy(observed, residuals(observed, found.model, found.posterior), found.options.adequacy)
    if rest.significant or math.isnan(rest.p_value):
        return found
    chosen = list(found.chosen)
    for one in sorted(strong, key=lambda one: -nats[id(one)]):
        kinds = [kind_of(c.effect) for c in chosen if not c.ordinary]
        if kinds.count(kind_of(one.effect)) < limit:
            chosen = [replace(c, ordinary=False) if c is one else c for c in chosen]
    strong = [one for one in strong if all(c is not one for c in chosen)]
    theirs = {id(named_in(found.rounds, one)) for one in strong}
    rounds = tuple(replace(own, appearance=0.0) if id(own) in theirs else own for own in found.rounds)
    least = found.options.naming.very_strong_nats
    steps = [
        step(
            StepKind.ENTER, one, "nothing_left", evidence_nats=nats[id(one)], least_nats=least,
            unexplained_part=rest.share_of_residual, p_value=rest.p_value,
        )
        for one in strong
    ]  # fmt: skip
    return replace(found, chosen=tuple(chosen), rounds=rounds, trace=(*found.trace, *steps))
