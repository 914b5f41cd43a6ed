"""The sequence: read, geometry, motion, inertia, inverse dynamics, files, report."""

import logging
import math
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from importlib.util import find_spec
from itertools import chain
from pathlib import Path

import torch

from torchid.config import Config, dump_config
from torchid.dynamics.rows import residual_rms
from torchid.errors import ConfigError, DataError, Note
from torchid.extension.open_geometry import right_subject, with_open_geometry
from torchid.extension.people_or_tables import people_or_tables
from torchid.extension.verdict import with_verdict
from torchid.geometry.result import GeometryFit
from torchid.geometry.tracking import Tracked, track
from torchid.io.files import files_on_disk
from torchid.motion.impossible_rates import frames_of, impossible_steps
from torchid.recording import Trial
from torchid.report import write_report
from torchid.run.acceptance import impossible
from torchid.run.consistent import with_consistent
from torchid.run.simulation import with_recordings
from torchid.run.torque_bands import outcome_draws
from torchid.run.write import result_names, write_outcome
from torchid.scene.embedded import EmbeddedPage
from torchid.session import Followed, Outcome, Residual, Session
from torchid.session.contact_wrenches import sharing_notes, wrenches_under
from torchid.session.fitting import OnStage, fit_session, identify
from torchid.session.following import Following, cutoff, follow, torques
from torchid.session.judging import judges, quality_of
from torchid.session.laboratory import earlier_sessions
from torchid.session.opening import open_session, read_each, setup_of
from torchid.session.other_contacts import refuse_unknown_plates
from torchid.session.people import people_of, subject_prior
from torchid.session.person import people_note, person_evidence, unlike_note
from torchid.session.standing import follow_session
from torchid.storage.files import file_sha256, write_json, write_text
from torchid.storage.provenance import provenance, stage_key
from torchid.storage.publication import CONFIGS
from torchid.storage.results import OutputFolder
from torchid.storage.snapshot import release
from torchid.storage.table_forms import refuse_missing

log = logging.getLogger(__name__)
UNFILTERED_HZ = 20.0
"""What stands for no filter in the table of contributions: above it nothing of a person's motion is left."""


def run_experiment(config: Config, progress: OnStage = lambda stage, fraction: None) -> Outcome:
    """Everything the config asks for, into its ``out`` folder; a second call takes up finished stages.

    Trials that were recorded with a device on are left to ``torchid evaluate``.

    Raises:
        TorchidError: bad input (what is in ``out`` stays), or data that do not support a result (what there is, is).
    """
    refuse_missing(config.tables)
    torch.set_num_threads(config.threads)
    torch.manual_seed(config.seed)
    listed, config = config.trials, config.body
    with OutputFolder(config.out) as folder:
        _claim(folder, config)
        config = with_recordings(config, progress)
        _claim(folder, config)
        write_text(folder.path(next(filter(folder.owns, CONFIGS))), dump_config(config))
        progress("read", 0.0)
        with folder.timed("read"):
            setup = setup_of(config)
            session = open_session(setup, config.trials, folder.aside)
            known = {trial.name for trial in config.trials}
            others = read_each(setup, [file for file in listed if file.name not in known])
            refuse_unknown_plates(config.contact, chain(session.trials.values(), others))
            earlier_sessions(config.laboratory, session)  # refused before hours of work
            people_of(config.model, config.subject)
        progress("read", 1.0)
        outcome, failure = compute_outcome(config, session, folder, progress)
        failure = failure or impossible(outcome)
        outcome = replace(outcome, quality=quality_of(outcome, failure), times=dict(folder.times))
        progress("write", 0.0)
        with folder.timed("write"):
            write_outcome(outcome, folder, failure)
            write_report(outcome, folder.path("report.html"), failure, _replay(outcome, folder))
        write_json(folder.path("provenance.json"), provenance(inputs(config), config.seed, folder.times))
        progress("write", 1.0)
        if failure is not None:
            raise failure
    return outcome


def _replay(outcome: Outcome, folder: OutputFolder) -> EmbeddedPage | None:
    """A trial in three dimensions for the report; None without viser, an optional part, and without a body."""
    if outcome.identified is None or find_spec("viser") is None:
        return None
    from torchid.scene.finished import FinishedRun  # noqa: PLC0415 - brings viser
    from torchid.scene.replay import replay  # noqa: PLC0415 - brings viser

    try:
        return replay(FinishedRun(folder.path("inertia.json").parent), judges(outcome).names[0])
    except Exception as error:  # what is only to be looked at costs nobody hours of work
        log.warning("the report has no replay: %s: %s", type(error).__name__, error)
        return None


GEOMETRY = "geometry"
"""Stage of the identified geometry."""


