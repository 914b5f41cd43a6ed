"""Whom a cohort has: rows of a table of subjects, or folders of a tree."""

import csv
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any

import pandas as pd

from torchid.errors import ConfigError, InputError
from torchid.folder.statements import HEAVIEST_KG, OLDEST_YEARS, SEXES, SMALLEST_M, TALLEST_M, Person
from torchid.io.files import container_of, is_derivative
from torchid.io.pairing import is_recording, visible_files
from torchid.storage.files import safe_name
from torchid.storage.results import STATE
from torchid.storage.table_forms import refuse_missing
from torchid.wording import listing

PARQUET = ".parquet"
TABLES = (".csv", ".tsv", PARQUET)
NAME, FOLDER, CONFIG = "subject", "folder", "config"
"""Columns of a table that say who it is, and where the recordings or a config of them are."""
FACTS = tuple(one.name for one in fields(Person) if one.name != "name")
"""Columns that say what is known of the person."""
LEAST = {"mass_kg": 0.0, "height_m": SMALLEST_M, "age_years": 0.0}
MOST = {"mass_kg": HEAVIEST_KG, "height_m": TALLEST_M, "age_years": OLDEST_YEARS}
"""Between which a fact is somebody's."""
BEYOND = "beyond the columns"
"""Key of what a line has more than there are columns."""
RESERVED = ("cohort", "groups", "laboratories", "people", "rows", "configs", "logs")
"""Names of files and folders of a cohort."""
LABELS = ("group", "session", "laboratory")
"""Columns that are taken over into the table of results."""


@dataclass(frozen=True)
class Participant:
    """One session of one subject."""

    name: str
    """Of the row, and of the folder of results."""
    source: Path
    """A folder of recordings, or a config."""
    person: Person = Person()
    """What the table says of the subject."""
    labels: Mapping[str, str] = field(default_factory=dict)
    """Group, session and laboratory, where the table has them."""


def parts_of(member: Participant, row: Mapping[str, Any]) -> tuple[Participant, ...]:
    """Return a member for each person whom a run has found in one folder; none where it has found one person.

    Args:
        member: whose folder it is.
        row: what the run left.
    """
    people = row.get("people", ())
    return tuple(
        replace(member, name=f"{member.name}_{who}", person=replace(member.person, name=who)) for who in people
    )


def members_of(where: Path) -> tuple[Participant, ...]:
    """Return whom a table or a tree of folders names, in its order.

    A table has a line for every session: ``subject``, ``folder`` or ``config`` (relative to the table), and if they are
    known ``mass_kg``, ``height_m`` and other facts, ``group``, ``session``, ``laboratory``. In a tree every folder with
    recordings, or a file that holds many, is a subject, or every ``sub-*/ses-*`` a session, where there are such.
    That a folder shows several people is found when it is run (``parts_of``).

    Args:
        where: a CSV, TSV or Parquet file, or a folder.

    Raises:
        ConfigError: ``cohort.table``, all faults of the table at once; ``cohort.names``.
        InputError: ``cohort.absent``; ``cohort.empty`` where nobody is named.
    """
    if not where.exists():
        raise InputError(
            "cohort.absent", "no such table or folder", source=str(where), remedy="Name a CSV of subjects, or a folder"
        )
    found = tuple(_of_tree(where)) if where.is_dir() else _of_table(where)
    refuse_names(found, where)
    if not found:
        raise InputError(
            "cohort.empty", "nobody is named", source=str(where), found="no line" if where.is_file() else "no folder",
            remedy=f"Give a line for each session ({NAME},{FOLDER},...), or a folder that holds one folder of each",
        )  # fmt: skip
    return found


def person_of(name: str) -> str:
    """Return whose session a member is: of BIDS' names, the subject's; any other names a person.

    Args:
        name: of the member.
    """
    subject, _, session = name.partition("_ses-")
    return subject if session and subject.startswith("sub-") else name


def refuse_names(members: Sequence[Participant], where: Path) -> None:
    """Refuse members whose results would lie in one place, or in the cohort's own.

    Args:
        members: all of them.
        where: table or tree that names them.

    Raises:
        ConfigError: ``cohort.names``.
    """
    faults = list(_of_names(members))
    if faults:
        raise ConfigError(
            "cohort.names", "results of two cannot lie in one folder", source=str(where), found=listing(faults, 12),
            remedy="Give each another name",
        )  # fmt: skip


def _of_names(members: Sequence[Participant]) -> Iterator[str]:
    names = Counter(safe_name(one.name).casefold() for one in members)
    yield from (f"{name} names {count}" for name, count in names.items() if count > 1)
    yield from (f"{name} is a name of the cohort's own" for name in names if name.partition(".")[0] in RESERVED)


def _of_tree(where: Path) -> Iterator[Participant]:
    sessions = [one for one in where.glob("sub-*/ses-*") if one.is_dir()]
    others = [one for one in where.iterdir() if not any(one in session.parents for session in sessions)]
    others = [one for one in others if one.name.startswith("sub-")] if sessions else others
    for one in sorted([*sessions, *others]):
        own = (one / STATE).exists() or one.name.startswith(".")  # results, of a cohort say
        inside = visible_files(one) if one.is_dir() and not own and not is_derivative(one) else ()
        if container_of(one) == one:
            yield Participant(one.stem, one.resolve())
        elif any(map(is_recording, inside)):
            yield Participant("_".join(one.relative_to(where).parts), one.resolve())


