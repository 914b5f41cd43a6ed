"""Whole runs of torchid from a command: of a config, of simulated subjects, subject after subject."""

from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

from harness.rows import Row, figures
from torchid.config import load_config
from torchid.errors import TorchidError
from torchid.run import run_experiment
from torchid.session import Outcome
from torchid.simulate.options import SimulateOptions
from torchid.simulate.session import SimulatedSession, simulate_session


def ran(config: Path | str | None, out: Path | str, *overrides: str) -> Outcome:
    """The outcome of a config in a folder, without the diagnosis unless ``overrides`` enable it."""
    assert config is not None
    settings = [f"out={Path(out).resolve()}", "diagnosis.enabled=false", *overrides]
    return run_experiment(load_config(config, settings))


def simulated(
    options: SimulateOptions, seed: int, folder: Path | str, *overrides: str
) -> tuple[SimulatedSession, Outcome]:
    """A simulated session, and its run from the files alone."""
    session = simulate_session(options, seed, Path(folder) / "recordings")
    return session, ran(session.config, Path(folder) / "result", *overrides)


def each(seeds: Iterable[int], work: Callable[[int], Row], skip: bool = False) -> Iterator[Row]:
    """A row for every seed, printed when it is there; with ``skip``, subjects that torchid refuses are left out."""
    for seed in seeds:
        try:
            row = {"seed": seed} | work(seed)
        except TorchidError as error:
            if not skip:
                raise
            print(f"seed {seed}  left out: {error}", flush=True)
            continue
        print(figures(row), flush=True)
        yield row
