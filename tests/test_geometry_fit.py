"""The geometric fit of a whole person: better than a scaled template, tied and grouped as asked, blind to the room."""

import functools
from dataclasses import replace

import pytest
import roma
import small_session as small
import torch
from torch.testing import assert_close

from torchid.errors import DataError
from torchid.geometry import tracking
from torchid.geometry.fit import fit_geometry, start_fit
from torchid.geometry.options import GeometryOptions
from torchid.geometry.posture import gap_filling
from torchid.geometry.posture import initial_posture as start_module
from torchid.geometry.posture.continuity import breaks, continuous
from torchid.geometry.posture.initial_posture import settle, turned_back
from torchid.geometry.problem import MarkerProblem
from torchid.geometry.result import parameters
from torchid.geometry.tracking import Tracked, modelled, track
from torchid.geometry.trial_problem import posture_prior, settled, trial_problem
from torchid.kinematics.chain import chain_poses
from torchid.recording import Markers

pytestmark = pytest.mark.slow


@functools.cache
def followed(free: bool = True) -> Tracked:
    """The held-out trial as it is, by the fit or by the scaled template."""
    return track(small.fit(free), small.markers("heldout")["sway_steps"])


@functools.cache
def problem_of() -> MarkerProblem:
    """Of the held-out trial, by the fit."""
    fit = small.fit()
    return trial_problem(fit, small.markers("heldout")["sway_steps"], posture_prior(fit))


@functools.cache
def postures() -> torch.Tensor:
    """Coordinates (dofs, frames) to which this problem settles."""
    return settled(small.fit(), problem_of())


def joint_errors(free: bool) -> torch.Tensor:
    """RMS distance of every joint centre from the true one over the held-out trial [m]."""
    fit, item = small.fit(free), small.session().trial("sway_steps")
    mine = chain_poses(fit.model.tree, followed(free).q, fit.geometry)[..., :3, 3]
    true = chain_poses(fit.model.tree, item.truth.motion.q, small.session().subject.geometry)[..., :3, 3]
    return (mine - true).square().sum(2).mean(0).sqrt()


def test_identified_geometry_follows_unseen_motion_better_than_the_scaled_template():
    """On the held-out trial both the markers' residual and the joint centres' errors fall."""
    identified, scaled = (followed(free).rmse for free in (True, False))
    assert identified < 0.7 * scaled
    assert float(joint_errors(True).square().mean()) < float(joint_errors(False).square().mean())


def test_residual_is_the_markers_noise():
    """One millimetre of noise a coordinate leaves at most its three-dimensional length."""
    assert followed().rmse < 1.2e-3 * 3**0.5


def test_true_lengths_lie_within_the_stated_scatter():
    """Standard deviations of xi are no larger than the prior's, and errors are of their size."""
    fit, truth = small.fit(), small.session().subject.xi
    assert fit.uncertainty is not None
    named = len(fit.prior.mean)
    sd = fit.uncertainty.sd[:named]
    assert bool((sd <= fit.prior.sd * (1 + 1e-6)).all()) and float(sd.min()) > 0.0
    z = (fit.xi[:named] - truth) / sd
    assert float((z.abs() < 3.0).double().mean()) > 0.8
    assert all(0.0 <= direction.share < 0.5 for direction in fit.uncertainty.undetermined)


def test_scaled_template_keeps_its_joints():
    """Without freedom only the markers are placed."""
    fit = small.fit(False)
    mean = small.template().geometry.geometry(small.template().geometry.mean)
    assert_close(fit.geometry.offset, mean.offset)
    assert_close(fit.geometry.hinge, mean.hinge)
    assert float((fit.place - fit.attachment.mean).norm(dim=1).max()) > 1e-3


