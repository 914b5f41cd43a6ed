"""The trace says of every decision which rule made it and by which numbers, and the report says it in words."""

import ast
import re
from pathlib import Path

import numpy as np
import pytest
import small_session as small

from torchid.diagnosis.trace import StepKind, TraceStep
from torchid.report.decisions import RULES, odds, sentence, why

DIAGNOSIS = Path(__file__).resolve().parents[1] / "torchid"
RULE = re.compile(r'rule = "|"([a-z_]+)"')


def decided() -> set[str]:
    """Names of rules that steps are made with, from the code of the diagnosis and of the experiment."""
    found: set[str] = set()
    stages = [DIAGNOSIS / "extension" / name for name in ("swapped_markers.py", "publishing.py")]
    for path in [*(DIAGNOSIS / "diagnosis").rglob("*.py"), *stages]:
        for one in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(one, ast.Constant) and one.value in RULES:
                found.add(one.value)
    return found


def test_every_rule_has_its_words():
    """No rule of the report is without code, and every step of the code names a rule of the report."""
    assert decided() == set(RULES)


@pytest.mark.parametrize("rule", sorted(RULES))
@pytest.mark.parametrize("seems", [False, True])
def test_a_decision_is_a_sentence(rule, seems):
    """It names the cause, has a number, and no underscore, whatever the numbers are."""
    rng = np.random.default_rng(small.SEED)
    names = ("evidence_nats", "crossed_nats", "effect_nats", "least_nats", "heldout_nats",
             "background_nats", "missing_part", "lowest_sd", "least_part", "factor",
             "field_part", "p_value", "force_growth_part", "moment_growth_part",
             "markers_growth_part", "most_part", "misfit_mm", "undone_mm", "shift_mm")  # fmt: skip
    names = (*names, "apparent_nats") if seems else names
    numbers = {name: float(rng.normal(scale=30.0 if name.endswith("nats") else 0.4)) for name in names}
    said = sentence(TraceStep(StepKind.ENTER, "drag", ("thorax",), rule, numbers))
    assert said.startswith("A drag") and said.endswith(".") and "_" not in said and "nan" not in said
    assert re.search(r"\d|million", said)


def test_odds_are_what_a_person_reads():
    """A log likelihood ratio of zero is 1 : 1, of the logarithm of twelve 12 : 1, of less 1 : 12."""
    assert odds(np.log(12.0)) == "12 : 1" and odds(0.0) == "1.0 : 1" and odds(50.0) == "over a million : 1"
    assert odds(-np.log(12.0)) == "1 : 12" and odds(-50.0) == "1 : over a million"
    assert why(()) == []
