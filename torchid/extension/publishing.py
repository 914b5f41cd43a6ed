"""The model that is published: extended by causes only as far as it predicts no worse than the base model.

Whether a cause is there and whether the model is better for it are two questions. The first is decided by evidence; a
cause that leaves the model here keeps its name. The second shows only when geometry, postures and inertia are fitted
again: all that is likely is corrected, and where the model then predicts worse than the base model beyond chance, in
held-out trials or in blocks of the fit trials left out in turn, the cause that promised least is taken out, until it
does not.
"""

import logging
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace

from torchid.diagnosis.options import NeverWorseOptions
from torchid.diagnosis.trace import StepKind, TraceStep
from torchid.diagnosis.verdict.records import Cause, Diagnosis
from torchid.errors import DataError
from torchid.extension.block_errors import block_errors, cut_blocks
from torchid.extension.correction import corrected_config, extend_outcome, moves_markers
from torchid.extension.never_worse import Growth, compare
from torchid.extension.swapped_markers import swap_causes
from torchid.session import Outcome
from torchid.session.fitting import OnStage
from torchid.storage.results import OutputFolder

log = logging.getLogger(__name__)
RULE = "never_worse"
"""Name of the rule in ``docs/diagnosis.md``."""
FAILED = (Growth("all trials", "force", math.inf, math.inf, 0, True),)
"""Of a model that no inertia fits."""
LeftOut = tuple[Cause, Mapping[str, float]]
"""A cause that is not corrected, and by how much errors grew."""


def publishable(base: Outcome, relabelled: Outcome, folder: OutputFolder, key: str, progress: OnStage) -> Outcome:
    """Extend the model by the likely causes of a verdict, as far as it predicts no worse than the base model.

    Args:
        base: with the verdict on it.
        relabelled: with the names of swapped markers put right, on it what was found then; without any, ``base``.
        folder: for stages.
        key: of all that these depend on.
        progress: called with stages and fractions.

    Returns:
        The extended model; the base model where no cause is left. The verdict on it says which causes are applied.
    """
    assert base.diagnosis is not None
    judge = _Judge(base)
    origin, swaps, left_out = _renamed(base, relabelled, judge)

    def attempt(some: Sequence[Cause]) -> tuple[Outcome | None, tuple[Growth, ...]]:
        outcome = _extended(base, origin, some, folder, key, progress)
        return outcome, FAILED if outcome is None else judge.growth(outcome, tuple(some)) if some else ()

    assert origin.diagnosis is not None
    likely = [cause for cause in origin.diagnosis.causes if cause.level != "possible"]
    outcome, kept, gone = _chosen(likely, attempt, judge.options)
    verdict = applied(base.diagnosis, [*kept, *swaps], [*left_out, *gone])
    published = replace(outcome, diagnosis=verdict)
    return published if outcome.base is None else replace(published, base=replace(base, diagnosis=verdict))


def _chosen(
    likely: Sequence[Cause],
    attempt: Callable[[Sequence[Cause]], tuple[Outcome | None, tuple[Growth, ...]]],
    options: NeverWorseOptions,
) -> tuple[Outcome, list[Cause], list[LeftOut]]:
    """The model of as many causes as make it predict no worse, these causes, and those that are left out.

    The one that promised least leaves first. As another may have done the harm, each is tried once more when all is
    well, but for the last, which has just been.
    """
    kept, gone = list(likely), []
    outcome, grown = attempt(kept)
    while kept and _worse(grown):
        gone.append((least_promised(kept, grown), worsening(grown, options)))
        log.info("%s left out: %s", _called([gone[-1][0]]), gone[-1][1])
        kept = [cause for cause in kept if cause is not gone[-1][0]]
        outcome, grown = attempt(kept)
    assert outcome is not None, "the base model, and that with other labels, were fitted before"
    for one in gone[-2::-1]:
        other, grown = attempt([*kept, one[0]])
        if other is not None and not _worse(grown):
            outcome, kept, gone = other, [*kept, one[0]], [left for left in gone if left is not one]
    return outcome, kept, gone


def _worse(grown: Sequence[Growth]) -> bool:
    return any(one.worse for one in grown)


