"""Synthetic subjects and recordings obey physics, seeds and their own files."""

import dataclasses
import hashlib
import json

import numpy as np
import numpy.testing as npt
import pytest
import torch
import yaml
from draws import seed_of
from torch.testing import assert_close

from torchid.config import load_config
from torchid.conventions import GRAVITY
from torchid.dynamics.equations_of_motion import inverse_dynamics, wrench_about
from torchid.errors import ConfigError
from torchid.filters import differentiate
from torchid.io import read_trial
from torchid.kinematics.plan import plan_tree
from torchid.kinematics.recursion import poses
from torchid.model.pseudo import params_to_pseudo
from torchid.run import run_simulation
from torchid.simulate.flight import centre_of_mass
from torchid.simulate.ground import force_plates
from torchid.simulate.legs import foot_pose
from torchid.simulate.motions import MOTIONS, make_script
from torchid.simulate.noise import lose_markers, noisy_plates
from torchid.simulate.options import PlantedOptions, SimulateOptions
from torchid.simulate.script import passages, wander
from torchid.simulate.session import simulate_session
from torchid.simulate.subject import draw_inertia, simulate_subject
from torchid.simulate.trial import lowest_sole, simulate_trial

CLEAN = SimulateOptions(duration_s=4.0, marker_noise_mm=0.0, force_noise_n=0.0)
SEED = seed_of(__name__)
EDGE = slice(5, -5)


@pytest.fixture(scope="module")
def subject():
    return simulate_subject(CLEAN, SEED)


@pytest.fixture(scope="module", params=sorted(MOTIONS))
def simulated(request, subject):
    duration = 8.0 if request.param in ("walk", "sway_steps") else 4.0
    return done(subject, request.param, duration)


def done(subject, motion: str, duration_s: float = CLEAN.duration_s):
    try:
        return simulate_trial(subject, motion, dataclasses.replace(CLEAN, duration_s=duration_s), SEED)
    except ConfigError as error:
        assert error.code == "simulate.balance"
        pytest.skip("one subject in a hundred has ankles that do not bend enough for a jump, or for wide circles")


def test_feet_carry_what_the_equations_of_motion_need(simulated, subject):
    """Base rows of inverse dynamics minus both feet's wrenches leave less than a micronewton."""
    m, feet = simulated.truth.motion, simulated.truth.feet.wrench.sum(1)
    columns = (x.T.contiguous() for x in (m.q, m.v, m.a))
    needed = inverse_dynamics(subject.model.tree, subject.geometry, subject.phi, *columns)[:6].T
    assert_close(wrench_about(feet, m.q[:, :3]), needed, atol=1e-6, rtol=0)


def test_force_is_mass_times_acceleration_of_the_centre_of_mass(simulated, subject):
    """Newton's law holds for the centre of mass found from poses alone and differentiated on its own."""
    q, tree = simulated.truth.motion.q, subject.model.tree
    plan = plan_tree(tree)
    at = poses(plan, q.T.contiguous(), subject.geometry)
    phi = subject.phi[list(plan.order)]
    moment = at.p * phi[:, :1, None] + sum(at.R[:, a] * phi[:, 1 + a, None, None] for a in range(3))
    mass = float(phi[:, 0].sum())
    _, a = differentiate(moment.sum(0).T / mass, 100.0)
    force = mass * (a + a.new_tensor([0.0, 0.0, GRAVITY]))
    # Splines through the angles of legs that leave the floor and through the heights that follow differ more.
    atol = 0.008 * GRAVITY * mass if simulated.trial.name == "jump" else 0.5
    assert_close(force[EDGE], simulated.truth.wrench[EDGE, :3], atol=atol, rtol=0)


def test_velocities_are_derivatives_of_positions(simulated, subject):
    """Markers differentiated from their positions move as the feet and forces assume: standing feet do not move."""
    m, feet = simulated.truth.motion, simulated.truth.feet
    plan = plan_tree(subject.model.tree)
    at = poses(plan, m.q.T.contiguous(), subject.geometry)
    for k, side in enumerate("lr"):
        ankle = at.p[plan.position[subject.model.tree.index(f"foot_{side}")]].T
        flat = at.R[plan.position[subject.model.tree.index(f"foot_{side}")], 2].T[:, 2] > 1.0 - 1e-9
        firm = flat & (feet.wrench[:, k, 2] > 0.05 * feet.wrench[:, :, 2].sum(1)) & flat.roll(1)
        assert bool(firm.any())
        step = (ankle[1:] - ankle[:-1]).norm(dim=1)[firm[1:]]
        assert float(step.max()) < 1e-5


