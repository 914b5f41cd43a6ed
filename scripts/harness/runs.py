"""Whole runs of torchid from a command: of a config, of simulated subjects, subject after subject."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from pathlib import Path

from harness.command import Among, Command
from harness.pool import performed
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


def of_sessions(
    doc: str | None, names: Sequence[str], work: Callable[[Path, str], Row], line: Callable[[Row], str], out: str
) -> None:
    """A command that makes a row of each of some sessions, in a folder, and prints its line; what is done stays done.

    Args:
        doc: of the command.
        names: of all sessions.
        work: makes the row, given the folder and the session, which is its ``key``.
        line: of a row.
        out: folder of configs, results and rows.
    """
    given = Command(
        doc,
        jobs=2,
        sessions=(Among(names, names, True, "NAME"), "only these"),
        out=(Path(out), "folder of configs and results"),
    ).asked()
    given.out.mkdir(parents=True, exist_ok=True)
    jobs = {name: name for name in given.sessions}
    for row in performed(jobs, partial(work, given.out.resolve()), given.jobs, given.out / "rows.jsonl"):
        print(line(row), flush=True)
