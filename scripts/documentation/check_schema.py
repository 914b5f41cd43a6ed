"""Writes the JSON schema of ``torchid check --json``: ``PYTHONPATH=scripts python -m documentation.check_schema``."""

import json
from pathlib import Path

from torchid.checks.as_json import schema

PAGE = Path(__file__).resolve().parents[2] / "docs" / "check.schema.json"


def text() -> str:
    """What the file must hold."""
    return json.dumps(schema(), indent=2) + "\n"


if __name__ == "__main__":
    PAGE.write_text(text(), encoding="utf-8")
