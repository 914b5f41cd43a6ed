"""Filters and derivatives: response, ends, gaps, poles."""

import itertools
import math

import numpy as np
import pytest
import roma
import torch
from torch.testing import assert_close
from trees import BASE, Dof

from torchid.model.tree import Body, Tree, Turn
from torchid.motion import Smoother, choose_cutoff, smooth_motion
from torchid.motion.rotations import filter_rotation, rotation_to_turns, turns_to_rotation

RATE = 100.0


@pytest.mark.parametrize("kind", ["spline", "butterworth"])
def test_response_is_minus_3_db_at_the_cutoff(kind: str) -> None:
    """A sine at the cut-off passes with 0.707 of its amplitude, one at a fifth of it unharmed, one at thrice not."""
    t = torch.arange(4000, dtype=torch.float64) / RATE
    for ratio, low, high in ((1.0, 0.69, 0.725), (0.2, 0.995, 1.005), (3.0, 0.0, 0.05)):
        x = torch.sin(2 * torch.pi * 6.0 * ratio * t)
        y = Smoother(6.0, RATE, kind)(x)[1000:3000]  # type: ignore[arg-type]
        gain = float((y.square().mean() * 2).sqrt())
        assert low <= gain <= high


def test_spline_leaves_the_acceleration_free_at_the_ends() -> None:
    """A parabola passes the spline filter unchanged, up to its ends."""
    t = torch.arange(131, dtype=torch.float64)[:, None] / RATE
    x = 0.3 + 2.0 * t - 4.0 * t**2
    assert_close(Smoother(6.0, RATE)(x), x, rtol=0, atol=1e-8)


def test_gap_is_bridged(seed: int) -> None:
    """Samples without weight are not read, and a slow signal is restored inside the gap."""
    t = torch.arange(400, dtype=torch.float64) / RATE
    x = torch.sin(2 * torch.pi * 0.7 * t)
    weight = torch.ones(400, dtype=torch.float64)
    weight[150:165] = 0.0
    spoilt = torch.where(weight > 0, x, torch.nan)
    assert_close(Smoother(8.0, RATE)(spoilt, weight), x, rtol=0, atol=2e-3)


@pytest.mark.parametrize("rate, cutoff_hz", [(100.0, 4.0), (100.0, 6.0), (2000.0, 6.0)])
def test_what_is_missing_for_long_spoils_nothing(rate, cutoff_hz, seed: int) -> None:
    """Rounding errors of a gap of many periods at the start are more than the penalty says of it."""
    rng = np.random.default_rng(seed)
    frames, away = int(rate * rng.uniform(8.0, 20.0)), float(rng.uniform(-100.0, 100.0))
    x = away + torch.sin(2 * torch.pi * 0.5 * torch.arange(2 * frames, dtype=torch.float64) / rate)
    weight = torch.ones(2 * frames, dtype=torch.float64)
    weight[:frames] = 0.0
    found = Smoother(cutoff_hz, rate)(x, weight)
    assert found.isfinite().all()
    assert_close(found[frames:], x[frames:], rtol=0, atol=5e-3)


def test_angular_rates_of_a_known_rotation(seed: int) -> None:
    """Angular velocity and acceleration of R(t) = exp(a(t) u) R0 are a' u and a'' u."""
    rng = np.random.default_rng(seed)
    u = torch.tensor(rng.normal(size=3))
    u = u / u.norm()
    t = torch.arange(300, dtype=torch.float64)[:, None] / RATE
    angle, rate, rate2 = 5 * torch.sin(t * 2), 10 * torch.cos(t * 2), -20 * torch.sin(t * 2)
    R = roma.rotvec_to_rotmat(angle * u) @ roma.random_rotmat(dtype=torch.float64)
    found = filter_rotation(R, Smoother(49.0, RATE))
    assert_close(found.w, rate * u, rtol=0, atol=1e-4)
    assert_close(found.alpha, rate2 * u, rtol=0, atol=1e-2)


def test_joint_passes_the_pole_of_its_angles() -> None:
    """A three-axis joint moving through its singular pose keeps exact body rates away from a few frames."""
    turns = (Turn(1, 6), Turn(0, 7, sign=-1.0), Turn(2, 8))
    tree = Tree((Body("a", -1), Body("b", 0, turns)), BASE + tuple(Dof(n, "rad") for n in "pqr"))
    t = torch.arange(300, dtype=torch.float64) / RATE
    q = torch.zeros(300, 9, dtype=torch.float64)
    q[:, 6], q[:, 7], q[:, 8] = 0.4 * torch.sin(3 * t), 1.2 * t, 0.3 * torch.cos(2 * t)
    motion = smooth_motion(tree, t, q, Smoother(49.0, RATE))
    assert_close(turns_to_rotation(turns, motion.q[:, 6:]), turns_to_rotation(turns, q[:, 6:]), rtol=0, atol=1e-8)
    away = (torch.cos(q[:, 7]).abs() > 0.05) & (t > 0.05) & (t < 2.9)
    assert_close(motion.v[away, 7], torch.full((int(away.sum()),), 1.2, dtype=torch.float64), rtol=0, atol=1e-3)
    assert torch.isfinite(motion.a).all()


def test_cutoff_grows_with_the_band_of_the_signal(seed: int) -> None:
    """A signal up to 3 Hz in noise gets a lower cut-off than one up to 9 Hz, and both keep their band."""
    rng = np.random.default_rng(seed)
    t = np.arange(1000) / RATE
    found = []
    for top in (3.0, 9.0):
        waves = sum(np.sin(2 * np.pi * f * t + rng.uniform(0, 6)) / f for f in np.linspace(0.5, top, 12))
        x = torch.tensor(0.05 * waves[:, None, None] + 1e-3 * rng.normal(size=(1000, 8, 3)))
        found.append(choose_cutoff(x, RATE))
    assert found[0] < found[1] and found[0] >= 2.9 and found[1] >= 8.5


def test_labels_that_jump_do_not_move_the_cutoff() -> None:
    """Two labels exchanged for a second, or a ghost, say nothing about how fast a person moves."""
    time = np.arange(1000) / 100.0
    slow = 0.2 * np.sin(2.0 * np.pi * 0.7 * time)
    x = torch.tensor(np.stack([np.stack([slow + 0.1 * k] * 3, 1) for k in range(6)], 1))
    x += 1e-3 * torch.tensor(np.random.default_rng(1).normal(size=x.shape))
    swapped = x.clone()
    swapped[300:450, [0, 1]] = x[300:450, [1, 0]]
    assert choose_cutoff(swapped, 100.0) == pytest.approx(choose_cutoff(x, 100.0), rel=0.1)


@pytest.mark.parametrize("axes", list(itertools.permutations(range(3))))
def test_angles_of_three_axes_make_the_rotation(axes, seed):
    """At the pole too, whatever the signs of the axes; near angles that were there before, they are those again."""
    signs = torch.where(torch.rand(3) < 0.5, -1.0, 1.0).tolist()
    turns = [Turn(axis, row, sign=sign) for row, (axis, sign) in enumerate(zip(axes, signs, strict=True))]
    q = 2.0 * torch.randn(200, 3, dtype=torch.float64)
    q[0, 1], q[1, 1], q[2] = 0.5 * math.pi, -0.5 * math.pi, 0.0
    R = turns_to_rotation(turns, q)
    found = rotation_to_turns(turns, R, q)
    assert_close(turns_to_rotation(turns, found), R, rtol=0, atol=1e-12)
    assert_close(found[2:], q[2:], rtol=0, atol=1e-8)
