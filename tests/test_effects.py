"""The contract of every effect: what it predicts is what it does in a simulation, and its parameters come back."""

import dataclasses
import os
import time as clock

import numpy as np
import pytest
import torch
from torch.testing import assert_close

from torchid.effects.catalogue import CATALOGUE, effect
from torchid.effects.effect import Interval, Place, Planted, columns, within
from torchid.effects.scene import Reading, Scene, make_scene
from torchid.errors import ConfigError
from torchid.simulate.options import PlantedOptions, SimulateOptions
from torchid.simulate.planting import planted, session_plates
from torchid.simulate.subject import simulate_subject
from torchid.simulate.trial import simulate_trial

CLEAN = SimulateOptions(duration_s=3.0, marker_noise_mm=0.0, force_noise_n=0.0)
SEED = int(os.environ.get("TORCHID_SEED", clock.time_ns() % 2**32))
MATRIX = [[0.01 * (i != j) * (-1) ** (i + j) for j in range(6)] for i in range(6)]
MIDDLE = (Interval("squats", 1.0, 2.0),)
SIZES: dict[str, tuple[tuple[str, ...], dict]] = {
    "time_offset": (("session",), {"lag_s": 0.004}),
    "plate_gain": (("plate_1",), {"gain": 1.02}),
    "plate_offset": (("plate_2",), {"force_plate_N": [3.0, -2.0, 5.0], "moment_plate_Nm": [0.5, 1.0, -0.4]}),
    "plate_drift": (("plate_1",), {"rate_plate": [0.2, -0.3, 0.5, 0.1, 0.05, -0.1]}),
    "plate_pose": (("plate_2",), {"shift_m": [0.004, -0.006, 0.002], "rotation_rad": [0.004, 0.003, -0.01]}),
    "plate_crosstalk": (("plate_1",), {"matrix_plate": MATRIX}),
    "plate_assignment": (("plate_1", "plate_2"), {}),
    "gravity_tilt": (("session",), {"roll_rad": 0.01, "pitch_rad": -0.015}),
    "moving_ground": (("session",), {"rms_m_s2": 0.1, "frequency_hz": 1.3}),
    "body_mass": (("session",), {"mass_kg": 72.0, "recorded_kg": 70.0}),
    "payload": (("thorax",), {"mass_kg": 3.0, "point_seg_m": [-0.1, 0.02, 0.25]}),
    "grasped_object": (("hand_r",), {"mass_kg": 1.5, "point_seg_m": [0.0, 0.0, -0.1]}),
    "wobbling_mass": (("abdomen",), {"mass_kg": 3.0, "frequency_hz": 4.0, "damping_ratio": 0.2}),
    "flywheel": (("thorax",), {"momentum_seg_Nms": [0.5, -1.0, 2.0]}),
    "unmeasured_contact": (("thorax",), {"force_N": [5.0, 10.0, 30.0]}),
    "external_force": (("pelvis",), {"force_N": [15.0, -5.0, 8.0]}),
    "body_weight_support": (("pelvis",), {"force_N": 80.0}),
    "tether": (("pelvis",), {"stiffness_N_m": 40.0, "anchor_m": [-1.0, 0.2, 1.0]}),
    "drag": (("thorax",), {"coefficient_Ns_m": 12.0}),
}  # fmt: skip
TIMED = {"grasped_object", "unmeasured_contact"}


@pytest.fixture(scope="module")
def subject():
    print(f"repeat with TORCHID_SEED={SEED}")  # noqa: T201
    return simulate_subject(CLEAN, SEED)


@pytest.fixture(scope="module")
def plain(subject):
    return simulate_trial(subject, "squats", CLEAN, SEED)


def options(name: str) -> PlantedOptions:
    where, parameters = SIZES[name]
    return PlantedOptions(name, where, MIDDLE if name in TIMED else None, parameters)


def test_every_effect_has_a_size():
    """The contract below leaves out no effect of the catalogue."""
    assert set(SIZES) == set(CATALOGUE)


@pytest.mark.parametrize("name", SIZES)
def test_parameters_come_back(name):
    """Named parameters of planted internal ones are those that were planted."""
    one = planted(options(name))
    found = one.effect.named(one.place, one.theta)
    for key, value in options(name).parameters.items():
        assert_close(found[key], torch.as_tensor(value, dtype=torch.float64), rtol=1e-12, atol=1e-12)
    assert len(one.theta) == one.effect.size == len(one.effect.scale)


def simulated(subject, plain, name: str, share: float = 1.0):
    """A share of the effect, the plain motion, and what the plates read of it, on the clock of the markers."""
    one = planted(options(name))
    one = dataclasses.replace(one, theta=share * one.theta)
    scene = make_scene("squats", subject.model.tree, subject.geometry, plain.truth.motion, subject.phi)
    forces = plain.trial.forces
    frames = session_plates(forces.plates)
    clock_ratio = len(forces.time) // len(scene.time)
    measured = Reading("squats", scene.time, forces.wrench[::clock_ratio], frames)
    return one, scene, measured


