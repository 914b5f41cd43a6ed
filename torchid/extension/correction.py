"""The model extended by what the diagnosis names: recordings corrected, everything fitted again."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.config import Config
from torchid.diagnosis.candidates.candidate import ColumnSource
from torchid.diagnosis.columns.marker_columns import response_of
from torchid.diagnosis.verdict.records import Cause
from torchid.dynamics.rows import residual_rms
from torchid.effects.catalogue import effect
from torchid.effects.columns import columns
from torchid.effects.effect import Planted
from torchid.effects.kinds import RecordEffect
from torchid.effects.marker_scene import Sight
from torchid.effects.place import inside_any
from torchid.effects.scene import PlateFrame, Scene, make_scene, reading
from torchid.effects.traits import Correction
from torchid.extension.diagnosing import Observer, forceful, spans
from torchid.extension.pieces import ends, pieces
from torchid.extension.swapped_markers import relabel, swap_causes
from torchid.geometry.result import GeometryFit
from torchid.geometry.tracking import Tracked, track
from torchid.motion import Motion
from torchid.observation.trial import TrialObservation
from torchid.recording import Forces, Trial
from torchid.session import Followed, Outcome, Residual, Session
from torchid.session.fitting import OnStage, fit_session, identify
from torchid.session.following import Following, put_aside
from torchid.session.people import subject_prior
from torchid.session.plates import session_plates
from torchid.session.standing import follow_each
from torchid.storage.provenance import stage_key
from torchid.storage.results import OutputFolder

MARK = 8
"""Digits of a stage's key that stand in its name."""


SESSION_WIDE = (Correction.MARKERS, Correction.LABELS, Correction.READING)
"""Corrections of what was recorded."""


def extend_outcome(base: Outcome, relabelled: Outcome, folder: OutputFolder, key: str, progress: OnStage) -> Outcome:
    """Everything fitted again with the named causes taken out of the recordings.

    Args:
        base: with the verdict on it.
        relabelled: with the names of swapped markers put right, on it what was found then; without any, ``base``.
        folder: for stages, which are stored by the causes that they depend on.
        key: of all else that these depend on.
        progress: called with stages and fractions.

    Raises:
        DataError: as ``identify``.
    """
    assert relabelled.diagnosis is not None
    causes = relabelled.diagnosis.causes
    moved = [cause for cause in causes if moves_markers(cause)]
    config, session, fit = corrected_config(base.config, causes), relabelled.session, relabelled.fit
    tracked = {name: item.tracked for name, item in relabelled.followed.items()}
    if any(correction(cause) in SESSION_WIDE for cause in causes):
        session = extend_session(relabelled, folder)
    if moved:
        fit, tracked = _followed_anew(relabelled, config, session, moved, folder, key, progress)
    with folder.timed("extend"):
        added = effect_wrenches(relabelled)
        followed = follow_extended(config, relabelled, session, fit, tracked, added, folder)
        added = _taken_off(base, followed)
    outcome = replace(
        base,
        config=config,
        fit=fit,
        followed=followed,
        prior=subject_prior(config.model, config.subject, fit),
        base=base,
        added=added,
        corrected={own: trial for own, trial in session.trials.items() if trial is not base.session.trials[own]},
    )
    name, key = _stage("inertia_extended", key, causes)
    identified = folder.stage(name, key, lambda: identify(config.inertia, config.subject, outcome, progress))
    outcome = replace(outcome, identified=identified, config=base.config)
    return replace(outcome, residuals=(*base.residuals, *_residuals(outcome, "+ named causes")))


def _taken_off(base: Outcome, followed: Mapping[str, Followed]) -> dict[str, Float[Tensor, "frames 6"]]:
    """What an extension took off the plates' total about the origin of W, by trial."""
    both = ((name, base.followed[name].wrench, one.wrench) for name, one in followed.items())
    return {name: old.wrench - new.wrench for name, old, new in both if old is not None and new is not None}


