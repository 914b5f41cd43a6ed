"""What bends markers is found, or left alone, by whole runs from files: knocked markers, flesh that lags, noise."""

import json
from pathlib import Path

import numpy as np
import pytest
from balance import in_balance
from draws import seed_of

from torchid.config import load_config
from torchid.effects.place import Interval
from torchid.run import run_experiment
from torchid.simulate.options import PlantedOptions, SimulateOptions
from torchid.simulate.session import simulate_session

SEED = seed_of(__name__)
SOFT = ("pelvis", "thorax", *(f"{part}_{side}" for part in ("upper_arm", "thigh", "shank") for side in "lr"))
"""Segments whose markers sit on flesh."""

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("tables_alone")]


def diagnosed(folder: Path, effect: str, **options) -> dict:
    """What a run over a simulated session says that looks for one effect only."""
    given = SimulateOptions(duration_s=5.0, skin_motion_mm=0.0, **options)
    session = in_balance(lambda seed: simulate_session(given, seed, folder), SEED)
    assert session.config is not None
    config = load_config(session.config, [f"diagnosis.include=[{effect}]", "geometry.max_frames=60"])
    run_experiment(config)
    said = json.loads((config.out / "diagnosis.json").read_text())
    print([(c["effect"], c["where"], c["gain"]) for c in said["causes"]])  # noqa: T201
    return said


def test_a_marker_that_stays_knocked_is_seen_so_on_held_out_motion(tmp_path):
    """From the second of two fit trials on, held-out ones too: those are corrected, and gain by it."""
    rng = np.random.default_rng([SEED, 8])
    label, way = str(rng.choice(["LTIB", "RTHI", "T10"])), rng.normal(size=3)
    when = tuple(Interval(name, 0.0, 5.0) for name in ("trunk", "arms"))
    # Of 13 mm, two trials of 6 s told 1.7 nats at one seed, more than what is ordinary at 60 markers.
    length = np.exp(rng.uniform(np.log(0.015), np.log(0.03)))
    shift = PlantedOptions(
        "marker_shift", (label,), when, {"shift_seg_m": (length * way / np.linalg.norm(way)).tolist()}
    )
    said = diagnosed(tmp_path, "marker_shift", fit=("squats", "trunk"), heldout=("arms", "hip_rom"), effects=(shift,))
    (cause,) = [c for c in said["causes"] if c["where"] == [label]]
    acting = {own["trial"] for own in cause["when"]}
    # Of two trials, either may be the one in which it sits where it belongs; held-out ones go with theirs.
    assert acting in ({"trunk", "arms"}, {"squats", "hip_rom"}), label
    assert cause["gain"]["heldout_log_likelihood"] > 10.0
    before, after = (said[key]["heldout"]["marker_rmse_mm"] for key in ("baseline", "extended"))
    assert after < before


def test_a_marker_that_moved_after_standing_is_named_by_distances(tmp_path):
    """No motion shows it where all of it was recorded then; the fitted one is corrected by the size that it has."""
    rng = np.random.default_rng([SEED, 11])
    label, way = str(rng.choice(["LTIB", "RTHI", "LASI"])), rng.normal(size=3)
    when = tuple(Interval(name, 0.0, 5.0) for name in ("squats", "hip_rom"))
    size = rng.uniform(0.02, 0.03) * way / np.linalg.norm(way)
    shift = PlantedOptions("marker_shift", (label,), when, {"shift_seg_m": size.tolist()})
    said = diagnosed(tmp_path, "marker_shift", fit=("squats",), heldout=("hip_rom",), effects=(shift,))
    (cause,) = said["causes"]
    assert cause["where"] == [label] and cause["level"] == "likely" and cause["applied"]
    assert {own["trial"] for own in cause["when"]} == {"squats", "hip_rom"}
    found, sd = (np.array(cause["parameters"]["shift_seg_m"][key]) for key in ("value", "sd"))
    assert (np.abs(found - size) < 4.0 * sd).all(), (found, size, sd)


def test_noise_is_no_flesh_that_lags(tmp_path):
    """Accelerations of noisy markers agree with what the noise left of the forces: a filter makes less of both."""
    noise = float(np.random.default_rng([SEED, 9]).uniform(3.5, 5.0))
    said = diagnosed(tmp_path, "skin_lag", fit=("squats", "trunk"), heldout=("hip_rom",), marker_noise_mm=noise)
    assert not said["causes"], noise


@pytest.mark.parametrize("sign", [1.0, pytest.param(-1.0, marks=pytest.mark.battery)])
def test_flesh_runs_behind_the_bone_and_never_ahead(tmp_path, sign):
    """The same markers ahead of an accelerated bone are no spring, however well it would explain them."""
    rng = np.random.default_rng([SEED, 10])
    shift = rng.uniform(0.001, 0.003, len(SOFT))
    shift[rng.choice(len(SOFT), 3, replace=False)] = rng.uniform(0.006, 0.01, 3)
    lag = PlantedOptions("skin_lag", SOFT, None, {"shift_1g_m": (sign * shift).tolist()})
    said = diagnosed(tmp_path, "skin_lag", fit=("squats", "trunk"), heldout=("hip_rom",), effects=(lag,))
    assert [cause["effect"] for cause in said["causes"]] == ["skin_lag"] * (sign > 0.0), shift
