"""Figures of long measurements, kept beside the scripts until they are measured again."""

import datetime
import json
from pathlib import Path
from typing import Any

RECORDS = Path(__file__).resolve().parents[1] / "reliability.json"


def record(name: str, figures: dict[str, Any]) -> None:
    """Note figures under a name, with the date."""
    found = recorded() | {name: figures | {"date": datetime.date.today().isoformat()}}
    RECORDS.write_text(json.dumps(dict(sorted(found.items())), indent=1) + "\n", encoding="utf-8")


def recorded() -> dict[str, dict[str, Any]]:
    """All figures noted so far."""
    return json.loads(RECORDS.read_text(encoding="utf-8")) if RECORDS.is_file() else {}
