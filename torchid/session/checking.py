"""A config's session before any fit: its recordings, and whether markers and model fit them."""

from collections.abc import Iterator

from torchid.checks.marker_tracks.statement import TrackFault, notes_of
from torchid.checks.report import CheckItem, Refusal, check_recordings
from torchid.config import Config
from torchid.errors import TorchidError
from torchid.geometry.assign import assign_markers
from torchid.recording import Trial
from torchid.session.opening import given_of, setup_of
from torchid.session.other_contacts import check_others, refuse_unknown_plates
from torchid.session.session import look_at_session


def check_session(config: Config) -> Iterator[CheckItem]:
    """What is wrong with each recording, then what becomes of its markers on the model.

    Raises:
        TorchidError: the model or the marker set is at fault.
    """
    setup = setup_of(config)
    given = [given_of(file, setup) for file in config.trials]
    trials: list[Trial] = []
    yield from check_recordings(given, trials.append, one_session=True)
    if len(trials) < len(given) or not trials:
        return
    try:
        assignment = assign_markers(setup.model, setup.markers, tuple(trials), setup.unlisted)
        named = {trial.name: trial for trial in trials}
        check_others(setup.contact, assignment, named)
        refuse_unknown_plates(setup.contact, trials)
        wrong = look_at_session({trial.name: trial for trial in trials}, assignment)
        # Leaps and frozen markers have been said of each recording.
        between = [one for one in wrong if one.kind in (TrackFault.EXCHANGED, TrackFault.MOVED)]
        yield from (*setup.notes, *assignment.notes, *notes_of(between))
    except TorchidError as error:
        yield Refusal.of(error)
