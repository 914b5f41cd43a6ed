"""A named force that changes with the place of its point as its cause does not: a magnet, and what is none."""

import json

import numpy as np
import pytest
import torch
from balance import in_balance
from draws import seed_of
from jaxtyping import Float
from torch import Tensor

from torchid.config import load_config
from torchid.effects.catalogue import CATALOGUE
from torchid.effects.effect import Parameter
from torchid.effects.forces import PointForce
from torchid.effects.scene import BodyPoint, Scene
from torchid.run import run_experiment
from torchid.simulate.options import PlantedOptions, SimulateOptions
from torchid.simulate.session import simulate_session

SEED = seed_of(__name__)
KNOWN = ("external_force", "tether", "drag", "payload")


class Magnet(PointForce):
    """Pulls with the inverse square of the distance."""

    name = "magnet"
    parameters = (Parameter("force_N", 20.0), Parameter("centre_m", 1.0, 3))

    def force(self, scene: Scene, at: BodyPoint, theta: Float[Tensor, " params"]) -> Float[Tensor, "3 frames"]:
        way = theta[1:, None] - at.p
        far = torch.linalg.vector_norm(way, dim=0)
        return 0.25 * theta[0] * way / (far * (far.square() + 0.04))


@pytest.mark.slow
@pytest.mark.usefixtures("tables_alone")
@pytest.mark.parametrize("strange", [True, pytest.param(False, marks=pytest.mark.battery)])
def test_a_force_that_goes_another_way_with_its_place_is_told(strange, tmp_path, monkeypatch):
    """Whatever a magnet is taken for is in doubt, and that nothing is named is said to be too little; a cable and a
    spring are what they are."""
    monkeypatch.setitem(CATALOGUE, "magnet", Magnet())
    rng = np.random.default_rng([SEED, 31])
    name = "magnet" if strange else str(rng.choice(["external_force", "tether"]))
    where, side = [("hand_l", 1.0), ("hand_r", -1.0)][rng.integers(2)] if strange else ("thorax", 1.0)
    # Before the body and at its other side: at half a metre from the hand it would pull as hard as no foot can hold.
    away = [float(rng.uniform(0.4, 0.7)), float(side * rng.uniform(-0.4, 0.1)), float(rng.uniform(0.8, 1.2))]
    way = rng.normal(size=3)
    parameters = {
        "magnet": {"force_N": float(rng.uniform(30.0, 40.0)), "centre_m": away},
        "external_force": {"force_N": (20.0 * way / np.linalg.norm(way)).tolist()},
        "tether": {"stiffness_N_m": float(rng.uniform(20.0, 40.0)), "anchor_m": [2.0 * x for x in away]},
    }[name]
    hidden = PlantedOptions(name, (where,), None, parameters)
    options = SimulateOptions(
        fit=("squats", "arms", "trunk"), heldout=("sway_steps",), duration_s=6.0, effects=(hidden,), skin_motion_mm=0.0
    )
    asked = [f"diagnosis.include=[{', '.join(KNOWN)}]", "geometry.max_frames=60"]
    session = in_balance(lambda seed: simulate_session(options, seed, tmp_path), SEED)
    config = load_config(session.config, asked)
    run_experiment(config)
    said = json.loads((config.out / "diagnosis.json").read_text())
    print([(c["effect"], c["where"], c["confidence"]) for c in said["causes"]], said["unexplained"])  # noqa: T201
    rest = said["unexplained"]
    if strange:
        sure = [cause for cause in said["causes"] if cause["confidence"] > 0.5]
        assert not any(cause["where"] == [where] for cause in sure)
        assert rest["significant"] or (said["causes"] and not sure)
        assert not rest["significant"] or "changes with the place" in rest["description"]
    else:
        assert not rest["significant"]
        assert said["causes"][0]["effect"] == name
