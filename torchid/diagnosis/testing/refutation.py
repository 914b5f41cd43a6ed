"""Causes that held-out motion speaks against leave the model.

What held-out motion says is gathered as ``HeldOutScores``; ``refute`` decides by these numbers alone.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from torchid.diagnosis.candidates.candidate import Candidate
from torchid.diagnosis.options import HeldOutOptions
from torchid.diagnosis.search.result import support, without
from torchid.diagnosis.testing.heldout import HeldOut
from torchid.diagnosis.trace import StepKind, Trace, step


@dataclass(frozen=True)
class HeldOutScores:
    """Evidence of held-out motion on each cause of a model, beside all the others."""

    nats: tuple[float, ...]
    """Log density that it gains there [nat]: of forces given what cameras saw, where it acts on forces alone."""
    leeway_nats: tuple[float, ...]
    """Log density by which held-out motion may speak against it [nat]."""
    error_growth: tuple[float, ...]
    """Logarithm of the factor by which both force and moment errors grow because of it; zero where it is spared."""


@dataclass(frozen=True)
class Refutation:
    """A cause that held-out motion refutes, with the rule that decided."""

    index: int
    """Index of the cause among the scores."""
    rule: str
    """``heldout_errors`` or ``heldout_density``."""
    numbers: dict[str, float]
    """Numbers that the rule compared, by names that end in their unit."""


def refute(scores: HeldOutScores, options: HeldOutOptions) -> Refutation | None:
    """Return the cause that held-out motion speaks against most, if it refutes one, else None.

    Errors come first: the density knows how little fit trials tell of a limb's inertia, which then makes up for much.

    Args:
        scores: scores of all causes.
        options: thresholds of refutation.
    """
    worse = [growth > math.log1p(options.error_part) for growth in scores.error_growth]
    margin = [x + y for x, y in zip(scores.nats, scores.leeway_nats, strict=True)]
    worst = min(range(len(margin)), key=lambda k: (not worse[k], margin[k]), default=None)
    if worst is None or (margin[worst] > -options.refuted_nats and not worse[worst]):
        return None
    numbers = {
        "heldout_nats": scores.nats[worst], "leeway_nats": scores.leeway_nats[worst],
        "least_nats": -options.refuted_nats, "error_growth_part": math.expm1(scores.error_growth[worst]),
        "most_part": options.error_part,
    }  # fmt: skip
    return Refutation(worst, "heldout_errors" if worse[worst] else "heldout_density", numbers)


@dataclass(frozen=True)
class Upheld:
    """Causes that held-out motion leaves, and those that it refutes."""

    chosen: tuple[Candidate, ...]
    """Causes that are left."""
    refuted: tuple[tuple[Candidate, Refutation], ...]
    """Refuted causes with the decision on each."""
    trace: Trace
    """Decisions, in order."""


def uphold(unseen: HeldOut, chosen: Sequence[Candidate], options: HeldOutOptions) -> Upheld:
    """Return the causes that held-out motion does not refute.

    Args:
        unseen: the held-out trials.
        chosen: the causes.
        options: thresholds.
    """
    kept, refuted, trace = list(chosen), [], []
    while kept and unseen.trials:
        decision = refute(score(unseen, kept, options), options)
        if decision is None:
            break
        gone = kept.pop(decision.index)
        if not gone.ordinary:
            refuted.append((gone, decision))
            trace.append(step(StepKind.REFUSE, gone, decision.rule, **decision.numbers))
    return Upheld(tuple(kept), tuple(refuted), tuple(trace))


def score(unseen: HeldOut, chosen: Sequence[Candidate], options: HeldOutOptions) -> HeldOutScores:
    """Return what held-out motion says of each cause.

    Args:
        unseen: the held-out trials.
        chosen: the causes.
        options: thresholds; ``cameras_part`` is the belief in cameras.
    """
    whole = {density: density(chosen) for density in (unseen.density, unseen.density_of_forces)}
    own = [unseen.density if one.effect.moves_markers else unseen.density_of_forces for one in chosen]
    nats = [whole[density] - density(without(chosen, one)) for density, one in zip(own, chosen, strict=True)]
    leeway = [_leeway(unseen, chosen, one, options) for one in chosen]
    return HeldOutScores(tuple(nats), tuple(leeway), tuple(_error_growth(unseen, chosen)))


def _error_growth(unseen: HeldOut, chosen: Sequence[Candidate]) -> list[float]:
    """Return the growth of errors because of each cause that acts on forces alone; what inertia takes on is spared."""
    whole, found = unseen.log_errors(chosen), []
    for one in chosen:
        spared = one.effect.moves_markers or one.effect.per_trial or one.effect.on_record
        if spared or not unseen.everywhere(one):
            found.append(0.0)
        else:
            found.append(float((whole - unseen.log_errors(without(chosen, one))).min()))
    return found


def _leeway(unseen: HeldOut, chosen: Sequence[Candidate], one: Candidate, options: HeldOutOptions) -> float:
    """Return the log density by which held-out motion may speak against a cause [nat].

    For a cause that acts there, it is the standard deviation of what fit trials promise; for what cameras saw in some
    trials alone, a part of what those say for it. What acts on forces alone has no such excuse, unless it has
    parameters of its own in every trial.
    """
    if not (one.effect.moves_markers or one.effect.per_trial):
        return 0.0
    nats = max(support(unseen.found.model.statistics, chosen, one), 0.0)
    promised = math.sqrt(2.0 * unseen.share * nats) if unseen.acts_here(one) else 0.0
    in_some = one.effect.moves_markers and not unseen.everywhere(one)
    return max(promised, options.cameras_part * nats) if in_some else promised
