"""The sequence: read, geometry, motion, inertia, inverse dynamics, files, report."""

import logging
from collections.abc import Callable, Sequence
from dataclasses import replace

import torch

from torchid.config import Config, dump_config
from torchid.errors import DataError, Note
from torchid.experiment.diagnosing import diagnose_outcome
from torchid.experiment.extending import (
    corrected_config,
    effect_wrenches,
    extend_session,
    follow_extended,
    moves_markers,
)
from torchid.experiment.read import read_session
from torchid.experiment.simulation import with_recordings
from torchid.experiment.stages import cutoff, follow, subject_prior, torques
from torchid.experiment.write import write_outcome
from torchid.files import file_sha256, write_json, write_text
from torchid.geometry.fit import fit_geometry
from torchid.geometry.fitted import GeometryFit
from torchid.geometry.tracking import Tracked, track
from torchid.inertia.identify import Identified, identify_inertia
from torchid.model.model import InertialPrior
from torchid.outcome import Followed, Outcome, Residual, Session
from torchid.provenance import provenance, stage_key
from torchid.regressor.rows import residual_rms
from torchid.report import write_report
from torchid.results import OutputFolder
from torchid.snapshot import release

log = logging.getLogger(__name__)
Progress = Callable[[str, float], None]
UNFILTERED_HZ = 20.0
"""What stands for no filter in the table of contributions: above it nothing of a person's motion is left."""

WORSE = 1.2
"""Times the held-out force error of the model without them that named causes may leave before the results warn."""

UNSEEN = 0.35
"""Share of the mass on bodies without markers above which inertia is not identified. Head, hands and abdomen together
are 0.24; trunk and arms held rigid on the pelvis, 0.5, left 42 N and 25 N m in a walk and cost the thorax 8 kg."""


def run_experiment(config: Config, progress: Progress = lambda stage, fraction: None) -> Outcome:
    """Everything the config asks for, into its ``out`` folder; a second call takes up finished stages.

    Raises:
        TorchidError: bad input (nothing more is written), or data that do not support a result (what there is, is).
    """
    if config.threads:
        torch.set_num_threads(config.threads)
    torch.manual_seed(config.seed)
    with OutputFolder(config.out) as folder:
        config = with_recordings(config, progress)
        write_text(folder.path("config.yaml"), dump_config(config))
        progress("read", 0.0)
        with folder.timed("read"):
            session = read_session(config, folder.aside)
        progress("read", 1.0)
        outcome, failure = _compute(config, session, folder, progress)
        outcome = replace(outcome, times=dict(folder.times))
        progress("write", 0.0)
        with folder.timed("write"):
            write_outcome(outcome, folder, failure)
            write_report(outcome, folder.path("report.html"), failure)
        write_json(folder.path("provenance.json"), provenance(_inputs(config), config.seed, folder.times))
        progress("write", 1.0)
        if failure is not None:
            raise failure
    return outcome


def _inputs(config: Config) -> list:
    files = [path for trial in config.trials for path in (trial.file, trial.forces) if path is not None]
    return files + [path for path in (config.model, config.markers) if not isinstance(path, str)]


def _compute(
    config: Config, session: Session, folder: OutputFolder, progress: Progress
) -> tuple[Outcome, DataError | None]:
    key = stage_key(
        inputs=[file_sha256(path) for path in _inputs(config)],
        config={k: v for k, v in config.model_dump(mode="json").items() if k not in ("out", "threads")},
    )
    fit, scaled = _geometry(config, session, folder, key, progress)
    cutoff_hz = cutoff(config, session)
    tracked = _track_all(session, folder, key, {"motion": fit, "scaled": scaled}, progress)
    with folder.timed("follow"):
        followed, followed_scaled = (
            {
                name: _aside(follow(g, trial, tracked[kind][name], cutoff_hz, config), folder)
                for name, trial in session.trials.items()
            }
            for kind, g in (("motion", fit), ("scaled", scaled))
        )
    outcome = Outcome(
        config, session, fit, scaled, cutoff_hz, followed, followed_scaled,
        subject_prior(config, fit), subject_prior(config, scaled), notes=(*session.notes, *fit.notes),
    )  # fmt: skip
    outcome = replace(outcome, notes=(*outcome.notes, *_contact_notes(followed)))
    if not config.inertia.enabled:
        return _with_torques(outcome, folder), None
    try:
        identified = folder.stage("inertia", key, lambda: _identify(config, outcome, progress))
    except DataError as failure:
        log.warning("%s", failure)
        return _with_torques(outcome, folder), failure
    outcome = replace(outcome, identified=identified, notes=(*outcome.notes, *identified.fit.notes))
    with folder.timed("residuals"):
        outcome = replace(outcome, residuals=contributions(outcome))
    if config.diagnosis.enabled:
        progress("diagnosis", 0.0)
        outcome = replace(outcome, diagnosis=folder.stage("diagnosis", key, lambda: diagnose_outcome(config, outcome)))
        progress("diagnosis", 1.0)
        if outcome.diagnosis is not None and outcome.diagnosis.causes:
            outcome = extend_outcome(outcome, folder, key, progress)
    return _with_torques(outcome, folder), None


