"""Deviations that runs state hold for people whose bodies are known."""

import numpy as np
import pytest
from batteries.coverage import KINDS, QUANTITIES, asked, plan, table
from draws import seed_of

PEOPLE = 2
"""Of each kind."""


@pytest.mark.slow
@pytest.mark.battery
def test_bands_hold_for_people_of_both_simulators(tmp_path):
    """Of segments of eight people, skin and all, most lie within one deviation and nearly all within two.

    Bars are far below 68 and 95 %: values of one person go together.
    """
    rows = [asked(job, tmp_path) for job in plan(seed_of(__name__) % 10**6, PEOPLE).values()]
    found = [row["found"] for row in rows if "found" in row]
    assert len(found) >= len(rows) - 1, [row.get("refused") for row in rows]
    for name in ("mass", "centre of mass", "moment of inertia"):
        error, sd = np.concatenate([np.array(one[name]) for one in found], axis=1)
        z = np.abs(error / sd)
        assert (z < 1.0).mean() > 0.5 and (z < 1.96).mean() > 0.8 and (z > 4.0).mean() < 0.05, (name, z)


def test_the_table_counts_what_lies_within():
    """Of values one half, one and a half, three and five deviations off."""
    values = [[0.5, 1.5, 3.0, -5.0], [1.0, 1.0, 1.0, 1.0]]
    kind, level = KINDS[0]
    rows = [{"kind": kind, "level": level, "found": dict.fromkeys(QUANTITIES, values)}]
    said = table([*rows, {"kind": kind, "level": level, "refused": "why"}])
    assert said[1].split()[-7:] == ["1", "25", "50.0", "25.0", "1", "3.02", "kg"] and said[-1] == "refused: why"
