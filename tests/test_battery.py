"""The diagnosis against a simulator that shares no code with torchid: effects hidden there, found from files alone."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from draws import seed_of
from torch.testing import assert_close

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "scripts"))
pytest.importorskip("mujoco", reason="the battery's physics is MuJoCo's")

from batteries.bound import known_else
from batteries.gain import heldout_gains
from batteries.judge import document, judged, kept, restored, tables
from batteries.power import draw_reliability, half_sizes, reliability
from models import model_of
from mujoco_laboratory.draws import draw_effect
from mujoco_laboratory.session import simulate
from mujoco_laboratory.sizes import SIZES

from torchid.config import load_config
from torchid.diagnosis.candidates.candidate import Candidate, ColumnSource
from torchid.diagnosis.columns.design import Design
from torchid.diagnosis.evidence.prior import Prior
from torchid.diagnosis.evidence.statistics import Statistics
from torchid.diagnosis.search.estimates import estimate
from torchid.diagnosis.search.result import SearchResult
from torchid.effects.catalogue import effect
from torchid.effects.place import Place
from torchid.run import run_experiment

SEED = seed_of(__name__)
HIDDEN = ("time_offset", "plate_pose", "gravity_tilt", "body_weight_support", "flywheel", "marker_scale")
"""Errors that every laboratory could make, hidden here at a size that nobody should miss."""


@pytest.mark.slow
@pytest.mark.battery
@pytest.mark.usefixtures("tables_alone")
def test_what_another_simulator_hides_is_found(tmp_path):
    """One effect of a drawn kind, large: named first and in its place; held-out errors grow by 2 % at most."""
    rng = np.random.default_rng(SEED)
    hidden = draw_effect(str(rng.choice(HIDDEN)), "large", rng)
    config = load_config(simulate(tmp_path, int(rng.integers(10**6)), [hidden]))
    outcome = run_experiment(config)
    said = json.loads((config.out / "diagnosis.json").read_text())
    truth = json.loads((tmp_path / "truth" / "truth.json").read_text())["effects"]
    assert {"baseline", "causes", "extended", "nearest", "not_testable", "plates", "trace"} <= set(said)
    row = judged(truth, said)
    print(row["told"])  # noqa: T201
    assert row["first"], row["told"]
    before, after = row["heldout"]
    assert after < 1.02 * before
    gained = heldout_gains(outcome, truth, tmp_path / "perfect")
    assert gained is not None
    reached, possible = gained
    print(f"reached {reached:.1f} of {possible:.1f} nats")  # noqa: T201
    assert reached > 0.5 * possible or possible < 10.0


def test_a_verdict_is_judged_by_effect_place_and_size():
    """Twins count, wrong places do not; sizes within two standard deviations that are themselves small."""
    entry = {"value": 0.011, "sd": 0.001}
    gain = {"heldout_log_likelihood": 1.0}
    cause = {
        "effect": "time_offset", "where": ["session"], "confidence": 0.95, "parameters": {"lag_s": entry},
        "indistinguishable": [{"effect": "drag", "where": ["pelvis"]}], "gain": gain,
    }  # fmt: skip
    held = {"heldout": {"force_rmse_N": 2.0}}
    said = {"causes": [cause], "baseline": held, "extended": held, "nearest": [], "refuted": []}
    planted = [{"effect": "time_offset", "where": ["session"], "parameters": {"lag_s": 0.010}}]
    row = judged(planted, said)
    assert row["found"] == [True] and row["first"] and row["sizes"][0]["lag_s"]["right"] and not row["wrong"]
    assert judged([{"effect": "drag", "where": ["pelvis"], "parameters": {}}], said)["found"] == [True]
    twin = {"coefficient_Ns_m": {"value": 20.0, "sd": 2.0}}
    cause["indistinguishable"] += [{"effect": "drag", "where": ["head"], "parameters": twin}]
    sizes = judged([{"effect": "drag", "where": ["head"], "parameters": {"coefficient_Ns_m": 21.0}}], said)["sizes"]
    assert sizes[0]["coefficient_Ns_m"]["right"]
    elsewhere = judged([{"effect": "drag", "where": ["thorax"], "parameters": {}}], said)
    assert elsewhere["found"] == [False] and len(elsewhere["wrong"]) == 1
    rows = [{"kind": "single", "names": ["time_offset"], "level": "medium", "seed": 1} | row]
    assert tables(rows)["figures"]["medium"] == {"sessions": 1, "first": 1.0, "sizes": (1, 1)}


def test_power_is_the_size_at_which_half_are_found():
    """Between the level at which nothing is found and the one at which all is; whichever way sizes grow."""
    rows = [
        {"kind": "single", "names": (name,), "level": level, "first": level != "small"}
        for name in ("drag", "filter_lag") for level in ("small", "medium", "large") for _ in range(8)
    ]  # fmt: skip
    found = half_sizes(rows)
    (small, large), (fast, slow) = SIZES["drag"]["coefficient_Ns_m"], SIZES["filter_lag"]["cutoff_hz"]
    assert small < found["drag"]["half"] < (small * large) ** 0.5
    assert (fast * slow) ** 0.5 < found["filter_lag"]["half"] < fast
    low, high = found["drag"]["interval"]
    assert low < found["drag"]["half"] < high
    always = half_sizes([r | {"first": True} for r in rows])
    assert always["drag"]["half"] < small
    assert always["filter_lag"]["half"] > fast


def test_reliability_counts_each_verdict_once(tmp_path):
    """Named causes of the laboratory by stated confidence, wrong ones apart."""
    good, bad = ["drag", ["pelvis"], 0.95], ["tether", ["thorax"], 0.95]
    rows = [{"kind": "single", "named": [good, bad, ["soft_tissue", ["thorax"], 1.0]], "wrong": [bad]},
            {"kind": "double", "named": [["drag", ["pelvis"], 1.0]], "wrong": []}]  # fmt: skip
    assert [(n, right) for *_, n, right in reliability(rows) if n] == [(2, 1), (1, 1)]
    draw_reliability(rows, tmp_path / "reliability.png")
    assert (tmp_path / "reliability.png").stat().st_size > 1000


def test_kept_rows_print_the_tables_of_whole_rows():
    """A short row a session is enough for every table; a witness's verdict has no gain, a failure is kept."""
    named = [["drag", ["pelvis"], 0.95], ["tether", ["thorax"], 0.6]]
    size = {"value": [21.0], "sd": [2.0], "true": [20.0], "right": True}
    whole = {
        "kind": "single", "names": ["drag"], "level": "medium", "seed": 3, "engine": "abc", "named": named,
        "truth": [{"effect": "drag", "where": ["pelvis"], "parameters": {"coefficient_Ns_m": 20.0}}], "found": [True],
        "first": True, "sizes": [{"coefficient_Ns_m": size}], "wrong": named[1:], "unexplained": False,
        "nearest": [["drag", ["head"], -1.25]], "gain": [31.26, None], "gained": [31.3012, 33.1234], "told": "drag",
    }  # fmt: skip
    rows = [whole, whole | {"kind": "null", "names": [], "level": "none", "truth": [], "found": [], "sizes": [None]},
            {"kind": "single", "names": ["drag"], "level": "small", "seed": 4, "failed": "ValueError: no"}]  # fmt: skip
    assert tables([restored(json.loads(json.dumps(kept(row)))) for row in rows]) == tables(rows)
    stored = json.loads(document(rows, "2026-01-01", 1))
    assert "\n".join(stored["tables"]) == tables(rows)["text"] and len(stored["rows"]) == 3


