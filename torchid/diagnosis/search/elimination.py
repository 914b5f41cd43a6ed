"""Rules that take causes out again, each a pure function from a result to a result with the step that it took.

Evidence names causes one after the other. A later one may make an earlier one superfluous, and where noise does not
explain the residual, evidence is cheap: then a cause must also be seen to gain.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import combinations

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.diagnosis.candidates.candidate import Candidate
from torchid.diagnosis.evidence.residuals import residuals
from torchid.diagnosis.search.estimates import parameter_map
from torchid.diagnosis.search.result import SearchResult, support, without
from torchid.diagnosis.search.scan import scan_all
from torchid.diagnosis.trace import StepKind, step
from torchid.observation.trial import TrialObservation

Rule = Callable[[SearchResult, Sequence[TrialObservation]], SearchResult]
"""A function of a result and the fit trials that returns the result without the causes that it takes out."""


def drop_unsupported(found: SearchResult, observed: Sequence[TrialObservation]) -> SearchResult:
    """Return the result without causes that the others make superfluous, or that stood by others which have left.

    The last ones that entered, which explain least, are asked first.

    Args:
        found: result so far.
        observed: fit trials; not asked.
    """
    del observed
    least, kept, steps = found.options.naming.named_nats, list(found.chosen), []
    for one in reversed(found.chosen):
        nats = support(found.model.statistics, kept, one)
        if nats < least:
            kept.remove(one)
            steps.append(step(StepKind.LEAVE, one, "unsupported", evidence_nats=nats, least_nats=least))
    return found.having(kept, *steps) if steps else found


def drop_negative(found: SearchResult, observed: Sequence[TrialObservation]) -> SearchResult:
    """Return the result without causes all of whose loads or springs are negative.

    An effect says that something is there; its negative says that something is taken away, which has another name.

    Args:
        found: result so far.
        observed: fit trials; not asked.
    """
    del observed
    return _without_negative(found, math.inf)


def drop_surely_negative(found: SearchResult, observed: Sequence[TrialObservation]) -> SearchResult:
    """Return the result without causes of which one load or spring of several is surely negative.

    The rule is for the end only: other causes that leave later may be what makes it negative.

    Args:
        found: result so far.
        observed: fit trials; not asked.
    """
    del observed
    return _without_negative(found, found.options.elimination.negative_sd)


def _without_negative(found: SearchResult, sd: float) -> SearchResult:
    """Return the result without causes whose parameters are all negative, or one of them by so many standard
    deviations."""
    for k, one in reversed(list(enumerate(found.chosen))):
        theta, spread = _positive_parameters(found, k)
        if len(theta) and bool((theta < 0.0).all() or (theta < -sd * spread).any()):
            numbers = {"lowest_sd": float((theta / spread).min())} | ({"least_sd": -sd} if math.isfinite(sd) else {})
            left = step(StepKind.LEAVE, one, "negative", **numbers)
            return _without_negative(found.having(without(found.chosen, one), left), sd)
    return found


def _positive_parameters(found: SearchResult, k: int) -> tuple[Float[Tensor, " some"], Float[Tensor, " some"]]:
    """Return the parameters of the k-th cause that are never negative, and their standard deviations."""
    one, factor = found.chosen[k], parameter_map(found, k)
    n = one.effect.positives(one.place)
    theta = (factor @ found.posterior.mean)[:n]
    return theta, (factor @ found.posterior.covariance @ factor.T).diagonal()[:n].sqrt()


def drop_opposed(found: SearchResult, observed: Sequence[TrialObservation]) -> SearchResult:
    """Return the result without causes on forces that mostly undo each other: what is left of a pair has another name,
    or none.

    Args:
        found: result so far.
        observed: fit trials; not asked.
    """
    del observed
    energy, limit = _energies(found), found.options.elimination.opposed_part
    own = [k for k, one in enumerate(found.chosen) if not one.effect.moves_markers]
    left: dict[int, float] = {}
    for i, k in combinations(own, 2):
        both = float(energy[[i, k]][:, [i, k]].sum() / max(energy[i, i], energy[k, k]))
        if both < limit:
            left |= {j: min(both, left.get(j, both)) for j in (i, k)}
    steps = [
        step(StepKind.LEAVE, found.chosen[k], "opposed", remaining_part=both, least_part=limit)
        for k, both in sorted(left.items())
    ]
    kept = [one for k, one in enumerate(found.chosen) if k not in left]
    return found.having(kept, *steps) if steps else found


def _energies(found: SearchResult) -> Float[Tensor, "chosen chosen"]:
    """Return products of what the chosen effects do to the whitened rows."""
    columns = len(found.model.prior.mean)
    total = found.model.prior.mean.new_zeros(len(found.chosen), len(found.chosen))
    for trial, raw in enumerate(found.model.statistics.trials):
        share = found.posterior.shares(columns, trial)[:, raw.live]
        total += share @ raw.gram[:-1, :-1] @ share.T
    return total


def drop_without_residual_gain(found: SearchResult, observed: Sequence[TrialObservation]) -> SearchResult:
    """Return the result without causes on forces that take too little of the residual away.

    They are judged without effects that have parameters of their own in every trial, beside which a plate's error can
    go unseen. A wrong record is spared: inertia takes it on, so that it leaves nothing in the residual.

    Args:
        found: result so far.
        observed: fit trials.
    """
    least, kept, steps = found.options.elimination.residual_part, list(found.chosen), []
    for one in reversed(found.chosen):
        if one.effect.moves_markers or one.effect.intermittent or one.effect.on_record:
            continue
        part = _takes_away(found, observed, kept, one)
        if part < least:
            kept.remove(one)
            steps.append(step(StepKind.LEAVE, one, "no_residual_gain", residual_part=part, least_part=least))
    return found.having(kept, *steps) if steps else found


def _takes_away(
    found: SearchResult, observed: Sequence[TrialObservation], chosen: Sequence[Candidate], one: Candidate
) -> float:
    """Return the part of the residual force or moment, whichever is more, that an effect takes away beside the
    others."""
    others = [c for c in without(chosen, one) if not c.effect.per_trial]
    with_, less = (
        sizes(observed, residuals(observed, found.model, found.model.fit(some))) for some in ([*others, one], others)
    )
    return 1.0 - float((with_ - less).exp().min())


def restore_record(found: SearchResult, observed: Sequence[TrialObservation]) -> SearchResult:
    """Return the result with a wrong record or a common gain, if forces that have left had stood for it.

    Args:
        found: result so far.
        observed: fit trials; not asked.
    """
    del observed
    barred = {one.effect for one in found.trace if one.rule == "witnesses_contradict"}
    left = [c for c in found.scales if c not in found.chosen and c.effect.name not in barred]
    if not left or not any(one.rule in ("opposed", "no_residual_gain") for one in found.trace):
        return found
    scan = scan_all(found.model.statistics, left, found.chosen, found.options.naming).round
    if scan.named is None:
        return found
    one = scan.named.candidate
    enter = step(StepKind.ENTER, one, "restored_record", score_nats=scan.named.score)
    rounds = (*found.rounds[:-1], scan, found.rounds[-1])
    return replace(found.having((*found.chosen, one), enter), rounds=rounds)


SUPPORTED: tuple[Rule, ...] = (drop_unsupported, drop_negative)
"""Rules that every result must pass."""
VISIBLE: tuple[Rule, ...] = (drop_opposed, drop_without_residual_gain)
"""Rules for results whose residual noise does not explain."""
AT_LAST: tuple[Rule, ...] = (drop_unsupported, drop_surely_negative)
"""Rules for the end, when nothing else changes any more."""


def eliminate(found: SearchResult, observed: Sequence[TrialObservation], rules: Sequence[Rule]) -> SearchResult:
    """Return the result after each rule in turn.

    Args:
        found: result so far.
        observed: fit trials.
        rules: the rules, in order.
    """
    for rule in rules:
        found = rule(found, observed)
    return found


def settle(found: SearchResult, observed: Sequence[TrialObservation], rules: Sequence[Rule]) -> SearchResult:
    """Return the result after the rules, applied in turn until none takes out a cause.

    Args:
        found: result so far.
        observed: fit trials.
        rules: the rules, in order.
    """
    after = eliminate(found, observed, rules)
    return after if len(after.chosen) == len(found.chosen) else settle(after, observed, rules)


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
    return 1.0 - float((sizes(observed, left) - sizes(observed, more)).exp().min())


def sizes(observed: Sequence[TrialObservation], left: Sequence[Tensor]) -> Float[Tensor, " 2"]:
    """Return logarithms of the RMS of residual forces [log N] and moments [log N m].

    They are averaged over trials so that none drowns the others.

    Args:
        observed: trials.
        left: residual of each about the root's origin [N, N m].
    """
    parts = [x[w.rows.used].unflatten(1, (2, 3)) for w, x in zip(observed, left, strict=True)]
    return torch.stack([0.5 * part.square().mean((0, 2)).log() for part in parts]).mean(0)
