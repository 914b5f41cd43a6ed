"""The ``torchid`` command: reads the config, runs what it asks for, and turns errors into one line and an exit code.

Exit codes: 0 done; 2 the config or a file is at fault; 3 the data do not support a result; 1 a defect of torchid;
4 some subjects of a cohort are set aside;
130 interrupted. Heavy imports wait inside the commands, because torch alone takes seconds.
"""

import io
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, suppress
from importlib.util import find_spec
from pathlib import Path
from shlex import quote
from typing import Annotated, NamedTuple

import typer
from rich.text import Text

from torchid.errors import ConfigError, DataError, InputError, TorchidError, said_of_defect
from torchid.storage.allocator import keep_memory, seldom_collect
from torchid.terminal import Terminal, cohort_progress, complain, print_lights, progress_bars, unbroken

SOME_ASIDE = 4
"""Exit code of a cohort of which some are set aside."""
CONFIG_SUFFIXES = (".yaml", ".yml", ".json")

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

Port = Annotated[int, typer.Option(min=1, max=65535, help="Of the page; the next free one is taken.")]
Host = Annotated[str, typer.Option(help="Address of the page; others than this machine's own ask for a token.")]


Subject = Annotated[str | None, typer.Option(help="Whose recordings, where they are of several people.")]
Mass = Annotated[float | None, typer.Option(help="In kg; default: as files say, or plates weigh.")]
Height = Annotated[float | None, typer.Option(help="In m; default: as files say, or markers stand.")]
Sex = Annotated[str | None, typer.Option(help="male or female; default: as files state it.")]
Age = Annotated[float | None, typer.Option(help="In years; default: as files state it.")]


class _Given(NamedTuple):
    """What the user says of a person."""

    name: str | None = None
    mass_kg: float | None = None
    height_m: float | None = None
    sex: str | None = None
    age_years: float | None = None


@app.callback(invoke_without_command=True)
def _main(version: Annotated[bool, typer.Option("--version", help="Show the version and exit.")] = False) -> None:
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")  # no work is lost for a sign that a terminal cannot show
    if version:
        from importlib.metadata import version as installed

        Terminal().print(installed("torchid"), highlight=False)
        raise typer.Exit


@app.command()
def new(
    folder: Annotated[
        Path, typer.Argument(help="With the recordings of one session; or a .b3d file.", show_default=False)
    ],
    output: Annotated[Path | None, typer.Option("-o", "--output", help="Default: SUBJECT.yaml here.")] = None,
    subject: Subject = None,
    mass: Mass = None,
    height: Height = None,
    sex: Sex = None,
    age: Age = None,
    debug: Debug = False,
) -> None:
    """A config from nothing but files: marker set, standing trial, what is fitted and held out, and why."""
    with _exit_codes(debug):
        config = _new_config(folder, output, _Given(subject, mass, height, sex, age))
        Terminal().print(f"next: torchid run {quote(str(config))}", soft_wrap=True, highlight=False, markup=False)


@app.command()
def run(
    config: Annotated[
        Path, typer.Argument(help="YAML or JSON; or a folder of recordings, or a .b3d file.", show_default=False)
    ],
    overrides: Overrides = None,
    subject: Subject = None,
    mass: Mass = None,
    height: Height = None,
    sex: Sex = None,
    age: Age = None,
    quiet: Annotated[bool, typer.Option("--quiet", help="Print the last line alone.")] = False,
    show: Annotated[bool, typer.Option("--open", help="Open the report when it is done.")] = False,
    debug: Debug = False,
) -> None:
    """Everything the config asks for, into its `out` folder; of a folder of recordings, with a config made of it."""
    with _exit_codes(debug):
        from torchid.config import load_config
        from torchid.io.files import container_of

        given = _Given(subject, mass, height, sex, age)
        if config.is_dir() or container_of(config) == config:
            config = _new_config(config, None, given, keep=True, quiet=quiet)
        elif given != _Given():
            raise _person_twice(config)
        loaded = load_config(config, overrides or ())
        from torchid.report.glance import glance
        from torchid.run import run_experiment

        keep_memory()
        page = loaded.out / "report.html"
        try:
            with progress_bars() as progress:
                outcome = run_experiment(loaded, progress)
        except DataError:  # there is a report all the same, if there is a body
            if page.exists():
                complain(f"what there is: {page}")
            raise
        if not quiet and outcome.quality is not None:
            print_lights(glance(outcome, outcome.quality))
        said = "" if outcome.quality is None else f", {outcome.quality.line}"
        Terminal().print(f"Done: {page}{said}", soft_wrap=True, highlight=False, markup=False)
        if show:
            typer.launch(str(page))