UNKEYED = {"out": True, "threads": True, "tables": True, "bids": True, "torques": True, "motion": {"consistent"}}
"""Keys of a config on which no stored stage depends, as pydantic leaves them out."""


def _claim(folder: OutputFolder, config: Config) -> None:
    """No work for results that have no place: InputError where a file of the user's has the name of one, ConfigError
    where two trials have the same."""
    trials, subject = [trial.name for trial in config.trials], config.subject.name if config.bids else None
    names = result_names(trials, config.tables, subject, config.motion.consistent)
    if twice := [name for name, times in Counter(names).items() if times > 1]:
        raise ConfigError(
            "config.names", "two trials would write one file", source="config", found=twice[0],
            remedy="Name the trials otherwise: one is called as a result of the other is",
        )  # fmt: skip
    folder.claim(names)
    if not folder.owns(CONFIGS[0]):
        folder.claim(CONFIGS[1:])


def inputs(config: Config) -> list[Path]:
    """Return every file on which a run of a config depends, itself apart."""
    files = [path for trial in config.trials for path in (trial.file, trial.forces) if path is not None]
    return list(dict.fromkeys(chain.from_iterable(map(files_on_disk, files)))) + [
        path
        for path in (config.model, config.markers, config.laboratory, config.subject.people)
        if isinstance(path, Path)
    ]


def run_key(config: Config) -> str:
    """Key of a run's stages: files and options."""
    own = config.model_dump(mode="json", exclude=UNKEYED)
    return stage_key(inputs=[file_sha256(path) for path in inputs(config)], config=own)


def compute_outcome(
    config: Config, session: Session, folder: OutputFolder, progress: OnStage
) -> tuple[Outcome, DataError | None]:
    """Compute what a run finds from what was read, without its files and reports.

    Returns:
        What was found, and what kept the rest from being found; None where nothing did.
    """
    key = run_key(config)
    fit, scaled = _geometry(config, session, folder, key, progress)
    cutoff_hz = cutoff(config.motion, session)
    tracked = _track_all(session, folder, key, {"motion": fit, "scaled": scaled}, progress)
    prior, prior_scaled = (subject_prior(config.model, config.subject, one) for one in (fit, scaled))
    with folder.timed("follow"):
        followed, followed_scaled = (
            follow_session(one, session, tracked[kind].__getitem__, Following.of(config, cutoff_hz), own, folder)
            for kind, one, own in (("motion", fit, prior), ("scaled", scaled, prior_scaled))
        )
    outcome = Outcome(
        config, session, fit, scaled, cutoff_hz, followed, followed_scaled, prior, prior_scaled,
        notes=(*session.notes, *fit.notes, *people_note(config)),
    )  # fmt: skip
    outcome = replace(outcome, notes=(*outcome.notes, *_contact_notes(followed), *_rate_notes(fit, followed)))
    if not config.inertia.enabled:
        return _with_forces(outcome, folder), None
    try:
        identified = folder.stage("inertia", key, lambda: identify(config.inertia, config.subject, outcome, progress))
    except DataError as failure:
        log.info("%s", failure)
        return _with_forces(outcome, folder), failure
    outcome = people_or_tables(replace(outcome, identified=identified), folder, key, progress)
    assert outcome.identified is not None
    outcome = replace(outcome, notes=(*outcome.notes, *outcome.identified.fit.notes))
    with folder.timed("residuals"):
        outcome = replace(outcome, residuals=contributions(outcome))
    if config.diagnosis.enabled:
        outcome = with_verdict(outcome, folder, key, progress)
    with folder.timed("deviations"):
        outcome = with_open_geometry(outcome, folder.room)
        told = unlike_note(outcome, person_evidence(outcome, right_subject(outcome)))
        outcome = replace(outcome, notes=(*outcome.notes, *told))
    return _with_forces(outcome, folder), None


def _with_forces(outcome: Outcome, folder: OutputFolder) -> Outcome:
    """Return the outcome with torques, and with the motion that obeys its forces where the config asks for it."""
    outcome = with_torques(outcome, folder)
    return with_consistent(outcome, folder) if outcome.config.motion.consistent else outcome


def _geometry(
    config: Config, session: Session, folder: OutputFolder, key: str, progress: OnStage
) -> tuple[GeometryFit, GeometryFit]:
    def fit(free: bool) -> GeometryFit:
        return fit_session(config.geometry, session, free, progress)

    found = folder.stage(GEOMETRY, key, lambda: fit(True)), folder.stage("scaled", key, lambda: fit(False))
    progress("geometry", 1.0)
    return found


