"""Motion that obeys its forces: its linear system, what it finds of hidden errors, and what it refuses to follow."""

from dataclasses import replace

import numpy as np
import pytest
import small_session as small
import torch
import xarray
from torch.testing import assert_close
from trees import coupled_tree, random_inertia, random_motion, random_tree

from torchid.config import load_config
from torchid.dynamics.rows import WrenchTrial, residual_rms
from torchid.dynamics.whitening import cosine_matrix
from torchid.effects.displacement import carriage, coordinate_levers, levers
from torchid.effects.scene import make_scene
from torchid.errors import ConfigError
from torchid.filters import Smoother
from torchid.motion import Motion
from torchid.observation.noise_draws import displaced
from torchid.report.consistent import consistent_section
from torchid.run import run_experiment
from torchid.run.consistent import BESIDE_S, PIECE, _pieces, with_consistent
from torchid.run.sequence import run_key
from torchid.run.torque_bands import seen_trials
from torchid.run.write import CONSISTENT, result_names
from torchid.storage.documents import read_document
from torchid.storage.results import OutputFolder
from torchid.torque.consistent import _rows, changed, consistent_motion
from torchid.torque.posture_errors import UNSEEN, error_penalty, posture_precision
from torchid.torque.seen import KEPT
from torchid.torque.spline_system import BlockBand, Knots

TRIAL = "sway_steps"
HIDDEN = 8
"""Errors that are hidden in the motion, drawn anew each."""
SIZE_M = 0.008
"""Root mean square of a hidden slide of a segment's markers."""


@pytest.fixture(scope="module")
def outcome():
    return small.outcome()


@pytest.fixture(scope="module")
def seen(outcome):
    return seen_trials(outcome, [TRIAL])[0]


@pytest.fixture(scope="module")
def exact(outcome, seen) -> WrenchTrial:
    """The trial's motion with the wrench that it needs, to the last digit."""
    rows = outcome.followed[TRIAL].wrench
    motion = changed(rows, torch.zeros_like(rows.motion.q))
    needed = make_scene(TRIAL, rows.tree, rows.geometry, motion, outcome.phi).needed().T
    return replace(rows, motion=motion, wrench=needed)


def random_band(knots: Knots, size: int, generator: torch.Generator) -> tuple[BlockBand, torch.Tensor]:
    """A positive definite matrix of random rows, and the same dense."""
    band = BlockBand(knots, size, torch.zeros((), dtype=torch.float64))
    dense = torch.zeros(knots.coefficients, size, knots.coefficients, size, dtype=torch.float64)
    for k in range(knots.intervals):
        J = torch.randn(4 * size + 3, 4 * size, generator=generator, dtype=torch.float64)
        own = (J.mT @ J).view(4, size, 4, size)
        parts = torch.zeros(knots.intervals, 4, size, 4, size, dtype=torch.float64)
        parts[k] = own
        band.add(parts)
        dense[k : k + 4, :, k : k + 4] += own
    return band, dense.flatten(2).flatten(0, 1)


@pytest.mark.parametrize("frames", [17, 24, 31])
def test_the_banded_system_is_the_dense_one(frames: int, seed: int) -> None:
    """Products, solutions and the covariance of draws are those of the whole matrix."""
    generator, size = torch.Generator().manual_seed(seed), 3
    knots = Knots(frames, 4, 100.0)
    band, dense = random_band(knots, size, generator)
    x = torch.randn(knots.coefficients, size, generator=generator, dtype=torch.float64)
    assert_close(band.times(x).flatten(), dense @ x.flatten())
    factor = band.factor()
    assert_close(factor.solve(x).flatten(), torch.linalg.solve(dense, x.flatten()))
    white = torch.eye(len(dense), dtype=torch.float64).unflatten(0, (-1, size))
    root = factor.draw(white).flatten(0, 1)
    assert_close(root @ root.mT, torch.linalg.inv(dense))