def test_ties_make_the_sides_mirror_each_other():
    """Tied geometry has one length for both shanks, whatever xi is."""
    model = small.template()
    prior = parameters(model, GeometryOptions(symmetry="tied"))
    assert len(prior.names) < len(model.geometry.names)
    geometry = prior.geometry(prior.mean + prior.sd * torch.randn(len(prior.mean), dtype=torch.float64))
    mirror = torch.tensor([1.0, -1.0, 1.0], dtype=torch.float64)
    for name in ("thigh", "shank", "foot", "forearm", "hand"):
        left, right = (geometry.offset[model.tree.index(f"{name}_{side}")] for side in "lr")
        assert_close(left, mirror * right)


def test_groups_become_one_parameter_in_proportion():
    """Grouped bones change by the same factor and at the mean nothing changes."""
    model = small.template()
    members = tuple(name for name in model.geometry.names if name.endswith("_length") and "_l_" in name)[:2]
    prior = parameters(model, GeometryOptions(groups={"left": members}))
    assert "left" in prior.names and not set(members) & set(prior.names)
    assert_close(prior.geometry(prior.mean).offset, model.geometry.geometry(model.geometry.mean).offset)
    xi = prior.mean.clone()
    xi[prior.names.index("left")] *= 1.1
    change = prior.geometry(xi).offset.norm(dim=1) / prior.geometry(prior.mean).offset.norm(dim=1)
    assert int((change > 1.05).sum()) == 2


def test_fit_does_not_depend_on_where_the_room_is():
    """Turned about the vertical and moved by metres, the recording gives the same xi, well within its sd."""
    turn = roma.rotvec_to_rotmat(torch.tensor([0.0, 0.0, 2.0], dtype=torch.float64))
    shift = torch.tensor([4.0, -3.0, 0.1], dtype=torch.float64)

    def moved(markers: Markers) -> Markers:
        return replace(markers, position=markers.position @ turn.T + shift)

    given, static = small.assignment(), small.markers("static")["static"]
    trials = {name: small.markers("fit")[name] for name in ("squats", "arms")}
    options = GeometryOptions(max_frames=24, tolerance=1e-9)
    here = fit_geometry(given.model, given.attachment, trials, static, options)
    there = {name: moved(markers) for name, markers in trials.items()}
    away = fit_geometry(given.model, given.attachment, there, moved(static), options)
    assert here.uncertainty is not None
    assert float(((away.xi - here.xi) / here.uncertainty.sd).abs().max()) < 0.25


def test_gaps_are_bridged_better_with_the_temporal_prior():
    """Where an arm's markers are lost for a fifth of a second, its course is nearer to the unbroken one."""
    fit, held = small.fit(), small.markers("fit")["arms"].frames(slice(100, 230))
    gap = slice(50, 70)
    lost = tuple(
        label
        for label, body in zip(fit.attachment.labels, fit.attachment.body.tolist(), strict=True)
        if fit.model.tree.names[body] in ("forearm_l", "hand_l")
    )
    whole = track(fit, held).q
    spoilt = small.without(held, lost, gap)
    rows = [k for k, name in enumerate(fit.model.tree.dof_names) if name.startswith("elbow_l")]
    bridged, plain = (track(fit, spoilt, bridge=b) for b in (True, False))
    errors = [(found.q - whole)[gap][:, rows].square().mean() for found in (bridged, plain)]
    assert errors[0] < errors[1]
    assert not bool(plain.observable[gap].any()) and bool(plain.observable[:50].all())
    assert bool(torch.isnan(bridged.error[gap][:, [fit.attachment.labels.index(x) for x in lost]]).all())


def test_a_course_is_not_drawn_where_seen_markers_would_pay(monkeypatch):
    """A marker that no frame shows makes no gap; a course that leads astray leaves the frames as they were."""
    fit, held = small.fit(), small.markers("fit")["arms"].frames(slice(100, 230))
    never, some = small.without(held, ("LELB",)), small.without(held, ("LELB",), slice(50, 70))
    assert_close(track(fit, never).q, track(fit, never, bridge=False).q)
    course = gap_filling.smooth_course

    def astray(problem, q, xi, typical=None):
        prior = course(problem, q, xi, typical)
        drawn = prior.precision > problem.posture.precision
        return replace(prior, mean=torch.where(drawn, prior.mean + 0.5, prior.mean), precision=prior.precision + 1e6)

    monkeypatch.setattr(gap_filling, "smooth_course", astray)
    assert_close(track(fit, some).q, track(fit, some, bridge=False).q)


