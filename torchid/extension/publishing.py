"""The model that is published: extended only by causes with which it predicts no worse than without them.

A verdict is found in a linear model; only fitting everything again shows what a cause does to geometry, inertia and
motion. Causes are left out one by one until the model is no worse than the base model, nor than it would be without any
single one on forces, in forces, moments and markers, in every held-out trial and in blocks of the fit trials left out
in turn. A cause that is only possible has to show more: without it, something must be predicted worse.
"""

import logging
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

from torchid.diagnosis.evidence.adequacy import Adequacy
from torchid.diagnosis.options import NeverWorseOptions
from torchid.diagnosis.trace import StepKind, TraceStep
from torchid.diagnosis.verdict.records import Cause, Diagnosis, Refuted
from torchid.errors import DataError
from torchid.extension.block_errors import BlockErrors, Group, block_errors, cut_blocks
from torchid.extension.correction import corrected_config, extend_outcome, moves_markers
from torchid.extension.diagnosing import assess_outcome
from torchid.extension.never_worse import Growth, compare
from torchid.extension.swapped_markers import swap_causes
from torchid.session import Outcome
from torchid.session.fitting import OnStage
from torchid.storage.results import OutputFolder

log = logging.getLogger(__name__)
RULE, UNPROVEN = "never_worse", "no_gain"
"""Names of the rules in ``docs/diagnosis.md``."""
Chosen = frozenset[int]
"""Causes of a verdict, by their place in it."""
FAILED = (Growth("all trials", "force", math.inf, math.inf, 0, True),)
"""Of a model that no inertia fits."""


def publishable(base: Outcome, relabelled: Outcome, folder: OutputFolder, key: str, progress: OnStage) -> Outcome:
    """Extend the model by the causes of a verdict that make no prediction worse; the others are refuted.

    Args:
        base: with the verdict on it.
        relabelled: with the names of swapped markers put right, on it what was found then; without any, ``base``.
        folder: for stages.
        key: of all that these depend on.
        progress: called with stages and fractions.

    Returns:
        The extended model; the base model where no cause is left. The verdict on it says what was refuted.
    """
    assert base.diagnosis is not None
    origin, refused = _judge_swaps(base, relabelled)
    attempts = Attempts(base, origin, folder, key, progress)
    selection = select(attempts)
    outcome, gone = attempts.outcome(selection.kept), [*refused, *selection.refused]
    verdict = base.diagnosis
    if gone or selection.unproven:
        verdict = without(verdict, gone, selection.unproven, assess_outcome(outcome))
    published = replace(outcome, diagnosis=verdict)
    return published if outcome.base is None else replace(published, base=replace(base, diagnosis=verdict))


Refusal = tuple[Cause, Mapping[str, float]]
"""A cause that makes predictions worse, or none better, and by how much they change."""


@dataclass(frozen=True)
class CauseSelection:
    """What becomes of the causes of a verdict."""

    kept: Chosen
    """Those by which the model is extended."""
    refused: list[Refusal]
    """Those with which it predicts worse."""
    unproven: list[Refusal]
    """Those that are only possible, and without which it predicts no worse."""


def _judge_swaps(base: Outcome, relabelled: Outcome) -> tuple[Outcome, list[Refusal]]:
    """The outcome to extend: relabelled, unless that is worse; then swaps are refuted and the others asked alone."""
    assert base.diagnosis is not None
    if relabelled is base:
        return base, []
    blocks = cut_blocks(base)
    limits = base.config.diagnosis.thresholds.never_worse
    before, after = (block_errors(one, base, one.config, blocks) for one in (base, relabelled))
    grown = compare(before, after, limits)
    if not any(one.worse for one in grown):
        return relabelled, []
    swaps = swap_causes(base.diagnosis.causes)
    others = tuple(cause for cause in base.diagnosis.causes if not any(cause is swap for swap in swaps))
    numbers = worsening(grown, grown, limits)
    return replace(base, diagnosis=replace(base.diagnosis, causes=others)), [(swap, numbers) for swap in swaps]


