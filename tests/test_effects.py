"""The contract of every effect: what it predicts is what it does in a simulation, and its parameters come back."""

import dataclasses
import math
import re
from itertools import product
from pathlib import Path

import numpy as np
import pytest
import torch
from balance import in_balance
from draws import seed_of
from effect_contract import check_class, check_words
from rates import at_least
from torch.testing import assert_close

import torchid
from torchid.diagnosis.candidates.candidate import ColumnSource
from torchid.diagnosis.columns.marker_columns import response_of
from torchid.dynamics.equations_of_motion import base_rows, body_rows
from torchid.effects import columns as columns_module
from torchid.effects.catalogue import CATALOGUE, effect
from torchid.effects.columns import columns
from torchid.effects.displacement import rate_of
from torchid.effects.effect import Planted
from torchid.effects.marker_scene import Sight, View
from torchid.effects.marker_swap import propose_swaps
from torchid.effects.markers import SkinSlide
from torchid.effects.missing_dof import courses
from torchid.effects.place import Angle, Interval, Place, mean_within, within
from torchid.effects.scene import Reading, Scene, make_scene
from torchid.effects.traits import Site
from torchid.effects.wobbling import wobble
from torchid.errors import ConfigError
from torchid.filters import Smoother
from torchid.geometry.arrow.inverse_kinematics import solve_poses
from torchid.geometry.attachment import Attachment
from torchid.geometry.options import GeometryOptions
from torchid.geometry.result import GeometryFit
from torchid.geometry.tracking import modelled, track
from torchid.geometry.trial_problem import posture_prior, trial_problem
from torchid.kinematics import recursion
from torchid.motion import smooth_motion
from torchid.observation import marker_bands
from torchid.observation.marker_response import MarkerResponse
from torchid.recording import Markers
from torchid.simulate.options import PlantedOptions, SimulateOptions
from torchid.simulate.planting import numbered_frames, planted
from torchid.simulate.subject import simulate_subject
from torchid.simulate.trial import simulate_trial

CLEAN = SimulateOptions(duration_s=3.0, marker_noise_mm=0.0, force_noise_n=0.0)
SEED = seed_of(__name__)
MATRIX = [[0.01 * (i != j) * (-1) ** (i + j) for j in range(6)] for i in range(6)]
MIDDLE = (Interval("squats", 1.0, 2.0),)
SIZES: dict[str, tuple[tuple[str, ...], dict]] = {
    "time_offset": (("session",), {"lag_s": 0.004}),
    "body_lag": (("session",), {"lag_s": 0.004}),
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
    "filter_lag": (("session",), {"cutoff_hz": 5.0}),
    "marker_shift": (("LTHI",), {"shift_seg_m": [0.004, -0.003, 0.006]}),
    "marker_swap": (("LTHI", "LTHAP"), {}),
    "marker_scale": (("session",), {"scale": 1.004}),
    "soft_tissue": (("thigh_r",), {"shift_90_m": [[0.004, 0.002, -0.006], [0.003, 0.0, -0.004]]}),
    "skin_lag": (("pelvis", "thigh_l"), {"shift_1g_m": [0.002, 0.003]}),
    "joint_centre_shift": (("knee_r",), {"shift_90_seg_m": [0.006, 0.0, 0.004]}),
    "missing_dof": (("knee_l",), {"axis_seg": [0.0, 0.0, 1.0], "range_rad": 0.05}),
}  # fmt: skip
TIMED = {name for name, one in CATALOGUE.items() if one.intermittent}
SEEN = {name for name, one in CATALOGUE.items() if one.moves_markers}
"""By cameras."""
FOLLOWS = {"soft_tissue": "knee_r_flexion", "joint_centre_shift": "knee_r_flexion"}


@pytest.fixture(scope="module")
def subject():
    return simulate_subject(CLEAN, SEED)


@pytest.fixture(scope="module")
def plain(subject):
    return in_balance(lambda seed: simulate_trial(subject, "squats", CLEAN, seed), SEED)


def options(name: str) -> PlantedOptions:
    """An effect to plant, where nothing else is given at the first of the usual places and of the size of its prior."""
    where, parameters = SIZES[name] if name in SIZES else usual(name)
    markers = ("RTHI", "RTHAP") if name == "soft_tissue" else ()
    return PlantedOptions(name, where, MIDDLE if name in TIMED else None, parameters, FOLLOWS.get(name), markers)


def usual(name: str) -> tuple[tuple[str, ...], dict]:
    """Place and parameters of an effect that ``SIZES`` does not know."""
    own = CATALOGUE[name]
    found = {Site.PLATE: "plate_1", Site.MARKER: "LTHI", Site.SEGMENT: "thorax", Site.JOINT: "knee_r"}
    place = Place((found.get(own.site, "session"),))
    named = own.named(place, torch.tensor(own.scale(place), dtype=torch.float64))
    return place.where, {key: value.tolist() for key, value in named.items()}


