"""Several subjects' evaluations tested together."""

import json
from pathlib import Path

import numpy as np
import pytest

from torchid.config.conditions import EvaluateOptions
from torchid.errors import InputError
from torchid.evaluation.subjects import compare_subjects, read_subjects, subjects_table

OPTIONS = EvaluateOptions(permutations=999)


def table(name: str, values: dict[str, float | None]) -> dict:
    """What an evaluation of one subject leaves of its differences."""
    rows = [{"condition": "on", "where": where, "measure": "peak_torque_Nm", "value": v} for where, v in values.items()]
    conditions = {"off": {}, "on": {}}
    return {"subject": name, "reference": "off", "conditions": conditions, "differences": rows,
            "template": {"differences": rows[:1]}}  # fmt: skip


def test_a_change_that_all_subjects_share_is_found(seed):
    """One joint lower in eight subjects, another one as it comes; a measure that two subjects lack is still tested."""
    rng = np.random.default_rng(seed)
    tables = [
        table(f"S{k}", {"hip": float(rng.normal(-8.0, 1.0)), "knee": float(rng.choice([-1, 1]) * (0.5 + rng.random())),
                        "ankle": None if k < 2 else -3.0 - rng.random()}) for k in range(8)
    ]  # fmt: skip
    found = {one.body: one for one in compare_subjects(tables, OPTIONS, seed)}
    hip = found["identified"]
    assert [c.where for c in hip.columns] == ["hip", "knee", "ankle"] and hip.least_p == 2 / 256
    assert float(hip.tested.adjusted[0]) <= 0.05 and float(hip.difference.high[0]) < 0.0
    assert len(found["template"].columns) == 1
    rows = subjects_table(tuple(found.values()), 0.05)
    assert [row["found"] for row in rows if row["where"] == "hip"] == [True, True]


def test_signs_of_subjects_are_wrong_as_rarely_as_they_say(seed):
    """Ten correlated measures of six subjects without an effect: a finding in at most 5 % of 200, within chance."""
    rng, wrong = np.random.default_rng(seed), 0
    for k in range(200):
        common = rng.normal(size=(6, 1))
        values = common + rng.normal(size=(6, 10))
        tables = [table(f"S{s}", {f"j{c}": float(values[s, c]) for c in range(10)}) for s in range(6)]
        found = compare_subjects(tables, OPTIONS, k)[0]
        wrong += bool((found.tested.adjusted <= 0.05).any())
    assert wrong <= 25


def test_a_folder_without_an_evaluation_is_refused(tmp_path: Path):
    """Missing, damaged or another file."""
    for content in (None, "{", json.dumps({"subject": "a"})):
        if content is not None:
            (tmp_path / "evaluation.json").write_text(content)
        with pytest.raises(InputError) as caught:
            read_subjects([tmp_path])
        assert caught.value.code == "evaluate.subject" and caught.value.remedy
