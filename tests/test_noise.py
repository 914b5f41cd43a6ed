"""Markers' noise in columns: what is believed of them, and what other draws would do."""

from dataclasses import replace
from itertools import islice

import numpy as np
import pytest
import small_session as small
import torch
from rates import FALSE_ALARM
from scipy.stats import norm
from torch.testing import assert_close

from torchid.diagnosis.columns.design import Design, Terms
from torchid.diagnosis.evidence.adequacy import assess_adequacy
from torchid.diagnosis.evidence.model import LinearModel
from torchid.diagnosis.evidence.noise import initial_noise
from torchid.diagnosis.evidence.noise_estimation import estimate_noise, unseen_noise
from torchid.diagnosis.evidence.prior import Prior
from torchid.diagnosis.evidence.spectra import TrialSpectra
from torchid.dynamics.equations_of_motion import base_rows, body_rows, wrench_about
from torchid.dynamics.rows import WrenchTrial
from torchid.dynamics.whitening import BlockSpectrum, frequencies, initial_whitening
from torchid.effects.marker_scene import Sight
from torchid.effects.scene import make_scene
from torchid.filters import Smoother
from torchid.geometry.trial_problem import posture_prior
from torchid.kinematics.plan import plan_tree
from torchid.motion import smooth_motion
from torchid.observation.marker_noise import usual_variance
from torchid.observation.marker_response import MarkerResponse
from torchid.observation.noise_budget import energy, passed
from torchid.observation.noise_draws import DRAWS, draw_noise
from torchid.observation.reliability import estimate_reliability

NOISE = 1e-3
"""Of the markers [m]."""


@pytest.fixture(scope="module")
def rows() -> WrenchTrial:
    """Of the held-out trial, at its true motion."""
    (found,) = small.true_rows("heldout", 6.0)
    return found


