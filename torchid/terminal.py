"""What people read on a terminal: lines that cannot do harm, bars, errors, a verdict in colours."""

import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from rich.console import Console, ConsoleOptions, RenderableType
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    SpinnerColumn,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.segment import Segment
from rich.table import Table
from rich.text import Text

from torchid.wording import visible

if TYPE_CHECKING:
    from torchid.report.blocks import Light

UNBROKEN = 1 << 16
"""Width of what is not shown on a terminal: nobody but a terminal wants lines broken."""
MARKS = {"good": ("●", "green"), "usable with care": ("▲", "yellow"), "do not use": ("■", "red")}
"""Sign and colour of what a reader may do with a result."""
ITEM = "-"
"""Before each line of a list."""


class Terminal(Console):
    """Whatever is printed: a label of a file that holds terminal escapes is shown, not obeyed."""

    def render(self, renderable: RenderableType, options: ConsoleOptions | None = None) -> Iterable[Segment]:
        """The parts of what is printed; those that control the terminal are rich's own."""
        if isinstance(renderable, Text):
            renderable = renderable.copy()
            renderable.plain = visible(renderable.plain)  # before its lines are broken
        for part in super().render(renderable, options):
            yield part if part.control else Segment(visible(part.text), part.style)


class Bar:
    """The bars on the terminal, one a stage, as the callback of a run (``session.fitting.OnStage``)."""

    def __init__(self, bars: Progress) -> None:
        self.bars, self.tasks = bars, {}

    def __call__(self, stage: str, fraction: float) -> None:
        if stage not in self.tasks:
            self.tasks[stage] = self.bars.add_task(stage, total=1.0)
        self.bars.update(self.tasks[stage], completed=fraction)


@contextmanager
def progress_bars() -> Iterator[Bar]:
    columns = (SpinnerColumn(), TextColumn("{task.description}", markup=False), BarColumn(), TimeElapsedColumn())
    with Progress(*columns, console=Terminal(stderr=True), disable=not sys.stderr.isatty()) as bars:
        yield Bar(bars)


class CohortBar:
    """One bar for all subjects, with how many failed and the time that is left; without a terminal, a line each."""

    def __init__(self, bars: Progress) -> None:
        self.bars, self.task, self.failed = bars, bars.add_task("subjects", total=None, failed=""), 0

    def open(self, address: str) -> None:
        """Say where the cluster can be watched."""
        self.bars.console.print(f"workers: {address}", highlight=False, markup=False, soft_wrap=True)

    def __call__(self, row: "Mapping[str, Any]", done: int, total: int) -> None:
        self.failed += row["status"] != "done"
        failed = f"{self.failed} set aside" if self.failed else ""
        self.bars.update(self.task, completed=done, total=total, failed=failed)
        if self.bars.disable:
            said = f"{done} of {total}  {row['subject']}: {row['status']}"
            self.bars.console.print(said, highlight=False, markup=False, soft_wrap=True)


@contextmanager
def cohort_progress() -> Iterator[CohortBar]:
    columns = (
        SpinnerColumn(), TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(),
        TextColumn("{task.fields[failed]}"),
        TimeElapsedColumn(), TimeRemainingColumn(),
    )  # fmt: skip
    with Progress(*columns, console=Terminal(stderr=True), disable=not sys.stderr.isatty()) as bars:
        yield CohortBar(bars)


def complain(error: object, traceback: bool = False) -> None:
    console = Terminal(stderr=True)
    if traceback:
        console.print_exception()
    for line in str(error).split("\n"):
        console.print(f"torchid: {line}", soft_wrap=True, highlight=False, markup=False)


def unbroken() -> Terminal:
    """Return the standard output, with lines as long as they are where it is not shown on a terminal."""
    console = Terminal()
    return console if console.is_terminal else Terminal(width=UNBROKEN)


def print_lights(lights: "Sequence[Light]") -> None:
    """Print what one look tells of a run, each line with its sign.

    Args:
        lights: as the report has them.
    """
    table = Table(show_header=False, box=None, pad_edge=False)
    for light in lights:
        sign, colour = ("→", "blue") if light.level is None else MARKS[light.level.value]
        said = "\n".join((*filter(None, (light.text,)), *(f"{ITEM} {item}" for item in light.items)))
        table.add_row(Text(sign, style=colour), Text(light.about, style="bold"), Text(said))
    unbroken().print(table)
