"""Recordings and model of a config, ready for the fits."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace

from torchid.checks.marker_tracks.statement import notes_of
from torchid.checks.plates_against_feet.session import Recording, refuse_disagreement
from torchid.checks.recording import plate_problems, stated_mass
from torchid.config import Config
from torchid.config.sections import TrialFile
from torchid.contact.others import feet_alone
from torchid.errors import ConfigError, DataError, Note
from torchid.geometry.assign import Assignment, assign_markers
from torchid.io import ReadOptions, read_trial
from torchid.io.resample import synchronise
from torchid.model.files import load_model
from torchid.model.marker_set import MarkerSet, MarkerSpec, load_marker_set
from torchid.model.model import Model
from torchid.model.whole_body import whole_body
from torchid.recording import Trial
from torchid.session import Session
from torchid.session.other_contacts import check_others
from torchid.session.tracks import look_at_session, taken_out

OWN = "model"
"""Wording. The ``markers`` of a config that are the model's own."""
SHORTEST = 6
"""Frames of the shortest trial whose accelerations a quintic spline tells; a static trial may be shorter."""


def read_session(config: Config, keep: Callable[[Trial], Trial] = lambda trial: trial) -> Session:
    """Read all trials of the config and assign their markers to the model.

    Args:
        config: which trials, on which model.
        keep: where to put a trial while others are read (``OutputFolder.aside``).

    Raises:
        TorchidError: a file, the model or the marker set is at fault, or a trial that moves is too short.
    """
    model, said, markers = read_setup(config)
    trials = open_trials(config, config.trials, markers, keep)
    assignment = assign_markers(model, markers, tuple(trials.values()), config.unlisted_choice)
    return _tracked(config, config.trials, assignment, trials, keep, (*said, *assignment.notes))


def join_trials(
    session: Session, config: Config, files: Sequence[TrialFile], keep: Callable[[Trial], Trial] = lambda trial: trial
) -> Session:
    """Read more trials of the subject of a session, for the model on which its markers are assigned already.

    Args:
        session: as it was read.
        config: with the trials.
        files: which of them to read.
        keep: where to put a trial while others are read.

    Returns:
        The session of these trials alone.

    Raises:
        TorchidError: as ``read_session``.
    """
    trials = open_trials(config, files, read_setup(config)[2], keep)
    return _tracked(config, files, session.assignment, trials, keep)


def open_trials(
    config: Config,
    files: Sequence[TrialFile],
    markers: MarkerSet,
    keep: Callable[[Trial], Trial] = lambda trial: trial,
) -> dict[str, Trial]:
    """Read trials by name, forces on the clock of the markers; whoever uses a recording of a config opens it here.

    Args:
        config: of the session.
        files: which of its trials to read.
        markers: the session's marker set.
        keep: where to put a trial while others are read.

    Raises:
        InputError: a file is at fault, or ``forces.feet``: its forces do not agree with its feet.
        DataError: ``trial.short`` where a trial that moves is too short.
    """
    # Kept twice: beside an hour's samples of the plates the markers would have no room.
    trials = {file.name: keep(synchronise(keep(read_recording(file, config, markers)))) for file in files}
    _refuse_short(trials)
    _refuse_forces(config, files, markers, trials)
    return trials


def open_as_recorded(config: Config, name: str, keep: Callable[[Trial], Trial] = lambda trial: trial) -> Trial:
    """Read one trial by itself, its forces on their own clock.

    Args:
        config: with the trial.
        name: of the trial.
        keep: where to put it while it is looked at.

    Raises:
        TorchidError: as ``open_trials``; the model or the marker set is at fault.
    """
    file, markers = next(file for file in config.trials if file.name == name), read_setup(config)[2]
    trial = keep(read_recording(file, config, markers))
    _refuse_forces(config, [file], markers, {name: synchronise(trial)})
    return trial


def _refuse_forces(config: Config, files: Sequence[TrialFile], markers: MarkerSet, trials: Mapping[str, Trial]) -> None:
    """Refuse forces that do not agree with the feet, of trials whose forces are on the clock of the markers."""
    judged = {f.name: (on_feet(trials[f.name], config), _recording(f, config, markers)) for f in files}
    refuse_disagreement(judged, everywhere=len(files) == len(config.trials))


