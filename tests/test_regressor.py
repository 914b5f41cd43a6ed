"""Base rows, wrenches and whitening."""

import numpy as np
import pytest
import roma
import torch
from torch.testing import assert_close
from trees import random_inertia, random_motion, random_tree

from torchid.dynamics.equations_of_motion import inverse_dynamics, wrench_about
from torchid.dynamics.row_equations import NormalEquations, half_product
from torchid.dynamics.rows import BLOCK, SHORTEST, WrenchTrial, measured, predict, residual_rms
from torchid.dynamics.whitening import (
    BAND_EDGES_HZ,
    BlockSpectrum,
    Whitening,
    accumulate,
    band_of,
    cosine_matrix,
    estimate_whitening,
    frequencies,
    initial_whitening,
    spectra,
)
from torchid.filters import Smoother
from torchid.motion import Motion
from torchid.runs import runs


def moving(seed: int, frames: int = 40, bodies: int = 4) -> tuple[WrenchTrial, torch.Tensor]:
    """A random tree in random motion with the wrench that its inertia needs."""
    rng = np.random.default_rng(seed)
    tree, geometry = random_tree(rng, bodies)
    q, v, a = random_motion(rng, tree, frames)
    phi = random_inertia(rng, bodies)
    time = torch.arange(frames, dtype=torch.float64) / 100.0
    motion = Motion(time, q, v, a, Smoother(40.0, 100.0))
    base = inverse_dynamics(tree, geometry, phi, q.T.contiguous(), v.T.contiguous(), a.T.contiguous())[:6].T
    trial = WrenchTrial("random", tree, geometry, motion, wrench_about(base, -q[:, :3]), torch.ones(frames).bool())
    return trial, phi


def test_rows_predict_the_wrench_of_inverse_dynamics(seed):
    """Y phi is the base part of inverse dynamics; measured minus predicted is nothing, and so is its RMS."""
    trial, phi = moving(seed)
    assert_close(predict(trial, phi), measured(trial), rtol=1e-9, atol=1e-8)
    assert max(residual_rms([trial], phi)) < 1e-7


def test_base_rows_determine_all_that_torques_would(seed):
    """Base rows alone have the rank of base and joint rows together (Ayusawa et al. 2014): no torque is needed."""
    trial, phi = moving(seed, frames=60)
    m, params = trial.motion, phi.numel()
    columns = [x.T.contiguous() for x in (m.q, m.v, m.a)]
    unit = torch.eye(params, dtype=torch.float64).reshape(params, -1, 10)
    full = torch.stack([inverse_dynamics(trial.tree, trial.geometry, e, *columns) for e in unit], dim=2)
    base = trial.rows(slice(0, 60))[0].permute(0, 2, 1)
    assert_close(base, full[:6])
    scale = full.reshape(-1, params).norm(dim=0).clamp(min=1e-9)
    ranks = [int(torch.linalg.matrix_rank(x.reshape(-1, params) / scale, rtol=1e-9)) for x in (base, full)]
    assert ranks[0] == ranks[1] < params


def test_rows_do_not_know_where_the_laboratory_is(seed):
    """Turned about the vertical and moved elsewhere, the same motion has the same rows in turned axes."""
    trial, _ = moving(seed)
    turn, shift = roma.rotvec_to_rotmat(torch.tensor([0.0, 0.0, 1.1]).double()), torch.tensor([3.0, -2.0, 0.5]).double()
    m = trial.motion
    q, v, a = m.q.clone(), m.v.clone(), m.a.clone()
    q[:, :3] = q[:, :3] @ turn.T + shift
    q[:, 3:6] = roma.rotmat_to_rotvec(turn @ roma.rotvec_to_rotmat(q[:, 3:6]))
    for x in (v, a):
        x[:, :3], x[:, 3:6] = x[:, :3] @ turn.T, x[:, 3:6] @ turn.T
    elsewhere = WrenchTrial(
        "moved", trial.tree, trial.geometry, Motion(m.time, q, v, a, m.smoother), trial.wrench, trial.used
    )
    part = slice(0, len(q))
    both = torch.block_diag(turn, turn)
    assert_close(elsewhere.rows(part)[0], torch.einsum("ij,jpt->ipt", both, trial.rows(part)[0]), rtol=1e-8, atol=1e-8)


def test_wrench_about_a_point_of_its_line_has_no_moment(seed):
    """A pure force has no moment about its own point, and two shifts are one."""
    force, point, shift = (torch.randn(50, 3, dtype=torch.float64) for _ in range(3))
    wrench = torch.cat([force, torch.linalg.cross(point, force)], dim=1)
    there = wrench_about(wrench, point)
    assert_close(there, torch.cat([force, torch.zeros_like(force)], dim=1), rtol=0, atol=1e-12)
    assert_close(wrench_about(there, shift), wrench_about(wrench, point + shift), rtol=0, atol=1e-12)


def test_blocks_cover_the_used_runs(seed):
    """Blocks are the used frames without their short runs, none longer than the limit, none across a gap."""
    trial, _ = moving(seed, frames=2 * BLOCK + 200)
    used = trial.used.clone()
    used[[100, 100 + SHORTEST, 700]] = False
    kept = used.clone()
    kept[100 : 100 + SHORTEST] = False
    blocks = list(WrenchTrial("x", trial.tree, trial.geometry, trial.motion, trial.wrench, used).blocks())
    covered = torch.zeros_like(used)
    for part in blocks:
        assert part.stop - part.start <= BLOCK and not bool(covered[part].any())
        covered[part] = True
    assert covered.tolist() == kept.tolist()
    assert runs(used)[0] == (0, 100)


