"""Noise of the motion is no inertia: what it is in the regressor is taken out of the fit."""

from dataclasses import replace
from itertools import islice

import pytest
import small_session as small
import torch
from draws import seed_of
from torch.testing import assert_close

from torchid.dynamics.equations_of_motion import wrench_about
from torchid.dynamics.row_equations import NormalEquations
from torchid.dynamics.rows import predict
from torchid.dynamics.whitening import initial_whitening
from torchid.extension.diagnosing import observe_outcome
from torchid.inertia.identify import identify_inertia
from torchid.inertia.reliability import calibrated, reliability
from torchid.observation.noise_draws import draw_noise
from torchid.session import motion_noise as drawn
from torchid.session.motion_noise import motion_noise

ROWS, PARAMETERS, TRIALS = 2000, 6, 400
BODIES = 6


def normal(generator: torch.Generator, *shape: int) -> torch.Tensor:
    """Numbers by lot."""
    return torch.randn(*shape, generator=generator, dtype=torch.float64)


def solved(sums: list[NormalEquations], covariance: torch.Tensor) -> torch.Tensor:
    """Parameters about a prior of zero."""
    total = sum(sums[1:], sums[0])
    return torch.linalg.solve(total.gram + torch.linalg.inv(covariance), total.moment)


def test_parameters_are_right_in_the_mean_under_noise_in_the_regressor():
    """Least squares alone is drawn to zero in every draw; of calibrated ones the mean errs by less than a third."""
    generator = torch.Generator().manual_seed(seed_of("noise in the regressor"))
    covariance, errors = 4.0 * torch.eye(PARAMETERS).double(), {"plain": [], "calibrated": []}
    size = torch.linspace(0.1, 0.5, PARAMETERS).double()
    for _ in range(TRIALS):
        x, mixed = 1.0 + 0.2 * normal(generator, PARAMETERS), normal(generator, PARAMETERS, PARAMETERS) / 2.0
        Y = normal(generator, ROWS, PARAMETERS) @ (torch.eye(PARAMETERS).double() + mixed)
        F = Y @ x + 0.1 * normal(generator, ROWS)
        seen = Y + size * normal(generator, ROWS, PARAMETERS)
        halves = [NormalEquations.from_rows(*half) for half in zip(seen.chunk(2), F.chunk(2), strict=True)]
        noise = ROWS * torch.diag(size.square())
        errors["plain"].append(solved(halves, covariance) - x)
        R = reliability(halves, noise, covariance)
        errors["calibrated"].append(solved([calibrated(one, R) for one in halves], covariance) - x)
    plain, right = (torch.stack(errors[name]).mean(0) for name in ("plain", "calibrated"))
    assert float(right.norm()) < float(plain.norm()) / 3.0


def test_what_rows_say_nothing_of_stays_and_what_is_all_noise_says_nothing():
    """No direction changes its sign, however large the noise is taken."""
    generator = torch.Generator().manual_seed(seed_of("all noise"))
    Y, covariance = normal(generator, ROWS, PARAMETERS), torch.eye(PARAMETERS).double()
    Y[:, 0] = 0.0
    sums = NormalEquations.from_rows(Y, Y.sum(1))
    noise = torch.zeros(PARAMETERS, PARAMETERS).double()
    noise[1, 1] = 5.0 * ROWS
    found = calibrated(sums, reliability([sums], noise, covariance))
    assert_close(found.gram[2:, 2:], sums.gram[2:, 2:], rtol=0.1, atol=1e-6 * ROWS)
    assert float(found.gram[0].abs().max()) < 1e-9 * ROWS and float(torch.linalg.eigvalsh(found.gram)[0]) > -1e-9 * ROWS
    assert float(found.gram[1, 1]) < 0.05 * float(sums.gram[1, 1])
    assert_close(reliability([sums], 0.0 * noise, covariance), torch.eye(PARAMETERS).double())


def test_blocks_of_a_long_session_stand_for_all_of_it(monkeypatch):
    """Wherever the frames that count are; the same is drawn again."""
    outcome = small.outcome()
    whitening, found = initial_whitening(outcome.phi), motion_noise(outcome)
    assert found is not None
    gram = found(whitening)
    assert float(torch.linalg.eigvalsh(gram)[0]) > -1e-9 * float(gram.diagonal().max()) and bool(gram.any())
    again = motion_noise(outcome)
    assert again is not None
    assert_close(again(whitening), gram)
    monkeypatch.setattr(drawn, "MOST_FRAMES", 800)
    some = motion_noise(outcome)
    assert some is not None and len(some.blocks) < len(found.blocks) and some.share > found.share
    assert float(some(whitening).trace()) == pytest.approx(float(gram.trace()), rel=0.5)
    name = next(iter(outcome.session.fit("inertia")))
    rows = outcome.followed[name].wrench
    assert rows is not None
    used = torch.zeros_like(rows.used)
    used[200:260] = True
    few = {name: replace(outcome.followed[name], wrench=replace(rows, used=used))}
    others = {other: replace(item, wrench=None) for other, item in outcome.followed.items() if other != name}
    short = motion_noise(replace(outcome, followed=others | few))
    assert short is not None and bool(short(whitening).any())


def test_masses_are_right_in_the_mean_under_noise_of_the_motion():
    """Of rows that a body by lot makes, under other draws of the markers' noise: without it taken out, all of them err
    the same way."""
    outcome = small.outcome()
    found = outcome.identified
    assert found is not None
    observed = observe_outcome(outcome, "fit", None)
    generator = torch.Generator().manual_seed(seed_of("wrenches"))
    draws = [islice(draw_noise(one.rows.motion, one.response), 16, 16 + BODIES) for one in observed.values()]
    errors = {"exact": [], "taken out": []}
    for motions in zip(*draws, strict=True):
        trials = []
        for one, motion in zip(observed.values(), motions, strict=True):
            needed = predict(one.rows, outcome.phi) + normal(generator, len(one.rows.used), 6)
            wrench = wrench_about(needed, -one.rows.motion.q[:, :3])
            trials.append(replace(one.rows, motion=motion, wrench=wrench))
        for name, noise in (("exact", None), ("taken out", motion_noise(outcome))):
            fit = identify_inertia(trials, found.fit.prior, noise=noise).fit
            errors[name].append((fit.mass - outcome.phi[:, 0]) / fit.sd.mass)
    exact, out = (float(torch.stack(errors[name]).mean(0).square().mean().sqrt()) for name in ("exact", "taken out"))
    assert out < exact