@app.command()
def demo(
    words: Annotated[
        list[str] | None,
        typer.Argument(metavar="[SEED] [KEY=VALUE]...", help="Default: a seed from the clock.", show_default=False),
    ] = None,
    debug: Debug = False,
) -> None:
    """A simulated session in which an effect is hidden by lot: found from the files alone, then compared."""
    with _exit_codes(debug):
        from torchid.run.demo import by_lot, demo_config, demonstrate

        seed, overrides = by_lot(words or [])
        keep_memory()
        with progress_bars() as progress:
            for line in demonstrate(demo_config(seed, overrides), progress):
                Terminal().print(line, soft_wrap=True, highlight=False, markup=False)


@app.command()
def cohort(
    who: Annotated[
        Path, typer.Argument(metavar="TABLE|FOLDER", help="CSV of subjects, or a folder of each.", show_default=False)
    ],
    output: Annotated[Path, typer.Option("-o", "--output", help="Folder of all results.", show_default=False)],
    scheduler: Annotated[str | None, typer.Option(help="Address or file of a Dask scheduler that is there.")] = None,
    workers: Annotated[int | None, typer.Option(min=1, help="Runs at once; default: by cores and memory.")] = None,
    memory: Annotated[float, typer.Option(min=0.5, help="GiB that one run may take.")] = 4.0,
    minutes: Annotated[float, typer.Option(min=0.1, help="That one run may take.")] = 60.0,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Say what would be run.")] = False,
    debug: Debug = False,
) -> None:
    """Many subjects, each as `torchid run` has it, one table and page of all; ends with 4 where some are set aside."""
    with _exit_codes(debug):
        from torchid.cohort.cohort import everybody, missing, run_cohort
        from torchid.cohort.members import members_of
        from torchid.cohort.task import RunLimits

        members, console = members_of(who), Terminal()
        if dry_run:
            rows, left = missing(members, output.resolve())
            everyone = everybody(members, rows)
            for member in everyone:
                word = "run" if member in left else "done"
                console.print(f"{word:5}{member.name}  {member.source}", highlight=False, markup=False, soft_wrap=True)
            console.print(f"{len(left)} of {len(everyone)} to run", highlight=False)
            return
        with cohort_progress() as shown:
            rows = run_cohort(members, output, RunLimits(memory, 60.0 * minutes), workers, scheduler, shown, shown.open)
        aside = [row for row in rows if row["status"] != "done"]
        for row in aside:
            complain(f"{row['subject']}: {row['reason']}")
        said = f"Done: {output / 'cohort.html'}, {len(rows) - len(aside)} of {len(rows)} subjects"
        console.print(said, soft_wrap=True, highlight=False, markup=False)
        if aside:
            raise typer.Exit(SOME_ASIDE)


@app.command()
def evaluate(config: ConfigFile, overrides: Overrides = None, debug: Debug = False) -> None:
    """Assistive device: what the conditions of a config differ by, or those of a study of several subjects; of a
    cohort's folder, what its groups differ by."""
    with _exit_codes(debug):
        from torchid.config import GroupQuestion, Study, load_evaluation

        loaded = load_evaluation(config, overrides or ())
        from torchid.evaluation.evaluate import evaluate as run_evaluation
        from torchid.evaluation.groups.write import evaluate_groups
        from torchid.evaluation.study.write import evaluate_study

        keep_memory()
        with progress_bars() as progress:
            if isinstance(loaded, GroupQuestion):
                page = evaluate_groups(loaded).question.cohort / "groups.html"
            elif isinstance(loaded, Study):
                page = evaluate_study(loaded, progress).study.out / "subjects.html"
            else:
                run_evaluation(loaded, progress)
                page = loaded.out / "evaluation.html"
        Terminal().print(f"Done: {page}", soft_wrap=True, highlight=False, markup=False)