def test_ground_pushes_only(simulated, subject):
    """No foot is pulled, slides, twists hard or bears beyond its sole, and none sinks into the floor."""
    truth = simulated.truth
    force = truth.feet.wrench[..., :3]
    assert float(force[..., 2].min()) > -1e-6
    bears = force[..., 2] > 50.0
    friction = force[..., :2].norm(dim=-1) / force[..., 2]
    assert float(friction[bears].max()) < 0.6
    twist = truth.feet.wrench[..., 3:] - torch.linalg.cross(truth.feet.pressure, force)
    assert_close(twist[..., :2], torch.zeros_like(twist[..., :2]), atol=1e-6, rtol=0)
    assert float(twist[..., 2].abs().max()) < 40.0
    assert float(lowest_sole(subject, truth.motion).min()) > -1e-3
    assert truth.miss < 0.01


def test_joint_limits_hold(simulated, subject):
    """Every coordinate stays inside the model's limits."""
    q = simulated.truth.motion.q
    for k, dof in enumerate(subject.model.tree.dofs):
        assert dof.lower <= float(q[:, k].min()) and float(q[:, k].max()) <= dof.upper, dof.name


def test_plates_hold_the_feet(simulated):
    """Where every bearing foot stands on a plate, the plates give the needed wrench; elsewhere they miss some."""
    truth, forces = simulated.truth, simulated.trial.forces
    total = forces.total[::10]
    assert_close(total[truth.complete], truth.wrench[truth.complete], atol=0.05, rtol=1e-6)
    lost = (total - truth.wrench)[~truth.complete].norm(dim=1)
    assert not len(lost) or float(lost.min()) > 0.005


def test_centre_of_pressure_lies_on_its_plate(simulated):
    """The centre of pressure of a loaded plate lies within its corners."""
    centre = simulated.trial.forces.centre_of_pressure(50.0)
    for k, plate in enumerate(simulated.trial.forces.plates):
        loaded = centre[:, k][centre[:, k].isfinite().all(1)]
        assert bool((loaded[:, :2] >= plate.corners.amin(0)[:2]).all())
        assert bool((loaded[:, :2] <= plate.corners.amax(0)[:2]).all())


def test_jump_leaves_the_floor(subject):
    """In the air nothing pushes, nor do plates say so; over the trial the ground gives what gravity takes."""
    item = done(subject, "jump")
    truth, forces = item.truth, item.trial.forces
    air = truth.wrench.abs().amax(1) < 1e-6
    height = lowest_sole(subject, truth.motion)[air]
    assert int(air.sum()) >= 10 and float(height.min()) > -1e-6 and float(height.max()) > 0.01
    high = air & air.roll(1) & air.roll(-1)
    assert float(forces.wrench.reshape(len(air), -1)[high].abs().max()) == 0.0
    weight = subject.mass * GRAVITY
    assert float(truth.wrench[:, 2].max()) > 1.3 * weight
    # The body starts and ends about at rest: what vertical momentum is left is what its last frames still move with.
    v = differentiate(centre_of_mass(subject, truth.motion), 100.0)[0][:, 2]
    impulse = float(torch.trapezoid(truth.wrench[:, 2] - weight, dx=0.01))
    assert impulse == pytest.approx(subject.mass * float(v[-1] - v[0]), abs=0.003 * weight)
    centre = centre_of_mass(subject, truth.motion)[:, 2]
    first = int(air.nonzero()[0])
    last = first + int((~air[first:]).nonzero()[0])
    t = truth.motion.time[first:last] - truth.motion.time[first]
    fall = centre[first:last] - centre[first] + 0.5 * GRAVITY * t**2
    assert_close(fall[1:] / t[1:], (fall[-1] / t[-1]).expand(len(t) - 1), atol=2e-3, rtol=0)


def test_walk_leaves_the_plates(subject):
    """A walk with long steps puts a loaded foot beside the plates; with two plates it is there more often."""
    script = make_script("walk", np.random.default_rng(SEED), subject, torch.arange(-0.8, 8.8, 0.01).double(), 8.0)
    away = []
    for count in (2, 4):
        low, high = torch.stack([p.corners for p in force_plates(count)]).flatten(0, 1)[:, 0].aminmax()
        x = torch.stack([path.base[:, 0] for path in script.feet], 1)
        away.append(int(((x > high) | (x < low)).sum()))
    assert away[0] > away[1] > 0


def test_motions_excite(simulated):
    """Every motion but standing still turns at least six joints by more than six degrees, standing still none."""
    turned = (simulated.truth.motion.q.amax(0) - simulated.truth.motion.q.amin(0))[6:]
    assert (int((turned > 0.1).sum()) >= 6) == (simulated.trial.name != "static")
    assert simulated.trial.name != "static" or float(turned.max()) < 0.1


