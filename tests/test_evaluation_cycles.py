"""Cycles where they were put, and measures that are known in closed form."""

import math

import numpy as np
import pytest
import torch

from torchid.config.conditions import CoordinateCycles, EvaluateOptions, EventCycles, GivenCycle
from torchid.contact.contact import Contact
from torchid.cycles.conventions import chosen, side_of, spelt
from torchid.cycles.cycles import APART, Course, Cycle, find_cycles, normalise, outliers, strikes
from torchid.cycles.measures import MEASURES, measure, stride_values, unit_of
from torchid.model.whole_body import whole_body
from torchid.recording import Event

RATE = 100.0


def course(x: torch.Tensor, contact: Contact | None = None, events: tuple[Event, ...] = ()) -> Course:
    """A trial with one coordinate."""
    return Course("t", torch.arange(len(x), dtype=torch.float64) / RATE, x[:, None], ("pelvis_z",), contact, events)


def contact(touching: torch.Tensor) -> Contact:
    """Contacts of two feet without plates."""
    frames, feet = touching.shape
    yes = torch.ones(frames, dtype=torch.bool)
    plate = torch.full((frames, 1), -1)
    return Contact(("foot_l", "foot_r"), touching, torch.ones_like(touching), plate, yes, yes,
                   torch.zeros(feet, 2, dtype=torch.float64))  # fmt: skip