def test_sizes_are_of_effects():
    """The contract below leaves out no effect of the catalogue, and knows no other."""
    assert set(SIZES) <= set(CATALOGUE)
    assert usual("plate_gain") == (("plate_1",), {"gain": pytest.approx(1.03)})


@pytest.mark.parametrize("name", CATALOGUE)
def test_every_effect_keeps_the_contract_of_its_class(name):
    """It is final and of one kind, its priors have sources, and it tells itself."""
    check_class(type(CATALOGUE[name]))
    check_words(CATALOGUE[name], planted(options(name)).place)


def test_recipes_tell_effects_apart_that_there_are():
    """Each pair stands at one of the two."""
    pairs = [frozenset((name, other)) for name, one in CATALOGUE.items() for other in one.apart]
    assert len(set(pairs)) == len(pairs) and {name for pair in pairs for name in pair} <= set(CATALOGUE)


def test_only_an_effects_own_file_knows_its_name():
    """Elsewhere classes, enumerations and methods are asked."""
    package = Path(torchid.__file__).parent
    named = re.compile(rf"""["']({"|".join(CATALOGUE)})["']""")
    files = [path for path in package.rglob("*.py") if path.parent.name != "effects"]
    assert len(files) > 100
    assert not [(path.name, found[0]) for path in files if (found := named.search(path.read_text(encoding="utf-8")))]


@pytest.mark.parametrize("name", CATALOGUE)
def test_parameters_come_back(name):
    """Named parameters of planted internal ones are those that were planted."""
    one = planted(options(name))
    found = one.effect.named(one.place, one.theta)
    for key, value in options(name).parameters.items():
        assert_close(found[key], torch.as_tensor(value, dtype=torch.float64), rtol=1e-8, atol=1e-8)
    assert len(one.theta) == one.effect.size(one.place) == len(one.effect.scale(one.place))


def simulated(subject, plain, name: str, share: float = 1.0):
    """A share of the effect, the plain motion, and what the plates read of it, on the clock of the markers."""
    one = planted(options(name))
    one = dataclasses.replace(one, theta=share * one.theta)
    scene = make_scene("squats", subject.model.tree, subject.geometry, plain.truth.motion, subject.phi)
    forces = plain.trial.forces
    frames = numbered_frames(forces.plates)
    clock_ratio = len(forces.time) // len(scene.time)
    measured = Reading("squats", scene.time, forces.wrench[::clock_ratio], frames)
    return one, scene, measured


def changed(one: Planted, scene: Scene, measured: Reading) -> Reading:
    """The ground supplies the load, then the plates misread it: the simulator's order."""
    loaded = measured.with_plate(0, measured.wrench[:, 0] + one.load(scene).T)
    return one.read(loaded)


@pytest.mark.parametrize("name", ["body_mass", "payload"])
def test_rigid_loads_are_inertia(subject, plain, name):
    """What an effect adds to the inertial parameters is its load."""
    one, scene, measured = simulated(subject, plain, name)
    fixed = one.effect.rigid(scene, one.place)
    assert fixed is not None
    Y = base_rows(scene.state.plan, body_rows(scene.state, torch.zeros_like(scene.q[:3])))
    found = torch.einsum("ipt,pk->ikt", Y, fixed.flatten(0, 1))
    assert_close(found, columns(one.effect, scene, measured, one.place), rtol=1e-7, atol=1e-6)


def test_masses_on_springs_are_made_at_once(subject, plain):
    """Side by side, each is what it is alone."""
    one, scene, measured = simulated(subject, plain, "wobbling_mass")
    springs = ((2.5, 0.1), (4.0, 0.2), (7.0, 0.3))
    places = [
        dataclasses.replace(one.place, where=(segment,), grid={"frequency_hz": f, "damping_ratio": z})
        for segment, (f, z) in [("pelvis", springs[2]), *product(("abdomen", "thigh_l"), springs)]
    ]
    alone = torch.cat([columns(one.effect, scene, measured, place) for place in places], 1)
    assert_close(one.effect.loads(scene, places).transpose(0, 1), alone, rtol=1e-7, atol=1e-6)


