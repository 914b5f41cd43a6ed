"""The sequence of a cohort: who is missing is run, who fails is set aside, and table and page have everybody."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from torchid.cohort.cluster import ended, workers
from torchid.cohort.members import Participant, parts_of, refuse_names
from torchid.cohort.one_run import Row
from torchid.cohort.page import render_cohort
from torchid.cohort.people_section import NAME as PEOPLE
from torchid.cohort.people_section import cohort_people, people_section
from torchid.cohort.shared_faults import NAME as LABORATORIES
from torchid.cohort.shared_faults import laboratories_section, laboratories_table
from torchid.cohort.table import cohort_table
from torchid.cohort.task import TRIES, RunLimits, log_path, perform, stored
from torchid.errors import ConfigError
from torchid.storage.files import safe_name, write_text
from torchid.storage.results import OutputFolder
from torchid.storage.table_forms import Form, installed
from torchid.storage.tables import write_table

if TYPE_CHECKING:
    from distributed import Client

FORMS: tuple[Form, ...] = ("parquet",)
"""Forms of the table beside CSV, where what writes them is installed."""
NAME = "cohort"
"""Of the table's and the page's files."""
OnRow = Callable[[Row, int, int], None]
"""Is told each row, how many are done, and of how many."""


def missing(members: Sequence[Participant], out: Path) -> tuple[dict[str, Row], list[Participant]]:
    """Return rows that an earlier call left and that still hold, by subject, and the members that have none.

    Args:
        members: all of them.
        out: folder of the cohort.
    """
    rows: dict[str, Row] = {}
    left: list[Participant] = []
    for member in members:
        row = stored(member, out)
        if row is None:
            left.append(member)
            continue
        rows[member.name] = row
        more, others = missing(parts_of(member, row), out)
        rows, left = rows | more, left + others
    return rows, left


def everybody(members: Sequence[Participant], rows: Mapping[str, Row]) -> list[Participant]:
    """Return the members, those of a folder that shows several people in place of that folder.

    Args:
        members: all of them.
        rows: by subject; who has none stands for himself.
    """
    each = ((member, parts_of(member, rows.get(member.name, {}))) for member in members)
    return [one for member, parts in each for one in parts or (member,)]


def run_cohort(
    members: Sequence[Participant], out: Path, limits: RunLimits, count: int | None = None,
    scheduler: str | None = None,
    on_row: OnRow = lambda row, done, total: None, on_cluster: Callable[[str], None] = lambda address: None,
) -> list[Row]:  # fmt: skip
    """Run who is missing, and write table and page of all.

    Args:
        members: all of them.
        out: folder of the cohort; members' results go into folders of it.
        limits: what one run may take.
        count: workers on this machine; None for as many as it holds.
        scheduler: of a cluster that is there; its workers see the same files.
        on_row: is told each row when it is there.
        on_cluster: is told the address of the dashboard.

    Returns:
        The rows, in the order of the members.

    Raises:
        ConfigError: ``cohort.no_dask``, ``cohort.scheduler``; ``cohort.inside`` for results among recordings;
            ``cohort.names`` where a person of a folder is called as another member.
        InputError: ``results.locked`` while another call works there, or a file cannot be written.
    """
    _refuse_inside(members, out.resolve())
    with OutputFolder(out, beside=True) as folder:
        folder.claim([*(f"{NAME}.{ending}" for ending in ("csv", "html", *FORMS)), LABORATORIES, PEOPLE])
        rows, left = missing(members, folder.out)

        def tell(some: Iterable[Row]) -> None:
            everyone = everybody(members, rows)
            done = sum(one.name in rows for one in everyone)
            for row in some:
                if not row.get("people"):
                    on_row(row, done, len(everyone))

        tell(rows.values())
        if left:
            with workers(count, scheduler) as client:
                on_cluster(client.dashboard_link or "")
                for row in _completed(client, members, left, folder.out, limits):
                    rows[row["subject"]] = row
                    tell([row])
        found = [rows[member.name] for member in everybody(members, rows)]
        write_table(cohort_table(found, folder.out), NAME, installed(FORMS), folder.path)
        told = laboratories_section(laboratories_table(found, folder)), people_section(cohort_people(found, folder))
        write_text(folder.path(f"{NAME}.html"), render_cohort(found, folder.out, told))
    return found


def _refuse_inside(members: Sequence[Participant], out: Path) -> None:
    """Refuse results among recordings, which they would change for the next call."""
    for member in members:
        own = out / safe_name(member.name)
        if member.source in (own, out, *own.parents):
            raise ConfigError(
                "cohort.inside", "results would lie among recordings", place=member.name, found=str(own),
                remedy="Give another folder with -o",
            )  # fmt: skip


def _completed(
    client: "Client", members: Sequence[Participant], left: Sequence[Participant], out: Path, limits: RunLimits
) -> Iterator[Row]:  # fmt: skip
    """Rows of members, and of the people that their folders turn out to show."""
    while left:
        found: dict[str, Row] = {}
        for row in _performed(client, left, out, limits):
            found[row["subject"]] = row
            yield row
        parts = [part for one in left for part in parts_of(one, found[one.name])]
        refuse_names([*members, *parts], out)
        rows, left = missing(parts, out)
        yield from rows.values()


def _performed(client: "Client", members: Sequence[Participant], out: Path, limits: RunLimits) -> Iterator[Row]:
    """Rows in the order in which they are done; a worker that was killed costs the run that it was at."""
    waiting = {client.submit(perform, member, out, limits, pure=False, retries=TRIES): member for member in members}
    for future in ended(waiting):
        try:
            yield future.result()
        except Exception as error:  # a lost worker, a file that is gone: the others go on
            yield failed(waiting[future], out, error)
        future.release()


def failed(member: Participant, out: Path, error: BaseException) -> Row:
    """Return the row of a member whose task itself has failed, because its worker was lost again and again, say.

    Args:
        member: whose.
        out: folder of the cohort.
        error: what the cluster says.
    """
    reason = f"its task failed: {type(error).__name__}: {error}; log: {log_path(member, out)}"
    return {"subject": member.name, **member.labels, "status": "set aside", "reason": reason}