def _followed_anew(
    relabelled: Outcome, config: Config, session: Session, causes: Sequence[Cause], folder: OutputFolder, key: str,
    progress: OnStage,
) -> tuple[GeometryFit, dict[str, Tracked]]:  # fmt: skip
    """Geometry fitted to corrected markers, and all trials followed by it."""
    name, key = _stage("geometry_extended", key, causes)
    fit = folder.stage(name, key, lambda: fit_session(config.geometry, session, True, progress, relabelled.fit))
    # All others are followed from where the markers that were measured led.
    renamed = {own.trial for cause in swap_causes(causes) for own in cause.when or ()}
    tracked = {}
    for own, trial in session.trials.items():
        near = None if own in renamed else relabelled.followed[own].tracked.q
        name, key = _stage(f"extended_{own}", key, ())
        tracked[own] = folder.stage(name, key, lambda t=trial, near=near: track(fit, t.markers, near=near))
    return fit, tracked


def _stage(name: str, key: str, causes: Sequence[Cause]) -> tuple[str, str]:
    """Name and key of a stage that depends on some causes, so that those of other causes stand beside it."""
    own = stage_key(key=key, causes=list(causes)) if causes else key
    return f"{name}_{own[:MARK]}", own


def _residuals(outcome: Outcome, label: str) -> list[Residual]:
    rows = []
    for role in ("fit", "heldout"):
        own = [outcome.followed[name].wrench for name in outcome.session.part(role, "inertia")]
        trials = [wrench for wrench in own if wrench is not None]
        if trials:
            found = residual_rms(trials, outcome.phi)
            rows.append(Residual(label, role, outcome.cutoff_hz, "identified", "identified", *found))
    return rows


def extend_session(outcome: Outcome, folder: OutputFolder) -> Session:
    """The same recordings with effects on markers and readings taken out, in all trials in which they are known to act.

    Args:
        outcome: with the verdict on it.
        folder: holds what is as long as a recording.
    """
    assert outcome.diagnosis is not None
    causes, found = outcome.diagnosis.causes, spans(outcome)
    exchanged, others = swap_causes(causes), [c for c in causes if correction(c) is Correction.MARKERS]
    read, frames = [c for c in causes if correction(c) is Correction.READING], session_plates(outcome.session)[1]
    trials = {}
    for name, trial in outcome.session.trials.items():
        corrected = _cleared(outcome, relabel(trial, exchanged), others, found[name])
        if trial.forces is not None:
            corrected = _read_right(corrected, trial.forces, frames[name], read, found[name])
        trials[name] = trial if corrected is trial else folder.aside(corrected)
    return replace(outcome.session, trials=trials)


def _read_right(
    trial: Trial, forces: Forces, frames: tuple[PlateFrame, ...], causes: Sequence[Cause], span: slice
) -> Trial:
    """The trial with its plates' readings put right; what was not read stays so."""
    acting = [planted for cause in causes if (planted := cause.on(trial.name)) is not None]
    if not acting:
        return trial
    right = replace(reading(trial.name, forces, frames), begin=float(forces.time[span.start or 0]))
    for one in acting:
        right = one.effect.undone(right, one.place, one.theta)
    wrench = torch.where(torch.isfinite(forces.wrench), right.wrench.to(forces.wrench), torch.nan)
    return replace(trial, forces=replace(forces, wrench=wrench, zeroed=right.zeroed))


def moves_markers(cause: Cause) -> bool:
    """Whether correcting it changes what cameras saw."""
    return correction(cause) in (Correction.MARKERS, Correction.LABELS)


def correction(cause: Cause) -> Correction:
    """How the extended model takes a cause into account."""
    return effect(cause.effect).correction


def _cleared(outcome: Outcome, trial: Trial, causes: list[Cause], span: slice) -> Trial:
    acting = [planted for cause in causes if (planted := cause.on(trial.name)) is not None]
    if not acting:
        return trial
    position, known = trial.markers.position.clone(), outcome.fit.attachment.labels
    for piece in pieces(trial.markers.time):
        off = _displaced(outcome, trial.name, acting, piece.around, span)[..., piece.inner].permute(2, 0, 1)
        for k, label in enumerate(known):
            if label in trial.markers.labels:
                position[piece.own, trial.markers.labels.index(label)] -= off[:, k].to(position)
    return replace(trial, markers=replace(trial.markers, position=position))


