"""What is wrong with the recordings, each fault once: how sure it is, whether it is corrected, what to do about it."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import torch

from torchid.checks.finding import InstrumentFault
from torchid.checks.marker_tracks.statement import FAULTS as TRACK_FAULTS
from torchid.checks.marker_tracks.statement import TrackFault, TrackStatement
from torchid.diagnosis.verdict.instruments import instrument_findings
from torchid.diagnosis.verdict.records import Cause, Diagnosis
from torchid.effects.catalogue import effect
from torchid.effects.instrument_faults import FAULTS
from torchid.effects.place import SESSION, inside_any
from torchid.effects.recommendations import tell_apart
from torchid.effects.traits import Correction, Site
from torchid.report.cause_sentences import called, likely, told
from torchid.session import Outcome
from torchid.wording import clean, listing, merge, pattern

WHOLE = 400
"""Choice. Letters of a sentence that are shown."""
MASSES = "corrected in masses, not in joint moments"
DONE = {
    Correction.WRENCH: MASSES,
    Correction.READING: "corrected here",
    Correction.MARKERS: "corrected here",
    Correction.LABELS: "names put right here",
    Correction.RECORD: "corrected here",
}
"""What the results have of a correction: a load is not taken out of the moments of the joints that bear it."""
NOT_DONE = "not corrected here, as the model would predict worse"
LEFT_OUT = "left out here"
COUNTS = ("two", "three", "four")
WRONG, HANDLED = "What the model gets wrong", "Data handling"
"""Sections that say more."""


@dataclass(frozen=True)
class Fault:
    """One thing that is wrong with the recordings."""

    line: str
    """What it is, how sure that is, and whether it is corrected."""
    step: str
    """What to do about it, as a sentence without its end; empty where nothing is left to be done."""
    apart: str
    """What to record to tell it from its twins, likewise."""
    section: str
    """Where the report says more."""
    bodily: bool
    """Whether it is the body's, or its model's, and no fault of an instrument or a label."""
    settled: bool
    """Whether the run has corrected it or left it out, and nothing is left to be done."""


def recording_faults(outcome: Outcome) -> tuple[Fault, ...]:
    """Return what the diagnosis and the tracks of markers say is wrong, each fault once.

    Those that ask for something come first, then those of instruments, the surest first, then those of the body.

    Args:
        outcome: the run.
    """
    found = outcome.diagnosis
    causes = () if found is None else found.likely
    own = sorted((cause for cause in causes if cause.effect in FAULTS), key=lambda cause: -cause.confidence)
    alone = [one for one in outcome.session.tracking if not any(_same(one, cause) for cause in own)]
    others = [cause for cause in causes if cause.effect not in FAULTS]
    named = (
        [_of_cause(cause, outcome) for cause in own],
        [_of_track(some) for some in _alike(alone)],
        [_of_cause(cause, outcome) for cause in others],
    )
    return tuple(sorted((one for some in named for one in some), key=lambda one: not one.step))


def _same(one: TrackStatement, cause: Cause) -> bool:
    """Whether a track and a cause tell of one fault: of the same markers, in the same trial, at the same time."""
    if TRACK_FAULTS[one.kind] is not FAULTS[cause.effect] or set(one.labels) != set(cause.where):
        return False
    if cause.when is None:
        return one.trial in cause.trials
    spans = [i for i in cause.when if i.trial == one.trial]
    return any(not one.when or any(t0 <= i.t1 and i.t0 <= t1 for t0, t1 in one.when) for i in spans)


def _of_cause(cause: Cause, outcome: Outcome) -> Fault:
    """A cause that is likely."""
    assert outcome.diagnosis is not None
    twins = [called(cause), *map(called, cause.indistinguishable)]
    apart, record = "", ""
    if len(twins) > 1:
        count = COUNTS[len(twins) - 2] if len(twins) < 2 + len(COUNTS) else str(len(twins))
        apart = f"; its cause is one of {count}, which the recordings do not tell apart: {' or '.join(twins)}"
        advice = tell_apart(cause.effect, cause.indistinguishable[0].effect)
        record = f"To tell {twins[0]} from {twins[1]}, record {advice}"
    sure, unused = likely(cause), _unused(cause, outcome)
    done = LEFT_OUT if unused else DONE[effect(cause.effect).correction] if cause.applied else NOT_DONE
    line = f"{told(cause)} {sure[0].upper()}{sure[1:]}{apart}; {done}."
    step = _step(cause, outcome.diagnosis, unused)
    settled = not (step or record) and (cause.applied or unused)
    return Fault(line, step, record, WRONG, cause.effect not in FAULTS, settled)


def _unused(cause: Cause, outcome: Outcome) -> bool:
    """Whether labels are exchanged of which no sample is used while that lasts."""
    if effect(cause.effect).correction is not Correction.LABELS or not cause.when:
        return False
    columns = [k for k, label in enumerate(outcome.fit.attachment.labels) if label in cause.where]
    for name in {one.trial for one in cause.when if one.trial in outcome.followed}:
        tracked = outcome.followed[name].tracked
        inside = inside_any(cause.when, name, tracked.time)
        if not columns or bool(torch.isfinite(tracked.error[inside][:, columns]).any()):
            return False
    return True


def _step(cause: Cause, found: Diagnosis, unused: bool) -> str:
    """What to do about a cause: of instruments alone, and only where results are not yet without it."""
    own = effect(cause.effect)
    if cause.effect not in FAULTS:
        return ""
    if cause.applied and not unused and own.correction is not Correction.WRENCH:
        return _beyond_this_run(cause, found)
    if own.correction is Correction.LABELS:
        return _rename(cause.where, cause.trials)
    if FAULTS[cause.effect] is InstrumentFault.MOVED:
        return _look_at(cause.where, cause.trials)
    why = f"Joint moments still have {called(cause)}: to mend it" if cause.applied else f"To be sure of {called(cause)}"
    return f"{why}, record {own.advice}"


def _beyond_this_run(cause: Cause, found: Diagnosis) -> str:
    """What rids `evaluate` and `live` of a wrong reading that was corrected here; empty of all else."""
    if effect(cause.effect).correction is not Correction.READING:
        return ""
    (finding,) = instrument_findings(replace(found, causes=(cause,)))
    if not finding.cures:
        return f"`evaluate` and `live` still have {called(cause)}: to mend it, record {effect(cause.effect).advice}"
    single = effect(cause.effect).site is Site.TRIAL and cause.where != SESSION.where
    where = listing(list(cause.where)) if single else "the trials"
    line = finding.cures[0].config
    return f"Add `{line}` to {where} of the config, so that `evaluate` and `live` are without it, too"


def _rename(labels: Sequence[str], trials: Sequence[str]) -> str:
    return f"Give {listing(labels)} their own names in {listing(trials)}, and run again"


def _look_at(labels: Sequence[str], trials: Sequence[str]) -> str:
    where = listing(trials)
    who = listing(labels) if len(labels) == 1 else f"one of {listing(labels)}"
    return f"See whether {who} was knocked or stuck on anew for {where}; if so, take it out of {where} and run again"


def _alike(some: Sequence[TrackStatement]) -> Iterator[list[TrackStatement]]:
    """Statements that differ in trials and numbers alone."""
    groups: dict[tuple[TrackFault, str], list[TrackStatement]] = {}
    for one in some:
        groups.setdefault((one.kind, pattern(one.sentence)), []).append(one)
    yield from groups.values()


def _of_track(some: Sequence[TrackStatement]) -> Fault:
    """What tracks of markers tell that no cause does."""
    first, trials = some[0], [one.trial for one in some]
    moved = first.kind is TrackFault.MOVED
    step = _look_at(first.labels, trials) if moved else ""
    step = _rename(first.labels, trials) if first.kind is TrackFault.EXCHANGED else step
    said = clean(merge([one.sentence for one in some]), WHOLE)
    return Fault(
        f"{listing(trials)}: {said}; {'used as it is' if moved else LEFT_OUT}.", step, "", HANDLED, False, not step
    )
