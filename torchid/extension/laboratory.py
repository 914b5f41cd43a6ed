"""The laboratory first: faults that witnesses name are put right before a body model is asked for the rest."""

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool
from torch import Tensor

from torchid.diagnosis.diagnose import select_effects
from torchid.diagnosis.evidence.adequacy import Adequacy
from torchid.diagnosis.testing.heldout import Errors, HeldOutFit
from torchid.diagnosis.trace import Trace
from torchid.diagnosis.verdict.causes import after_forces
from torchid.diagnosis.verdict.laboratory import DISAGREE, NAMED, OUTDONE, causes_of_faults, refusals_of, steps_of
from torchid.diagnosis.verdict.one_fault import joined
from torchid.diagnosis.verdict.records import Cause, Diagnosis, Refuted
from torchid.dynamics.rows import residual_rms
from torchid.effects.scene import PlateFrame, make_scene, reading
from torchid.effects.traits import Correction
from torchid.errors import DataError
from torchid.extension.correction import (
    corrected_config,
    correction,
    effect_wrenches,
    extend_session,
    follow_extended,
)
from torchid.extension.diagnosing import MOST, diagnose_outcome, plate_frames, spans
from torchid.model_free.faults import left_by, name_faults, outdone, suspects_of, without
from torchid.model_free.panel import Panel, make_panel
from torchid.model_free.watched import Watched, watch
from torchid.session import Outcome
from torchid.session.fitting import OnStage, identify
from torchid.session.following import soles, subject_prior
from torchid.storage.results import OutputFolder

log = logging.getLogger(__name__)
UNRECORDED = 1.0
"""Resolution. Relative standard deviation of a mass that nobody has recorded: the template's says nothing."""


@dataclass(frozen=True)
class Laboratory:
    """What witnesses found wrong with the measurement."""

    causes: tuple[Cause, ...] = ()
    trace: Trace = ()


def diagnosed(
    outcome: Outcome, folder: OutputFolder, progress: OnStage, refuted: Sequence[Refuted] = ()
) -> Diagnosis | None:
    """The verdict on an outcome: faults of the laboratory by witnesses, and what the body model finds beside them.

    Args:
        outcome: up to the inertia.
        folder: holds what is as long as a recording.
        progress: called with stages and fractions.
        refuted: faults that witnesses named and that did not stand; recordings are not put right by them again.

    Returns:
        The verdict; None without any forces.

    Raises:
        ConfigError: ``diagnosis.include`` or ``exclude`` names no effect.
    """
    panel = panel_of(outcome)
    first = Laboratory()
    if not first.causes:
        found = diagnose_outcome(outcome, folder.room, panel)
        return None if found is None else replace(found, trace=(*first.trace, *found.trace))
    try:
        right = read_right(outcome, first.causes, folder, progress)
    except DataError as failure:
        # No inertia fits what is put right: all else is looked for as recorded, and no model is extended by the faults.
        log.info("%s", failure)
        right = outcome
    found = diagnose_outcome(right, folder.room, panel_of(right, () if right is outcome else first.causes))
    return None if found is None else _together(outcome, right, first, found)


def examine(outcome: Outcome, panel: Panel | None, refuted: Sequence[Refuted] = ()) -> Laboratory:
    """What witnesses find wrong with the measurement.

    Args:
        outcome: up to the inertia.
        panel: what they state.
        refuted: what is not named again; the others have to describe what witnesses state without it.
    """
    wanted = outcome.config.diagnosis
    if panel is None:
        return Laboratory()
    effects = select_effects(wanted.include, wanted.exclude)
    if outcome.config.model != "whole_body" or outcome.config.subject.mass_kg is None:
        effects = tuple(one for one in effects if not one.on_record)  # a model's file has its masses from elsewhere
    faults = name_faults(panel, suspects_of(panel, effects))
    faults = without(panel, faults, {(one.effect, one.where) for one in refuted})
    chance, least = left_by(panel, faults), wanted.thresholds.witnesses.p_value
    if chance < least:
        return Laboratory((), refusals_of(faults, DISAGREE, {"p_value": chance, "least_p_value": least}))
    if faults and (better := outdone(panel, faults, effects)) > 0.0:
        return Laboratory((), refusals_of(faults, OUTDONE, {"rival_nats": better}))
    trials = [name for role in ("fit", "heldout") for name in outcome.session.part(role, "inertia")]
    causes = causes_of_faults(panel, faults, trials, wanted.thresholds)
    return Laboratory(causes, steps_of(faults, wanted.thresholds))


