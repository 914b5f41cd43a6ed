"""Rules that take causes out again, each a pure function from a result to a result with the step that it took.

Evidence names causes one after the other, and a later one may make an earlier one superfluous.
"""

import math
from collections.abc import Callable, Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.diagnosis.candidates.candidate import Candidate
from torchid.diagnosis.evidence.residuals import residuals
from torchid.diagnosis.search.estimates import parameter_map
from torchid.diagnosis.search.result import SearchResult, support, without
from torchid.diagnosis.trace import StepKind, TraceStep, step
from torchid.observation.trial import TrialObservation

Rule = Callable[[SearchResult], SearchResult]
"""A function of a result that returns the result without the causes that it takes out."""


def drop_unsupported(found: SearchResult) -> SearchResult:
    """Return the result without causes that the others make superfluous, or that stood by others which have left.

    The last ones that entered, which explain least, are asked first.

    Args:
        found: result so far.
    """
    least, kept, steps = found.options.naming.named_nats, list(found.chosen), []
    for one in reversed(found.chosen):
        nats = support(found.model.statistics, kept, one)
        if nats < least:
            kept.remove(one)
            steps += left(one, "unsupported", evidence_nats=nats, least_nats=least)
    return found.having(kept, *steps) if len(kept) < len(found.chosen) else found


def left(one: Candidate, rule: str, **numbers: float) -> list[TraceStep]:
    """Return the step of a cause that leaves; none of what is ordinary, which was never named.

    Args:
        one: the cause.
        rule: that takes it out.
        numbers: that the rule compared.
    """
    return [] if one.ordinary else [step(StepKind.LEAVE, one, rule, **numbers)]


def drop_negative(found: SearchResult) -> SearchResult:
    """Return the result without causes all of whose loads or springs are negative.

    An effect says that something is there; its negative says that something is taken away, which has another name.

    Args:
        found: result so far.
    """
    return _without_negative(found, math.inf)


def drop_surely_negative(found: SearchResult) -> SearchResult:
    """Return the result without causes of which one load or spring of several is surely negative.

    The rule is for the end only: other causes that leave later may be what makes it negative.

    Args:
        found: result so far.
    """
    return _without_negative(found, found.options.elimination.negative_sd)


def _without_negative(found: SearchResult, sd: float) -> SearchResult:
    """Return the result without causes whose parameters are all negative, or one of them by so many standard
    deviations."""
    for k, one in reversed(list(enumerate(found.chosen))):
        theta, spread = _positive_parameters(found, k)
        if len(theta) and bool((theta < 0.0).all() or (theta < -sd * spread).any()):
            numbers = {"lowest_sd": float((theta / spread).min())} | ({"least_sd": -sd} if math.isfinite(sd) else {})
            steps = left(one, "negative", **numbers)
            return _without_negative(found.having(without(found.chosen, one), *steps), sd)
    return found


def _positive_parameters(found: SearchResult, k: int) -> tuple[Float[Tensor, " some"], Float[Tensor, " some"]]:
    """Return the parameters of the k-th cause that are never negative, and their standard deviations."""
    one, factor = found.chosen[k], parameter_map(found, k)
    n = one.effect.positives(one.place)
    theta = (factor @ found.posterior.mean)[:n]
    return theta, (factor @ found.posterior.covariance @ factor.T).diagonal()[:n].sqrt()


SUPPORTED: tuple[Rule, ...] = (drop_unsupported, drop_negative)
"""Rules that every result must pass."""
AT_LAST: tuple[Rule, ...] = (drop_unsupported, drop_surely_negative)
"""Rules for the end, when nothing else changes any more."""


def eliminate(found: SearchResult, rules: Sequence[Rule]) -> SearchResult:
    """Return the result after each rule in turn.

    Args:
        found: result so far.
        rules: the rules, in order.
    """
    for rule in rules:
        found = rule(found)
    return found


def settle(found: SearchResult, rules: Sequence[Rule]) -> SearchResult:
    """Return the result after the rules, applied in turn until none takes out a cause.

    Args:
        found: result so far.
        rules: the rules, in order.
    """
    after = eliminate(found, rules)
    return after if len(after.chosen) == len(found.chosen) else settle(after, rules)


def stands_out(found: SearchResult, observed: Sequence[TrialObservation], k: int) -> float:
    """Return the part of the residual force or moment, whichever is more, that the k-th chosen effect takes away by
    itself.

    Nothing else makes up for it here, whereas in another fit the inertia takes on what a hidden load needs.

    Args:
        found: result of the search.
        observed: fit trials.
        k: index of the effect.
    """
    model, n, more = found.model, found.model.design.inertia, []
    left = residuals(observed, model, found.posterior)
    for trial, (columns, own) in enumerate(zip(model.design.trials, left, strict=True)):
        share = model.prior.scale * found.posterior.shares(len(model.prior.mean), trial)[k, n:]
        more.append(own + columns.added(share[columns.terms.live[n:] - n]))
    return 1.0 - float((_sizes(observed, left) - _sizes(observed, more)).exp().min())


def _sizes(observed: Sequence[TrialObservation], left: Sequence[Tensor]) -> Float[Tensor, " 2"]:
    """Return logarithms of the RMS of residual forces [log N] and moments [log N m].

    They are averaged over trials so that none drowns the others.

    Args:
        observed: trials.
        left: residual of each about the root's origin [N, N m].
    """
    parts = [x[w.rows.used].unflatten(1, (2, 3)) for w, x in zip(observed, left, strict=True)]
    return torch.stack([0.5 * part.square().mean((0, 2)).log() for part in parts]).mean(0)
