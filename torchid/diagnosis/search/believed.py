"""Effects that hardly more than noise is left with are named by their evidence alone.

Appearances are what bodies do that no column knows (``evidence/apparent.py``). Where columns know everything, nothing
appears: what seemed ordinary is named, and no name is doubted for what sound sessions seem to have of it.
"""

import math
from collections.abc import Sequence
from dataclasses import replace

from torchid.diagnosis.candidates.candidate import Candidate
from torchid.diagnosis.evidence.adequacy import assess_adequacy
from torchid.diagnosis.evidence.residuals import residuals
from torchid.diagnosis.search.result import SearchResult, support
from torchid.diagnosis.search.rivals import named_in, same
from torchid.diagnosis.search.still_open import kind_of
from torchid.diagnosis.trace import StepKind, step
from torchid.observation.trial import TrialObservation


def believed(found: SearchResult, observed: Sequence[TrialObservation], limit: int) -> SearchResult:
    """Return the result without appearances of what has very strong evidence, where hardly more than noise is left with
    it: what is ordinary is named as well.

    Args:
        found: result of a search.
        observed: fit trials.
        limit: number of effects at most of each kind (``kind_of``).
    """
    doubted = [c for c in found.chosen if c.ordinary or _seems(found, c)]
    nats = {id(one): support(found.model.statistics, found.chosen, one) for one in doubted}
    strong = [one for one in doubted if nats[id(one)] >= found.options.naming.very_strong_nats]
    if not strong:
        return found
    rest = assess_adequacy(observed, residuals(observed, found.model, found.posterior), found.options.adequacy)
    if rest.significant or math.isnan(rest.p_value):
        return found
    chosen = list(found.chosen)
    for one in sorted((c for c in strong if c.ordinary), key=lambda one: -nats[id(one)]):
        kinds = [kind_of(c.effect) for c in chosen if not c.ordinary]
        if kinds.count(kind_of(one.effect)) < limit:
            chosen = [replace(c, ordinary=False) if c is one else c for c in chosen]
    strong = [one for one in strong if not one.ordinary or all(c is not one for c in chosen)]
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


def _seems(found: SearchResult, one: Candidate) -> bool:
    """Return whether a named effect is doubted for what sessions without it seem to have of it."""
    own = next((r for r in found.rounds if r.rivals and same(r.rivals[0].candidate, one)), None)
    return own is not None and own.appearance > 0.0