def _tracked(
    config: Config, files: Sequence[TrialFile], assignment: Assignment, trials: dict[str, Trial],
    keep: Callable[[Trial], Trial], said: tuple[Note, ...] = (),
) -> Session:  # fmt: skip
    """The session of trials that were opened, without the samples of markers that say nothing of segments."""
    check_others(config, assignment, trials)
    mass = config.subject.mass_kg
    each = (
        (*trial.notes, *(found.note for found in plate_problems(trial, mass or stated_mass(trial))))
        for trial in trials.values()
    )
    notes = tuple(note for some in each for note in some)
    wrong = look_at_session(trials, assignment)
    sound, before = taken_out(trials, wrong, keep)
    named = {file.name: file for file in files}
    return Session(sound, named, assignment, (*notes, *said, *notes_of(wrong)), wrong, before)


def read_setup(config: Config) -> tuple[Model, tuple[Note, ...], MarkerSet]:
    """The model, what reading it had to say, and the marker set of a config.

    Raises:
        TorchidError: one of them is at fault.
    """
    model, said = _model(config)
    if config.markers == OWN:
        return model, said, _own_markers(model, config)
    segments = _segments(model)
    given = load_marker_set(config.markers, tuple(segments), tuple(model.landmarks))
    specs = {label: replace(spec, segment=segments[spec.segment]) for label, spec in given.specs.items()}
    return model, said, replace(given, specs=specs)


def _segments(model: Model) -> dict[str, str]:
    """Names by which a marker set may call the bodies of a model, and the bodies: bodies welded to others too."""
    own = {name: name for name in model.tree.names}
    if model.osim is None:
        return own
    bodies, groups = model.osim.model.bodies, model.osim.groups
    return {bodies[body]: model.tree.names[k] for k, members in enumerate(groups) for body in members} | own


def _own_markers(model: Model, config: Config) -> MarkerSet:
    """The markers that an OpenSim file brings, each a landmark of its own name."""
    if model.osim is None or not model.osim.model.markers:
        raise ConfigError(
            "markers.own", "the model brings no markers of its own", source=str(config.model), place="markers",
            found=OWN, remedy="Name a marker set, or an OpenSim model that has a MarkerSet.",
        )  # fmt: skip
    names = [marker.name for marker in model.osim.model.markers if marker.name in model.landmarks]
    return MarkerSet(OWN, {name: MarkerSpec(model.landmarks[name].segment, name) for name in names})


def read_recording(file: TrialFile, config: Config, markers: MarkerSet) -> Trial:
    """One trial of a config, markers and forces each on their own clock. Errors as ``read_trial``."""
    return read_trial(file.name, file.file, file.forces, file.role, config.reading(file, markers.wanted))


def read_each(config: Config, files: Iterable[TrialFile]) -> Iterator[Trial]:
    """Read trials one by one, as they are asked for.

    Args:
        config: of the session.
        files: of the trials.

    Raises:
        TorchidError: a file, the model or the marker set is at fault.
    """
    for file in files:
        yield read_recording(file, config, read_setup(config)[2])


def _recording(file: TrialFile, config: Config, markers: MarkerSet) -> Recording:
    def read(options: ReadOptions) -> Trial:
        return on_feet(read_trial(file.name, file.file, file.forces, file.role, options), config)

    return Recording(read, config.reading(file, markers.wanted), config.subject.mass_kg)


def on_feet(trial: Trial, config: Config) -> Trial:
    """Return the trial with the forces that feet must answer for.

    Args:
        trial: as read.
        config: with the contacts other than feet.
    """
    if not config.contact.others or trial.forces is None:
        return trial
    return replace(trial, forces=feet_alone(config.contact, trial.name, trial.forces))


def _refuse_short(trials: dict[str, Trial]) -> None:
    for name, trial in trials.items():
        if trial.role != "static" and len(trial.markers.time) < SHORTEST:
            raise DataError(
                "trial.short", "too few frames to tell accelerations", source=trial.parameters.get("file", name),
                found=f"{len(trial.markers.time)} frames", remedy="Give it the role static, or leave it out",
            )  # fmt: skip


def _model(config: Config) -> tuple[Model, tuple[Note, ...]]:
    if config.model == "whole_body":
        who = config.subject
        return whole_body(who.height_m, who.mass_kg, who.sex, who.mass_sd_kg), ()
    return load_model(config.model, config.scatter)