def test_squats_are_found_between_their_rests(seed):
    """As many as were made, each beginning and ending near the top, the lowest point inside."""
    rng = np.random.default_rng(seed)
    count, pieces, lows, frame = int(rng.integers(2, 6)), [], [], 0
    for _ in range(count):
        rest, move = int(rng.integers(20, 80)), int(rng.integers(120, 250))
        depth = float(rng.uniform(0.3, 0.4))
        pieces += [np.zeros(rest), -depth * 0.5 * (1.0 - np.cos(2 * np.pi * np.arange(move) / move))]
        lows.append(frame + rest + move // 2)
        frame += rest + move
    x = 0.9 + np.concatenate([*pieces, np.zeros(30)]) + 0.0005 * rng.normal(size=frame + 30)
    found = find_cycles(course(torch.as_tensor(x)), EvaluateOptions(cycles=CoordinateCycles()))
    assert len(found) == count
    for cycle, low in zip(found, lows, strict=True):
        assert cycle.start < low < cycle.stop
        assert min(x[cycle.start], x[cycle.stop]) > 0.9 - 0.06
    lifted = find_cycles(course(torch.as_tensor(-x)), EvaluateOptions(cycles=CoordinateCycles(turn="high")))
    assert [(c.start, c.stop) for c in lifted] == [(c.start, c.stop) for c in found]


def test_strides_run_from_strike_to_strike():
    """A gap in the contact shorter than a swing is none, nor is a touch shorter than a stance."""
    down = torch.zeros(600, 2, dtype=torch.bool)
    for start in (20, 140, 260, 380):
        down[start : start + 70, 0] = True
        down[start + 60 : start + 130, 1] = True
    down[50:54, 0] = False
    down[110:113, 0] = True
    assert strikes(down[:, 0], RATE) == [20, 140, 260, 380]
    found = find_cycles(course(torch.zeros(600, dtype=torch.float64), contact(down)), EvaluateOptions())
    assert [(c.start, c.stop) for c in found if c.side == "l"] == [(20, 140), (140, 260), (260, 380)]
    assert [(c.start, c.stop) for c in found if c.side == "r"] == [(80, 200), (200, 320), (320, 440)]
    stance = find_cycles(
        course(torch.zeros(600, dtype=torch.float64), contact(down)), EvaluateOptions(cycles="stance")
    )  # fmt: skip
    assert [(c.start, c.stop) for c in stance if c.side == "l"] == [(20, 90), (140, 210), (260, 330), (380, 450)]


def test_a_stride_is_as_long_as_the_way_of_its_heel():
    """On the ground, and on a belt that moves backwards under a person who stays."""
    down = torch.zeros(400, 2, dtype=torch.bool)
    down[10:80, 0] = down[130:200, 0] = down[70:140, 1] = True
    heels = {"foot_l": torch.zeros(400, 3, dtype=torch.float64), "foot_r": torch.zeros(400, 3, dtype=torch.float64)}
    heels["foot_l"][100:, 0], heels["foot_r"][:, :2] = 1.4, torch.tensor([0.7, -0.12], dtype=torch.float64)
    cycle = Cycle("t", 10, 130, "l")
    time, length, speed, stance, width = stride_values(cycle, contact(down), heels, 0.01).tolist()
    assert (time, length, speed, width) == pytest.approx((1.2, 1.4, 1.4 / 1.2, 0.12))
    assert stance == pytest.approx(70 / 120)
    on_belt = contact(down)
    on_belt.belt[:, 0] = -1.5
    heels["foot_l"][:] = 0.0
    assert float(stride_values(cycle, on_belt, heels, 0.01)[2]) == pytest.approx(1.5)


def test_events_and_given_intervals_make_cycles():
    """Of either side by itself, in the time of the file; what lies outside the recording is none."""
    x = torch.zeros(500, dtype=torch.float64)
    events = tuple(
        Event("Foot Strike", s, t) for s, t in (("Left", 0.5), ("Right", 1.0), ("Left", 1.7), ("Right", 9.0))
    )
    struck = find_cycles(course(x, None, events), EvaluateOptions(cycles=EventCycles()))
    assert [(c.side, c.start, c.stop) for c in struck] == [("l", 50, 170)]
    given = (GivenCycle("t", 1.0, 2.0), GivenCycle("other", 0.0, 1.0), GivenCycle("t", 4.5, 5.5))
    assert [(c.start, c.stop) for c in find_cycles(course(x), EvaluateOptions(cycles=given))] == [(100, 200)]


def test_normalising_keeps_ends_and_straight_lines():
    """Any number of points, draws in front; what is not known stays so."""
    x = torch.arange(300, dtype=torch.float64)[:, None] * torch.tensor([1.0, -2.0], dtype=torch.float64)
    found = normalise(x.expand(3, -1, -1), Cycle("t", 17, 93), 101)
    torch.testing.assert_close(found[2, :, 0], torch.linspace(17, 93, 101, dtype=torch.float64))
    x[50] = torch.nan
    assert 0 < int(torch.isnan(normalise(x, Cycle("t", 17, 93), 101)[:, 0]).sum()) <= 4


def test_a_strange_cycle_stands_apart(seed):
    """The one that is another movement, and hardly any other."""
    generator = torch.Generator().manual_seed(seed)
    phase = torch.linspace(0, 2 * math.pi, 101, dtype=torch.float64)
    curves = torch.sin(phase)[None, :, None] * (1.0 + 0.1 * torch.randn(15, 1, 2, generator=generator).double())
    curves[4] = torch.cos(phase)[:, None]
    assert int(outliers(curves).argmax()) == 4 and float(outliers(curves)[4]) > APART


@pytest.mark.parametrize("frames", [401, 2001])
def test_measures_are_those_of_sines(frames):
    """tau = A sin t and v = B sin t over one period: power A B sin^2 t, work pi A B, load 4 A."""
    A, B = 30.0, 2.0
    t = torch.linspace(0, 2 * math.pi, frames, dtype=torch.float64)[:, None]
    step = float(t[1] - t[0])
    tau, v, q = A * torch.sin(t), B * torch.sin(t), 1.0 - B * torch.cos(t)
    names = tuple(MEASURES)
    found = dict(zip(names, measure(names, Cycle("t", 0, frames - 1), tau, v, q, step)[0].tolist(), strict=True))
    expected = {
        "peak_torque_Nm": A, "max_torque_Nm": A, "min_torque_Nm": -A, "mean_torque_Nm": 0.0,
        "positive_work_J": math.pi * A * B, "negative_work_J": 0.0, "peak_power_W": A * B,
        "cumulative_load_Nms": 4.0 * A, "range_deg": math.degrees(2.0 * B),
    }  # fmt: skip
    for name, value in expected.items():
        assert found[name] == pytest.approx(value, rel=1e-4, abs=1e-6), name
    braking = measure(("negative_work_J",), Cycle("t", 0, frames - 1), -tau, v, q, step)
    assert float(braking) == pytest.approx(-math.pi * A * B, rel=1e-4)


def test_a_torque_that_is_not_known_throughout_has_no_measure():
    """But the range of motion has; and every draw has its own measure."""
    tau = torch.ones(4, 100, 1, dtype=torch.float64) * torch.arange(1.0, 5.0, dtype=torch.float64)[:, None, None]
    names, line = ("peak_torque_Nm", "range_deg"), torch.linspace(0, 1, 100, dtype=torch.float64)[:, None]
    assert measure(names, Cycle("t", 10, 60), tau, line, line, 0.01)[:, 0, 0].tolist() == [1.0, 2.0, 3.0, 4.0]
    tau[:, 30] = torch.nan
    found = measure(names, Cycle("t", 10, 60), tau, line, line, 0.01)
    assert bool(torch.isnan(found[..., 0]).all()) and bool(torch.isfinite(found[..., 1]).all())


def test_coordinates_have_names_and_signs_of_other_programs():
    """Of OpenSim with its own sign at the lumbar joint; a coordinate without side stands for both."""
    dofs = whole_body(1.75, 70.0).tree.dof_names
    assert chosen(("hip_flexion", "knee_l_flexion", "tail"), dofs) == (
        ("hip_l_flexion", "hip_r_flexion", "knee_l_flexion"), ("tail",)
    )  # fmt: skip
    assert spelt("hip_l_flexion", "opensim") == ("hip_flexion_l", 1.0)
    assert spelt("lower_spine_flexion", "opensim") == ("lumbar_extension", -1.0)
    assert spelt("hip_r_flexion", "isb") == ("hip_flexion_r", 1.0)
    assert (side_of("hip_flexion_r"), side_of("lower_spine_bending")) == ("r", "")
    assert len({spelt(dof, "opensim")[0] for dof in dofs}) == len(dofs)
    assert (unit_of("cumulative_load_Nms"), unit_of("speed_m_s"), unit_of("stance_share")) == ("N m s", "m/s", "")
