"""Recordings and model of a config, ready for the fits."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

from torchid.checks.marker_tracks.statement import notes_of
from torchid.checks.plates_against_feet.session import refuse_disagreement
from torchid.checks.recording import plate_problems, stated_mass
from torchid.checks.report import Given, judged
from torchid.config import Config
from torchid.config.sections import TrialFile
from torchid.contact.options import ContactOptions
from torchid.contact.others import feet_alone
from torchid.errors import ConfigError, DataError, Note
from torchid.geometry.assign import Assignment, assign_markers
from torchid.io import ReadOptions, read_trial
from torchid.io.mend import ForcesAs, PlateAs
from torchid.io.resample import synchronise
from torchid.model.files import load_model
from torchid.model.marker_set import MarkerSet, MarkerSpec, load_marker_set
from torchid.model.model import Model
from torchid.model.recognition import recognised, unrecognised
from torchid.model.whole_body import whole_body
from torchid.recording import Trial
from torchid.session import Session
from torchid.session.other_contacts import check_others
from torchid.session.session import look_at_session, taken_out

AUTO = "auto"
"""Wording. The ``markers`` of a config that leaves them to their labels."""
OWN = "model"
"""Wording. The ``markers`` of a config that are the model's own."""
SHORTEST = 6
"""Frames of the shortest trial whose accelerations a quintic spline tells; a static trial may be shorter."""


@dataclass(frozen=True)
class Setup:
    """What recordings of a session are opened with."""

    model: Model
    markers: MarkerSet
    notes: tuple[Note, ...]
    """What reading the model had to say."""
    mass_kg: float | None
    """The subject's, on record."""
    forces_as: ForcesAs
    """What is wrong with the forces of every trial that says nothing of its own."""
    plates: Mapping[int, PlateAs]
    """What is wrong with single force plates, likewise."""
    contact: ContactOptions
    unlisted: Literal["assign", "leave_out"]
    """What becomes of labels that the marker set does not list."""

    def reading(self, file: TrialFile) -> ReadOptions:
        """How a trial is to be read."""
        forces_as = self.forces_as if file.forces_as is None else file.forces_as
        plates = self.plates if file.plates is None else file.plates
        return ReadOptions(
            file.subject, file.up, file.units, file.allow_truncated, forces_as, plates, self.markers.wanted
        )


def setup_of(config: Config) -> Setup:
    """What the recordings of a config are opened with.

    Raises:
        TorchidError: the model or the marker set is at fault.
    """
    model, said = _model(config)
    markers, chosen = _markers(config, model)
    return Setup(
        model, markers, (*said, *chosen), config.subject.mass_kg, config.forces_as, config.plates, config.contact,
        config.unlisted_choice,
    )  # fmt: skip


def read_session(config: Config, keep: Callable[[Trial], Trial] = lambda trial: trial) -> Session:
    """Read all trials of the config and assign their markers to the model.

    Args:
        keep: where to put a trial while others are read (``OutputFolder.aside``).

    Raises:
        TorchidError: a file, the model or the marker set is at fault, or a trial that moves is too short.
    """
    return open_session(setup_of(config), config.trials, keep)


def open_session(
    setup: Setup, files: Sequence[TrialFile], keep: Callable[[Trial], Trial] = lambda trial: trial
) -> Session:
    """Read trials and assign their markers to the model.

    Args:
        setup: model, markers, and what is said of the recordings.
        keep: where to put a trial while others are read.

    Raises:
        TorchidError: as ``open_trials``; the markers do not carry the model.
    """
    trials = open_trials(setup, files, keep)
    assignment = assign_markers(setup.model, setup.markers, tuple(trials.values()), setup.unlisted)
    return _tracked(setup, files, assignment, trials, keep, (*setup.notes, *assignment.notes))


def join_trials(
    session: Session, setup: Setup, files: Sequence[TrialFile], keep: Callable[[Trial], Trial] = lambda trial: trial
) -> Session:
    """Read more trials of the subject of a session, for the model on which its markers are assigned already.

    Args:
        setup: what its recordings are opened with.
        files: of the further trials.
        keep: where to put a trial while others are read.

    Returns:
        The session of these trials alone.

    Raises:
        TorchidError: as ``open_trials``.
    """
    trials = open_trials(setup, files, keep, everywhere=False)
    return _tracked(setup, files, session.assignment, trials, keep)


def open_trials(
    setup: Setup,
    files: Sequence[TrialFile],
    keep: Callable[[Trial], Trial] = lambda trial: trial,
    everywhere: bool = True,
) -> dict[str, Trial]:
    """Read trials by name, forces on the clock of the markers; whoever uses a recording of a config opens it here.

    Args:
        keep: where to put a trial while others are read.
        everywhere: whether these are all trials of the session, so that a line may be advised for all of them.

    Raises:
        InputError: a file is at fault, or ``forces.feet``: its forces do not agree with its feet.
        DataError: ``trial.short`` where a trial that moves is too short.
    """
    # Kept twice: beside an hour's samples of the plates the markers would have no room.
    trials = {file.name: keep(synchronise(keep(read_recording(file, setup)))) for file in files}
    _refuse_short(trials)
    _refuse_forces(setup, files, trials, everywhere)
    return trials