@pytest.fixture(scope="module")
def response(rows) -> MarkerResponse:
    """That see nothing but white noise, a jump of half a metre in one marker and a gap in another."""
    subject, tree = small.session().subject, rows.tree
    scene = make_scene(rows.name, tree, rows.geometry, rows.motion, subject.phi)
    labels, n, frames = subject.labels, len(subject.labels), len(rows.used)
    fit = small.fit()
    assert fit.attachment.labels == labels
    body = torch.tensor(plan_tree(tree).position)[fit.attachment.body]
    error = NOISE * torch.tensor(np.random.default_rng(small.SEED).normal(size=(n, 3, frames)))
    error[0, :, frames // 2 : frames // 2 + 20] += 0.5
    weight = torch.full((n, frames), 1e6).double()
    weight[1, : frames // 3] = error[1, :, : frames // 3] = 0.0
    return MarkerResponse(Sight(scene, labels, body, subject.p_BM_B), weight, error, posture_prior(fit).precision[:, 0])


def test_noise_under_a_steep_spectrum_is_told_at_each_frequency():
    """White noise under a signal that falls steeply: the part to believe falls along, also within a band."""
    generator = torch.Generator().manual_seed(small.SEED)
    frequency = torch.linspace(0.0, 12.0, 400).double()
    signal = 30.0 * torch.exp(-frequency)
    drawn = torch.randn(400, 2, generator=generator, dtype=torch.float64)
    energy = (signal[:, None] * drawn[:, :1] + drawn[:, 1:]).square()
    part = estimate_reliability(frequency, energy, torch.ones_like(energy))(frequency)[:, 0]
    true = signal.square() / (signal.square() + 1.0)
    assert float(part[0]) == 1.0
    assert float((part - true).abs().mean()) < 0.16
    assert float(part[true < 0.01].mean()) < 0.3
    inside = part[(frequency > 3.0) & (frequency < 4.5)]
    assert float(inside[: len(inside) // 3].mean()) > float(inside[-(len(inside) // 3) :].mean())


def test_noise_is_what_markers_do_most_of_the_time(response):
    """Neither a gap nor an arm that is lost for a fifth of a second makes 1 mm more than that.

    The postures' share is given back for noise that a fit has left: here none has taken any.
    """
    found = response.scatter * response.bands.kept.view(-1, 3).mean(1).sqrt()
    assert_close(found, torch.full_like(response.scatter, NOISE), rtol=0.5, atol=0.0)  # as below


def test_each_segment_is_given_back_what_its_posture_took(rows, response):
    """A foot with three markers has lost more of its noise to its posture than an arm with seven."""
    drawn = NOISE * np.random.default_rng(small.SEED + 1).normal(size=response.error.shape)
    error = torch.tensor(drawn).flatten(0, 1).T[:, :, None]
    seen = replace(response, weight=torch.full_like(response.weight, 1e6))
    x, J = seen.followed(error), seen.jacobian(slice(None))
    left = (error - J @ x)[:, :, 0].T.reshape(response.error.shape)
    after = replace(seen, error=left)
    kept = after.bands.kept.view(-1, 3).mean(1)
    samples = left[0].numel() * float(kept.min())
    chance = norm.isf(FALSE_ALARM / len(kept)) * (2.0 / samples) ** 0.5
    assert chance < 0.3
    assert_close(left.square().mean((1, 2)) / NOISE**2, kept, rtol=chance, atol=0.0)
    assert float(kept.max() / kept.min()) > 1.3
    # A choice: one of 124 was off by 0.39 in some forty draws.
    assert_close(after.scatter, torch.full_like(after.scatter, NOISE), rtol=0.5, atol=0.0)


def test_noise_that_was_filtered_shakes_no_faster(rows, response):
    """Where the cameras' maker has passed 8 Hz, draws hold next to nothing above 15 Hz."""
    quiet = Smoother(8.0, rows.rate)(response.error.flatten(0, 1).T).T.reshape(response.error.shape)
    after = replace(response, error=quiet)
    assert bool((after.scatter[1] < 0.3 * after.scatter[0]).all())
    moved = [
        [drawn.q - rows.motion.q for drawn in islice(draw_noise(rows.motion, c), DRAWS)] for c in (response, after)
    ]
    fast, slow = (torch.stack([(x - Smoother(15.0, rows.rate)(x)).square().mean() for x in some]) for some in moved)
    assert float(slow.mean()) < 0.3 * float(fast.mean())


def test_what_a_filter_leaves_of_white_noise_is_known(rows):
    """The mean over draws is the filter's own sum of squares in each band."""
    exact = energy(rows, rows.motion.smoother(torch.eye(len(rows.used)).to(rows.wrench)))[0].sum(1)
    assert_close(passed(rows), exact, rtol=0.3, atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("scatter", [(2e3, 2e3, 2e3, 3e3, 3e3, 1e2), (2e3, 1e2, 1e2, 3e3, 1e2, 1e2)])
def test_noise_alone_is_as_unlikely_as_it_says(scatter):
    """Of plates so loud that markers do not matter, residuals of noise are flagged as seldom as they should."""
    generator, loud = torch.Generator().manual_seed(small.SEED), torch.tensor(scatter).double()
    observed = [replace(w, scatter=loud) for w in small.observed().values()]
    said = [assess_adequacy(observed, [white(w.rows, loud, generator) for w in observed]) for _ in range(100)]
    assert 2 <= sum(one.p_value < 0.2 for one in said) <= 30
    assert sum(one.significant for one in said) <= 3


def white(rows: WrenchTrial, scatter: torch.Tensor, generator: torch.Generator) -> torch.Tensor:
    """Filtered noise of plates."""
    drawn = torch.randn(len(rows.used), 6, generator=generator, dtype=torch.float64)
    return rows.motion.smoother(drawn * scatter)


def test_noise_is_told_by_short_runs_of_fast_cameras():
    """A band narrower than one coefficient still tells white noise of 1 from none, within a factor of a few."""
    generator = torch.Generator().manual_seed(small.SEED)
    for frames, band in ((64 * 40, (0.006, 0.010)), (25, (0.03, 0.05))):
        found = [
            usual_variance(torch.randn(frames, 3, generator=generator, dtype=torch.float64), band) for _ in range(20)
        ]
        assert 0.4 < float(np.mean(found)) < 2.5


def test_a_shaken_motion_is_a_motion(rows, response):
    """Its rates, the base's rotation among them, are those of its coordinates; its wrench is about the found root."""
    motion, phi = rows.motion, small.session().subject.phi
    for drawn in islice(draw_noise(motion, response), DRAWS):
        again, plain = (smooth_motion(rows.tree, m.time, m.q, Smoother(50.0, rows.rate)) for m in (drawn, motion))
        for moved, true in ((drawn.v - motion.v, again.v - plain.v), (drawn.a - motion.a, again.a - plain.a)):
            assert float((moved - true)[20:-20].norm()) < 0.05 * float(true[20:-20].norm())
        scenes = [make_scene("", rows.tree, rows.geometry, m, phi) for m in (drawn, motion)]
        true, was = (wrench_about(scene.needed().T, motion.q[:, :3]) for scene in scenes)
        Y, before = (base_rows(s.state.plan, body_rows(s.state, motion.q[:, :3].T)) for s in scenes)
        more = torch.einsum("ipt,p->ti", Y - before, phi.reshape(-1))
        assert_close(more, true - was, rtol=1e-6, atol=1e-6)


def test_every_trial_has_its_own_noise():
    """A trial whose forces are left five times as large counts a twenty-fifth: it hides nothing of the other."""
    generator, kept, sizes = torch.Generator().manual_seed(small.SEED % 2**31), 64, (2.0, 10.0)
    trials = []
    for size in sizes:
        blocks = []
        for _ in range(4):
            Y = torch.randn(6, 1, kept, generator=generator, dtype=torch.float64)
            noise = size * torch.randn(6, kept, generator=generator, dtype=torch.float64)
            blocks.append(BlockSpectrum(Y, 3.0 * Y[:, 0] + noise, frequencies(2 * kept, kept, 12.0)))
        trials.append(TrialSpectra(tuple(blocks), Terms(torch.arange(1), None)))
    prior = Prior(torch.zeros(1).double(), torch.eye(1).double(), torch.zeros(0).double())
    start = initial_noise(initial_whitening(torch.zeros(()).double()), 2)
    noise = estimate_noise(LinearModel(tuple(trials), prior, Design(1, 1, (), (), ()), start), ())
    assert float(noise.trials[1] / noise.trials[0]) == pytest.approx(25.0, rel=0.25)
    for k, size in enumerate(sizes):
        own = torch.diagonal(noise.of(k).covariance, dim1=1, dim2=2)
        assert float(own.mean().sqrt()) == pytest.approx(size, rel=0.1)


def _plain(sizes: tuple[float, ...]) -> tuple[list[TrialSpectra], Prior, Design]:
    """Trials of one parameter beside noise of these sizes."""
    generator, kept, found = torch.Generator().manual_seed(small.SEED % 2**31), 96, []
    for size in sizes:
        Y = torch.randn(6, 1, kept, generator=generator, dtype=torch.float64)
        F = Y[:, 0] + size * torch.randn(6, kept, generator=generator, dtype=torch.float64)
        found.append(
            TrialSpectra((BlockSpectrum(Y, F, frequencies(2 * kept, kept, 20.0)),), Terms(torch.arange(1), None))
        )
    one = torch.ones(1).double()
    return found, Prior(0.0 * one, one[None], one[:0]), Design(1, 1, (), (), ())


def test_statistics_at_hand_change_no_noise():
    """They only save their making."""
    trials, prior, design = _plain((1.0, 3.0))
    start = initial_noise(initial_whitening(torch.ones(1).double()), 2)
    one, other = (LinearModel(tuple(trials), prior, design, start) for _ in range(2))
    assert other.statistics is other.statistics
    one, other = (estimate_noise(model, ()) for model in (one, other))
    assert_close(one.forces.covariance, other.forces.covariance)
    assert_close(one.trials, other.trials)


def test_unseen_trials_are_as_loud_as_they_are():
    """A held-out trial of five times the noise counts a twenty-fifth, and cameras alone hear none of it."""
    trials, prior, design = _plain((1.0, 1.0, 5.0, 1.0))
    start = initial_noise(initial_whitening(torch.ones(1).double()), 2)
    seen = LinearModel(tuple(trials[:2]), prior, design, start)
    seen = seen.with_noise(estimate_noise(seen, ()))
    unseen = LinearModel(tuple(trials[2:]), prior, design, seen.noise.typical(2))
    both = replace(seen.statistics, trials=(*seen.statistics.trials, *unseen.statistics.trials))
    found = unseen_noise(unseen, (), both)
    assert 15.0 < float(found.trials[0]) < 40.0
    assert 0.5 < float(found.trials[1]) < 2.0
    silent = unseen.with_noise(found).marker_statistics
    assert all(not raw.gram.any() and not raw.moment.any() for raw in silent.trials)