def test_subject_is_physical_and_differs_by_seed():
    """Pseudo-inertias are positive definite; the seed alone decides who it is."""
    one, same, other = (simulate_subject(seed=s) for s in (SEED, SEED, SEED + 1))
    assert float(torch.linalg.eigvalsh(params_to_pseudo(one.phi)).min()) > 0.0
    assert_close(one.xi, same.xi, atol=0, rtol=0)
    assert_close(one.phi, same.phi, atol=0, rtol=0)
    assert float((one.xi - other.xi).abs().max()) > 1e-3
    assert {one.segments.count(name) >= 3 for name in one.model.tree.names} == {True}


def test_no_scatter_is_the_priors_mean():
    """A subject drawn without scatter has the template's joint centres."""
    subject = simulate_subject(SimulateOptions(scatter=0.0, height_m=1.75, mass_kg=70.0, sex="male"), SEED)
    assert_close(subject.xi, subject.model.geometry.mean)
    assert subject.mass == pytest.approx(70.0, rel=1e-6)


def test_noise_has_the_size_asked_for(subject):
    """Marker noise and frame-averaged plate noise have their standard deviations, and nothing else changes."""
    noisy = dataclasses.replace(CLEAN, marker_noise_mm=1.5, force_noise_n=3.0)
    clean, measured = (simulate_trial(subject, "static", o, SEED) for o in (CLEAN, noisy))
    assert_close(clean.truth.markers, measured.truth.markers, atol=0, rtol=0)
    marker = measured.trial.markers.position - clean.trial.markers.position
    assert float(marker.std()) == pytest.approx(1.5e-3, rel=0.02)
    plate = measured.trial.forces.wrench - clean.trial.forces.wrench
    frame = plate.reshape(-1, 10, *plate.shape[1:]).mean(1)
    assert float(frame[..., :3].std()) == pytest.approx(3.0, rel=0.06)
    rng, plates = np.random.default_rng(SEED), measured.trial.forces.plates
    own = noisy_plates(rng, torch.zeros(4000, len(plates), 6, dtype=torch.float64), plates, 3.0)
    centre = torch.stack([p.corners.mean(0) for p in plates])
    local = own[..., 3:] - torch.linalg.cross(centre.expand(4000, -1, 3), own[..., :3])
    assert float(local.std()) == pytest.approx(3.0 * 10**0.5 * 0.2, rel=0.03)


def test_gaps_come_in_bursts(subject):
    """The share asked for is lost, whole markers at a time, in runs longer than a frame."""
    position = torch.zeros(600, len(subject.labels), 3, dtype=torch.float64)
    lost = lose_markers(np.random.default_rng(SEED), position, subject.segments, 0.1, 100.0).isnan()
    assert_close(lost.any(2), lost.all(2))
    assert float(lost.double().mean()) == pytest.approx(0.1, abs=0.02)
    starts = int((lost[1:, :, 0] & ~lost[:-1, :, 0]).sum())
    assert int(lost[1:, :, 0].sum()) > 4 * starts


def test_skin_moves_with_the_joints(subject):
    """Skin motion shifts thigh markers by about its size in a squat and hardly anything at rest."""
    soft = dataclasses.replace(CLEAN, skin_motion_mm=5.0)
    moved = {}
    for motion in ("static", "squats"):
        firm, loose = (simulate_trial(subject, motion, o, SEED).truth.markers for o in (CLEAN, soft))
        moved[motion] = (loose - firm).norm(dim=2)
    thigh = [k for k, s in enumerate(subject.segments) if s.startswith("thigh")]
    assert 1e-3 < float(moved["squats"][:, thigh].mean()) < 15e-3
    assert float(moved["static"].mean()) < float(moved["squats"].mean())
    assert float(moved["static"].std(0).max()) < 1e-3


def test_standing_feet_follow_their_paths(subject):
    """A foot that pitches about its ball keeps that point of the sole in place."""
    time = torch.arange(-0.8, 8.8, 0.01, dtype=torch.float64)
    script = make_script("walk", np.random.default_rng(SEED), subject, time, 8.0)
    for path in script.feet:
        R, p = foot_pose(path, subject.sole)
        bearing = torch.cat([path.bearing, torch.full_like(path.bearing[:, :1], -subject.sole.height)], 1)
        point = p + (R @ bearing[:, :, None])[:, :, 0]
        down = (path.pitch.abs() > 1e-6) & (path.airborne == 0.0)
        assert bool(down.any())
        assert float(point[down, 2].abs().max()) < 1e-9
        heel_to_ball = (point[1:] - point[:-1])[down[1:] & down[:-1]]
        assert float(heel_to_ball.norm(dim=1).max()) < 1e-9


