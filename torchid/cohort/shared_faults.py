"""What a cohort's sessions say of their laboratories together, as ``laboratories.json`` and on the page."""

import json
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from torchid.cohort.laboratories import Laboratory, laboratories
from torchid.cohort.one_run import Row
from torchid.cohort.pooling import LaboratoryVerdict, SharedFault, pooled
from torchid.diagnosis.verdict.records import CERTAIN, EVEN
from torchid.effects.catalogue import effect
from torchid.errors import InputError
from torchid.report.blocks import Section, Table
from torchid.report.cause_sentences import chance
from torchid.session.laboratory import NAME as EVIDENCE
from torchid.session.laboratory import SessionEvidence, read_laboratory
from torchid.storage.files import plain, safe_name, write_json
from torchid.storage.provenance import stage_key
from torchid.wording import clean, listing, plural

NAME = "laboratories.json"
"""Of the file in a cohort's folder."""
FEWEST = 2
"""Sessions of a laboratory from which on they are pooled; derived: one says nothing that its own verdict does not."""
Said = dict[str, Any]
"""What the file says of a laboratory, or of a fault."""


def laboratories_table(rows: Sequence[Row], out: Path, path: Path) -> list[Said]:
    """Return what the sessions of each laboratory say together, and write it.

    Nothing is computed again where no session has changed since the file was written.

    Args:
        rows: of all members.
        out: folder of the cohort, with each member's results.
        path: of ``laboratories.json``.

    Raises:
        InputError: the file cannot be written.
    """
    done = [row for row in rows if row["status"] == "done"]
    key = stage_key(rows=[[row["subject"], row.get("content", ""), *_labels(row).values()] for row in done])
    with suppress(OSError, ValueError, KeyError, TypeError):
        said = json.loads(path.read_text(encoding="utf-8"))
        if said["key"] == key:
            return said["laboratories"]
    found = _sessions(done, out)
    every = laboratories(found, {row["subject"]: _labels(row) for row in done})
    table = [plain(laboratory_table(pooled(one))) for one in every if len(one.visits) >= FEWEST]
    write_json(path, {"key": key, "laboratories": table})
    return table


def _labels(row: Row) -> dict[str, str]:
    return {name: str(row.get(name) or "") for name in ("laboratory", "session")}


def _sessions(rows: Sequence[Row], out: Path) -> dict[str, SessionEvidence]:
    """What each session says; those without any evidence of their laboratory are left out."""
    found = {}
    for row in rows:
        path = out / safe_name(row["subject"]) / EVIDENCE
        with suppress(InputError):
            found[row["subject"]] = read_laboratory(path)
    return found


def laboratory_table(found: LaboratoryVerdict) -> Said:
    """Return what the sessions of a laboratory say together, as the file has it.

    Args:
        found: the pooled sessions.
    """
    home = found.laboratory
    return {
        "name": home.name,
        "sessions": [one.name for one in home.visits],
        "plates": {one.name: {"position_m": one.position.tolist()} for one in home.plates},
        "faults": [_fault(one, home) for one in found.faults],
        "scatter_prior_sd": found.scatter,
    }


def _fault(one: SharedFault, home: Laboratory) -> Said:
    names = ("effect", "where", "parameters", "confidence", "indistinguishable", "first", "last", "visits")
    level = "certain" if one.confidence > CERTAIN else "likely" if one.confidence > EVEN else "possible"
    said = {name: getattr(one, name) for name in names} | {"level": level}
    return said | {"sentence": effect(one.effect).sentence(one), "throughout": len(one.visits) == len(home.visits)}


def laboratories_section(table: Sequence[Mapping[str, Any]]) -> Section | None:
    """Return the chapter of the page; None where no two sessions share a laboratory.

    Args:
        table: what ``laboratories.json`` has.
    """
    if not table:
        return None
    lines = [_line(home, fault) for home in table for fault in home["faults"]]
    count = f"{len(table)} {'laboratory' if len(table) == 1 else 'laboratories'}"
    sure = [one for home in table for one in home["faults"] if one["level"] != "possible"]
    finding = f"{count} with several sessions; {plural(len(sure), 'fault')} that all sessions of one share."
    if not sure:
        finding = f"{count} with several sessions; no fault that the sessions of one share."
    sessions = Table(
        "Sessions on the same plates are one laboratory's.", ("Laboratory", "Sessions", "number"),
        tuple((clean(h["name"]), clean(listing(h["sessions"], 6), 300), str(len(h["sessions"]))) for h in table), 2,
    )  # fmt: skip
    if not lines:
        return Section("laboratories", "Laboratories", finding, (sessions,))
    faults = Table(
        "Told by all sessions together; a single one mostly cannot.",
        ("Laboratory", "What is wrong", "Sessions", "Or it is", "Sure"), tuple(lines), 5, True,
    )  # fmt: skip
    return Section("laboratories", "Laboratories", finding, (faults, sessions), "care" if sure else "")


def _line(home: Mapping[str, Any], fault: Mapping[str, Any]) -> tuple[str, ...]:
    span = "all" if fault["throughout"] else f"from {fault['first']} to {fault['last']}"
    others = [effect(name).noun for name, _ in fault["indistinguishable"]]
    sentence = fault["sentence"]
    return (
        clean(home["name"]), clean(sentence[:1].upper() + sentence[1:], 300), clean(span, 200),
        clean(listing(others, 2), 120), chance(fault["confidence"]),
    )  # fmt: skip
