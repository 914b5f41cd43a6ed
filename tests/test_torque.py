"""Bands of joint torques: what they are made of, and that they hold the truth."""

from dataclasses import replace

import numpy as np
import pytest
import small_session as small
import torch
import xarray
from torch.testing import assert_close

from torchid.config import load_config
from torchid.geometry.tracking import modelled, track
from torchid.motion import smooth_motion
from torchid.run import run_experiment
from torchid.run.torque_bands import outcome_draws, seen_trials
from torchid.session.following import torques
from torchid.torque.bodies import BodyDraws, draw_skin, find_slides, slide_size
from torchid.torque.draws import PlateErrors, torque_draws
from torchid.torque.inverse import Load, joint_torques
from torchid.torque.seen import SeenTrial, by_markers

TRIAL = "sway_steps"
INNER = slice(40, -40)
"""Frames away from the ends of the trial."""
NONE = PlateErrors(gain=0.0, place_m=0.0)


@pytest.fixture(scope="module")
def outcome():
    return small.outcome()


@pytest.fixture(scope="module")
def seen(outcome) -> SeenTrial:
    return seen_trials(outcome, [TRIAL])[0]


def test_loads_give_the_torques_of_the_run(outcome, seen):
    found = joint_torques(outcome.fit.model.tree, outcome.fit.geometry, outcome.phi, seen.motion, seen.loads)
    fit = outcome.fit
    run = torques(outcome.followed[TRIAL], fit.model.tree, fit.geometry, outcome.phi, outcome.session.trials[TRIAL])
    known = torch.isfinite(run)
    assert known.double().mean() > 0.5
    assert_close(found[known], run[known], rtol=1e-9, atol=1e-7)


@pytest.mark.slow
def test_markers_noise_moves_torques_as_tracking_other_noise_does(outcome, seen):
    """The linear response against the whole chain: other noise, tracked and filtered anew."""
    fit, trial = outcome.fit, outcome.session.trials[TRIAL]
    generator = torch.Generator().manual_seed(small.SEED)
    p, found = modelled(fit, seen.motion.q), []
    for _ in range(16):
        noisy = p + 1e-3 * torch.randn(p.shape, generator=generator, dtype=torch.float64)
        markers = replace(trial.markers.select(fit.attachment.labels), position=noisy)
        tracked = track(fit, markers, near=seen.motion.q)
        motion = smooth_motion(fit.model.tree, seen.motion.time, tracked.q, seen.motion.smoother)
        found.append(joint_torques(fit.model.tree, fit.geometry, outcome.phi, motion, seen.loads))
    whole = torch.stack(found).std(0)[INNER, 6:].square().mean(0).sqrt()
    noise = 1e-3 * torch.randn(seen.response.error.shape, generator=generator, dtype=torch.float64)
    kept = seen.response.bands.kept.view(-1, 3).mean(1)[:, None, None]
    white = replace(seen, response=replace(seen.response, error=noise * kept.clamp(min=0.1).sqrt()))
    still = _still_bodies(outcome, seen, 24)
    drawn = torque_draws(fit, outcome.phi, [replace(white, loads=_slow(seen.loads))], still, generator, NONE)
    linear = (drawn.draws[TRIAL] - drawn.draws[TRIAL].mean(0)).std(0)[INNER, 6:].square().mean(0).sqrt()
    ratio = linear / whole
    assert 0.8 < float(ratio.median()) < 1.25
    assert float(ratio.min()) > 0.5
    assert float(ratio.max()) < 2.0


def _slow(loads: tuple[Load, ...]) -> tuple[Load, ...]:
    return tuple(replace(load, fast=None) for load in loads)


def _still_bodies(outcome, seen: SeenTrial, count: int):
    """Draws in which the body is the identified one."""
    skin = draw_skin([seen], count, torch.Generator().manual_seed(0))
    still = replace(skin, along=torch.zeros_like(skin.along))
    return BodyDraws(outcome.fit.xi.expand(count, -1), still, outcome.phi.expand(count, *outcome.phi.shape))


@pytest.mark.slow
def test_a_plate_that_reads_elsewhere_turns_the_ankle(outcome, seen):
    count, shift = 200, 0.01
    drawn = torque_draws(
        outcome.fit, outcome.phi, [replace(seen, loads=_slow(seen.loads), response=_calm(seen))],
        _still_bodies(outcome, seen, count), torch.Generator().manual_seed(small.SEED), PlateErrors(0.0, shift),
    )  # fmt: skip
    dof = outcome.fit.model.tree.dof_names.index("ankle_r_flexion")
    load = sum(one.wrench[:, 2] for one in seen.loads if one.body == "foot_r")
    standing = load > 100.0
    # The axis leans a little, and two plates may share a foot.
    expected = shift * load[standing]
    ratio = (drawn.sd(TRIAL)[standing, dof] / expected).median()
    assert 0.7 < float(ratio) < 1.2


