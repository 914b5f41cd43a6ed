"""One list of the plates of all trials of a session."""

from torchid.effects.scene import PlateFrame
from torchid.observation.plate_registry import SessionPlate, recognise
from torchid.recording import Forces
from torchid.session.session import Session

FIRST = ("fit", "static", "heldout")
"""Roles in the order in which they say where a plate is: held-out trials never do where another one knows."""


def plate_forces(session: Session) -> dict[str, Forces]:
    """Return the readings of all trials that have plates, by trial, those first that say where plates are.

    Args:
        session: its trials.
    """
    trials = session.trials
    order = sorted(trials, key=lambda name: FIRST.index(trials[name].role))
    return {name: forces for name in order if (forces := trials[name].forces) is not None}


def session_plates(session: Session) -> tuple[tuple[SessionPlate, ...], dict[str, tuple[PlateFrame, ...]]]:
    """Return all plates of a session, and the frames of every trial's plates in the order of its file.

    Args:
        session: its trials.
    """
    return recognise(plate_forces(session))