@app.command()
def live(
    config: ConfigFile,
    source: Annotated[str, typer.Option(help="lsl or lsl:NAME; qualisys[:HOST[:PORT]]; xdf:FILE; or replay:TRIAL.")],
    speed: Annotated[float, typer.Option(min=0.01, help="Multiple of the trial's own pace; inf: without a pause.")] = 1,
    seconds: Annotated[float, typer.Option(min=0, help="Stop after so long.")] = float("inf"),
    record: Annotated[Path | None, typer.Option(help="New folder for what comes, as TRC and MOT.")] = None,
    headless: Annotated[bool, typer.Option("--headless", help="Without a page.")] = False,
    port: Port = 8080,
    host: Host = "127.0.0.1",
    guide: Annotated[
        bool, typer.Option("--guide", help="Advise what to do next, and say what each exercise told.")
    ] = False,
    seated: Annotated[bool, typer.Option("--seated", help="Advise one who sits.")] = False,
    no_arms: Annotated[bool, typer.Option("--no-arms", help="Advise one who does not move the arms.")] = False,
    half_life: Annotated[
        float, typer.Option(min=1, help="Seconds after which a row counts half, for a body that changes.")
    ] = float("inf"),
    overrides: Overrides = None,
    debug: Debug = False,
) -> None:
    """Identify while a stream comes; ends with one line of JSON, and the estimate in `live.json`."""
    with _exit_codes(debug):
        import json

        from torchid.config import load_config

        loaded = load_config(config, overrides or ())
        from torchid.live.exercises.exercises import Possibilities
        from torchid.live.run import run_live

        keep_memory()
        possibilities = Possibilities(seated, not no_arms) if guide or seated or no_arms else None
        with progress_bars() as progress:
            page = None if headless else _live_page(port, host)
            found = run_live(
                loaded, source, speed, seconds, record, progress, page, _announce, possibilities, half_life
            )
        typer.echo(json.dumps(found))


@app.command()
def view(
    out: Annotated[Path, typer.Argument(help="The `out` of a config that `torchid run` has finished.")],
    port: Port = 8080,
    host: Host = "127.0.0.1",
    seconds: Annotated[float, typer.Option(min=0, help="Stop after so long.")] = float("inf"),
    debug: Debug = False,
) -> None:
    """The 3-D page of a finished run; ends with Ctrl-C."""
    with _exit_codes(debug):
        _need_viser("nothing else shows a run in three dimensions; report.html has its figures")
        from torchid.scene.finished import FinishedRun
        from torchid.scene.player import Player
        from torchid.scene.server import close_page, open_page

        run = FinishedRun(out)
        server, address = open_page(port, host)
        try:
            player = Player(server, run)
            _announce(address)
            with suppress(KeyboardInterrupt), closing(player):
                player.play(seconds)
        finally:
            close_page(server)


@app.command()
def simulate(config: ConfigFile, overrides: Overrides = None, debug: Debug = False) -> None:
    """A synthetic subject, written as C3D, with effects planted on request."""
    with _exit_codes(debug):
        from torchid.config import load_config

        loaded = load_config(config, overrides or ())
        from torchid.run import run_simulation

        with progress_bars() as progress:
            run_simulation(loaded, progress)
        Terminal().print(f"Done: {loaded.out}", soft_wrap=True, highlight=False, markup=False)


@app.command()
def check(
    what: Annotated[
        list[str],
        typer.Argument(metavar="CONFIG [KEY=VALUE]... | FILE... | FOLDER...", help="A config, or recordings."),
    ],
    json: Annotated[bool, typer.Option("--json", help="As JSON (docs/check.schema.json).")] = False,
    debug: Debug = False,
) -> None:
    """What is wrong with the recordings, before any fit; ends with 2 where there is a problem."""
    with _exit_codes(debug):
        from torchid.checks.as_json import report, to_json

        found = report(_findings(what) if json else _shown(_findings(what)))
        if json:
            typer.echo(to_json(found))
        if found.defects:
            raise typer.Exit(1)
        if not found.clean:
            raise typer.Exit(InputError.exit_code)