class _Judge:
    """Compares models with the base model in its blocks."""

    def __init__(self, base: Outcome) -> None:
        self.options = base.config.diagnosis.thresholds.never_worse
        self._base, self._blocks = base, cut_blocks(base)
        self._before = block_errors(base, base, base.config, self._blocks)

    def growth(self, outcome: Outcome, causes: tuple[Cause, ...]) -> tuple[Growth, ...]:
        """Growth of the errors of a model that is corrected for these causes."""
        config = corrected_config(self._base.config, causes)
        return compare(self._before, block_errors(outcome, self._base, config, self._blocks), self.options)


def _renamed(base: Outcome, relabelled: Outcome, judge: _Judge) -> tuple[Outcome, list[Cause], list[LeftOut]]:
    """The outcome to extend, the swaps that it has put right, and those that were left out.

    Relabelled, unless that predicts worse; then the other causes are asked alone.
    """
    assert base.diagnosis is not None and relabelled.diagnosis is not None
    if relabelled is base:
        return base, [], []
    after = relabelled.diagnosis.causes
    swaps = [cause for cause in swap_causes(base.diagnosis.causes) if not _among(cause, after)]
    grown = judge.growth(relabelled, ())
    if not _worse(grown):
        return relabelled, swaps, []
    numbers = worsening(grown, judge.options)
    return replace(base, diagnosis=relabelled.diagnosis), [], [(swap, numbers) for swap in swaps]


def _extended(
    base: Outcome, origin: Outcome, causes: Sequence[Cause], folder: OutputFolder, key: str, progress: OnStage
) -> Outcome | None:
    """The model extended by some causes, which is the base model without any; None where no inertia fits."""
    assert origin.diagnosis is not None
    if not causes and origin.followed is base.followed:
        return base
    some = replace(origin, diagnosis=replace(origin.diagnosis, causes=tuple(causes)))
    try:
        return extend_outcome(base, some, folder, key, progress)
    except DataError as failure:
        log.info("%s: %s", _called(causes), failure)
        return None


def least_promised(kept: Sequence[Cause], grown: Sequence[Growth]) -> Cause:
    """The cause to be left out of a model that predicts worse: of those on what grew most, that with the least gain.

    Args:
        kept: causes of the model.
        grown: growth of its errors.
    """
    worst = max(grown, key=lambda one: one.least_log)
    movers = [cause for cause in kept if moves_markers(cause)]
    return min(movers if movers and worst.kind == "markers" else kept, key=_promise)


def _promise(cause: Cause) -> tuple[float, float]:
    """What a cause gains on held-out motion by the linear model, where there is any, and its confidence."""
    parts = [cause.gain.get(key, math.nan) for key in ("force_rmse_pct", "moment_rmse_pct")]
    return min((part for part in parts if math.isfinite(part)), default=0.0), cause.confidence


def worsening(grown: Sequence[Growth], options: NeverWorseOptions) -> dict[str, float]:
    """Numbers of a cause that was left out.

    Args:
        grown: growth of errors of the model with the cause, over the base model's.
        options: their margin.
    """
    kinds = {kind: [one.part for one in grown if one.kind == kind] for kind in ("force", "moment", "markers")}
    return {
        **{f"{kind}_growth_part": max(some, default=0.0) for kind, some in kinds.items()},
        "least_growth_part": math.expm1(max(one.least_log for one in grown)), "most_part": options.margin_part,
    }  # fmt: skip


def applied(found: Diagnosis, kept: Sequence[Cause], left_out: Sequence[LeftOut]) -> Diagnosis:
    """The verdict that says which causes the model is corrected for, with a step of the trace for what left it.

    Args:
        found: with all causes.
        kept: those that are corrected.
        left_out: those with which the model predicts worse.
    """
    causes = tuple(replace(own, applied=_among(own, kept)) for own in found.causes)
    steps = [TraceStep(StepKind.LEAVE, cause.effect, cause.where, RULE, numbers) for cause, numbers in left_out]
    return replace(
        found, causes=causes, trace=(*found.trace, *steps), extended=found.extended if kept else found.baseline,
        aside=found.aside if kept else (),
    )  # fmt: skip


def _among(one: Cause, some: Iterable[Cause]) -> bool:
    return any(one is other for other in some)


def _called(causes: Iterable[Cause]) -> str:
    return ", ".join(f"{cause.effect} [{', '.join(cause.where)}]" for cause in causes)