def beyond_limits(fit, q: torch.Tensor) -> torch.Tensor:
    """The same poses (dofs, frames), shoulders and hips by the triples of angles that no joint can take, hinges too."""
    far = q.clone()
    for body in fit.model.tree.bodies:
        rows = [turn.row for turn in body.turns if turn.moving]
        if len(rows) == 3:
            far[rows] = torch.stack([q[rows[0]] - torch.pi, torch.pi - q[rows[1]], q[rows[2]] + torch.pi])
        else:
            far[rows] += 2.0 * torch.pi
    return far


def test_joints_beyond_their_limits_are_turned_back_without_moving_a_marker():
    """Angles change, poses do not; and nothing is left to turn."""
    fit = small.fit()
    q, posture = followed().q.T, posture_prior(fit)
    far = beyond_limits(fit, q)
    back = turned_back(fit.model.tree, posture, far)
    assert float((far - q).abs().amax()) > 3.0
    assert_close(back, q, atol=1e-12, rtol=0)
    assert_close(modelled(fit, far.T), modelled(fit, back.T), atol=1e-12, rtol=0)
    # Far overhead is within a shoulder's limits, though more than half a turn.
    overhead, row = q.clone(), fit.model.tree.dof_names.index("shoulder_r_flexion")
    overhead[row] = torch.deg2rad(torch.tensor(185.0))
    assert_close(turned_back(fit.model.tree, posture, overhead), overhead, atol=0, rtol=0)


def test_a_trial_that_starts_beyond_its_limits_is_followed(monkeypatch):
    """All frames start where least squares stays for good: none stands out of the others, and examples are none."""
    fit, problem, right = small.fit(), problem_of(), postures()
    start = beyond_limits(fit, right)
    monkeypatch.setattr(start_module, "_exemplify", lambda *_: None)
    assert float((settle(problem, start, fit.xi) - right).abs().amax()) < 1e-3
    monkeypatch.setattr(start_module, "turned_back", lambda tree, posture, q: q)
    assert float((settle(problem, start, fit.xi) - right).abs().amax()) > 0.1


@pytest.mark.slow
@pytest.mark.parametrize("blank", [0.05, 0.6])
def test_a_trial_that_starts_anywhere_is_followed(seed: int, blank: float) -> None:
    """Every frame starts from its own posture with all joints turned by the same angles, some 40 degrees: many come to
    rest on a far side. Frames that show nothing are no example to them."""
    fit, problem, right = small.fit(), problem_of(), postures()
    shown = torch.arange(right.shape[1]) >= blank * right.shape[1]
    problem = replace(problem, weight=problem.weight * shown)
    draw, shares = torch.Generator().manual_seed(seed), []
    for _ in range(6):
        turned = torch.zeros_like(right[:, :1])
        turned[6:] = 0.7 * torch.randn(len(right) - 6, 1, generator=draw, dtype=right.dtype)
        astray = (settle(problem, right + turned, fit.xi) - right).abs().amax(0) > 1e-2
        shares.append(float(astray[shown].to(right).mean()))
    assert max(shares) < 0.05, shares
    assert sum(shares) / len(shares) < 0.02, shares


def broken(problem, q, fit) -> list[int]:
    return breaks(problem, q, fit.xi).nonzero()[:, 0].tolist()


