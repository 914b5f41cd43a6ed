"""The trials of an evaluation: those of the body's run, and those recorded with a device on, followed by the same body.

A trial with a device tells nothing of the body: it is read, and its markers are followed, with the geometry that the
other trials have identified.
"""

from dataclasses import dataclass, replace
from itertools import chain

from torchid.config import Config
from torchid.config.sections import TrialFile
from torchid.errors import DataError, InputError
from torchid.geometry.result import GeometryFit
from torchid.geometry.tracking import Tracked, track
from torchid.io.files import files_on_disk
from torchid.recording import Trial
from torchid.run.sequence import run_key
from torchid.session import Followed, Outcome, Session
from torchid.session.fitting import OnStage
from torchid.session.following import Following
from torchid.session.opening import join_trials, open_trials, setup_of
from torchid.session.people import subject_prior
from torchid.session.standing import follow_session
from torchid.storage.files import file_sha256
from torchid.storage.provenance import stage_key
from torchid.storage.results import OutputFolder


@dataclass(frozen=True)
class ConditionTrial:
    """One trial of a condition, followed by the identified body and by the scaled template."""

    name: str
    condition: str
    recording: Trial
    followed: Followed
    scaled: Followed
    dofs: tuple[str, ...]
    """Names of the coordinates."""
    file: TrialFile


def condition_trials(
    config: Config, outcome: Outcome, folder: OutputFolder, progress: OnStage
) -> tuple[ConditionTrial, ...]:
    """All trials that have a condition, in the order of the config.

    Raises:
        TorchidError: a recording is at fault, or shows no marker that the body has.
    """
    worn = [file for file in config.trials if file.name not in outcome.session.trials]
    session = outcome.session
    followed, scaled = dict(outcome.followed), dict(outcome.followed_scaled)
    if worn:
        session = _worn_session(config, outcome, folder)
        _refuse_strange(outcome, session)
        key = stage_key(inputs=[run_key(config.body)], config=_files(config, worn))
        for kind, fit, into in (("worn", outcome.fit, followed), ("worn_scaled", outcome.scaled, scaled)):
            into |= _follow(kind, fit, outcome, session, folder, key, config, progress)
    return tuple(
        ConditionTrial(
            file.name, file.condition, session.trials[file.name], followed[file.name], scaled[file.name],
            outcome.fit.model.tree.dof_names, file,
        )
        for file in config.trials
        if file.condition is not None
    )  # fmt: skip


def refuse_faulty(config: Config, folder: OutputFolder) -> None:
    """Read the trials that were recorded with a device on, before the body is identified, and refuse what is wrong.

    Args:
        folder: where to put recordings while others are read.

    Raises:
        TorchidError: as ``open_trials``.
    """
    known = {file.name for file in config.body.trials}
    worn = [file for file in config.trials if file.name not in known]
    if worn:
        open_trials(setup_of(config), worn, folder.aside, everywhere=False)


def _worn_session(config: Config, outcome: Outcome, folder: OutputFolder) -> Session:
    """The session with the trials that its run has left out."""
    files = [file for file in config.trials if file.name not in outcome.session.trials]
    added = join_trials(outcome.session, setup_of(config), files, folder.aside)
    every = outcome.session.trials | {name: replace(trial, role="heldout") for name, trial in added.trials.items()}
    return replace(outcome.session, trials=every, files=outcome.session.files | added.files)


def _refuse_strange(outcome: Outcome, session: Session) -> None:
    labels = set(outcome.fit.attachment.labels)
    for name, trial in session.trials.items():
        if not labels & set(trial.markers.labels):
            raise DataError(
                "evaluate.markers", "this trial has none of the body's markers", source=name,
                found=", ".join(trial.markers.labels[:8]), remedy="Record all conditions with the same marker set",
            )  # fmt: skip


def _files(config: Config, worn: list) -> dict[str, object]:
    paths = [path for file in worn for path in (file.file, file.forces) if path is not None]
    hashes = [file_sha256(path) for path in dict.fromkeys(chain.from_iterable(map(files_on_disk, paths)))]
    return {"trials": [file.model_dump(mode="json") for file in worn], "hashes": hashes}


def _follow(
    kind: str, fit: GeometryFit, outcome: Outcome, session: Session, folder: OutputFolder, key: str, config: Config,
    progress: OnStage,
) -> dict[str, Followed]:  # fmt: skip
    """The worn trials followed by one model, static ones of the run before them: they tell the weight."""
    known = outcome.followed if kind == "worn" else outcome.followed_scaled
    new = [name for name in session.trials if name not in outcome.session.trials]
    tracked: dict[str, Tracked] = {name: item.tracked for name, item in known.items()}
    for k, name in enumerate(new):
        trial = session.trials[name]
        tracked[name] = folder.stage(f"{kind}_{name}", key, lambda t=trial: track(fit, t.markers))
        progress("motion with the device", (k + 1) / len(new))
    wanted = {n: t for n, t in session.trials.items() if t.role == "static" or n in new}
    part = replace(session, trials=wanted)
    prior = subject_prior(config.model, config.subject, fit)
    way = Following.of(config, outcome.cutoff_hz)
    followed = follow_session(fit, part, tracked.__getitem__, way, prior, folder)
    return {name: followed[name] for name in new}


def refuse_still(trials: tuple[ConditionTrial, ...]) -> None:
    """Raise DataError where a trial of a condition has too few frames to move."""
    for trial in trials:
        if trial.recording.role == "static" or len(trial.followed.motion.time) < 2:
            raise InputError(
                "evaluate.static", "a static trial has no cycles", source=trial.name,
                remedy="Leave its condition: out; it tells of the body all the same",
            )  # fmt: skip
