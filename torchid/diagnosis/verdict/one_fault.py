"""A fault that is found twice, by witnesses and again in what is left when it is put right, is one fault."""

from collections.abc import Sequence
from dataclasses import replace

import torch

from torchid.diagnosis.trace import StepKind, Trace, TraceStep
from torchid.diagnosis.verdict.causes import parameter_table
from torchid.diagnosis.verdict.records import Cause
from torchid.effects.catalogue import effect

NOTHING_SD = 2.0
"""Resolution. Standard deviations within which what two findings leave of a fault is nothing: the usual 95 %."""
TAKEN_BACK, ONE_FAULT, REFINED = "taken_back", "one_fault", "only_refined"
"""Names of the rules, as in ``docs/diagnosis.md``."""


def joined(
    first: Sequence[Cause], later: Sequence[Cause], put_right: bool = True
) -> tuple[tuple[Cause, ...], tuple[Cause, ...], Trace]:  # fmt: skip
    """Join what witnesses named with what the body model found of the same effects at the same places.

    Sizes add up: to first order an effect that acts on top of itself is one of the sum (all internal parameters are
    zero where it is not there). What the body model takes back was a stand-in for something that no witness can name,
    such as a load that is carried, for the weight of the body.

    Args:
        first: causes that witnesses named.
        later: causes that were found then.
        put_right: whether the first were put right before; if not, what is found again stays as witnesses named it.

    Returns:
        Those of the first and those of the later that are left, and the decisions.
    """
    left, rest, steps = [], list(later), list[TraceStep]()
    for own in first:
        again = next((one for one in rest if _same(own, one)), None)
        if again is None:
            left.append(own)
            continue
        rest = [one for one in rest if one is not again]
        if again.level == "possible" or not put_right:
            left.append(own)
            steps.append(_step(again, REFINED, {"confidence": again.confidence}))
            continue
        both = _both(own, again)
        numbers = {"size_sd": _size_sd(both), "least_size_sd": NOTHING_SD}
        if numbers["size_sd"] < NOTHING_SD:
            steps += [_step(one, TAKEN_BACK, numbers) for one in (own, again)]
        else:
            left.append(both)
            steps.append(_step(again, ONE_FAULT, numbers))
    return tuple(left), tuple(rest), tuple(steps)


def _same(own: Cause, other: Cause) -> bool:
    return (own.effect, own.where, own.when) == (other.effect, other.where, other.when) and (
        own.theta.shape == other.theta.shape
    )


def _both(own: Cause, again: Cause) -> Cause:
    """Return the sum, as sure of its size as what was found last, when all else was known; rivals keep no size."""
    kind, theta = effect(own.effect), own.theta + again.theta
    nowhere = torch.zeros(theta.shape[1], theta.shape[1], dtype=theta.dtype)
    values = parameter_table(kind.estimated(own.place, theta[0], nowhere))
    parameters = {key: {"value": one["value"], "sd": again.parameters[key]["sd"]} for key, one in values.items()}
    twins = tuple(replace(one, parameters=None) for one in own.indistinguishable)
    return replace(own, parameters=parameters, theta=theta, indistinguishable=twins)


def _size_sd(cause: Cause) -> float:
    """Return how far a cause's parameters are from those of none, in standard deviations."""
    none = effect(cause.effect).named(cause.place, torch.zeros_like(cause.theta[0]))
    off = [
        ((cause.parameters[key]["value"] - value).abs() / cause.parameters[key]["sd"].clamp(min=1e-12)).max()
        for key, value in none.items()
    ]
    return float(torch.stack(off).max())


def _step(cause: Cause, rule: str, numbers: dict[str, float]) -> TraceStep:
    return TraceStep(StepKind.LEAVE, cause.effect, cause.where, rule, numbers)