def test_a_run_of_frames_that_leaps_away_is_followed_from_around_it():
    """Postures that turn the pelvis by half a radian within a frame and back go."""
    fit, held = small.fit(), small.markers("heldout")["sway_steps"]
    problem, q = problem_of(), postures()
    assert continuous(problem, q, fit.xi, held.rate) is q and not broken(problem, q, fit)
    astray, row = q.clone(), fit.model.tree.dof_names.index("pelvis_ry")
    astray[row, 40:48] += 0.5
    assert broken(problem, astray, fit) == [39, 47]
    found = continuous(problem, astray, fit.xi, held.rate)
    assert not broken(problem, found, fit)
    assert float((found - q).abs().amax()) < 1e-3
    assert_close(continuous(problem, astray, fit.xi, held.rate, near=q), found, atol=1e-3, rtol=0)


def test_frames_that_take_turns_between_two_postures_come_to_one():
    """An upper arm whose markers lie on its axis may turn about it by anything: it turns as the frames around it do."""
    fit, held = small.fit(), small.markers("heldout")["sway_steps"]
    problem, q, names = problem_of(), postures(), fit.model.tree.dof_names
    astray, own = q.clone(), [k for k, name in enumerate(names) if name.startswith("shoulder_r")]
    alternating = torch.arange(q.shape[1]) % 3 == 0
    alternating[[0, -1]] = False
    astray[own[0], alternating] += 1.0
    found = continuous(problem, astray, fit.xi, held.rate)
    assert len(broken(problem, astray, fit)) > 50 and not broken(problem, found, fit)
    assert float((found - q).abs().amax()) < 0.02


@pytest.mark.parametrize("lost", [True, False])
def test_an_arm_that_turned_about_while_it_was_lost_is_taken_back(lost):
    """No marker tells that it leaps: the frames beside it and the cost do. Elsewhere nothing changes."""
    fit, held = small.fit(), small.markers("heldout")["sway_steps"]
    problem, q, names = problem_of(), postures(), fit.model.tree.dof_names
    arm = torch.tensor([fit.model.tree.bodies[k].name == "upper_arm_r" for k in fit.attachment.body.tolist()])
    weight, astray = problem.weight.clone(), q.clone()
    weight[arm, 40:50] *= 0.0 if lost else 1.0
    problem = replace(problem, weight=weight)
    astray[[k for k, name in enumerate(names) if name.startswith("shoulder_r")], 40:50] += 1.5
    found, run = continuous(problem, astray, fit.xi, held.rate), problem.frames(slice(40, 50))
    before, after = (problem.residual(x, fit.xi)[1][arm].diff(dim=2).norm(dim=1).amax() for x in (astray, found))
    assert float(after) < 0.5 * float(before)
    assert float(run.frame_cost(found[:, 40:50], fit.xi).sum()) < float(run.frame_cost(astray[:, 40:50], fit.xi).sum())
    assert lost or float((found - q).abs().amax()) < 0.05
    rest = [k for k in range(q.shape[1]) if not 40 <= k < 50]
    assert_close(found[:, rest], q[:, rest], atol=2e-3, rtol=0)


def test_markers_that_leap_themselves_are_followed():
    """Eight frames of a recording stand a hand's breadth aside: so does the model, and nobody takes it back."""
    fit, held = small.fit(), small.markers("heldout")["sway_steps"]
    position = held.position.clone()
    position[40:48] += 0.1
    problem = trial_problem(fit, replace(held, position=position), posture_prior(fit))
    q = settled(fit, problem)
    assert continuous(problem, q, fit.xi, held.rate) is q


def test_tracking_a_part_is_tracking_the_whole():
    """Frames tracked alone get, within the solver's tolerance, the coordinates that they get among others."""
    fit, held = small.fit(), small.markers("heldout")["sway_steps"]
    part = Markers(held.labels, held.time[100:160], held.position[100:160])
    assert_close(track(fit, part).q, followed().q[100:160], rtol=0, atol=1e-3)