def _track_all(
    session: Session, folder: OutputFolder, key: str, fits: dict[str, GeometryFit], progress: OnStage
) -> dict[str, dict[str, Tracked]]:
    found: dict[str, dict[str, Tracked]] = {kind: {} for kind in fits}
    done, total = 0, len(fits) * len(session.trials)
    for kind, fit in fits.items():
        for name, trial in session.trials.items():
            # The template follows from where the identified body stands, which takes a fraction of the time.
            near = found["motion"][name].q if name in found["motion"] and kind != "motion" else None
            found[kind][name] = folder.stage(
                f"{kind}_{name}", key, lambda f=fit, t=trial, near=near: track(f, t.markers, near=near)
            )
            done += 1
            progress("motion", done / total)
    return found


def _contact_notes(followed: dict[str, Followed]) -> list[Note]:
    notes = []
    for name, item in followed.items():
        if item.contact is not None and item.contact.excluded:
            frames = len(item.contact.used)
            said = f"{item.contact.excluded} of {frames} frames left out: a foot stands beside the plates"
            notes.append(Note("contact.beside", said, name))
        if item.contact is not None and item.contact.others is not None and bool(item.contact.unmeasured.any()):
            named, frames = item.contact.others.beside_plates, int(item.contact.unmeasured.sum())
            said = f"{frames} frames left out: no plate measures {', '.join(named)}"
            notes.append(Note("contact.unmeasured", said, name))
        if item.contact is not None and item.contact.short:
            said = f"{item.contact.short} frames left out: the plates miss a part of the weight that standing has told"
            notes.append(Note("contact.short", said, name))
    return notes


def _rate_notes(fit: GeometryFit, followed: dict[str, Followed]) -> list[Note]:
    notes = []
    for name, item in followed.items():
        time, rate = item.tracked.time, item.motion.smoother.rate_hz
        steps = impossible_steps(fit.model.tree, item.tracked.q, rate) if len(time) > 1 else []
        if steps:
            worst = max(steps, key=lambda one: one.rate_rad_s / one.limit_rad_s)
            left = int(frames_of(steps, len(time), rate).sum())
            said = (
                f"{left} of {len(time)} frames left out: joints turn faster than any body ({worst.body} by "
                f"{worst.rate_rad_s:.0f} rad/s at {float(time[worst.frame]):.2f} s, limit {worst.limit_rad_s:.0f}); "
                "look at the markers there"
            )
            notes.append(Note("tracking.rates", said, name))
    return notes


def with_torques(outcome: Outcome, folder: OutputFolder) -> Outcome:
    """Return the outcome with wrenches under the feet and joint torques, of forces that are put right.

    Those of the scaled template are of forces as they were read.

    Args:
        outcome: up to the inertia and the verdict.
        folder: holds what is as long as a recording.
    """
    under = {}

    def each(
        followed: dict[str, Followed], fit: GeometryFit, phi: torch.Tensor, read: Callable[[str], Trial]
    ) -> dict[str, torch.Tensor]:
        found = {}
        for name, one in followed.items():
            feet = wrenches_under(one, fit, phi, read(name), outcome.config.contact)
            feet = None if feet is None else folder.aside(feet)
            if fit is outcome.fit and feet is not None:
                under[name] = feet
            found[name] = folder.aside(torques(one, fit.model.tree, fit.geometry, phi, read(name), feet))
        return found

    with folder.timed("torques"):
        torque = each(outcome.followed, outcome.fit, outcome.phi, outcome.right)
        as_read = outcome.session.trials.__getitem__
        scaled = each(outcome.followed_scaled, outcome.scaled, outcome.prior_scaled.mean, as_read)
    notes = (*outcome.notes, *sharing_notes(under))
    return _with_bands(replace(outcome, torque=torque, torque_scaled=scaled, under=under, notes=notes), folder)


def _with_bands(outcome: Outcome, folder: OutputFolder) -> Outcome:
    """The same with standard deviations of the torques, where the config asks for draws and there is a body."""
    count = outcome.config.torques.draws
    moving = [name for name, one in outcome.followed.items() if not math.isinf(one.motion.smoother.rate_hz)]
    if not count or outcome.identified is None:
        return outcome
    with folder.timed("torque bands"):
        drawn = outcome_draws(outcome, moving, count, outcome.config.seed)
        known = {name: torch.isfinite(outcome.torque[name]) for name in moving}
        sd = {name: folder.aside(torch.where(known[name], drawn.sd(name), torch.nan)) for name in moving}
    return replace(outcome, torque_sd=sd)


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
                    item = follow(fit, session.trials[name], item.tracked, Following.of(config, cutoff_hz))
                if item.wrench is not None:
                    trials.append(item.wrench)
            if trials:
                rows.append(Residual(label, role, cutoff_hz, geometry, inertia, *residual_rms(trials, phi)))
            release()
    return tuple(rows)