def test_splines_have_the_derivatives_of_their_course(seed: int) -> None:
    """Of a course with many frames between knots, differences of its values are the derivatives."""
    knots = Knots(2000, 100, 1000.0)
    c = torch.randn(knots.coefficients, 1, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
    course, touched = knots.course(c)[:, 0], c.unfold(0, 4, 1)[:, 0]
    slope, bend = (torch.einsum("hp,ip->ih", one, touched).flatten() for one in knots.basis(c)[1:])
    inner = (course[2:] - course[:-2]) * 500.0, (course[2:] - 2 * course[1:-1] + course[:-2]) * 1e6
    assert_close(inner[0], slope[1:-1], rtol=0.0, atol=1e-3 * float(slope.abs().max()))
    within = (torch.arange(1, 1999) % 100).clamp(1, 98) == torch.arange(1, 1999) % 100
    assert_close(inner[1][within], bend[1:-1][within], rtol=0.0, atol=1e-5 * float(bend.abs().max()))


@pytest.mark.parametrize("coupled", [False, True])
def test_levers_of_coordinates_are_those_of_the_bodies_they_carry(coupled: bool, seed: int) -> None:
    """Of any tree, also where functions drive joints."""
    rng = np.random.default_rng(seed)
    tree, geometry = random_tree(rng)
    tree = coupled_tree(rng, tree) if coupled else tree
    q, v, a = random_motion(rng, tree, 5)
    motion = Motion(torch.arange(5) / 100.0, q, v, a, Smoother(6.0, 100.0))
    scene = make_scene("any", tree, geometry, motion, random_inertia(rng, len(tree.bodies)))
    assert_close(coordinate_levers(scene), (levers(scene) @ carriage(scene)).permute(1, 2, 0))


def test_rows_tell_what_a_change_of_the_coordinates_does(outcome, exact, seed: int) -> None:
    """Against the whole equations of motion, of a small slow change of all coordinates."""
    generator = torch.Generator().manual_seed(seed)
    knots = Knots(len(exact.used), 12, exact.rate)
    c = 1e-5 * torch.randn(knots.coefficients, exact.motion.q.shape[1], generator=generator, dtype=torch.float64)
    touched = c.unfold(0, 4, 1)
    courses = [torch.einsum("hp,inp->ihn", one, touched).flatten(0, 1)[: knots.frames] for one in knots.basis(c)]
    scenes = [
        make_scene(TRIAL, exact.tree, exact.geometry, motion, outcome.phi)
        for motion in (exact.motion, changed(exact, courses[0]))
    ]
    told = sum(torch.einsum("int,tn->it", row, x) for row, x in zip(_rows(scenes[0]), courses, strict=True))
    first, second = (scene.needed() for scene in scenes)
    off = second - first
    off[3:] -= torch.linalg.cross(scenes[0].q[:3], off[:3], dim=0)
    inner = slice(20, -20)
    wrong = (told - off)[:, inner].square().mean(1).sqrt() / off[:, inner].square().mean(1).sqrt()
    assert float(wrong.max()) < 0.03


def test_hidden_slides_of_whole_segments_are_taken_back(outcome, seen, exact, seed: int) -> None:
    """All markers of a segment slide as one, which no residual shows; forces tell it, of the centre of mass.

    Segment, direction and course are drawn. The body's centre of mass comes nearer to where it was in nearly all.
    """
    generator, nearer = torch.Generator().manual_seed(seed), 0
    sight = seen.response.sight
    for _ in range(HIDDEN):
        error = slide(sight, exact, generator)
        found = seen.response.followed(error.permute(2, 0, 1).flatten(1)[:, :, None])[:, :, 0]
        wrong = displaced(exact.motion, exact.motion.smoother(found))
        rows = replace(exact, motion=wrong)
        response = replace(seen.response, error=seen.response.error + left_of(seen, found, error))
        best = consistent_motion(response, rows, outcome.phi)
        before, after = (centre_error(outcome, exact, motion) for motion in (wrong, best.motion))
        nearer += after < 0.7 * before
        assert best.settled
        assert residual_rms([replace(rows, motion=best.motion)], outcome.phi)[0] < residual_rms([rows], outcome.phi)[0]
    assert nearer >= HIDDEN - 2


def slide(sight, rows: WrenchTrial, generator: torch.Generator) -> torch.Tensor:
    """A slide of all markers of one segment of the trunk or a thigh, (markers, 3, frames), in W [m]."""
    segments = [s for s in ("pelvis", "thorax", "thigh_l", "thigh_r") if sight.on(s)]
    segment = segments[int(torch.randint(len(segments), (), generator=generator))]
    course = rows.motion.smoother(torch.randn(len(rows.used), 3, generator=generator, dtype=torch.float64))
    course *= SIZE_M / course.square().sum(1).mean().sqrt()
    error = torch.zeros_like(sight.p)
    error[list(sight.on(segment))] = course.T
    return error


def left_of(seen, found: torch.Tensor, error: torch.Tensor) -> torch.Tensor:
    """What postures that follow a slide leave of it in the residuals."""
    J = seen.response.jacobian(slice(None))
    moved = (J @ found[:, :, None])[:, :, 0].unflatten(1, (-1, 3)).permute(1, 2, 0)
    return torch.where(seen.response.weight[:, None] > 0.0, error - moved, 0.0)


def centre_error(outcome, rows: WrenchTrial, motion) -> float:
    """How far the centre of mass is from the true one, its mean place apart [m]."""
    both = [
        make_scene(TRIAL, rows.tree, rows.geometry, one, outcome.phi).centre_of_mass for one in (motion, rows.motion)
    ]
    off = (both[0] - both[1])[:, rows.used]
    return float((off - off.mean(1, keepdim=True)).square().sum(0).mean().sqrt())


def test_a_fault_of_plates_does_not_bend_the_body(outcome, seen, exact, seed: int) -> None:
    """A tenth of the weight too much, all the time, is no motion: it is not followed, and trust says so."""
    generator = torch.Generator().manual_seed(seed)
    force = exact.wrench[exact.used, 2].mean()
    sign = 1.0 if float(torch.rand((), generator=generator)) < 0.5 else -1.0
    wrench = exact.wrench.clone()
    wrench[:, 2] += sign * 0.1 * force
    found = consistent_motion(seen.response, replace(exact, wrench=wrench), outcome.phi)
    sound = consistent_motion(seen.response, exact, outcome.phi)
    used = exact.used
    assert float(found.trust[used].mean()) < 0.3 < 0.9 < float(sound.trust[used].mean())
    assert float(sound.change.abs().max()) < 1e-3
    assert float(found.change[:, :3].square().mean().sqrt()) < 0.03
    wrench = exact.wrench.clone()
    wrench[:, 3] += sign * 0.1 * wrench[:, 2]  # pressures 0.1 m off
    shifted = consistent_motion(seen.response, replace(exact, wrench=wrench), outcome.phi)
    assert float(shifted.trust[used].mean()) < 0.5


@pytest.mark.parametrize("used", ["none", "air"])
def test_where_plates_bear_nothing_markers_decide(outcome, seen, exact, used: str) -> None:
    """Without used frames, and where these are of a body that nobody has weighed, nothing is bent and all ends."""
    rows = replace(exact, used=torch.zeros_like(exact.used)) if used == "none" else exact
    rows = replace(rows, wrench=torch.zeros_like(rows.wrench))
    found = consistent_motion(seen.response, rows, outcome.phi)
    assert bool(found.change.isfinite().all())
    blind = replace(seen.response, weight=torch.zeros_like(seen.response.weight))
    assert bool(consistent_motion(blind, rows, outcome.phi).change.isfinite().all())
    generator = torch.Generator().manual_seed(small.SEED)
    assert all(float(error.abs().max()) > 0.0 for error, _ in found.draw(2, generator))
    if used == "none":
        assert found.settled
        assert float(found.change.abs().max()) == 0.0
    else:
        assert float(found.trust[rows.used].mean()) < 0.1


def test_errors_of_markers_have_the_spectrum_of_their_residuals(seen, seed: int) -> None:
    """Residuals that are drawn with a known spectrum give it back."""
    generator, sight = torch.Generator().manual_seed(seed), seen.response.sight
    frames, rate = 4000, sight.scene.rate
    frequency = 0.5 * rate / frames * torch.arange(frames, dtype=torch.float64)
    squared = (2.0 * torch.pi * frequency).square()
    true = torch.tensor([0.02, 3e-4, 1e-6], dtype=torch.float64)
    precision = true[0] + true[1] * squared + true[2] * squared.square()
    seen_marker = seen.response.weight.amax(1) > 0.0
    white = torch.randn(len(seen_marker), 3, frames, generator=generator, dtype=torch.float64) / precision.sqrt()
    error = white @ cosine_matrix(frames, frames)
    kept = seen.response.bands.kept.view(-1, 3).mean(1).clamp(min=KEPT)
    scale = (kept / seen.response.weight.amax(1).clamp(min=1e-9)).sqrt() * seen_marker
    weight = seen.response.weight.amax(1, keepdim=True).expand(-1, frames)
    drawn = replace(seen.response, error=error * scale[:, None, None], weight=weight)
    drawn.__dict__["bands"] = seen.response.bands
    found = error_penalty(drawn, Smoother(100.0 * rate, rate))
    inner = squared[(frequency > 0.1) & (frequency < 6.0)]
    terms = torch.stack([torch.ones_like(inner), inner, inner.square()], 1)
    assert float(((terms @ found) / (terms @ true)).log().abs().max()) < 0.2


def test_precision_of_postures_is_that_of_their_markers(seen, monkeypatch) -> None:
    """Without slides of whole segments it is J' W J, and with them less in every direction."""
    with_slides = posture_precision(seen.response)
    monkeypatch.setattr("torchid.torque.posture_errors.TOGETHER", 0.0)
    H, response = posture_precision(seen.response), seen.response
    J, w = response.jacobian(slice(0, 5)), response.mean_weight.repeat_interleave(3)
    own = UNSEEN**-2 * torch.eye(H.shape[1], dtype=torch.float64)
    assert_close(H[:5], J.mT @ (w[:, None] * J) + own, rtol=1e-9, atol=1e-6 * float(H.abs().max()))
    assert float(torch.linalg.eigvalsh(H - with_slides).min()) > -1e-9 * float(H.abs().max())


@pytest.mark.parametrize("frames", [300, PIECE, 3 * PIECE + 77])
def test_pieces_share_frames_without_loss(frames: int) -> None:
    """Shares of all pieces add up to one in every frame, and neighbours overlap."""
    total = torch.zeros(frames, dtype=torch.float64)
    pieces = list(_pieces(frames, 100.0))
    for piece in pieces:
        total[piece.part] += piece.share
    assert_close(total, torch.ones_like(total))
    assert len(pieces) == max(1, round(frames / PIECE))
    for one, other in zip(pieces, pieces[1:], strict=False):
        assert one.part.stop - other.part.start == 2 * round(BESIDE_S * 100.0)


def test_the_report_shows_what_was_left_and_what_moved(outcome, tmp_path) -> None:
    """Every trial with forces has a row, every coordinate another; without the motion there is no section."""
    assert consistent_section(outcome) is None
    with OutputFolder(tmp_path / "out") as folder:
        found = with_consistent(outcome, folder)
    section = consistent_section(found)
    assert section is not None
    figure, trials, details = section.blocks
    (changes,) = details.blocks
    assert [row[0] for row in trials.rows] == list(found.consistent)
    assert len(changes.rows) == len(outcome.fit.model.tree.dofs)
    for one in found.consistent.values():
        assert one.settled and one.trusted > 0.9
        assert one.after.force_N < one.before.force_N and one.after.marker_m < one.before.marker_m + 1e-3
    assert figure.svg.startswith("<svg")
    assert not any(note.code.startswith("consistent.") for note in found.notes)


@pytest.mark.usefixtures("no_report")
def test_a_run_writes_the_motion_that_obeys_its_forces(outcome, tmp_path) -> None:
    """Only where it is asked for, with deviations where draws are; no stage is computed anew for it."""
    assert not outcome.consistent
    few = ["geometry.max_frames=20", "geometry.iterations=8", "inertia.refuse=false"]
    over = [f"out={tmp_path / 'out'}", "diagnosis.enabled=false", *few]
    config = load_config(small.config(), over)
    more = load_config(small.config(), [*over, "motion.consistent=true", "torques.draws=3"])
    assert run_key(config) == run_key(more)
    trials = tuple(trial for trial in config.trials if trial.name in ("static", "squats", TRIAL))
    run_experiment(more.model_copy(update={"trials": trials}))
    with xarray.open_dataset(tmp_path / "out" / f"motion_{TRIAL}.nc") as held:
        q, torque, sd = (held[f"{name}_consistent{end}"] for name, end in (("q", ""), ("torque", ""), ("v", "_sd")))
        assert q.shape == torque.shape == sd.shape == held["q"].shape
        assert 0.0 < float(abs(q - held["q"]).max()) < 0.5
        assert float(sd.median()) > 0.0
    for file in CONSISTENT:
        assert (tmp_path / "out" / file.format(TRIAL)).exists()
        assert file.format(TRIAL) in result_names([TRIAL], consistent=True)
        assert file.format(TRIAL) not in result_names([TRIAL])
    run_experiment(config.model_copy(update={"trials": trials}))
    stages = read_document(tmp_path / "out" / "provenance.json")["stages"]
    assert stages["geometry"]["reused"] and stages["inertia"]["reused"]
    assert not any((tmp_path / "out" / file.format(TRIAL)).exists() for file in CONSISTENT)


def test_trials_that_would_write_one_file_are_refused(tmp_path) -> None:
    """``walk_consistent_id.sto`` is what a walk writes, and what a trial called ``walk_consistent`` does."""
    config = load_config(small.config(), [f"out={tmp_path / 'out'}", "motion.consistent=true"])
    first, second, *_ = config.trials
    named = (first, second.model_copy(update={"name": f"{first.name}_consistent"}))
    with pytest.raises(ConfigError) as refused:
        run_experiment(config.model_copy(update={"trials": named}))
    assert refused.value.code == "config.names" and f"{first.name}_consistent_id.sto" in refused.value.found
    assert not (tmp_path / "out" / "geometry.json").exists()


def test_who_has_no_inertia_is_told_that_no_such_motion_was_sought(outcome, tmp_path) -> None:
    with OutputFolder(tmp_path / "out") as folder:
        found = with_consistent(replace(outcome, identified=None), folder)
    assert not found.consistent
    assert found.notes[-1].code == "consistent.none"