def panel_of(outcome: Outcome, taken_off: Sequence[Cause] = ()) -> Panel | None:
    """The statements of witnesses on static and fit trials; None where there are none.

    Args:
        outcome: up to the inertia.
        taken_off: causes that it is put right for; what is no correction of readings is taken off the trials here.
    """
    recorded, limits = float(outcome.prior.mean[:, 0].sum()), outcome.config.diagnosis.thresholds
    trials = [name for role in ("static", "fit") for name in outcome.session.part(role, "inertia")][:MOST]
    frames, parts = plate_frames(outcome)[1], spans(outcome)
    seen = [_watched(outcome, name, frames[name], recorded, parts[name]) for name in trials if name in frames]
    loads = [cause for cause in taken_off if correction(cause) is Correction.WRENCH]
    right = [_without(one, loads) for one in seen if one is not None]
    who = outcome.config.subject
    part = UNRECORDED if who.mass_kg is None else (who.mass_sd_kg or 0.0) / recorded
    return make_panel(right, part, limits.witnesses, limits.observation)


def _without(watched: Watched, causes: Sequence[Cause]) -> Watched:
    """A trial without the loads of causes."""
    for cause in causes:
        if (planted := cause.on(watched.name)) is not None:
            watched = watched.without(planted.effect, planted.place, planted.theta)
    return watched


def _watched(
    outcome: Outcome, name: str, frames: tuple[PlateFrame, ...], recorded_kg: float, part: slice
) -> Watched | None:
    """Part of a trial as witnesses see it; None where no contact is known."""
    item, trial = outcome.followed[name], outcome.session.trials[name]
    if item.contact is None or trial.forces is None:
        return None
    measured = _known(outcome, name)
    scene = make_scene(
        name, outcome.fit.model.tree, outcome.fit.geometry, item.motion.frames(part), outcome.prior.mean
    )  # fmt: skip
    return watch(
        replace(scene, recorded_kg=recorded_kg), reading(name, trial.forces.samples(part), frames), measured[part],
        soles(outcome.fit, item.tracked.frames(part)), item.contact.frames(part),
    )  # fmt: skip


def _known(outcome: Outcome, name: str) -> Bool[Tensor, " frames"]:
    """Frames whose whole wrench is on plates and whose motion is known."""
    item, forces = outcome.followed[name], outcome.session.trials[name].forces
    assert item.contact is not None and forces is not None
    return item.contact.measured & torch.isfinite(item.tracked.error).any(1) & torch.isfinite(forces.total).all(1)


def read_right(outcome: Outcome, causes: Sequence[Cause], folder: OutputFolder, progress: OnStage) -> Outcome:
    """The outcome up to the inertia, from recordings without the faults; geometry and motion stay.

    Args:
        outcome: up to the inertia.
        causes: faults of readings, of the vertical or of the record.
        folder: holds what is as long as a recording.
        progress: called with stages and fractions.

    Raises:
        DataError: as ``identify``.
    """
    config, named = corrected_config(outcome.config, tuple(causes)), replace(outcome, diagnosis=verdict_of(causes))
    session, tracked = extend_session(named, folder), {n: item.tracked for n, item in outcome.followed.items()}
    followed = follow_extended(config, named, session, outcome.fit, tracked, effect_wrenches(named), folder)
    prior = subject_prior(config.model, config.subject, outcome.fit)
    found = replace(outcome, config=config, session=session, followed=followed, prior=prior)
    return replace(found, identified=identify(config.inertia, config.subject, found, progress))


def unfounded(found: Diagnosis) -> tuple[Refuted, ...]:
    """Return the faults that witnesses named and that the extended model refuted.

    Recordings had been put right by them before all else was looked for, so that what was found then is void.

    Args:
        found: the verdict on the model that is published.
    """
    named = {(step.effect, step.where) for step in found.trace if step.rule == NAMED}
    return tuple(one for one in found.refuted if (one.effect, one.where) in named)


UNASKED = Adequacy(False, torch.nan, torch.nan, "")
"""Of what remains where nobody has looked."""


def verdict_of(causes: Sequence[Cause]) -> Diagnosis:
    """A verdict of these causes and nothing else.

    Args:
        causes: the causes.
    """
    nothing = Errors(torch.nan, torch.nan)
    return Diagnosis((), nothing, nothing, tuple(causes), UNASKED)


def _together(outcome: Outcome, right: Outcome, first: Laboratory, found: Diagnosis) -> Diagnosis:
    """Both verdicts, and what the faults gain on held-out motion together."""
    before, after = _heldout(outcome), _heldout(right)
    gain = HeldOutFit(after, torch.nan).over(HeldOutFit(before, torch.nan))
    # Where nothing could be put right, what is found again is the fault itself, and not what is left of it.
    own, rest, steps = joined(first.causes, found.causes, put_right=right is not outcome)
    causes = tuple(sorted((*(replace(cause, gain=gain) for cause in own), *rest), key=after_forces))
    return replace(found, baseline=before, causes=causes, trace=(*first.trace, *found.trace, *steps))


def _heldout(outcome: Outcome) -> Errors:
    """Held-out residual of the identified model."""
    own = [outcome.followed[name].wrench for name in outcome.session.part("heldout", "inertia")]
    trials = [wrench for wrench in own if wrench is not None]
    return Errors(*residual_rms(trials, outcome.phi)) if trials else Errors(torch.nan, torch.nan)