class Attempts:
    """Models extended by some of the causes, each fitted once, with their errors in the base model's blocks.

    Leaving out a cause on forces fits the inertia alone; leaving out one on markers fits geometry and postures too, of
    which at most one more than there are causes are worth their time.
    """

    def __init__(self, base: Outcome, origin: Outcome, folder: OutputFolder, key: str, progress: OnStage) -> None:
        """Cut the blocks, and begin with the base model.

        Args:
            base: with the whole verdict.
            origin: to be extended: ``base``, or with swapped markers put right.
            folder: for stages.
            key: of all that these depend on.
            progress: called with stages and fractions.
        """
        assert origin.diagnosis is not None
        self.causes, self.options = origin.diagnosis.causes, base.config.diagnosis.thresholds.never_worse
        self._base, self._origin, self._stages = base, origin, (folder, key, progress)
        self._blocks, self._most = cut_blocks(base), 1 + len(self.causes)
        self._models: dict[Chosen, tuple[Outcome, Mapping[Group, BlockErrors]] | None] = {}
        self._geometries: set[Chosen] = {frozenset()}
        self._before = self._errors(base, ())
        if origin.followed is base.followed:
            self._models[frozenset()] = base, self._before

    def affordable(self, chosen: Chosen) -> bool:
        """Whether the geometry of these causes is fitted, or may be."""
        return self.movers(chosen) in self._geometries or len(self._geometries) <= self._most

    def outcome(self, chosen: Chosen) -> Outcome:
        """The model extended by these causes, which must fit."""
        found = self._model(chosen)
        assert found is not None, "a model that no inertia fits is never kept"
        return found[0]

    def growth(self, chosen: Chosen, other: Chosen | None = None) -> tuple[Growth, ...]:
        """Compare the model with that of other causes; None: with the base model, labels as they were."""
        found, reference = self._model(chosen), None if other is None else self._model(other)
        if found is None:
            return FAILED
        if other is not None and reference is None:
            return ()
        return compare(self._before if reference is None else reference[1], found[1], self.options)

    def movers(self, chosen: Chosen) -> Chosen:
        """Those of the causes that act on markers."""
        return frozenset(k for k in chosen if moves_markers(self.causes[k]))

    def _model(self, chosen: Chosen) -> tuple[Outcome, Mapping[Group, BlockErrors]] | None:
        if chosen not in self._models:
            self._geometries.add(self.movers(chosen))
            causes = tuple(self.causes[k] for k in sorted(chosen))
            self._models[chosen] = self._extended(causes)
        return self._models[chosen]

    def _extended(self, causes: tuple[Cause, ...]) -> tuple[Outcome, Mapping[Group, BlockErrors]] | None:
        assert self._origin.diagnosis is not None
        origin = replace(self._origin, diagnosis=replace(self._origin.diagnosis, causes=causes))
        try:
            outcome = extend_outcome(self._base, origin, *self._stages)
        except DataError as failure:
            log.info("%s: %s", _called(causes), failure)
            return None
        return outcome, self._errors(outcome, causes)

    def _errors(self, outcome: Outcome, causes: tuple[Cause, ...]) -> Mapping[Group, BlockErrors]:
        return block_errors(outcome, self._base, corrected_config(self._base.config, causes), self._blocks)


def select(attempts: Attempts) -> CauseSelection:
    """Leave out causes until the model is no worse than the base model, nor than without any single one on forces.

    Where no more geometries are worth their time, causes on markers leave together. What is only possible leaves too
    unless the model is worse without it.

    Args:
        attempts: models to compare.
    """
    found = CauseSelection(frozenset(range(len(attempts.causes))), [], [])
    while kept := found.kept:
        whole = attempts.growth(kept)
        worse = any(one.worse for one in whole)
        grown = {some: attempts.growth(kept, kept - some) for some in _leavable(attempts, kept, worse)}
        harmful = {some: own for some, own in grown.items() if any(one.worse for one in own)}
        if harmful or worse:
            gone, leaving = max(harmful or grown, key=lambda some: _worst(grown[some])), found.refused
            numbers = worsening(whole, grown[gone], attempts.options)
        else:
            gone, leaving = _unproven(attempts, kept), found.unproven
            numbers = worsening(whole, attempts.growth(kept - gone, kept), attempts.options)
        if not gone:
            break
        leaving += [(attempts.causes[k], numbers) for k in sorted(gone)]
        log.info("%s left out: %s", _called(attempts.causes[k] for k in gone), numbers)
        found = replace(found, kept=kept - gone)
    return found