def test_corrected_markers_are_followed_from_where_the_measured_ones_led(monkeypatch, seed):
    """Of a marker that sat up to 20 mm aside nothing is left, in one piece or several."""
    fit, held = small.fit(), small.markers("heldout")["sway_steps"]
    draw, position = torch.Generator().manual_seed(seed), held.position.clone()
    position[:, int(torch.randint(position.shape[1], (1,), generator=draw))] += 0.02 * torch.rand(3, generator=draw)
    near, cold = track(fit, replace(held, position=position)).q, followed()
    for piece in (tracking.PIECE, 145):
        monkeypatch.setattr(tracking, "PIECE", piece)
        found = track(fit, held, near=near)
        assert_close(found.q, cold.q, rtol=0, atol=1e-2)
        assert_close(found.error, cold.error, rtol=0, atol=1e-3, equal_nan=True)


def test_a_long_trial_is_followed_in_pieces_that_do_not_show(monkeypatch):
    """Cut within a gap, a trial gets the coordinates and errors of the whole.

    Those of frames without a gap, and all where the pieces reach over the whole trial with what is beside them. Else
    the gap's frames lie near: what is typical of a coordinate, beyond which its course takes over, is judged by the
    piece, and a coordinate close to that limit changes sides. On 40 draws one moved by 0.02 rad, all together by 0.001
    to 0.002 rad in root mean square, the errors by 0.05 to 0.07 mm.
    """
    fit, held = small.fit(), small.markers("heldout")["sway_steps"]
    held = small.without(held, fit.attachment.labels[:2], slice(130, 160))
    complete = torch.isfinite(held.select(fit.attachment.labels).position).all(2).all(1)
    assert int((~complete).sum()) == 30
    whole = track(fit, held)
    monkeypatch.setattr(tracking, "PIECE", 145)
    for beside, same in ((100, complete), (len(held.time) - 145, torch.ones_like(complete))):
        monkeypatch.setattr(tracking, "BESIDE", beside)
        cut = track(fit, held)
        # Steps end where a frame's cost falls by 1e-5 of itself: one frame in some thousands stops 1 to 4 mrad short.
        assert_close(cut.q[same], whole.q[same], rtol=0, atol=2e-2)
        assert_close(cut.error[same], whole.error[same], rtol=0, atol=1e-3, equal_nan=True)
        assert float((cut.q - whole.q)[same].square().mean().sqrt()) < 3e-4
        assert float((cut.error - whole.error)[same].nan_to_num().square().mean().sqrt()) < 3e-5
        assert torch.equal(cut.observable, whole.observable)
        assert float((cut.q - whole.q)[~complete].square().mean().sqrt()) < 6e-3
        assert float((cut.error - whole.error)[~complete].nan_to_num().square().mean().sqrt()) < 3e-4


def test_modelled_markers_are_where_the_errors_say():
    """Their distance from the measured markers is the error of the tracked frame."""
    fit, held = small.fit(), small.markers("heldout")["sway_steps"]
    found = followed()
    measured = held.select(fit.attachment.labels).position
    assert_close((modelled(fit, found.q) - measured).norm(dim=2), found.error, equal_nan=True)


def test_first_order_solvers_run_through_the_same_fit():
    """Adam and LBFGS lower the joint cost of the whole body from where the arrow starts too."""
    given, static = small.assignment(), small.markers("static")["static"]
    trials = {"squats": small.markers("fit")["squats"]}
    for solver in ("adam", "lbfgs"):
        options = GeometryOptions(solver=solver, max_frames=10, gradient_iterations=6, static_frames=3)
        found = fit_geometry(given.model, given.attachment, trials, static, options).solution
        assert found is not None and found.cost <= found.trace[0]


def test_a_missing_static_trial_is_said():
    """Without a static trial the markers are placed from the motion, with a note."""
    given = small.assignment()
    found = start_fit(given.model, given.attachment, small.markers("fit"), None, small.GEOMETRY)
    assert [note.code for note in found.notes] == ["geometry.no_static"]


def test_an_empty_static_trial_is_refused():
    """A static trial without any of the subject's markers is an error of the data."""
    given, static = small.assignment(), small.markers("static")["static"]
    with pytest.raises(DataError, match="geometry.static"):
        start_fit(given.model, given.attachment, {}, small.without(static, static.labels), small.GEOMETRY)
