"""Hands and seats of simulated persons, found again: ``python -m benchmarks.other_contacts [SEED ...]``.

For every seed a session is simulated and run, and a hand holds on during two of its trials; in another session squats
are held by a seat. Each is without a plate, on a plate of its own, and the seat on the plate that the feet stand on.
"""

from dataclasses import asdict
from pathlib import Path
from tempfile import TemporaryDirectory

import torch
from harness.command import Command
from harness.runs import simulated
from hidden_contact import (
    Hidden,
    answers,
    draw_hand,
    mass_error,
    on_one_plate,
    seated,
    seated_options,
    told,
    with_handle,
    with_plate,
    without,
)

from torchid.errors import ConfigError
from torchid.session import Outcome
from torchid.simulate.options import SimulateOptions
from torchid.simulate.session import SimulatedSession

OPTIONS = SimulateOptions(fit=("squats", "hip_rom", "arms", "trunk"), heldout=("sway_steps",), duration_s=4.0)
FEW = "geometry.max_frames=80"


def report(label: str, outcome: Outcome, found: Outcome, session: SimulatedSession, hidden: Hidden) -> None:
    """Print one line of figures."""
    used = int(sum(int(one.contact.used.sum()) for one in found.followed.values() if one.contact is not None))
    said = {k: round(v, 3) for k, v in asdict(answers(outcome, found, session, hidden)).items()}
    masses = [round(mass_error(one, session), 3) for one in (outcome, found)]
    print(label, said, f"masses kg {masses[0]} -> {masses[1]}", f"used {used}", flush=True)


def hands(seed: int) -> None:
    """A hand that holds on in two trials of a person who balances alone."""
    generator = torch.Generator().manual_seed(seed)
    with TemporaryDirectory() as folder:
        session, outcome = simulated(OPTIONS, seed, folder, FEW)
    for trial in ("arms", "trunk"):
        hidden = draw_hand(session, trial, generator)
        recording = outcome.session.trials[trial]
        less = without(recording, hidden)
        found = told(outcome, less, hidden, hidden.contact)
        report(f"{seed} {trial} {hidden.name} unmeasured", outcome, found, session, hidden)
        silent = told(outcome, less, hidden, None)
        print(f"{seed} {trial} nothing said: masses kg {mass_error(silent, session):.3f}", flush=True)
        handle = with_handle(recording, hidden, generator)
        assert handle.forces is not None
        found = told(outcome, handle, hidden, hidden.measured(len(handle.forces.plates)))
        report(f"{seed} {trial} {hidden.name} own plate", outcome, found, session, hidden)


def seated_session(seed: int, folder: Path, generator: torch.Generator) -> tuple[SimulatedSession, Outcome]:
    """A session with squats that a seat holds; seats with which the person cannot keep balance are drawn again."""
    while True:
        try:
            return simulated(seated_options(OPTIONS, generator), seed, folder, FEW)
        except ConfigError as error:
            if error.code != "simulate.balance":
                raise


def seats(seed: int) -> None:
    """A seat that squats are held by; the first figures of masses are those with nothing said of it."""
    generator = torch.Generator().manual_seed(seed)
    with TemporaryDirectory() as folder:
        session, outcome = seated_session(seed, Path(folder), generator)
    hidden = seated(session)
    recording = outcome.session.trials[hidden.trial]
    found = told(outcome, recording, hidden, hidden.contact)
    report(f"{seed} seat unmeasured", outcome, found, session, hidden)
    plate = with_plate(recording, hidden, generator)
    assert plate.forces is not None
    found = told(outcome, plate, hidden, hidden.measured(len(plate.forces.plates)))
    report(f"{seed} seat own plate", outcome, found, session, hidden)
    found = told(outcome, on_one_plate(recording, hidden), hidden, hidden.measured(1))
    report(f"{seed} seat and feet on one plate", outcome, found, session, hidden)


if __name__ == "__main__":
    for one in Command(__doc__, ("seeds",), seeds={"nargs": "*", "type": int, "default": [1]}).asked().seeds:
        hands(one)
        seats(one)