@pytest.mark.parametrize("name", sorted(set(CATALOGUE) - SEEN))
def test_columns_predict_the_plates(subject, plain, name):
    """Columns times parameters are what planting changes in the total of the plates, to second order in its size."""
    change = []
    for share in (1.0, 0.5):
        one, scene, measured = simulated(subject, plain, name, share)
        read = changed(one, scene, measured)
        exact, known = read.total - measured.total, read if one.effect.reads_measured else measured
        guess = torch.einsum("ipt,p->it", columns(one.effect, scene, known, one.place), one.theta)
        # Beyond the ends of a recording nobody knows what a later clock would read.
        change.append(tuple(float(x[:, 5:-5].norm()) for x in (exact, exact - guess)))
    (size, miss), (_, half) = change
    assert size > 0.0
    assert miss < 0.15 * size, f"columns miss {miss / size:.3f} of the effect"
    if miss > 1e-6 * size:
        assert half < 0.35 * miss, "what columns miss is of second order"


CURVED = {
    "payload": PlantedOptions("payload", ("thigh_l",), None, {"mass_kg": 4.0, "point_seg_m": [0.1, 0.1, -0.4]}),
    "tether": PlantedOptions(
        "tether", ("thorax",), None, {"stiffness_N_m": 14.0, "anchor_m": [0.9, 0.8, 1.5], "rest_m": 0.7}
    ),
}


@pytest.mark.parametrize("name", CURVED)
def test_columns_of_curved_effects_are_exact_where_they_were_found(subject, plain, name):
    """Absent, a load has no place and a spring no direction; found, columns times parameters are all of the load."""
    one, (_, scene, measured) = planted(CURVED[name]), simulated(subject, plain, name)
    values = {key: torch.as_tensor(value, dtype=torch.float64) for key, value in CURVED[name].parameters.items()}
    # Scanned is a place on the segment that is not the load's.
    place = dataclasses.replace(one.place, point=(0.0, 0.0, 0.0))
    one = dataclasses.replace(one, place=place, theta=one.effect.internal(place, values))
    exact = one.load(scene)
    miss = [
        float(
            (torch.einsum("ipt,p->it", columns(one.effect, scene, measured, one.place, at), one.theta) - exact).norm()
        )
        for at in (None, one.theta)
    ]
    assert miss[0] > 1e-3 * float(exact.norm())
    assert miss[1] < 1e-5 * float(exact.norm())