def _displaced(
    outcome: Outcome, name: str, acting: list[Planted], part: slice, span: slice
) -> Float[Tensor, "markers 3 frames"]:
    """Where cameras see the fit's markers, from where bodies carry them, in part of a trial [m]."""
    fit, motion = outcome.fit, outcome.followed[name].motion

    def scene_of(some: Motion) -> Scene:
        return make_scene(name, fit.model.tree, fit.geometry, some, outcome.prior.mean)

    known = ends(motion, span, part)
    scene = replace(scene_of(motion.frames(part)), ends=None if known is None else scene_of(known))
    body = torch.tensor(scene.state.plan.position)[fit.attachment.body]
    sight = Sight(scene, fit.attachment.labels, body, fit.place)
    return torch.stack([one.seen(one.effect.beneath(sight, one.place, one.theta)) for one in acting]).sum(0)


def corrected_config(config: Config, causes: tuple[Cause, ...]) -> Config:
    """With what was found of the person where the record is named wrong."""
    for cause in causes:
        own = effect(cause.effect)
        if isinstance(own, RecordEffect):
            subject = config.subject.model_copy(update=dict(own.entries(cause)))
            return config.model_copy(update={"subject": subject})
    return config


def follow_extended(
    config: Config, base: Outcome, session: Session, fit: GeometryFit, tracked: dict[str, Tracked],
    added: dict[str, Float[Tensor, "frames 6"]], folder: OutputFolder,
) -> dict[str, Followed]:  # fmt: skip
    """All trials followed by the extended model; wrenches are those that it has to explain by motion alone.

    Frames that did not count before do not count now: a corrected reading is none of a foot beside the plates.

    Args:
        config: corrected by what was found.
        base: with the verdict.
        session: corrected by it.
        fit: to the corrected markers.
        tracked: by that.
        added: what the named effects add to the plates' total, see ``effect_wrenches``.
        folder: holds what is as long as a recording.
    """
    assert base.diagnosis is not None
    found = {}
    prior, way = subject_prior(config.model, config.subject, fit), Following.of(config, base.cutoff_hz)
    for one in follow_each(fit, session, tracked.__getitem__, way, prior):
        before = base.followed[one.name].wrench
        if one.wrench is not None and one.contact is not None and before is not None:
            used = one.wrench.used & before.used
            contact = replace(one.contact, used=used)
            used = used & ~inside_any(base.diagnosis.aside, one.name, one.wrench.motion.time)
            wrench = one.wrench.wrench - added[one.name] if one.name in added else one.wrench.wrench
            one = replace(one, contact=contact, wrench=replace(one.wrench, wrench=wrench, used=used))
        found[one.name] = put_aside(one, folder)
    return found


def effect_wrenches(base: Outcome) -> dict[str, Float[Tensor, "frames 6"]]:
    """What the named effects add to the plates' total about the origin of W, by trial; those on markers have none."""
    assert base.diagnosis is not None
    causes = [c for c in base.diagnosis.causes if correction(c) is Correction.WRENCH]
    observer, known, found = Observer(base), spans(base), {}
    for name, rows in (forceful(base, "fit") | forceful(base, "heldout")).items():
        acting = [one for c in causes if (one := c.on(name)) is not None]
        if acting:
            found[name] = torch.empty_like(rows.wrench)
            for piece in pieces(rows.motion.time):
                observed = observer(name, piece.around, ends(rows.motion, known[name], piece.around))
                added = torch.stack([_added(observed, one) for one in acting]).sum(0)
                found[name][piece.own] = added[piece.inner]
    return found


def _added(observed: TrialObservation, one: Planted) -> Float[Tensor, "frames 6"]:
    if one.effect.moves_markers:
        assert observed.response is not None
        source = ColumnSource(one.effect, one.place, slice(0, 0), (), one.effect.scale(one.place))
        added = (one.theta @ observed.response.wrench([response_of(observed.response, source)])).T
        return one.effect.trusted(added, observed.rows.rate, one.place, one.theta)
    view = observed.view
    if one.effect.reads_measured:
        back = one.effect.undone(view.measured, one.place, one.theta)
        return (view.measured.total - back.total).T
    where = one.theta if one.effect.nonlinear else None
    return (one.theta @ columns(one.effect, view.scene, view.reading, one.place, where)).T