def extend_outcome(base: Outcome, folder: OutputFolder, key: str, progress: Progress) -> Outcome:
    """Everything fitted again with the named causes taken out of the recordings.

    Args:
        base: with the verdict on it.
        folder: for stages.
        key: of all that these depend on.
        progress: called with stages and fractions.
    """
    assert base.diagnosis is not None
    causes, fit = base.diagnosis.causes, base.fit
    config, session = corrected_config(base.config, causes), base.session
    tracked = {name: item.tracked for name, item in base.followed.items()}
    if any(moves_markers(cause) for cause in causes):
        session = extend_session(base)
        fit = folder.stage("geometry_extended", key, lambda: _fit_geometry(config, session, True, progress))
        for name, trial in session.trials.items():
            tracked[name] = folder.stage(f"extended_{name}", key, lambda t=trial: track(fit, t.markers))
    with folder.timed("extend"):
        followed = follow_extended(config, base, session, fit, tracked)
        added = effect_wrenches(base)
    outcome = replace(
        base, config=config, fit=fit, followed=followed, prior=subject_prior(config, fit), base=base, added=added
    )
    identified = folder.stage("inertia_extended", key, lambda: _identify(config, outcome, progress))
    outcome = replace(outcome, identified=identified, config=base.config)
    more = _residuals(outcome, "+ named causes")
    notes = (*outcome.notes, *_worse_notes(base.residuals, more))
    return replace(outcome, residuals=(*base.residuals, *more), notes=notes)


def _worse_notes(base: Sequence[Residual], extended: Sequence[Residual]) -> list[Note]:
    """An extension that held-out motion does not bear out is said to be none."""
    before, after = ([row.force_rmse_N for row in rows if row.role == "heldout"] for rows in (base, extended))
    if not before or not after or not after[-1] > WORSE * before[-1]:
        return []
    said = f"with the named causes, held-out forces are off by {after[-1]:.1f} N, without them by {before[-1]:.1f} N"
    advice = "do not use the extended model: exclude causes (diagnosis.exclude) or set diagnosis.enabled: false"
    return [Note("diagnosis.worse", f"{said}; {advice}")]


def _residuals(outcome: Outcome, label: str) -> list[Residual]:
    rows = []
    for role in ("fit", "heldout"):
        own = [outcome.followed[name].wrench for name in outcome.session.part(role, "inertia")]
        trials = [wrench for wrench in own if wrench is not None]
        if trials:
            found = residual_rms(trials, outcome.phi)
            rows.append(Residual(label, role, outcome.cutoff_hz, "identified", "identified", *found))
    return rows


def _geometry(
    config: Config, session: Session, folder: OutputFolder, key: str, progress: Progress
) -> tuple[GeometryFit, GeometryFit]:
    def fit(free: bool) -> GeometryFit:
        return _fit_geometry(config, session, free, progress)

    found = folder.stage("geometry", key, lambda: fit(True)), folder.stage("scaled", key, lambda: fit(False))
    progress("geometry", 1.0)
    return found


def _fit_geometry(config: Config, session: Session, free: bool, progress: Progress) -> GeometryFit:
    options, static = config.geometry, session.static
    trials = {name: trial.markers for name, trial in session.fit("geometry").items()}
    if not trials:
        trials = {n: t.markers for n, t in session.trials.items() if t.role == "static"}
    assignment, markers = session.assignment, None if static is None else static.markers

    return fit_geometry(
        assignment.model, assignment.attachment, trials, markers, options, free,
        lambda step, cost: progress("geometry", min(0.95, step / options.iterations)),
    )  # fmt: skip


def _track_all(
    session: Session, folder: OutputFolder, key: str, fits: dict[str, GeometryFit], progress: Progress
) -> dict[str, dict[str, Tracked]]:
    found: dict[str, dict[str, Tracked]] = {kind: {} for kind in fits}
    done, total = 0, len(fits) * len(session.trials)
    for kind, fit in fits.items():
        for name, trial in session.trials.items():
            found[kind][name] = folder.stage(f"{kind}_{name}", key, lambda f=fit, t=trial: track(f, t.markers))
            done += 1
            progress("motion", done / total)
    return found