def test_the_stored_tables_are_those_of_the_stored_sessions():
    """``battery.json`` can be told anew from its own rows, and stays small."""
    path = Path(__file__).resolve().parents[1] / "scripts" / "batteries" / "battery.json"
    stored = json.loads(path.read_text(encoding="utf-8"))
    said = tables([restored(values) for values in stored["rows"]])
    assert said["text"].splitlines() == stored["tables"]
    assert json.loads(json.dumps(said["figures"])) == stored["figures"]
    assert path.stat().st_size < 300_000


def test_what_can_be_known_at_best_is_known_of_the_effect_alone():
    """Its own columns and prior say it; beside another plate's offset, which goes nearly alike, less is known."""
    rng, one = np.random.default_rng(SEED), effect("plate_offset")
    mine = torch.tensor(rng.normal(size=(40, 6)))
    columns = torch.cat([mine, mine + 0.3 * torch.tensor(rng.normal(size=(40, 6)))], 1)
    scale = torch.tensor(one.scale(Place(("plate_1",))), dtype=torch.float64)
    prior = Prior(torch.zeros(12).double(), torch.zeros(0, 0).double(), scale.repeat(2))
    raw = prior.standard(columns.T @ columns, columns.T @ columns[:, 0], torch.arange(12))
    sources = [
        ColumnSource(one, Place((f"plate_{k + 1}",)), slice(6 * k, 6 * k + 6), (0.0,) * 6, tuple(scale.tolist()))
        for k in range(2)
    ]
    chosen = tuple(Candidate(one, source.place, source, frozenset({0})) for source in sources)
    model = model_of(Design(0, 0, tuple(sources), chosen, ()), prior, Statistics(0, 0, (raw,)))
    said = SearchResult(model, chosen, (), model.fit(chosen))
    keys = ("force_plate_N", "moment_plate_Nm")
    bound, stated = known_else(said, 0), estimate(said, 0)
    best = torch.cat([bound[key] for key in keys])
    assert_close(best, torch.linalg.inv(mine.T @ mine + torch.diag(scale**-2)).diagonal().sqrt())
    assert bool((torch.cat([stated[key][1] for key in keys]) > 1.5 * best).all())