def _new_config(folder: Path, output: Path | None, given: _Given, keep: bool = False, quiet: bool = False) -> Path:
    """Write the config of a folder's session, and say what was chosen.

    Args:
        keep: use a config of the folder that is there already, instead of refusing to write over it.
        quiet: say nothing.
    """
    from rich.table import Table

    from torchid.folder.proposal import propose
    from torchid.folder.said import said_of
    from torchid.folder.statements import SEXES, Person
    from torchid.folder.writing import refuse_other, refuse_taken, write_config

    if output is not None:
        refuse_taken(output)
    sex = given.sex and SEXES.get(given.sex.lower(), given.sex)
    with progress_bars() as progress:
        proposal = propose(folder, Person(*given[:3], sex, given.age_years), progress)
    config, console = output or Path(f"{proposal.name}.yaml"), Terminal(quiet=quiet)
    if keep and config.exists():
        refuse_other(config, folder)
        if given[1:] != _Given()[1:]:
            raise _person_twice(config)
        console.print(f"{config} is used; remove it to start from files again", highlight=False, markup=False)
        return config
    written = write_config(proposal, config)
    table = Table(show_header=False, box=None, pad_edge=False)
    for word, text in said_of(proposal, config):
        table.add_row(Text(word, style="dim"), Text(text))
    console.print(table)
    said = f"wrote {' and '.join(map(str, written))}"
    console.print(said, soft_wrap=True, highlight=False, markup=False)
    return config


def _person_twice(config: Path) -> ConfigError:
    """The refusal of facts about a person beside a config."""
    return ConfigError(
        "cli.person", "a config says itself whom it is about", source=str(config),
        remedy="Change it there, or give them as subject.mass_kg=62.6",
    )  # fmt: skip


def _live_page(port: int, host: str) -> Callable:
    """Opens the page of a stream."""
    _need_viser("or give --headless")
    from torchid.live.display.page import Address, Page

    return lambda subject, source: Page(subject, source.labels, source.plates, Address(port, host))


def _need_viser(otherwise: str) -> None:
    if find_spec("viser") is None:
        raise ConfigError(
            "scene.no_viser", "the page needs the package viser, which is not installed", found="no viser",
            remedy=f"pip install 'torchid[live]'; {otherwise}",
        )  # fmt: skip


def _announce(address: str) -> None:
    complain(f"open {address} in a browser")


def _findings(what: list[str]) -> Iterator:
    """What there is to say of a config's session, or of the recordings of a list, one after the other."""
    if Path(what[0]).suffix.lower() in CONFIG_SUFFIXES:
        from torchid.config import load_config
        from torchid.evaluation.foreseen import foreseen
        from torchid.session.checking import check_session

        config = load_config(what[0], what[1:])
        yield from check_session(config)
        yield from foreseen(config)
    else:
        from torchid.checks.report import Given, check_recordings
        from torchid.io.files import recording_name
        from torchid.io.pairing import pair_files

        pairs = pair_files([Path(text) for text in what])
        yield from check_recordings(Given(recording_name(file), file, forces) for file, forces in pairs)


def _shown(findings: Iterator) -> Iterator:
    """The same, each shown when it comes: errors on stderr, all else on stdout."""
    from torchid.checks.recording import TrialCheck, format_check
    from torchid.checks.report import Refusal

    console = unbroken()
    for finding in findings:
        if isinstance(finding, TrialCheck):
            console.print(format_check(finding))
        elif isinstance(finding, Refusal):
            complain(finding.text)
        else:
            console.print(f"  {finding}", style="dim", highlight=False, markup=False)
        yield finding


@contextmanager
def _exit_codes(debug: bool) -> Iterator[None]:
    """Errors become a line each on stderr and an exit code (module docstring); ``debug`` adds the traceback."""
    from torchid.storage.logs import configure_logging

    configure_logging(debug)
    seldom_collect()
    # As `threads` of a config, before torch is imported: threads that share small matrices mostly wait for each other.
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    try:
        yield
    except (typer.Exit, typer.Abort):
        raise
    except TorchidError as error:
        complain(error, debug)
        raise typer.Exit(error.exit_code) from None
    except KeyboardInterrupt:
        complain("interrupted; the next run continues from here")
        raise typer.Exit(130) from None
    except Exception as error:
        complain(f"a defect of torchid: {said_of_defect(error)} (the traceback: --debug)", debug)
        raise typer.Exit(1) from None


if __name__ == "__main__":
    app()