def _aside(followed: Followed, folder: OutputFolder) -> Followed:
    """The same, its motion and wrench in a file; the tracked coordinates are in their stage's."""
    return Followed(
        followed.name, followed.tracked, *folder.aside((followed.motion, followed.contact, followed.wrench))
    )


def _contact_notes(followed: dict[str, Followed]) -> list[Note]:
    notes = []
    for name, item in followed.items():
        if item.contact is not None and item.contact.excluded:
            frames = len(item.contact.used)
            said = f"{item.contact.excluded} of {frames} frames left out: a foot stands beside the plates"
            notes.append(Note("contact.beside", said, name))
    return notes


def _identify(config: Config, outcome: Outcome, progress: Progress) -> Identified:
    progress("inertia", 0.0)
    if config.inertia.refuse:
        _refuse_unseen(outcome)
    names = outcome.session.fit("inertia")
    trials = [outcome.followed[n].wrench for n in names]
    mass, box = None, None
    who = config.subject
    if config.inertia.known_mass and who.mass_kg:
        mass = (who.mass_kg, who.mass_sd_kg or 1e-3 * who.mass_kg)
    if config.inertia.com_boxes:
        box = _com_boxes(outcome.prior)
    found = identify_inertia([t for t in trials if t is not None], outcome.prior, config.inertia, mass, box)
    progress("inertia", 1.0)
    return found


def _refuse_unseen(outcome: Outcome) -> None:
    """A wrench cannot be explained by the motion of a body that nobody saw moving."""
    seen = {int(body) for body in outcome.fit.attachment.body}
    names, mass = outcome.fit.model.tree.names, outcome.prior.mean[:, 0]
    unseen = [k for k in range(len(names)) if k not in seen]
    share = float(mass[unseen].sum() / mass.sum())
    if share > UNSEEN:
        raise DataError(
            "inertia.unseen_bodies", f"no marker shows how {100.0 * share:.0f} % of the body's mass moves",
            found=f"no markers on {', '.join(names[k] for k in unseen)}",
            remedy="Record markers on trunk and arms, or set inertia.enabled: false (inertia.refuse: false goes on)",
        )  # fmt: skip


def _com_boxes(prior: InertialPrior) -> torch.Tensor:
    """Three prior standard deviations about the template's centres of mass."""
    m, centre = prior.mean[:, :1], prior.mean[:, 1:4] / prior.mean[:, :1]
    sd = torch.diagonal(prior.covariance).sqrt().reshape(-1, 10)
    reach = 3.0 * sd[:, 1:4] / m
    return torch.stack([centre - reach, centre + reach], dim=1)


def _with_torques(outcome: Outcome, folder: OutputFolder) -> Outcome:
    def each(followed: dict[str, Followed], fit: GeometryFit, phi: torch.Tensor) -> dict[str, torch.Tensor]:
        tree, trials = fit.model.tree, outcome.session.trials
        return {n: folder.aside(torques(f, tree, fit.geometry, phi, trials[n])) for n, f in followed.items()}

    with folder.timed("torques"):
        return replace(
            outcome,
            torque=each(outcome.followed, outcome.fit, outcome.phi),
            torque_scaled=each(outcome.followed_scaled, outcome.scaled, outcome.prior_scaled.mean),
        )


def contributions(outcome: Outcome) -> tuple[Residual, ...]:
    """Residuals of fit and held-out trials, step by step from the unfiltered template to the identified model."""
    config, session, rows = outcome.config, outcome.session, []
    steps = (
        ("scaled template, hardly filtered", UNFILTERED_HZ, "scaled", "prior"),
        ("+ filter", outcome.cutoff_hz, "scaled", "prior"),
        ("+ identified geometry", outcome.cutoff_hz, "identified", "prior"),
        ("+ identified inertia", outcome.cutoff_hz, "identified", "identified"),
    )
    for label, cutoff_hz, geometry, inertia in steps:
        fit, source, prior = (
            (outcome.scaled, outcome.followed_scaled, outcome.prior_scaled)
            if geometry == "scaled"
            else (outcome.fit, outcome.followed, outcome.prior)
        )
        phi = outcome.phi if inertia == "identified" else prior.mean
        for role in ("fit", "heldout"):
            names = session.part(role, "inertia")
            trials = []
            for name in names:
                item = source[name]
                if cutoff_hz != outcome.cutoff_hz:
                    item = follow(fit, session.trials[name], item.tracked, cutoff_hz, config)
                if item.wrench is not None:
                    trials.append(item.wrench)
            if trials:
                rows.append(Residual(label, role, cutoff_hz, geometry, inertia, *residual_rms(trials, phi)))
            release()
    return tuple(rows)
