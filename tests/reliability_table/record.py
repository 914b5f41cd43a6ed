"""Figures of long measurements, kept here until they are measured again."""

import datetime
import json
from dataclasses import asdict, dataclass
from pathlib import Path

RECORDS = Path(__file__).with_name("reliability.json")


@dataclass(frozen=True)
class Figure:
    """What was measured of a goal."""

    text: str
    reached: bool | None
    """None: not decided by this measurement."""
    command: str
    date: str = ""


def record(name: str, text: str, reached: bool | None, command: str) -> None:
    """Note a figure with the date; ``name`` is a goal's (G8), or of a part of one (G2 trc)."""
    figure = Figure(text, reached, command, datetime.date.today().isoformat())
    found = {key: asdict(value) for key, value in recorded().items()} | {name: asdict(figure)}
    lines = (f"{json.dumps(key)}: {json.dumps(value)}" for key, value in sorted(found.items()))
    RECORDS.write_text("{\n" + ",\n".join(lines) + "\n}\n", encoding="utf-8")


def recorded() -> dict[str, Figure]:
    """All figures noted so far."""
    found = json.loads(RECORDS.read_text(encoding="utf-8")) if RECORDS.is_file() else {}
    return {name: Figure(**figure) for name, figure in found.items()}