def changed(one: Planted, scene: Scene, measured: Reading) -> Reading:
    """The ground supplies the load, then the plates misread it: the simulator's order."""
    loaded = measured.with_plate(0, measured.wrench[:, 0] + one.load(scene).T)
    return one.read(loaded)


@pytest.mark.parametrize("name", SIZES)
def test_columns_predict_the_plates(subject, plain, name):
    """Columns times parameters are what planting changes in the total of the plates, to second order in its size."""
    change = []
    for share in (1.0, 0.5):
        one, scene, measured = simulated(subject, plain, name, share)
        exact = changed(one, scene, measured).total - measured.total
        guess = torch.einsum("ipt,p->it", columns(one.effect, scene, measured, one.place), one.theta)
        # Beyond the ends of a recording nobody knows what a later clock would read.
        change.append(tuple(float(x[:, 5:-5].norm()) for x in (exact, exact - guess)))
    (size, miss), (_, half) = change
    assert size > 0.0
    assert miss < 0.15 * size, f"columns miss {miss / size:.3f} of the effect"
    if miss > 1e-6 * size:
        assert half < 0.35 * miss, "what columns miss is of second order"


@pytest.mark.parametrize("name", sorted(set(SIZES) - {"plate_assignment"}))
def test_a_planted_effect_is_recovered_from_columns(subject, plain, name):
    """Least squares on the columns, with all else known, finds what was planted."""
    one, scene, measured = simulated(subject, plain, name)
    misread = changed(one, scene, measured)
    C = columns(one.effect, scene, measured, one.place)
    scale = C.new_tensor(one.effect.scale)
    A = (C * scale[:, None]).permute(0, 2, 1).reshape(-1, one.effect.size)
    b = (misread.total - measured.total).reshape(-1)
    # Directions that this motion does not show stay where the prior has them.
    found = torch.linalg.solve(A.T @ A + 1e-8 * A.T.matmul(A).diagonal().mean() * torch.eye(len(scale)).to(A), A.T @ b)
    assert float((A @ found - b).norm()) < 0.15 * float(b.norm())


def test_the_ground_carries_what_is_hidden(subject, plain):
    """A hidden payload changes the plates by its wrench, and the person keeps balance under it."""
    hidden = dataclasses.replace(subject, hidden=(planted(options("payload")),))
    found = simulate_trial(hidden, "static", CLEAN, SEED)
    without = simulate_trial(subject, "static", CLEAN, SEED)
    weight = [float(x.trial.forces.wrench[:, :, 2].sum(1).mean()) for x in (found, without)]
    assert weight[0] - weight[1] == pytest.approx(3.0 * 9.80665, abs=0.05)
    assert found.truth.miss < 0.01


def test_intervals_bound_an_effect():
    """Inside one, outside zero, half at the ends; other trials stay as they are."""
    time = torch.arange(0.0, 3.0, 0.01, dtype=torch.float64)
    place = Place(("thorax",), MIDDLE)
    weight = within(place, "squats", time)
    assert float(weight[150]) == 1.0 and float(weight[20]) == 0.0 == float(weight[-20])
    assert float(weight[100]) == pytest.approx(0.5, abs=1e-9) == float(weight[200])
    assert not bool(within(place, "walk", time).any())
    assert bool((within(Place(("thorax",)), "walk", time) == 1.0).all())


def test_unknown_effects_and_missing_parameters_are_refused():
    """The message names the effect, what it needs and what it got."""
    with pytest.raises(ConfigError, match="plate_gain"):
        effect("plate_gian")
    with pytest.raises(ConfigError, match="needs mass_kg with 1 value"):
        planted(PlantedOptions("grasped_object", ("hand_r",), None, {"point_seg_m": [0.0, 0.0, 0.0]}))


def test_places_cover_the_session(subject, plain):
    """Every effect names at least one place, all of them distinct."""
    _, scene, measured = simulated(subject, plain, "drag")
    for one in CATALOGUE.values():
        places = one.places((scene,), (measured,))
        keys = [(p.where, tuple(sorted(p.grid.items()))) for p in places]
        assert places and len(set(keys)) == len(keys)


def test_a_column_per_parameter_is_finite(subject, plain):
    """At every place of every effect."""
    _, scene, measured = simulated(subject, plain, "drag")
    for one in CATALOGUE.values():
        for place in one.places((scene,), (measured,))[:4]:
            C = columns(one, scene, measured, place)
            assert C.shape == (6, one.size, len(scene.time)) and bool(torch.isfinite(C).all())
            assert np.isfinite(one.scale).all()