@pytest.mark.slow
def test_session_is_written_and_read_back(tmp_path):
    """C3D files, config and truth agree with the session in memory; the same seed writes the same bytes."""
    options = SimulateOptions(fit=("squats",), heldout=("squats",), duration_s=2.0, gap_fraction=0.05)
    session = simulate_session(options, SEED, tmp_path / "a")
    simulate_session(options, SEED, tmp_path / "b")
    config = yaml.safe_load(session.config.read_text())
    assert [t["name"] for t in config["trials"]] == ["static", "squats", "squats_2"]
    assert [t["role"] for t in config["trials"]] == ["static", "fit", "heldout"]
    for item in session.trials:
        name = f"{item.trial.name}.c3d"
        digest = {hashlib.sha256((tmp_path / x / name).read_bytes()).hexdigest() for x in "ab"}
        assert len(digest) == 1
        back = read_trial(item.trial.name, tmp_path / "a" / name)
        assert back.markers.labels == item.trial.markers.labels
        assert_close(back.markers.position, item.trial.markers.position, atol=2e-6, rtol=0, equal_nan=True)
        assert_close(back.forces.wrench, item.trial.forces.wrench, atol=1e-3, rtol=1e-6)
    truth = json.loads((tmp_path / "a" / "truth" / "subject.json").read_text())
    npt.assert_allclose(list(truth["phi"].values()), session.subject.phi.numpy())
    arrays = np.load(tmp_path / "a" / "truth" / "squats_2.npz", allow_pickle=False)
    npt.assert_allclose(arrays["q"], session.trial("squats_2").truth.motion.q.numpy())


def test_signals_keep_their_bounds():
    """Wandering signals stay between their limits, and passages hit their keys at rest."""
    rng, time = np.random.default_rng(SEED), torch.linspace(0, 20, 4001, dtype=torch.float64)
    x = wander(rng, time, -0.3, 1.2)
    assert -0.3 <= float(x.min()) < float(x.max()) <= 1.2
    y = passages(time, [(2.0, 1.0), (4.0, 3.0), (9.0, -1.0)])
    assert_close(y[[0, 400, 800, 1800, 4000]], y.new_tensor([1.0, 1.0, 3.0, -1.0, -1.0]))
    assert float((y[[401, 801, 1801]] - y[[399, 799, 1799]]).abs().max()) < 1e-6


def test_impossible_options_are_refused(subject):
    """An unknown motion names the known ones; impossible options name their key."""
    with pytest.raises(ConfigError, match="sway_steps"):
        simulate_trial(subject, "moonwalk", CLEAN, SEED)
    with pytest.raises(ConfigError, match="plates"):
        SimulateOptions(plates=9)


@pytest.mark.parametrize(
    ("hidden", "found"),
    [
        (PlantedOptions("drag", ("tail",), None, {"coefficient_Ns_m": 12.0}), "tail"),
        (PlantedOptions("plate_gain", ("plate_3",), None, {"gain": 1.02}), "plate_3"),
        (PlantedOptions("marker_swap", ("LTHI", "LTHX")), "LTHX"),
    ],
)
def test_nothing_is_hidden_where_nothing_is(hidden, found):
    """A segment, a plate or a marker that the session lacks is named before anything is simulated."""
    with pytest.raises(ConfigError) as caught:
        simulate_session(SimulateOptions(plates=2, effects=(hidden,)), SEED)
    assert (caught.value.code, caught.value.place, caught.value.found) == ("effect.place", hidden.effect, found)
    assert "plate_2" in caught.value.remedy and "thorax" in caught.value.remedy


def test_a_prior_of_which_no_body_can_be_drawn_is_refused(subject):
    """So wide that some segment of every draw has no mass: it ends, and the key is named."""
    with pytest.raises(ConfigError, match=r"simulate\.scatter.*simulate\.inertia"):
        draw_inertia(np.random.default_rng(SEED), subject.model, 1e3)


def test_a_config_that_asks_for_no_simulation_is_not_simulated(tmp_path):
    """The section that is missing is named, and nothing is written."""
    (tmp_path / "a.c3d").write_bytes(b"")
    text = "subject: {name: S, mass_kg: 70}\nmarkers: plug_in_gait\ntrials: [{name: a, file: a.c3d}]\n"
    (tmp_path / "config.yaml").write_text(text)
    with pytest.raises(ConfigError, match=r"simulate: \{\}.*simulate\.missing"):
        run_simulation(load_config(tmp_path / "config.yaml"))
    assert not (tmp_path / "out").exists()