@pytest.mark.parametrize(("frames", "kept"), [(7, 7), (64, 20), (513, 60)])
def test_cosine_rows_are_orthonormal(frames, kept):
    """White noise stays white."""
    C = cosine_matrix(frames, kept)
    assert_close(C @ C.T, torch.eye(kept, dtype=torch.float64), rtol=0, atol=1e-12)


def coloured(count: int, params: int) -> tuple[list[BlockSpectrum], torch.Tensor, torch.Tensor]:
    """Blocks whose six channels have another covariance in every band; also the parameters and those covariances."""
    U, _, Vh = torch.linalg.svd(torch.randn(len(BAND_EDGES_HZ) + 1, 6, 6, dtype=torch.float64))
    # Singular values within a factor of two: along a near-singular direction the floor of the noise would rule.
    root = U @ torch.diag_embed(0.7 + 0.7 * torch.rand(len(U), 6, dtype=torch.float64)) @ Vh
    root = root * torch.linspace(12.0, 3.0, len(root), dtype=torch.float64)[:, None, None]
    phi, blocks = torch.randn(params, dtype=torch.float64), []
    for _ in range(count):
        frequency = frequencies(500, 150, 100.0)
        band = band_of(frequency)
        Y = 20.0 * torch.randn(6, params, len(band), dtype=torch.float64)
        noise = torch.einsum("kij,kj->ik", root[band], torch.randn(len(band), 6, dtype=torch.float64))
        blocks.append(BlockSpectrum(Y, torch.einsum("ipk,p->ik", Y, phi) + noise, frequency))
    return blocks, phi, root @ root.mT


def test_white_rows_have_unit_covariance(seed):
    """Whitened rows, the blocks' means apart, have independent channels of variance one in every band."""
    blocks, phi, _ = coloured(120, 12)
    whitening = estimate_whitening(((block, phi) for block in blocks), 0.0)
    residual = torch.stack([(lambda Y, F: F - Y @ phi)(*whitening(block)) for block in blocks])
    residual = residual.reshape(len(blocks), -1, 6)
    for band in blocks[0].band[1:].unique():
        rows = residual[:, 1:][:, blocks[0].band[1:] == band].reshape(-1, 6)
        sample = rows.T @ rows / len(rows)
        # Five standard deviations of what so many rows estimate, and a little for the floor of the noise.
        sd = (2.0 / len(rows)) ** 0.5
        assert_close(sample, torch.eye(6, dtype=torch.float64), rtol=0, atol=0.08 + 5.0 * sd)
        assert float(torch.diagonal(sample).mean()) == pytest.approx(1.0, abs=0.08 + 5.0 * sd / 6.0**0.5)


def test_weights_beat_equal_weights(seed):
    """With the right covariance the estimate is nearer to the truth than with the first guess, on average."""
    errors = []
    for _ in range(4):
        blocks, phi, covariance = coloured(3, 12)
        pair = []
        for whitening in (initial_whitening(phi), Whitening(covariance)):
            sums = accumulate(blocks, whitening)
            pair.append(float((torch.linalg.solve(sums.gram, sums.moment) - phi).norm()))
        errors.append(pair)
    mean = torch.tensor(errors).square().mean(0)
    assert mean[1] < mean[0]


def test_sums_over_blocks_are_sums_over_rows(seed):
    """Accumulation equals stacking all white rows."""
    blocks, _, covariance = coloured(3, 12)
    whitening = Whitening(covariance)
    rows = [whitening(block) for block in blocks]
    stacked = NormalEquations.from_rows(torch.cat([Y for Y, _ in rows]), torch.cat([F for _, F in rows]))
    summed = accumulate(blocks, whitening)
    assert_close(summed.gram, stacked.gram)
    assert_close(summed.moment, stacked.moment)
    assert summed.rows == stacked.rows


def test_spectra_of_a_long_trial_are_made_anew_in_every_pass(seed, monkeypatch):
    """Not kept, they are the same in every pass, and the same as kept ones."""
    trial, _ = moving(seed, frames=80)
    kept = spectra(trial)
    monkeypatch.setattr("torchid.dynamics.whitening.KEPT", 79)
    long = spectra(trial)
    for _ in range(2):
        for block, same in zip(long, kept, strict=True):
            assert_close(block.Y, same.Y, rtol=0, atol=0)
            assert_close(block.F, same.F, rtol=0, atol=0)


def test_spectra_keep_the_linear_model(seed):
    """In the frequency domain the true parameters still explain a noiseless trial."""
    trial, phi = moving(seed, frames=80)
    for block in spectra(trial):
        assert_close(torch.einsum("ipk,p->ik", block.Y, phi.flatten()), block.F, rtol=1e-8, atol=1e-7)


@pytest.mark.parametrize("columns", [5, 256, 257, 900])
def test_half_a_product_is_all_of_it(columns):
    """Whatever blocks it is taken in."""
    Y = torch.randn(40, columns, dtype=torch.float64, generator=torch.Generator().manual_seed(columns))
    torch.testing.assert_close(half_product(Y), Y.mT @ Y)