@pytest.mark.parametrize("name", [*CURVED, "plate_crosstalk"])
def test_many_columns_of_a_long_trial_are_those_of_a_short_one(subject, plain, monkeypatch, name):
    """From some length on, parameters are read one after the other, and cross products made in place."""
    one, (_, scene, measured) = planted(CURVED.get(name) or options(name)), simulated(subject, plain, name)
    short = columns(one.effect, scene, measured, one.place, one.theta)
    for module in (columns_module, recursion):
        monkeypatch.setattr(module, "SMALL", 100)
    scene = make_scene("squats", subject.model.tree, subject.geometry, plain.truth.motion, subject.phi)
    assert_close(columns(one.effect, scene, measured, one.place, one.theta), short, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize(
    ("name", "grid"),
    [("moving_ground", {}), ("unmeasured_contact", {}), ("unmeasured_contact", {"knots": 4.0}), ("grasped_object", {})],
)
def test_what_no_motion_gives_is_read_through_the_filter(subject, plain, name, grid):
    """Courses of ground that shakes, and of what comes and goes, are what plates read of them behind a filter."""
    one, scene, measured = simulated(subject, plain, name)
    draw = torch.Generator().manual_seed(SEED)
    smoother = Smoother(3.0 + 3.0 * float(torch.rand((), generator=draw)), scene.rate)
    if name == "moving_ground":
        place = dataclasses.replace(one.place, grid={"frequency_hz": 0.97 * smoother.cutoff_hz})
        one = dataclasses.replace(one, place=place)
    if grid:
        place = dataclasses.replace(one.place, grid=grid)
        one = dataclasses.replace(one, place=place, theta=torch.randn(12, generator=draw).double())
    exact = smoother(one.load(scene).T).T
    behind = dataclasses.replace(scene, smoother=smoother)
    left = [
        float((torch.einsum("ipt,p->it", columns(one.effect, seen, measured, one.place), one.theta) - exact)[:3].norm())
        for seen in (behind, scene)
    ]
    # A load in a hand is accelerated as well, by a motion that was smoothed before.
    assert left[0] < (0.6 if name == "grasped_object" else 1e-4) * left[1]
    # One that comes later, or less quickly, is another course.
    if one.place.when is not None:
        own = one.place.when[0]
        later = dataclasses.replace(own, t0=own.t0 + 0.3)
        for other in ({"when": (later,)}, {"grid": {"knots": 5.0} if grid else {"edge_s": 0.3}}):
            place = dataclasses.replace(one.place, **other)
            both = [columns(one.effect, seen, measured, place) for seen in (behind, dataclasses.replace(behind))]
            assert_close(*both, rtol=0, atol=0)


@pytest.fixture(scope="module")
def followed(subject, plain):
    """Cameras that know geometry and motion exactly, and the fit that tracks with them."""
    return known_cameras(subject, plain)


def known_cameras(subject, plain) -> tuple[GeometryFit, MarkerResponse]:
    prior, n = subject.model.geometry, len(subject.labels)
    tree = subject.model.tree
    body = torch.tensor([tree.index(segment) for segment in subject.segments])
    free = Attachment(subject.labels, body, subject.p_BM_B, torch.full((n, 3), 0.01).double(), (None,) * n)
    xi = torch.cat([subject.xi, subject.p_BM_B.reshape(-1)])
    fit = GeometryFit(subject.model, free, prior, xi, torch.full((n,), 0.001).double(), GeometryOptions(robust=None))
    scene = make_scene("squats", tree, subject.geometry, plain.truth.motion, subject.phi)
    sight = Sight(scene, subject.labels, torch.tensor(scene.state.plan.position)[body], subject.p_BM_B)
    weight = torch.full((n, len(scene.time)), 1e6).double()
    return fit, MarkerResponse(
        sight, weight, torch.zeros(n, 3, len(scene.time)).double(), posture_prior(fit).precision[:, 0]
    )


@pytest.mark.parametrize("name", sorted(SEEN - {"filter_lag"}))
def test_the_fitted_motion_yields_as_predicted(subject, plain, followed, name):
    """Markers moved by the effect and followed anew: residuals, and the wrench that the found motion lacks."""
    fit, response = followed
    scene, one = response.sight.scene, planted(options(name))
    one = dataclasses.replace(one, theta=0.2 * one.theta)
    moved = plain.truth.markers + one.seen(response.sight).permute(2, 0, 1)
    both = [track(fit, Markers(subject.labels, scene.time, p)).q for p in (plain.truth.markers, moved)]
    smoother = Smoother(8.0, 100.0)
    before, after = (smooth_motion(scene.tree, scene.time, q, smoother) for q in both)
    lacks = one.load(scene) - sum(
        sign * make_scene("squats", scene.tree, subject.geometry, m, subject.phi).needed()
        for sign, m in ((1.0, after), (-1.0, before))
    )
    source = ColumnSource(one.effect, one.place, slice(0, 0), (), one.effect.scale(one.place))
    answer = response_of(response, source)
    wrench = smoother(smoother(response.wrench([answer]).permute(2, 0, 1) @ one.theta)).T
    exact = smoother(lacks.T).T
    inner = slice(30, -30)
    for part in (slice(0, 3), slice(3, 6)):
        size = float(exact[part, inner].norm())
        assert float((wrench - exact)[part, inner].norm()) < 0.05 * size + 0.02
    still, shown = ((p - modelled(fit, q)) for p, q in zip((plain.truth.markers, moved), both, strict=True))
    left = response.bands.rows[0, 0] * (shown - still)[response.bands.middle].flatten(1)
    guess = torch.tensordot(one.theta, response.bands.left(answer.shift), 1)
    assert float((guess - left)[3:-3].norm()) < 0.05 * float(left[3:-3].norm())


@pytest.mark.parametrize("name", ["marker_shift", "soft_tissue", "skin_slide", "joint_centre_shift", "missing_dof"])
def test_what_sways_is_answered_as_any_displacement_is(followed, name, monkeypatch):
    """Fixed ways times courses, against differences of the effect itself, in several blocks of coefficients."""
    fit, response = followed
    monkeypatch.setattr(marker_bands, "BLOCK", 12)
    response = dataclasses.replace(response)
    if name == "skin_slide":
        effect, place = (
            SkinSlide(fit.attachment.labels, fit.place),
            Place(("thigh_r",), follows=Angle("knee_r_flexion")),
        )
    else:
        effect, place = CATALOGUE[name], planted(options(name)).place
    source = ColumnSource(effect, place, slice(0, 0), (), effect.scale(place))
    quick, plain = response_of(response, source), response_of(response, source, response.sight)
    for own, other in (
        (quick.nine, plain.nine), (quick.shift, plain.shift),
        (quick.spectrum(response.bands), plain.spectrum(response.bands)),
    ):  # fmt: skip
        assert float(other.abs().max()) > 0.0
        assert_close(own, other, rtol=0.0, atol=1e-9 * float(other.abs().max()))


def test_what_soft_flesh_adds_is_known_from_the_motion_that_was_seen_through_it(subject, plain, followed):
    """The seen motion is livelier than the bones'; taken as theirs, a tenth too much came off."""
    fit, response = followed
    scene, smoother = response.sight.scene, Smoother(20.0, 100.0)
    where = tuple(name for name in scene.tree.names if response.sight.on(name))
    place = Place(where)
    theta = 0.001 + 0.005 * torch.rand(len(where), generator=torch.Generator().manual_seed(SEED)).double()
    flesh = Planted(CATALOGUE["skin_lag"], place, theta)
    off = flesh.seen(response.sight)
    q = track(fit, Markers(subject.labels, scene.time, plain.truth.markers + off.permute(2, 0, 1))).q
    motion = smooth_motion(scene.tree, scene.time, q, smoother)
    sight = dataclasses.replace(
        response.sight, scene=make_scene("squats", scene.tree, subject.geometry, motion, subject.phi)
    )
    inner = (..., slice(50, -50))
    miss = [
        float((flesh.seen(one) - off)[inner].norm() / off[inner].norm())
        for one in (sight, flesh.effect.beneath(sight, place, theta))
    ]
    assert miss[1] < 0.5 * miss[0], (SEED, miss)


def test_skin_that_slides_as_one_is_part_of_what_slides(followed):
    """Written as shifts of the segment's markers, a shift and a turn move them as they do."""
    fit, response = followed
    skin, sight = SkinSlide(fit.attachment.labels, fit.place), response.sight
    labels = tuple(sight.labels[k] for k in sight.on("thigh_r"))
    place = Place(("thigh_r",), follows=Angle("knee_r_flexion"), markers=labels)
    theta = torch.tensor(np.random.default_rng([SEED, 16]).normal(size=6)) * 0.01
    one, part = skin.slide(sight, place, theta), skin.part_of(place, CATALOGUE["soft_tissue"], place)
    assert part is not None and skin.part_of(place, CATALOGUE["skin_lag"], place) is None
    same = CATALOGUE["soft_tissue"].slide(sight, place, part @ theta)
    assert same is not None and same.which == one.which
    assert_close(same.by, one.by)


def test_what_a_filter_took_is_known_from_what_it_left(subject, plain, followed):
    """The column of filtered markers is the wrench that their motion lacks, however much the filter took."""
    fit, response = followed
    one, scene, smoother = planted(options("filter_lag")), response.sight.scene, Smoother(8.0, 100.0)
    seen = response.sight.p + one.seen(response.sight)
    filtered_markers = Markers(subject.labels, scene.time, seen.permute(2, 0, 1))
    # 5 Hz take less of a squat than the solver's usual stop leaves.
    problem = trial_problem(fit, filtered_markers, posture_prior(fit))
    q = solve_poses(problem, track(fit, filtered_markers).q.T, fit.xi, tolerance=1e-12)[0].T
    filtered = smooth_motion(scene.tree, scene.time, q, Smoother(50.0, 100.0))
    found = make_scene("squats", scene.tree, subject.geometry, filtered, subject.phi)
    sight = dataclasses.replace(response.sight, scene=found)
    known = MarkerResponse(sight, response.weight, response.error, posture_prior(fit).precision[:, 0])
    source = ColumnSource(one.effect, one.place, slice(0, 0), (), one.effect.scale(one.place))
    lacks = smoother((scene.needed() - found.needed()).T)[40:-40]
    guess = smoother(known.wrench([response_of(known, source)]).permute(2, 0, 1) @ one.theta)[40:-40]
    # Of ten subjects, forces were 0.3 to 4 % off, and the moments of a squat, which are small, 4 to 27 %.
    for part, most in ((slice(0, 3), 0.1), (slice(3, 6), 0.4)):
        assert float((lacks - guess)[:, part].norm()) < most * float(lacks[:, part].norm())


@pytest.mark.parametrize("lost", [(), (0,), (1,), (0, 1)])
def test_a_swap_is_proposed_whole(followed, lost):
    """Also where one of the markers is lost meanwhile, or both are."""
    response = followed[1]
    rng = np.random.default_rng([SEED, 12])
    a, b = sorted(rng.choice(len(response.sight.labels), 2, replace=False).tolist())
    apart = torch.zeros_like(response.error[a])
    apart[:, 60:120] = (response.sight.p[b] - response.sight.p[a])[:, 60:120]
    error, weight = response.error.clone(), response.weight.clone()
    error[a], error[b] = error[a] + apart, error[b] - apart
    for k in lost:
        error[(a, b)[k], :, 80:100] = weight[(a, b)[k], 80:100] = 0.0
    time = response.sight.scene.time
    (place,) = propose_swaps(dataclasses.replace(response, error=error, weight=weight))
    assert place.where == (response.sight.labels[a], response.sight.labels[b])
    assert [(one.t0, one.t1) for one in place.when] == [(float(time[60]), float(time[119]))]


@pytest.mark.parametrize("own_ways", [False, True])
def test_a_glide_along_the_axis_tells_that_in_the_plane(own_ways):
    """Markers show four of the six numbers of a hinge whose centre glides; one course for all axes shows the others."""
    rng = np.random.default_rng([SEED, 14])
    found = [_glide(rng, own_ways) for _ in range(100)]
    if own_ways:
        # Some look like one course for all axes by chance, as some of one course look like their own ways.
        own = [float((shift - named).abs().max()) < 1e-9 and float(sd.norm()) > 0.01 for shift, sd, named, _ in found]
        assert sum(own) >= at_least(0.98, 100)
    else:
        told = [(shift, sd, true) for shift, sd, _, true in found if float(sd.norm()) < 0.007]
        # One in a hundred passes for a glide that goes its own way along each axis (OWN_WAYS): nine of them by chance
        # once in a million draws.
        assert len(told) > 91
        assert all(bool(((shift - true).abs() < 5.5 * sd).all()) for shift, sd, true in told)


def _glide(rng, own_ways):
    """What is estimated of a glide drawn at random, its sd, the same of each axis by itself, and the true one."""
    part, turn = rng.uniform(0.2, 0.8), rng.uniform(0.0, 2.0 * np.pi)
    shift = torch.tensor([0.006 * np.cos(turn), 0.006 * np.sin(turn), rng.choice([-1.0, 1.0]) * 0.005])
    true = torch.cat([part * shift, (1.0 - part) * shift])
    if own_ways:
        true[2] = -true[2]
    # A marker beyond the hinge that sits elsewhere looks like a sine along y and one minus cosine along x, and so on.
    gauge = torch.zeros(2, 6, dtype=torch.float64)
    gauge[0, [1, 3]], gauge[1, [0, 4]] = torch.tensor([1.0, -1.0]).double(), torch.ones(2).double()
    covariance = 1e-4**2 * torch.eye(6).double() + 0.006**2 * gauge.T @ gauge
    drawn = true + torch.linalg.cholesky(covariance) @ torch.tensor(rng.normal(size=6))
    effect, place = CATALOGUE["joint_centre_shift"], Place(("knee_r",), follows=Angle("knee_r_flexion"))
    found, sd = effect.estimated(place, drawn, covariance)["shift_90_seg_m"]
    return found, sd, effect.named(place, drawn)["shift_90_seg_m"], shift


@pytest.mark.parametrize("lacks", ["z", "xz", "xyz"])
def test_a_loose_joint_has_a_direction_with_an_sd(lacks):
    """However many axes it lacks."""
    effect, modes = CATALOGUE["missing_dof"], 12
    grid = {axis: float(axis in lacks) for axis in "xyz"} | {"modes": float(modes), "turning": 1.0}
    theta = torch.tensor(np.random.default_rng([SEED, 15]).normal(size=2 * len(lacks) * modes)) * 0.01
    found = effect.estimated(Place(("ankle_l",), grid=grid), theta, 1e-8 * torch.eye(len(theta)).double())
    axis, sd = found["axis_seg"]
    assert float(axis.norm()) == pytest.approx(1.0) and bool(sd.isfinite().all())
    assert not axis[["xyz".index(one) for one in set("xyz") - set(lacks)]].any()
    assert 0.0 < float(found["range_rad"][1]) < 0.01


def test_where_a_loose_joint_stands_is_no_direction_of_its_motion():
    """Every trial has a place of its own, as large as it likes, which axes of other joints must not make up for."""
    effect, modes, time = CATALOGUE["missing_dof"], 12, torch.linspace(3.0, 9.0, 301).double()
    place = Place(("ankle_l",), grid={"x": 1.0, "y": 0.0, "z": 1.0, "modes": float(modes), "turning": 1.0})
    wave = 0.03 * torch.cos(2.0 * math.pi * 0.5 * (time - 3.0))
    able = courses(time, modes)
    theta = torch.zeros(2, 2, modes).double()
    for trial, (x, z) in enumerate(((0.01, 0.3), (-0.02, -0.1))):
        for row, course in ((0, x + wave), (1, z + 0.0 * time)):
            theta[trial, row] = torch.linalg.lstsq(able.T, course[:, None]).solution[:, 0]
            assert_close(theta[trial, row] @ able, course, rtol=0.0, atol=1e-9)
    found = effect.named(place, theta.flatten())
    assert_close(found["axis_seg"], torch.tensor([1.0, 0.0, 0.0]).double(), rtol=0.0, atol=1e-6)
    assert float(found["range_rad"]) == pytest.approx(0.06, rel=1e-3)


def test_the_mean_of_a_force_is_as_uncertain_as_its_ends():
    """Of two intervals, the shorter has the worse mean; impulses are as the forces tell."""
    effect, theta, covariance = CATALOGUE["unmeasured_contact"], torch.tensor([3.0, 4.0, 12.0]).double(), torch.eye(3)
    long, short = (Place(("thorax",), (Interval("a", 1.0, 1.0 + s),)) for s in (8.0, 0.8))
    told = [effect.estimated(place, theta, 0.01 * covariance.double()) for place in (long, short)]
    parts = [float(sd.norm() / force.norm()) for force, sd in (one["force_N"] for one in told)]
    assert 0.01 < parts[0] < 0.03 and 0.15 < parts[1] < 0.25
    impulse, sd = told[1]["impulse_Ns"]
    assert float(sd.norm() / impulse.norm()) == pytest.approx(0.1 * 3.0**0.5 / 13.0, rel=0.2)


def test_the_ground_carries_what_is_hidden(subject, plain):
    """A hidden payload changes the plates by its wrench, and the person keeps balance under it."""
    hidden = dataclasses.replace(subject, hidden=(planted(options("payload")),))
    found = simulate_trial(hidden, "static", CLEAN, SEED)
    without = simulate_trial(subject, "static", CLEAN, SEED)
    weight = [float(x.trial.forces.wrench[:, :, 2].sum(1).mean()) for x in (found, without)]
    assert weight[0] - weight[1] == pytest.approx(3.0 * 9.80665, abs=0.05)
    assert found.truth.miss < 0.01


def test_intervals_bound_an_effect():
    """Outside zero, then risen to one within a tenth of a second; other trials stay as they are."""
    time = torch.arange(0.0, 3.0, 0.01, dtype=torch.float64)
    place = Place(("thorax",), MIDDLE)
    weight = within(place, "squats", time)
    assert float(weight[150]) == 1.0 and float(weight[20]) == 0.0 == float(weight[-20])
    assert float(weight[100]) == pytest.approx(0.0, abs=1e-9) == float(weight[200])
    assert float(weight[105]) == pytest.approx(0.5, abs=1e-9) == float(weight[195])
    assert float(weight[100:201].mean()) == pytest.approx(mean_within(place), abs=0.01)
    assert not bool(within(place, "walk", time).any())
    assert bool((within(Place(("thorax",)), "walk", time) == 1.0).all())


def test_unknown_effects_and_missing_parameters_are_refused():
    """The message names the effect, what it needs and what it got."""
    with pytest.raises(ConfigError, match=r"plate_gain.*effect\.unknown") as caught:
        effect("plate_gian")
    assert caught.value.place == "plate_gian"
    cases: tuple[tuple[dict[str, float | list], str], ...] = (
        ({}, "no parameters"),
        ({"point_seg_m": [0.0, 0.0, 0.0]}, "point_seg_m"),
    )
    for given, said in cases:
        with pytest.raises(ConfigError, match=r"needs mass_kg with 1 value.*effect\.parameters") as caught:
            planted(PlantedOptions("grasped_object", ("hand_r",), None, given))
        assert (caught.value.place, caught.value.found) == ("grasped_object", said) and caught.value.remedy


@pytest.mark.parametrize("name", ["joint_centre_shift", "missing_dof"])
def test_a_joint_that_the_model_lacks_is_refused(subject, name):
    """Where an effect is at a joint, a segment or a misspelt name is none; the message lists those there are."""
    tree, time = subject.model.tree, torch.arange(0.0, 0.5, 0.01, dtype=torch.float64)
    q = torch.zeros(len(time), len(tree.dofs), dtype=torch.float64)
    scene = make_scene(
        "squats", tree, subject.geometry, smooth_motion(tree, time, q, Smoother(10.0, 100.0)), subject.phi
    )
    own = planted(options(name))
    own.effect.move(scene, own.place, own.theta)
    for joint in ("thorax", "knee"):
        with pytest.raises(ConfigError, match=r"effect\.joint") as caught:
            own.effect.move(scene, dataclasses.replace(own.place, where=(joint,)), own.theta)
        assert caught.value.place == joint and "knee_r" in caught.value.remedy


def bodies_of(subject, scene):
    return torch.tensor([scene.at(segment) for segment in subject.segments])


def test_places_cover_the_session(subject, plain):
    """Every effect names at least one place, all of them distinct."""
    _, scene, measured = simulated(subject, plain, "drag")
    view = View(scene, measured, measured, Sight(scene, subject.labels, bodies_of(subject, scene), subject.p_BM_B))
    other = dataclasses.replace(view, scene=dataclasses.replace(scene, trial="arms"))
    for one in CATALOGUE.values():
        places = one.places((view, other))
        keys = [
            (p.where, p.when and tuple(i.trial for i in p.when), p.follows, tuple(sorted(p.grid.items())))
            for p in places
        ]
        assert one.name == "marker_swap" or places
        assert len(set(keys)) == len(keys)


def test_weight_is_wrong_by_records_and_by_gains_of_all_plates(subject, plain):
    """Columns of both are of what the body needs, in the air as well: nothing but another scale tells them apart."""
    _, scene, measured = simulated(subject, plain, "drag")
    measured = dataclasses.replace(measured, unborne=scene.needed().T - measured.total.T)
    view = View(scene, measured, measured)
    (record,), gains = CATALOGUE["body_mass"].places((view,)), CATALOGUE["plate_gain"].places((view,))
    (every,) = (place for place in gains if len(place.where) > 1)
    of_record = columns(CATALOGUE["body_mass"], scene, measured, record)
    of_gains = columns(CATALOGUE["plate_gain"], scene, measured, every)
    assert_close(scene.mass * of_record, of_gains, rtol=1e-9, atol=1e-6)


def test_what_wobbles_is_a_part_of_its_segment(subject, plain):
    """Expected in proportion to it, wherever and however fast it wobbles; what is hidden need not say of how much."""
    wobbling = effect("wobbling_mass")
    _, scene, measured = simulated(subject, plain, "drag")
    for place in wobbling.places((View(scene, measured, measured),)):
        kg = float(scene.phi[scene.tree.index(place.where[0]), 0])
        assert wobbling.scale(place) == pytest.approx((0.25 * kg,))
    assert wobbling.scale(planted(options("wobbling_mass")).place) == (2.0,)


def test_a_column_per_parameter_is_finite(subject, plain):
    """At every place of every effect."""
    _, scene, measured = simulated(subject, plain, "drag")
    for one in CATALOGUE.values():
        if one.name in SEEN:
            continue
        for place in one.places((View(scene, measured, measured),))[:4]:
            C = columns(one, scene, measured, place)
            assert C.shape == (6, one.size(place), len(scene.time)) and bool(torch.isfinite(C).all())


def test_a_trial_that_ends_in_motion_is_smoothed_like_any_other(followed):
    """What the filter takes of an oscillation is as much of it to the last frames: no end of a trial rings."""
    _, response = followed
    lag, sight = CATALOGUE["filter_lag"], dataclasses.replace(response.sight)
    time, (place,) = sight.scene.time, lag.places([])
    wave = torch.sin(2.0 * torch.pi * 1.3 * time + 0.7)
    sight.__dict__["p"] = wave.expand(len(sight.labels), 3, -1)
    theta = torch.tensor([1e-6], dtype=torch.float64)
    slid = lag.slide(sight, place, theta)
    assert slid is not None
    wanted = -float(theta[0]) * 1.3**4 * wave
    assert float((slid.by - wanted)[..., 5:-5].abs().max()) < 0.05 * float(wanted.abs().max())
    assert float(slid.by.abs().max()) < 1.05 * float(wanted.abs().max())


@pytest.mark.parametrize("rate", [100.0, 50.0])
@pytest.mark.parametrize("spring", [(2.5, 0.1), (7.0, 0.17), (7.0, 0.3)])
def test_a_mass_on_a_spring_follows_its_equation(spring, rate):
    """x'' + 2 z w x' + w^2 x = -a of a carrier that swings at 5 Hz, once the start has died away."""
    own, damping = 2.0 * math.pi * spring[0], spring[1]
    w, t = 2.0 * math.pi * 5.0, torch.arange(round(20.0 * rate), dtype=torch.float64) / rate
    exact = -1.0 / complex(own**2 - w**2, 2.0 * damping * own * w)
    course = torch.exp(1j * w * t)
    (x,), (xdd,) = wobble(course.imag.expand(1, 3, -1), rate, [spring])
    part = slice(len(t) // 2, -10)
    for found, way in ((x, exact), (xdd, -(w**2) * exact)):
        error = found[0, 0, part] - (way * course[part]).imag
        assert float(error.abs().max()) < 0.15 * abs(way) * (w / rate) ** 4


@pytest.mark.parametrize("rate", [60.0, 100.0])
def test_rates_are_of_sixth_order(rate):
    """Differences of that order are short by (w h)^6 / 140."""
    w, t = 2.0 * math.pi * rate / 10.0, torch.arange(200, dtype=torch.float64) / rate
    off = (rate_of(torch.sin(w * t), rate) / w - torch.cos(w * t))[3:-3].abs().max()
    assert_close(float(off), (w / rate) ** 6 / 140.0, rtol=0.1, atol=0.0)
