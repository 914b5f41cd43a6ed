"""The table of a cohort, a row a subject, and what its columns mean."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import pandas as pd

from torchid.cohort.members import LABELS
from torchid.cohort.one_run import Row
from torchid.storage.files import safe_name


class Column(NamedTuple):
    """One column."""

    name: str
    """Ends in the unit where there is one."""
    meaning: str


COLUMNS = (
    Column("subject", "name of the row, and of the folder of its results"),
    *(Column(name, "as the table of subjects has it") for name in LABELS),
    Column("status", "done, or set aside"),
    Column("reason", "why it was set aside, or why its verdict is not good"),
    Column("verdict", "good, usable with care, do not use: the verdict of its report"),
    Column("mass_kg", "identified total mass"),
    Column("mass_sd_kg", "its standard deviation"),
    Column("recorded_kg", "mass on record"),
    Column("marker_rmse_mm", "distance of markers from the model, RMS over all trials"),
    Column("heldout_force_N", "residual force in trials that no fit has seen, RMS"),
    Column("heldout_moment_Nm", "residual moment at the root in these trials, RMS"),
    Column("causes", "what the diagnosis finds at least likely, with semicolons between"),
    Column("seconds", "time that it took, all tries together"),
    Column("report", "its report, from the folder of the table"),
)
"""In the order of the table."""


def cells(row: Row, out: Path) -> list[Any]:
    """Return a member's cells, None where nothing is known.

    Args:
        row: as its task left it.
        out: folder of the cohort.
    """
    report = f"{safe_name(row['subject'])}/report.html"
    more = {
        "reason": row.get("reason") or (row.get("because", "") if row.get("verdict") != "good" else ""),
        "causes": "; ".join(row.get("causes", ())),
        "report": report if (out / report).is_file() else "",
    }
    known = [(row | more).get(one.name) for one in COLUMNS]
    # A name of a folder may be no text.
    return [cell.encode("utf-8", "replace").decode() if isinstance(cell, str) else cell for cell in known]


def cohort_table(rows: Sequence[Row], out: Path) -> pd.DataFrame:
    """Return the table of all members, a row each.

    Args:
        rows: as their tasks left them.
        out: folder of the cohort.
    """
    return pd.DataFrame([cells(row, out) for row in rows], columns=[one.name for one in COLUMNS])