def open_as_recorded(setup: Setup, file: TrialFile, keep: Callable[[Trial], Trial] = lambda trial: trial) -> Trial:
    """Read one trial by itself, its forces on their own clock.

    Args:
        keep: where to put it while it is looked at.

    Raises:
        TorchidError: as ``open_trials``.
    """
    trial = keep(read_recording(file, setup))
    _refuse_forces(setup, [file], {file.name: synchronise(trial)}, everywhere=False)
    return trial


def _refuse_forces(setup: Setup, files: Sequence[TrialFile], trials: Mapping[str, Trial], everywhere: bool) -> None:
    """Refuse forces that do not agree with the feet, of trials whose forces are on the clock of the markers."""
    each = [(given_of(file, setup), trials[file.name]) for file in files if judged(trials[file.name])]
    refuse_disagreement({one.name: (one.on_feet(trial), one.again(trial)) for one, trial in each}, everywhere)


def _tracked(
    setup: Setup, files: Sequence[TrialFile], assignment: Assignment, trials: dict[str, Trial],
    keep: Callable[[Trial], Trial], said: tuple[Note, ...] = (),
) -> Session:  # fmt: skip
    """The session of trials that were opened, without the samples of markers that say nothing of segments."""
    check_others(setup.contact, assignment, trials)
    each = (
        (*trial.notes, *(found.note for found in plate_problems(trial, setup.mass_kg or stated_mass(trial))))
        for trial in trials.values()
    )
    notes = tuple(note for some in each for note in some)
    wrong = look_at_session(trials, assignment)
    sound, before = taken_out(trials, wrong, keep)
    named = {file.name: file for file in files}
    return Session(sound, named, assignment, (*notes, *said, *notes_of(wrong)), wrong, before)


def _markers(config: Config, model: Model) -> tuple[MarkerSet, tuple[Note, ...]]:
    """The marker set of a config, and how it was chosen where the config leaves that open."""
    own = model.osim is not None and model.osim.model.markers
    if config.markers == OWN or (config.markers == AUTO and own):
        return _own_markers(model, config), ()
    segments = _segments(model)
    if config.markers == AUTO:
        given, notes = _recognised(config)
    else:
        given, notes = load_marker_set(config.markers, tuple(segments), tuple(model.landmarks)), ()
    specs = {
        label: replace(spec, segment=segments[spec.segment])
        for label, spec in given.specs.items()
        if config.markers != AUTO or spec.segment in segments
    }
    return replace(given, specs=specs), notes


def _recognised(config: Config) -> tuple[MarkerSet, tuple[Note, ...]]:
    """Where the labels of the first recording of motion are, by a built-in set and their words."""
    if not config.trials:
        raise ConfigError(
            "markers.auto", "without recordings nothing tells the markers", place="markers", found=AUTO,
            remedy="Name a marker set; that of simulated people is `simulated`",
        )  # fmt: skip
    first = next((file for file in config.trials if file.role != "static"), config.trials[0])
    options = ReadOptions(first.subject, first.up, first.units, first.allow_truncated, ForcesAs(use=False))
    found = recognised(read_trial(first.name, first.file, None, "fit", options).markers.labels)
    if not found.enough and config.unlisted_choice == "leave_out":
        raise unrecognised(found, str(first.file))
    return found.markers, (Note("markers.auto", f"markers: auto, by {first.name}: {found.said}"),)


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


def read_recording(file: TrialFile, setup: Setup) -> Trial:
    """One trial, markers and forces each on their own clock. Errors as ``read_trial``."""
    return given_of(file, setup).read(setup.reading(file))


def given_of(file: TrialFile, setup: Setup) -> Given:
    """A trial of a session as checks read and judge it, whoever asks."""
    options = setup.reading(file)
    return Given(
        file.name, file.file, file.forces, file.role, options, setup.mass_kg,
        lambda trial: on_feet(trial, setup.contact),
    )  # fmt: skip


def read_each(setup: Setup, files: Iterable[TrialFile]) -> Iterator[Trial]:
    """Read trials one by one, as they are asked for.

    Raises:
        TorchidError: a file is at fault.
    """
    for file in files:
        yield read_recording(file, setup)


def on_feet(trial: Trial, contact: ContactOptions) -> Trial:
    """Return the trial with the forces that feet must answer for.

    Args:
        contact: with the contacts other than feet.
    """
    if not contact.others or trial.forces is None:
        return trial
    return replace(trial, forces=feet_alone(contact, trial.name, trial.forces))


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
        return whole_body(who.height_m, who.mass_kg, who.sex, who.mass_sd_kg, who.age_years), ()
    return load_model(config.model, config.scatter)
