"""What a cohort's sessions say of their laboratories together, as ``laboratories.json`` and on the page."""

import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from torchid.cohort.laboratories import Laboratory, laboratories
from torchid.cohort.one_run import Row
from torchid.cohort.pooling import LaboratoryVerdict, SharedFault, pooled
from torchid.diagnosis.verdict.records import level_of
from torchid.effects.catalogue import effect
from torchid.errors import InputError
from torchid.report.blocks import Block, Details, Paragraph, Section, Table
from torchid.report.cause_sentences import chance
from torchid.session.laboratory import NAME as EVIDENCE
from torchid.session.laboratory import SessionEvidence, laboratory_dataset, read_laboratory
from torchid.storage.files import file_sha256, plain, safe_name, write_json
from torchid.storage.netcdf import write_netcdf
from torchid.storage.provenance import stage_key
from torchid.storage.results import OutputFolder
from torchid.wording import ABSENT, clean, listing, number, plural

NAME = "laboratories.json"
"""Of the file in a cohort's folder."""
FEWEST = 2
"""Sessions of a laboratory from which on they are pooled; derived: one says nothing that its own verdict does not."""
Said = dict[str, Any]
"""What the file says of a laboratory, or of a fault."""


def laboratories_table(rows: Sequence[Row], folder: OutputFolder) -> Said:
    """Return what the sessions of each laboratory say together, and who says nothing of his, and write it, with a file
    for each laboratory that a config's ``laboratory`` takes.

    Nothing is computed again where no session has changed since an earlier call wrote it.

    Args:
        rows: of all members.
        folder: of the cohort, with each member's results, and what an earlier call wrote.

    Raises:
        InputError: the file cannot be written.
    """
    out = folder.out
    done = {row["subject"]: _labels(row) for row in rows if row["status"] == "done"}
    files = {name: out / safe_name(name) / EVIDENCE for name in done}
    signs = {name: file_sha256(file) if file.is_file() else "" for name, file in files.items()}
    key = stage_key(sessions=[[name, signs[name], *labels.values()] for name, labels in done.items()])
    said: Said = {}
    with suppress(OSError, ValueError):
        said = json.loads((out / NAME).read_text(encoding="utf-8"))
    if not _holds(said, key, out):
        found = {name: one for name, file in files.items() if (one := _read(file)) is not None}
        every = [pooled(one) for one in laboratories(found, done) if len(one.visits) >= FEWEST]
        for one in every:
            kept = SessionEvidence(one.expected, one.laboratory.plates, pooled=True)
            write_netcdf(folder.path(file_of(one.laboratory.name)), [laboratory_dataset(kept)])
        table = [plain(laboratory_table(one)) for one in every]
        said = {"key": key, "laboratories": table, "without": [name for name in done if name not in found]}
    write_json(folder.path(NAME), said)
    return said


def _holds(said: Any, key: str, out: Path) -> bool:
    """Whether what an earlier call wrote is of the same sessions, and all of it is there."""
    same = isinstance(said, dict) and said.get("key") == key
    return same and all((out / one["file"]).is_file() for one in said["laboratories"])


def file_of(laboratory: str) -> str:
    """Return the file, in a cohort's folder, of what a laboratory's sessions say of one more.

    Args:
        laboratory: its name.
    """
    return f"laboratories/{safe_name(laboratory)}.nc"


def _labels(row: Row) -> dict[str, str]:
    return {name: str(row.get(name) or "") for name in ("laboratory", "session")}


def _read(path: Path) -> SessionEvidence | None:
    """What a session says of its laboratory; None where it says nothing that can be read."""
    with suppress(InputError):
        return read_laboratory(path)
    return None


def laboratory_table(found: LaboratoryVerdict) -> Said:
    """Return what the sessions of a laboratory say together, as the file has it.

    Args:
        found: the pooled sessions.
    """
    home = found.laboratory
    return {
        "name": home.name,
        "file": file_of(home.name),
        "sessions": [one.name for one in home.visits],
        "plates": {one.frame.name: {"position_m": one.frame.p_WF.tolist()} for one in home.plates},
        "faults": [_fault(one, home) for one in found.faults],
        "scatter_prior_sd": found.scatter,
    }


def _fault(one: SharedFault, home: Laboratory) -> Said:
    names = ("effect", "where", "parameters", "confidence", "indistinguishable", "first", "last", "visits")
    said = {name: getattr(one, name) for name in names} | {"level": level_of(one.confidence)}
    return said | {"sentence": effect(one.effect).sentence(one), "throughout": len(one.visits) == len(home.visits)}


def laboratories_section(said: Mapping[str, Any]) -> Section | None:
    """Return the chapter of the page; None where no two sessions share a laboratory.

    Args:
        said: what ``laboratories.json`` has.
    """
    table = said["laboratories"]
    if not table:
        return None
    count = f"{len(table)} {'laboratory' if len(table) == 1 else 'laboratories'} with several sessions"
    faults = [(home, fault) for home in table for fault in home["faults"]]
    sure = sum(fault["level"] != "possible" for _, fault in faults)
    finding = (
        f"{count}; {plural(sure, 'fault')} that sessions share." if sure else f"{count}; no fault that they share."
    )
    blocks: list[Block] = []
    if faults:
        blocks += [
            Table(
                "Told by sessions together. One alone mostly cannot tell it.",
                ("Laboratory", "What is wrong", "Sessions", "Or it is", "Sure"),
                tuple(_line(*both) for both in faults), 5, True,
            ),
            Details("Plates, by the laboratory's numbers", (
                Table("", ("Laboratory", "Plate", "x [m]", "y [m]"), tuple(_plates(table)), 2),
            )),
        ]  # fmt: skip
    sessions = tuple((clean(h["name"]), str(len(h["sessions"])), clean(listing(h["sessions"], 6), 300)) for h in table)
    blocks.append(Table("Sessions on the same plates.", ("Laboratory", "number", "Sessions"), sessions, 3, True))
    if said["without"]:
        names = clean(listing(said["without"], 6), 300)
        blocks.append(Paragraph(f"Without a word of their laboratory: {names}."))
    return Section("laboratories", "Laboratories", finding, tuple(blocks), "care" if sure else "")


def _plates(table: Sequence[Mapping[str, Any]]) -> Iterator[tuple[str, ...]]:
    for home in table:
        for name, plate in home["plates"].items():
            place = [number(x, 2) for x in plate["position_m"][:2]]
            if ABSENT not in place:  # a plate that bore nothing is nowhere
                yield clean(home["name"]), clean(name), *place


def _line(home: Mapping[str, Any], fault: Mapping[str, Any]) -> tuple[str, ...]:
    span = "all" if fault["throughout"] else f"from {fault['first']} to {fault['last']}"
    others = [effect(name).noun for name, _ in fault["indistinguishable"]]
    sentence = fault["sentence"]
    return (
        clean(home["name"]), clean(sentence[:1].upper() + sentence[1:], 300), clean(span, 200),
        clean(listing(others, 2), 120), chance(fault["confidence"]),
    )  # fmt: skip