def _of_table(where: Path) -> tuple[Participant, ...]:
    if where.suffix.lower() not in TABLES:
        raise ConfigError(
            "cohort.table", "not a known kind of table", source=str(where), found=where.suffix or "no ending",
            remedy="Save it as CSV",
        )  # fmt: skip
    head, rows = _read(where)
    faults = list(_of_head(head))
    found: list[Participant] = []
    for number, row in () if faults else rows:
        try:
            found.append(_member(row, where.parent))
        except ValueError as fault:
            faults.append(f"line {number}: {fault}")
    if faults:
        raise ConfigError(
            "cohort.table", "the table of subjects is at fault", source=str(where), found=listing(faults, 12),
            remedy="Mend these lines; nothing was run",
        )  # fmt: skip
    return tuple(found)


def _read(where: Path) -> tuple[Sequence[str], list[tuple[int, dict[str, str]]]]:
    """Columns and lines with their numbers in the file; empty lines are passed over."""
    if where.suffix.lower() == PARQUET:
        return _read_parquet(where)
    text = _text(where)
    first = text.partition("\n")[0]
    delimiter = "\t" if where.suffix.lower() == ".tsv" else ";" if first.count(";") > first.count(",") else ","
    reader = csv.reader(text.splitlines(), delimiter=delimiter)
    head = [cell.strip().lower() for cell in next(reader, [])]
    rows = []
    for row in reader:
        cells = [cell.strip() for cell in row]
        more = [cell for cell in cells[len(head) :] if cell]
        if any(cells):
            known = dict(zip(head, cells, strict=False))
            rows.append((reader.line_num, known | ({BEYOND: f"{len(cells)} cells"} if more else {})))
    return head, rows


def _text(where: Path) -> str:
    """The text of a file in UTF-8, or as spreadsheets of Western Europe write it."""
    data = where.read_bytes()
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("cp1252", errors="replace")


def _read_parquet(where: Path) -> tuple[Sequence[str], list[tuple[int, dict[str, str]]]]:
    refuse_missing(("parquet",))
    try:
        frame = pd.read_parquet(where, engine="pyarrow")
    except (OSError, ValueError) as error:
        raise ConfigError(
            "cohort.table", "cannot be read as Parquet", source=str(where), found=str(error)[:120],
            remedy="Write the table again, or as CSV",
        ) from error  # fmt: skip
    head = [str(name).strip().lower() for name in frame.columns]
    cells = [["" if pd.isna(cell) else str(cell).strip() for cell in row] for row in frame.itertuples(index=False)]
    return head, [(number, dict(zip(head, row, strict=True))) for number, row in enumerate(cells, 1)]


def _of_head(head: Sequence[str]) -> Iterator[str]:
    known = (NAME, FOLDER, CONFIG, *FACTS, *LABELS)
    if NAME not in head:
        yield f"no column {NAME}"
    if not {FOLDER, CONFIG} & set(head):
        yield f"neither a column {FOLDER} nor {CONFIG}"
    strange = [one or "without a name" for one in head if one not in known]
    if strange:
        yield f"unknown column {listing(strange)} (known: {listing(list(known), len(known))})"
    yield from (f"two columns {one}" for one, count in Counter(head).items() if count > 1)


def _member(row: Mapping[str, str], base: Path) -> Participant:
    """A line as a member.

    Raises:
        ValueError: what is wrong with it.
    """
    if BEYOND in row:
        raise ValueError(f"{row.get(NAME, '')}: {row[BEYOND]}, more than columns; a number has a point, not a comma")
    name, places = row.get(NAME, ""), [row[key] for key in (FOLDER, CONFIG) if row.get(key)]
    if not name:
        raise ValueError(f"no {NAME}")
    if len(places) != 1:
        raise ValueError(f"{name}: needs either a {FOLDER} or a {CONFIG}")
    source = (base / places[0]).resolve()
    holds = source.is_dir() or source.is_file() and container_of(source) == source
    if not (holds if row.get(FOLDER) else source.is_file()):
        raise ValueError(f"{name}: no {FOLDER if row.get(FOLDER) else CONFIG} {places[0]}")
    facts: dict[str, Any] = {key: _fact(key, row[key], name) for key in FACTS if row.get(key)}
    if facts and row.get(CONFIG):
        raise ValueError(f"{name}: its config says whom it is about ({listing(list(facts))} given here, too)")
    return Participant(name, source, Person(name=name, **facts), {key: row[key] for key in LABELS if row.get(key)})


def _fact(key: str, text: str, name: str) -> Any:
    if key == "sex":
        if text.lower() not in SEXES:
            raise ValueError(f"{name}: sex is neither male nor female: {text[:40]}")
        return SEXES[text.lower()]
    try:
        value = float(text.replace(",", "."))
    except ValueError:
        raise ValueError(f"{name}: {key} is no number: {text[:40]}") from None
    if not LEAST[key] < value < MOST[key]:
        raise ValueError(f"{name}: {key} is nobody's: {text[:40]}")
    return value