def _calm(seen: SeenTrial):
    return replace(seen.response, error=torch.zeros_like(seen.response.error))


def test_surrogates_have_the_energy_of_the_residuals(seen):
    generator = torch.Generator().manual_seed(small.SEED)
    drawn = torch.stack(list(by_markers(seen, 8, generator)))
    assert torch.isfinite(drawn).all()
    again = torch.stack(list(by_markers(seen, 8, torch.Generator().manual_seed(small.SEED))))
    assert_close(drawn, again)
    assert float(drawn.std()) > 0.0
    nothing = torch.stack(list(by_markers(replace(seen, response=_calm(seen)), 2, generator)))
    assert float(nothing.abs().max()) == 0.0


@pytest.mark.slow
def test_bands_hold_the_true_torques(outcome):
    """All joints and frames of a trial that took no part in the fit."""
    session = small.session()
    subject, truth = session.subject, session.trial(TRIAL).truth
    loads = [Load(f"foot_{side}", truth.feet.wrench[:, k]) for k, side in enumerate("lr")]
    true = joint_torques(subject.model.tree, subject.geometry, subject.phi, truth.motion, loads)
    drawn = outcome_draws(outcome, [TRIAL], 32, small.SEED, NONE)
    known = torch.isfinite(outcome.torque[TRIAL]) & outcome.followed[TRIAL].wrench.used[:, None]
    known[:, :6] = False
    inside = ((outcome.torque[TRIAL] - true).abs() < 1.96 * drawn.sd(TRIAL))[known]
    assert float(inside.double().mean()) > 0.8
    # Bands that hold everything because they are wide say nothing.
    assert float(drawn.sd(TRIAL)[known].square().mean().sqrt()) < 3.0


@pytest.mark.slow
def test_conditions_share_their_body(outcome):
    """What the body gets wrong is the same in two trials, and leaves their difference."""
    names = [TRIAL, next(iter(outcome.session.fit("inertia")))]
    drawn = outcome_draws(outcome, names, 32, small.SEED, NONE)
    off = [(drawn.draws[name] - drawn.value[name])[:, INNER, 6:].mean(1) for name in names]
    # Neck and trunk hold the same body in both, whose centre of mass is the same: their errors go together.
    columns = [outcome.fit.model.tree.dof_names.index(f"{joint}_flexion") - 6 for joint in ("neck", "lower_spine")]
    for k in columns:
        both = torch.stack([one[:, k] for one in off])
        assert float(torch.corrcoef(both)[0, 1]) > 0.5


def test_slides_are_as_large_as_what_was_planted(outcome):
    """Every marker slides by itself; postures take a part, and the rest stands in the residuals."""
    trials, planted = seen_trials(outcome, list(outcome.session.fit("inertia"))), 0.006
    slides, generator = find_slides(trials), torch.Generator().manual_seed(small.SEED)
    drawn = draw_skin(trials, 1, generator)
    white = planted * torch.randn(drawn.along.shape, generator=generator, dtype=torch.float64)
    skin = replace(drawn, along=torch.where(drawn.along != 0.0, white, 0.0))
    assert slide_size(slides, trials) < 0.2 * planted
    assert 0.6 * planted < slide_size(slides, [_slid(trial, skin.shift(trial)[0]) for trial in trials]) < 1.6 * planted


def _slid(trial: SeenTrial, shift: torch.Tensor) -> SeenTrial:
    response = trial.response
    rows = shift.permute(2, 0, 1).flatten(1)[..., None]
    left = rows - response.jacobian(slice(None)) @ response.followed(rows)
    error = response.error + left[..., 0].unflatten(1, (-1, 3)).permute(1, 2, 0)
    return replace(trial, response=replace(response, error=error))


@pytest.mark.slow
@pytest.mark.usefixtures("no_report")
def test_a_run_writes_its_bands(outcome, tmp_path):
    """Only where draws are asked for, and blank where the torque is."""
    assert not outcome.torque_sd
    few = ["geometry.max_frames=20", "geometry.iterations=8", "inertia.refuse=false"]
    over = [f"out={tmp_path / 'out'}", "diagnosis.enabled=false", "torques.draws=3", *few]
    config = load_config(small.config(), over)
    trials = tuple(trial for trial in config.trials if trial.name in ("static", "squats", TRIAL))
    run_experiment(config.model_copy(update={"trials": trials}))
    with xarray.open_dataset(tmp_path / "out" / f"motion_{TRIAL}.nc") as held:
        torque, sd = held["torque"].values, held["torque_sd"].values
    assert (np.isfinite(torque) == np.isfinite(sd)).all() and np.nanmedian(sd[:, 6:]) > 0.0
