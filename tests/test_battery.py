"""The diagnosis against a simulator that shares no code with torchid: effects hidden there, found from files alone."""

import json
import os
import sys
import time as clock
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "scripts"))
pytest.importorskip("mujoco", reason="the battery's physics is MuJoCo's")

from batteries.judge import judged, tables
from batteries.mujoco_session import draw_effect, simulate

from torchid.config import load_config
from torchid.experiment import run_experiment

SEED = int(os.environ.get("TORCHID_SEED", clock.time_ns() % 2**32))
HIDDEN = ("time_offset", "plate_pose", "gravity_tilt", "body_weight_support", "flywheel", "marker_scale")
"""Errors that every laboratory could make, hidden here at a size that nobody should miss."""


@pytest.mark.slow
def test_what_another_simulator_hides_is_found(tmp_path):
    """One effect of a drawn kind, large: named first and in its place; held-out errors grow by 2 % at most."""
    print(f"repeat with TORCHID_SEED={SEED}")  # noqa: T201
    rng = np.random.default_rng(SEED)
    hidden = draw_effect(str(rng.choice(HIDDEN)), "large", rng)
    config = load_config(simulate(tmp_path, int(rng.integers(10**6)), [hidden]))
    run_experiment(config)
    said = json.loads((config.out / "diagnosis.json").read_text())
    truth = json.loads((tmp_path / "truth" / "truth.json").read_text())["effects"]
    row = judged(truth, said)
    print(row["told"])  # noqa: T201
    assert row["first"], row["told"]
    before, after = row["heldout"]
    assert after < 1.02 * before


def test_a_verdict_is_judged_by_effect_place_and_size():
    """Twins count, wrong places do not; sizes within two standard deviations that are themselves small."""
    entry = {"value": 0.011, "sd": 0.001}
    gain = {"heldout_log_likelihood": 1.0}
    cause = {
        "effect": "time_offset", "where": ["session"], "confidence": 0.95, "parameters": {"lag_s": entry},
        "indistinguishable": [{"effect": "drag", "where": ["pelvis"]}], "gain": gain,
    }  # fmt: skip
    held = {"heldout": {"force_rmse_N": 2.0}}
    said = {"causes": [cause], "baseline": held, "extended": held, "nearest": []}
    planted = [{"effect": "time_offset", "where": ["session"], "parameters": {"lag_s": 0.010}}]
    row = judged(planted, said)
    assert row["found"] == [True] and row["first"] and row["sizes"][0]["lag_s"]["right"] and not row["wrong"]
    assert judged([{"effect": "drag", "where": ["pelvis"], "parameters": {}}], said)["found"] == [True]
    elsewhere = judged([{"effect": "drag", "where": ["thorax"], "parameters": {}}], said)
    assert elsewhere["found"] == [False] and len(elsewhere["wrong"]) == 1
    rows = [{"kind": "single", "names": ["time_offset"], "level": "medium", "seed": 1} | row]
    assert tables(rows)["figures"]["medium"] == {"sessions": 1, "first": 1.0, "sizes": (1, 1)}
