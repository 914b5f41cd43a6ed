"""The ``torchid`` command: reads the config, runs what it asks for, and turns errors into one line and an exit code.

Exit codes: 0 done; 2 the config or a file is at fault; 3 the data do not support a result; 1 a defect of torchid;
130 interrupted. Heavy imports wait inside the commands, because torch alone takes seconds.
"""

import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console, ConsoleOptions, RenderableType
from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn
from rich.segment import Segment
from rich.text import Text

from torchid.allocator import keep_memory
from torchid.errors import InputError, TorchidError
from torchid.wording import visible

CONFIG_SUFFIXES = (".yaml", ".yml", ".json")
MARKER_SUFFIXES = (".c3d", ".trc")
FORCE_SUFFIXES = (".mot", ".sto")

app = typer.Typer(
    name="torchid",
    help="Geometry, motion and inertia of a moving person from marker trajectories and force plates.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)
ConfigFile = Annotated[Path, typer.Argument(help="YAML or JSON.", show_default=False)]
Overrides = Annotated[
    list[str] | None, typer.Argument(metavar="[KEY=VALUE]...", help="Replace single keys.", show_default=False)
]
Debug = Annotated[bool, typer.Option("--debug", help="Show the log and, on an error, the traceback.")]


class _Terminal(Console):
    """Whatever is printed: a label of a file that holds terminal escapes is shown, not obeyed."""

    def render(self, renderable: RenderableType, options: ConsoleOptions | None = None) -> Iterable[Segment]:
        """The parts of what is printed; those that control the terminal are rich's own."""
        if isinstance(renderable, Text):
            renderable = renderable.copy()
            renderable.plain = visible(renderable.plain)  # before its lines are broken
        for part in super().render(renderable, options):
            yield part if part.control else Segment(visible(part.text), part.style)


@app.callback(invoke_without_command=True)
def _main(version: Annotated[bool, typer.Option("--version", help="Show the version and exit.")] = False) -> None:
    if version:
        from importlib.metadata import version as installed

        _Terminal().print(installed("torchid"), highlight=False)
        raise typer.Exit


@app.command()
def run(config: ConfigFile, overrides: Overrides = None, debug: Debug = False) -> None:
    """Everything the config asks for, into its `out` folder."""
    with _exit_codes(debug):
        from torchid.config import load_config

        loaded = load_config(config, overrides or ())
        from torchid.experiment import run_experiment

        keep_memory()
        with _progress() as progress:
            run_experiment(loaded, progress)
        _Terminal().print(f"Done: {loaded.out}", soft_wrap=True, highlight=False, markup=False)


@app.command()
def simulate(config: ConfigFile, overrides: Overrides = None, debug: Debug = False) -> None:
    """A synthetic subject, written as C3D, with effects planted on request."""
    with _exit_codes(debug):
        from torchid.config import load_config

        loaded = load_config(config, overrides or ())
        from torchid.experiment import run_simulation

        with _progress() as progress:
            run_simulation(loaded, progress)
        _Terminal().print(f"Done: {loaded.out}", soft_wrap=True, highlight=False, markup=False)


@app.command()
def check(
    what: Annotated[
        list[str], typer.Argument(metavar="CONFIG [KEY=VALUE]... | FILE...", help="A config, or recordings.")
    ],
    debug: Debug = False,
) -> None:
    """What is wrong with the recordings, before any fit."""
    with _exit_codes(debug):
        from torchid.check import check_trial, format_check
        from torchid.io import read_trial

        console, refused = _Terminal(), False
        for arguments, mass_kg in _recordings(what):
            try:
                console.print(format_check(check_trial(read_trial(*arguments), mass_kg)))
            except InputError as error:
                refused = True
                _complain(error)
        if refused:
            raise typer.Exit(InputError.exit_code)


def _recordings(what: list[str]) -> Iterator[tuple[tuple, float | None]]:
    """Arguments of ``read_trial`` and the known mass, for each recording of a config, or for each file of a list."""
    from torchid.io import ReadOptions

    if Path(what[0]).suffix.lower() in CONFIG_SUFFIXES:
        from torchid.config import load_config

        config = load_config(what[0], what[1:])
        for trial in config.trials:
            yield (trial.name, trial.file, trial.forces, trial.role, config.reading(trial)), config.subject.mass_kg
    else:
        for file, forces in pair_files([Path(text) for text in what]):
            yield (file.stem, file, forces, "fit", ReadOptions()), None


def pair_files(files: list[Path]) -> list[tuple[Path, Path | None]]:
    """Each marker file with the force file that follows it, as in ``squat.trc squat_grf.mot``.

    Raises:
        InputError: ``check.order`` for a force file without markers before it, ``check.kind`` for anything else.
    """
    pairs: list[tuple[Path, Path | None]] = []
    for file in files:
        kind = file.suffix.lower()
        if kind in MARKER_SUFFIXES:
            pairs.append((file, None))
        elif kind in FORCE_SUFFIXES and pairs and pairs[-1][1] is None:
            pairs[-1] = (pairs[-1][0], file)
        elif kind in FORCE_SUFFIXES:
            raise InputError(
                "check.order", "forces without markers", source=file, remedy="Name its marker file before it."
            )
        else:
            known = ", ".join(MARKER_SUFFIXES + FORCE_SUFFIXES + CONFIG_SUFFIXES)
            raise InputError("check.kind", "not a known kind of file", source=file, remedy=f"Known: {known}.")
    return pairs


class _Bar:
    """The bars on the terminal, one a stage, as the callback of a run (``experiment.fits.OnStage``)."""

    def __init__(self, bars: Progress) -> None:
        self.bars, self.tasks = bars, {}

    def __call__(self, stage: str, fraction: float) -> None:
        if stage not in self.tasks:
            self.tasks[stage] = self.bars.add_task(stage, total=1.0)
        self.bars.update(self.tasks[stage], completed=fraction)


@contextmanager
def _progress() -> Iterator[_Bar]:
    columns = (SpinnerColumn(), TextColumn("{task.description}", markup=False), BarColumn(), TimeElapsedColumn())
    with Progress(*columns, console=_Terminal(stderr=True), disable=not sys.stderr.isatty()) as bars:
        yield _Bar(bars)


@contextmanager
def _exit_codes(debug: bool) -> Iterator[None]:
    """Errors become a line each on stderr and an exit code (module docstring); ``debug`` adds the traceback."""
    from torchid.logs import configure_logging

    configure_logging(debug)
    try:
        yield
    except (typer.Exit, typer.Abort):
        raise
    except TorchidError as error:
        _complain(error, debug)
        raise typer.Exit(error.exit_code) from None
    except KeyboardInterrupt:
        _complain("interrupted; the next run continues from here")
        raise typer.Exit(130) from None
    except Exception as error:
        text = " ".join(f"{type(error).__name__}: {error}".split())
        _complain(f"a defect of torchid: {text[:400]} (the traceback: --debug)", debug)
        raise typer.Exit(1) from None


def _complain(error: object, traceback: bool = False) -> None:
    console = _Terminal(stderr=True)
    if traceback:
        console.print_exception()
    for line in str(error).split("\n"):
        console.print(f"torchid: {line}", soft_wrap=True, highlight=False, markup=False)


if __name__ == "__main__":
    app()