def _unproven(attempts: Attempts, kept: Chosen) -> Chosen:
    """The least confident cause that is only possible and without which nothing is worse; empty where none is.

    Those on markers leave or stay together: all of them ask for one geometry more.
    """
    possible = frozenset(k for k in kept if attempts.causes[k].level == "possible")
    movers = attempts.movers(possible)
    singles = sorted(possible - movers, key=lambda k: attempts.causes[k].confidence)
    for some in [*(frozenset({k}) for k in singles), *([movers] if movers else [])]:
        if not any(one.worse for one in attempts.growth(kept - some, kept)):
            return some
    return frozenset()


def _leavable(attempts: Attempts, kept: Chosen, worse: bool) -> list[Chosen]:
    """Single causes, those on markers from the least confident on; all on markers where not each can be left out.

    While the whole is no worse than the base model, those on markers, of which each asks for another geometry, stay.
    """
    if not worse:
        return [frozenset({k}) for k in sorted(kept - attempts.movers(kept))]
    order = sorted(kept, key=lambda k: attempts.causes[k].confidence)
    found = []
    for k in order:
        if attempts.affordable(kept - {k}):
            attempts.growth(kept - {k})
            found.append(frozenset({k}))
    return found if len(found) == len(kept) else [*found, attempts.movers(kept)]


def _worst(grown: Sequence[Growth]) -> float:
    return max((one.least_log for one in grown), default=-math.inf)


def worsening(whole: Sequence[Growth], own: Sequence[Growth], options: NeverWorseOptions) -> dict[str, float]:
    """Numbers of a refusal.

    Args:
        whole: growth of errors of the model with the cause, over the base model's.
        own: over those of the same model without it, or the other way round.
        options: their margin.
    """
    kinds = {kind: [one.part for one in own if one.kind == kind] for kind in ("force", "moment", "markers")}
    return {
        **{f"{kind}_growth_part": max(some, default=0.0) for kind, some in kinds.items()},
        "least_growth_part": math.expm1(_worst(own)), "base_growth_part": math.expm1(_worst(whole)),
        "most_part": options.margin_part,
    }  # fmt: skip


def without(found: Diagnosis, refused: Sequence[Refusal], unproven: Sequence[Refusal], rest: Adequacy) -> Diagnosis:
    """The verdict with causes refuted or not applied, each with a step of the trace.

    Args:
        found: with all of them.
        refused: those that leave the verdict, and their numbers.
        unproven: those that leave the model alone, and their numbers.
        rest: what remains without either.
    """
    causes = tuple(
        replace(own, applied=not any(own is gone for gone, _ in unproven))
        for own in found.causes
        if not any(own is gone for gone, _ in refused)
    )
    extended = any(own.applied for own in causes)
    refuted = (
        Refuted(gone.effect, gone.where, gone.gain["heldout_log_likelihood"], RULE, dict(numbers))
        for gone, numbers in refused
    )
    steps = [TraceStep(StepKind.REFUSE, gone.effect, gone.where, RULE, numbers) for gone, numbers in refused]
    steps += [TraceStep(StepKind.LEAVE, gone.effect, gone.where, UNPROVEN, numbers) for gone, numbers in unproven]
    return replace(
        found, causes=causes, refuted=(*found.refuted, *refuted), trace=(*found.trace, *steps), unexplained=rest,
        extended=found.extended if extended else found.baseline, aside=found.aside if causes else (),
    )  # fmt: skip


def _called(causes: Iterable[Cause]) -> str:
    return ", ".join(f"{cause.effect} [{', '.join(cause.where)}]" for cause in causes)
