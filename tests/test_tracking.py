"""What is wrong with the tracks of markers is found where it was planted, and nothing in clean sessions."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import small_session
import torch
from balance import in_balance
from torch import Tensor

from torchid.checks.marker_tracks.clusters import Clusters, shape_of
from torchid.checks.marker_tracks.jumps import find_jumps
from torchid.checks.marker_tracks.moved import Verdict, moved_nats
from torchid.checks.marker_tracks.segment_shape import align
from torchid.checks.marker_tracks.session import look_at_trial, look_at_trials, readings_of, renamed
from torchid.checks.marker_tracks.statement import TrackFault, TrackStatement, notes_of
from torchid.diagnosis.candidates.marker_faults import exchanged_markers
from torchid.filters import Smoother
from torchid.geometry.options import GeometryOptions
from torchid.geometry.result import GeometryFit
from torchid.geometry.tracking import Tracked
from torchid.io import ReadOptions, read_trial
from torchid.model.marker_set import load_marker_set
from torchid.motion import smooth_motion
from torchid.motion.impossible_rates import frames_of, impossible_steps
from torchid.recording import Trial
from torchid.run.sequence import _rate_notes
from torchid.session import Followed, Session
from torchid.session.session import look_at_session, session_clusters, taken_out
from torchid.simulate.options import SimulateOptions
from torchid.simulate.session import simulate_session

Trials = dict[str, Trial]


@pytest.fixture(scope="module")
def trials() -> Trials:
    """A clean session."""
    return {item.trial.name: item.trial for item in small_session.session().trials}


@pytest.fixture(scope="module")
def clusters() -> Clusters:
    return session_clusters(small_session.assignment())


def look(trials: Trials) -> tuple[TrackStatement, ...]:
    return look_at_session(trials, small_session.assignment())


def with_position(trials: Trials, name: str, change: Callable[[Tensor, Tensor], None]) -> Trials:
    """The trials, one of them changed in place by ``change(position, time)``."""
    trial = trials[name]
    position = trial.markers.position.clone()
    change(position, trial.markers.time)
    return {**trials, name: replace(trial, markers=replace(trial.markers, position=position))}


def drawn(rng: np.random.Generator, clusters: Clusters, least: int) -> int:
    """A marker at random that sits with at least so many others on its segment."""
    count = clusters.together.sum(dim=1)
    return int(rng.choice((count >= least).nonzero()[:, 0].numpy()))


def moving(rng: np.random.Generator, trials: Trials) -> str:
    return str(rng.choice(sorted(name for name, trial in trials.items() if trial.role != "static")))


@pytest.fixture
def rng(seed) -> np.random.Generator:
    return np.random.default_rng([small_session.SEED, seed])


def test_nothing_is_found_in_a_clean_session(trials):
    assert look(trials) == ()


@pytest.mark.slow
def test_nothing_is_found_where_skin_slides_and_markers_are_lost(seed):
    """Ten millimetres of sliding skin on the thighs, a tenth of the samples lost."""
    options = SimulateOptions(fit=("squats", "walk"), heldout=("walk",), duration_s=4.0, skin_motion_mm=10.0)
    given = replace(options, gap_fraction=0.1)
    session = in_balance(lambda attempt: simulate_session(given, attempt), seed)
    assert look({item.trial.name: item.trial for item in session.trials}) == ()


def pair(rng: np.random.Generator, trials: Trials, clusters: Clusters, others: int = 2) -> tuple[int, int]:
    """Two markers at random, of ``others`` + 1 or more, whose distances to others differ by what skin does not do."""
    shape = shape_of("static", trials["static"].markers, clusters.labels).median
    while True:
        a, b = drawn(rng, clusters, others), drawn(rng, clusters, others)
        rest = [k for k in clusters.together[a].nonzero()[:, 0].tolist() if k != b]
        if a != b and float((shape[a, rest] - shape[b, rest]).abs().mean()) > 0.03:
            return a, b


@pytest.mark.parametrize("throughout", [False, True])
def test_exchanged_labels_are_found_and_put_right(trials, clusters, rng, throughout):
    """Also which trial it is, and when; undone, the recording is the clean one."""
    name, both = moving(rng, trials), pair(rng, trials, clusters)
    labels = [clusters.labels[k] for k in both]
    time = trials[name].markers.time
    t0 = float(rng.uniform(0.5, 2.0))
    inside = torch.ones_like(time, dtype=torch.bool) if throughout else (time >= t0) & (time < t0 + 1.0)
    columns = [trials[name].markers.labels.index(label) for label in labels]

    def change(position: Tensor, _: Tensor) -> None:
        rows = inside.nonzero()
        position[rows, columns] = position[rows, columns[::-1]]

    planted = with_position(trials, name, change)
    (found,) = look(planted)
    assert (found.kind, found.trial, set(found.labels)) == (TrackFault.EXCHANGED, name, set(labels))
    assert float((found.inside(time) != inside).double().sum()) <= 4
    assert found.left_mm < found.size_mm / 2

    sound, before = taken_out(planted, (found,), lambda trial: trial)
    assert torch.isnan(sound[name].markers.position[inside][:, columns]).double().mean() > 0.9
    session = Session(sound, {}, small_session.assignment(), notes_of([found]), (found,), before)
    undone = session.with_names([found])
    assert undone.tracking == ()
    wrong = (undone.trials[name].markers.position - trials[name].markers.position).nan_to_num().norm(dim=2) > 0
    assert int(wrong.any(dim=1).sum()) <= 4
    place = exchanged_markers(found, time).place
    assert {one.trial for one in place.when or ()} == {name} and place.where == found.labels


def test_exchanged_labels_of_a_segment_with_two_markers_are_told_by_their_paths(trials, clusters, rng):
    """No distance tells them, for there is no third marker; both leap at once, each to where the other was."""
    name, pair = moving(rng, trials), None
    shape = shape_of("static", trials["static"].markers, clusters.labels).median
    while pair is None:
        a = drawn(rng, clusters, 2)
        far = [k for k in clusters.together[a].nonzero()[:, 0].tolist() if float(shape[a, k]) > 0.06]
        pair = (a, int(rng.choice(far))) if far else None
    labels = [clusters.labels[k] for k in pair]
    rest = [clusters.labels[k] for k in clusters.together[pair[0]].nonzero()[:, 0].tolist() if k not in pair]
    t0 = float(rng.uniform(0.5, 2.0))

    def change(position: Tensor, time: Tensor) -> None:
        rows = ((time >= t0) & (time < t0 + 0.8)).nonzero()
        columns = [trials[name].markers.labels.index(label) for label in labels]
        position[rows, columns] = position[rows, columns[::-1]]

    def bare(trial: Trial) -> Trial:
        position = trial.markers.position.clone()
        position[:, [trial.markers.labels.index(label) for label in rest]] = torch.nan
        return replace(trial, markers=replace(trial.markers, position=position))

    planted = with_position({one: bare(trial) for one, trial in trials.items()}, name, change)
    (found,) = look(planted)
    assert (found.kind, found.trial, set(found.labels)) == (TrackFault.EXCHANGED, name, set(labels))
    ((start, stop),) = found.when
    assert abs(start - t0) < 0.03 and abs(stop - t0 - 0.8) < 0.03
    assert found.left_mm < 0.4 * found.size_mm


def test_a_name_on_the_marker_of_one_that_a_trial_lacks_is_put_right(trials, clusters, rng):
    """A trial whose file has only one of the two labels, and that on the other's marker.

    Of three markers it would leave a single distance, which two exchanges may explain alike.
    """
    name, both = moving(rng, trials), pair(rng, trials, clusters, 3)
    whole = trials[name].markers
    lost, kept = (clusters.labels[k] for k in both)
    position = whole.position.clone()
    position[:, whole.labels.index(kept)] = position[:, whole.labels.index(lost)]
    left = tuple(label for label in whole.labels if label != lost)
    planted = {**trials, name: replace(trials[name], markers=replace(whole, position=position).select(left))}
    (found,) = look(planted)
    assert (found.kind, found.trial, set(found.labels)) == (TrackFault.EXCHANGED, name, {lost, kept})
    undone = renamed(planted[name].markers, [found])
    torch.testing.assert_close(undone.select((lost,)).position, whole.select((lost,)).position, equal_nan=True)
    assert torch.isnan(undone.select((kept,)).position).all()
    sound, _ = taken_out(planted, (found,), lambda trial: trial)
    assert torch.isnan(sound[name].markers.select((kept, lost)).position).all()


@pytest.mark.parametrize("times", [1, 3])
def test_leaps_are_found(trials, clusters, rng, times):
    """By 40 to 130 mm, for one frame or a while, once or between two places."""
    name, marker = moving(rng, trials), drawn(rng, clusters, 2)
    label = clusters.labels[marker]
    column = trials[name].markers.labels.index(label)
    way = torch.from_numpy(rng.normal(size=3))
    way *= float(rng.uniform(0.04, 0.13)) / way.norm()
    mask = torch.zeros(len(trials[name].markers.time), dtype=torch.bool)
    for k in range(times):
        start = int(60 + 90 * k + rng.integers(0, 30))
        mask[start : start + int(rng.integers(1, 40))] = True
    planted = with_position(trials, name, lambda position, _: _shift(position, mask, column, way))
    (found,) = look(planted)
    assert (found.trial, found.labels) == (name, (label,))
    assert found.kind is (TrackFault.JUMP if times == 1 else TrackFault.FLIP)
    assert torch.equal(found.inside(trials[name].markers.time), mask)


def _shift(position: Tensor, mask: Tensor, column: int, way: Tensor) -> None:
    position[mask, column] += way


def test_leaps_are_found_without_a_marker_set(trials, clusters, rng):
    """The markers to which one keeps its distance stand in for its segment."""
    name, marker = moving(rng, trials), drawn(rng, clusters, 3)
    label, markers = clusters.labels[marker], trials[name].markers
    mask = torch.zeros(len(markers.time), dtype=torch.bool)
    mask[100:120] = True
    way = torch.tensor([0.08, 0.06, 0.06]).double()
    planted = with_position(trials, name, lambda p, _: _shift(p, mask, markers.labels.index(label), way))
    (found,) = find_jumps(name, planted[name].markers, Clusters.unknown(markers.labels), ())
    assert found.labels == (label,) and torch.equal(found.inside(markers.time), mask)


def test_a_frozen_marker_is_found(trials, clusters, rng):
    """It trembles by less than a camera sees, while others go on."""
    for _ in range(1000):
        name, marker = moving(rng, trials), drawn(rng, clusters, 2)
        column = trials[name].markers.labels.index(clusters.labels[marker])
        start = int(rng.integers(50, 300))
        part = trials[name].markers.position[start : start + 40, column]
        if float((part[-1] - part[0]).norm()) > 0.1:
            break
    else:
        pytest.skip("no marker of this session goes far")

    def change(position: Tensor, _: Tensor) -> None:
        position[start : start + 40, column] = part[0] + 1e-6 * torch.from_numpy(rng.normal(size=(40, 3)))

    kinds = {(one.kind, one.labels) for one in look(with_position(trials, name, change))}
    assert (TrackFault.FROZEN, (clusters.labels[marker],)) in kinds
    assert {labels for _, labels in kinds} == {(clusters.labels[marker],)}


def test_a_marker_that_was_moved_is_named(trials, clusters, rng):
    """By 25 to 40 mm on a segment with four markers or more, throughout a trial: its size and verdict are right."""
    while True:
        name, marker = moving(rng, trials), drawn(rng, clusters, 3)
        if clusters.scatter[marker] < 0.005:
            break
    rest = clusters.together[marker].nonzero()[:, 0].tolist()
    size = float(rng.uniform(0.025, 0.04))
    columns = [trials[name].markers.labels.index(clusters.labels[k]) for k in (marker, *rest)]

    def change(position: Tensor, _: Tensor) -> None:
        p = position[:, columns]
        away = p[:, 0] - p[:, 1:].nanmean(dim=1)
        position[:, columns[0]] += size * away / away.norm(dim=1, keepdim=True)

    planted = with_position(trials, name, change)
    found = [one for one in look(planted) if one.trial == name]
    assert [(one.kind, one.labels) for one in found] == [(TrackFault.MOVED, (clusters.labels[marker],))]
    assert abs(found[0].size_mm - 1e3 * size) < 3.0 * found[0].sd_mm
    readings = readings_of(planted, clusters)
    nats = {trial: moved_nats(readings, clusters.labels[marker], [trial]) for trial in trials}
    assert nats[name] > 3.0 and all(own < 0.0 for trial, own in nats.items() if trial != name), nats
    told = {one.label: one for one in readings if (one.trial, one.against) == (name, "static")}
    assert told[clusters.labels[marker]].verdict is Verdict.MOVED
    assert all(told[clusters.labels[k]].verdict is Verdict.STAYS for k in rest)


def test_of_three_markers_the_one_that_moved_is_told_and_of_two_both_are_said(trials, clusters, rng):
    """The third is on a segment of its own in the second look.

    Where the place that it moved to is near to that of another, labels may as well be exchanged: another is moved then.
    """
    three = [s for s in dict.fromkeys(clusters.segments) if len(clusters.on(s)) == 3]
    while True:
        segment, name = str(rng.choice(three)), moving(rng, trials)
        labels = [clusters.labels[k] for k in clusters.on(segment)]
        a, b, _ = (trials[name].markers.labels.index(label) for label in labels)

        def change(position: Tensor, _: Tensor, a: int = a, b: int = b) -> None:
            away = position[:, a] - position[:, b]
            position[:, a] += 0.04 * away / away.norm(dim=1, keepdim=True)

        planted = with_position(trials, name, change)
        before, after = (shape_of(name, some[name].markers, tuple(labels)).median for some in (trials, planted))
        swaps = ([1, 0, 2], [2, 1, 0], [0, 2, 1])
        if min(float((after - before[swap][:, swap]).abs().max()) for swap in swaps) > 0.02:
            break
    (found,) = [one for one in look(planted) if one.trial == name]
    assert found.kind is TrackFault.MOVED and labels[0] in found.labels
    apart = dict(zip(clusters.labels, clusters.segments, strict=True)) | {labels[2]: labels[2]}
    (found,) = [one for one in look_at_trials(planted, Clusters.of(apart)) if one.trial == name]
    assert found.kind is TrackFault.MOVED and set(found.labels) == set(labels[:2])
    assert "nothing tells which" in found.sentence


def test_left_and_right_of_a_head_are_told_by_its_asymmetry(trials, clusters, rng):
    """Both pairs at once, where the head's markers are not a rectangle."""
    name = moving(rng, trials)
    both = (("LFHD", "RFHD"), ("LBHD", "RBHD"))
    skew, sign = trials, 0.0
    for trial in trials:  # the same head in all trials, plainly no rectangle: one diagonal is made longer still
        labels = trials[trial].markers.labels
        corner = {label: trials[trial].markers.position[:, labels.index(label)] for two in both for label in two}
        diagonals = [(corner[a] - corner[b]).norm(dim=1).nanmean() for a, b in (("LFHD", "RBHD"), ("RFHD", "LBHD"))]
        sign = sign or (1.0 if diagonals[0] < diagonals[1] else -1.0)
        a, b, c = (labels.index(label) for label in ("LFHD", "RBHD", "LBHD"))

        def lean(position: Tensor, _: Tensor, a: int = a, b: int = b, c: int = c, by: float = 0.03 * sign) -> None:
            along = position[:, b] - position[:, c]
            position[:, a] += by * along / along.norm(dim=1, keepdim=True)

        skew = with_position(skew, trial, lean)

    def turn(position: Tensor, _: Tensor) -> None:
        for two in both:
            columns = [trials[name].markers.labels.index(label) for label in two]
            position[:, columns] = position[:, columns[::-1]]

    assert look(skew) == ()
    found = look(with_position(skew, name, turn))
    assert {(one.kind, one.trial, frozenset(one.labels)) for one in found} == {
        (TrackFault.EXCHANGED, name, frozenset(two)) for two in both
    }


def test_joints_that_no_body_turns_so_fast_are_marked(seed):
    """A shoulder that steps by 2 rad in a frame and back; a turn by 2 pi of a three-axis joint is none."""
    tree = small_session.template().tree
    q = torch.zeros(100, len(tree.dofs), dtype=torch.float64)
    names = [dof.name for dof in tree.dofs]
    assert impossible_steps(tree, q, 100.0) == []
    q[40:, names.index("shoulder_l_flexion")] += 2.0 * torch.pi
    assert impossible_steps(tree, q, 100.0) == []
    q[50:60, names.index("shoulder_l_rotation")] += 2.5
    q[80:, names.index("knee_r_flexion")] += 1.0
    steps = impossible_steps(tree, q, 100.0)
    assert [(one.body, one.frame) for one in steps] == [("upper_arm_l", 49), ("upper_arm_l", 59), ("shank_r", 79)]
    marked = frames_of(steps, len(q), 100.0).nonzero()[:, 0].tolist()
    assert marked == [*range(49, 61), 79, 80]


def test_frames_whose_joints_turn_too_fast_are_told(seed):
    """With their number, and the joint that is furthest beyond what a body can; a sound trial says nothing."""
    given = small_session.assignment()
    prior = given.model.geometry
    fit = GeometryFit(given.model, given.attachment, prior, prior.mean, torch.zeros(0), GeometryOptions())
    tree, time = given.model.tree, torch.arange(100, dtype=torch.float64) / 100.0
    sound = torch.zeros(100, len(tree.dofs), dtype=torch.float64)
    wild = sound.clone()
    wild[80:, tree.dof_names.index("knee_r_flexion")] += 2.0
    followed = {}
    for name, q in (("sound", sound), ("wild", wild)):
        tracked = Tracked(time, q, torch.zeros(100, 1), torch.ones(100, dtype=torch.bool))
        followed[name] = Followed(name, tracked, smooth_motion(tree, time, q, Smoother(10.0, 100.0)))
    (said,) = _rate_notes(fit, followed)
    assert (said.code, said.source) == ("tracking.rates", "wild")
    assert said.message.startswith("2 of 100 frames") and "shank_r by 200 rad/s at 0.79 s" in said.message


def test_alignment_is_a_rotation(seed):
    """Also of flat clusters, in batches."""
    points = torch.randn(5, 4, 3).double() * torch.tensor([1.0, 1.0, 0.0]).double()
    R, t = align(points, points.roll(1, dims=0))
    torch.testing.assert_close(torch.linalg.det(R), torch.ones(5).double())
    back, shift = align(points, points @ R.mT + t[:, None])
    assert float((back - R).abs().max()) < 1e-6 and float((shift - t).abs().max()) < 1e-6


def recorded(data_dir: Path, markers: str, files: dict[str, str]) -> tuple[Trials, Clusters]:
    """Trials of a real session, markers alone."""
    known = load_marker_set(markers)
    options = ReadOptions(wanted=known.wanted)
    found = {
        name: read_trial(name, data_dir / file, None, "static" if name == "static" else "fit", options)
        for name, file in files.items()
    }
    labels = {label: None for trial in found.values() for label in trial.markers.labels}
    match = known.match(labels).assigned
    return found, Clusters.of({label: spec.segment for label, spec in match.items()})


def test_a_thigh_marker_by_another_name_is_found(data_dir):
    """OpenCap's walkingTI3 calls the fifth marker of the right thigh the third, but for the first frames."""
    folder = "opencap_subject4/MarkerData"
    names = {"static": "static1", "walking1": "walking1", "walkingTI2": "walkingTI2", "walkingTI3": "walkingTI3"}
    trials, clusters = recorded(data_dir, "opencap", {name: f"{folder}/{file}.trc" for name, file in names.items()})
    others = [shape_of(name, trials[name].markers, clusters.labels) for name in trials if name != "walkingTI3"]
    found = [one for one in look_at_trial(trials["walkingTI3"], clusters, others) if one.kind is TrackFault.EXCHANGED]
    assert [set(one.labels) for one in found] == [{"r_thigh3", "r_thigh5"}]
    assert found[0].share > 0.9 and found[0].left_mm < 5.0


def test_a_single_frame_has_one_time_and_distances_agree_to_a_millimetre_at_best():
    """Not from a time to the same time, and not within nothing."""
    leap = TrackStatement(TrackFault.JUMP, "walk", ("LTHI",), ((0.1, 0.1),), 60.0, 3.0)
    assert leap.sentence.endswith("60 mm off, at 0.10 s")
    assert replace(leap, when=((0.1, 0.3), (0.5, 0.5))).sentence.endswith("at 0.10-0.30 s, 0.50 s")
    moved = replace(leap, kind=TrackFault.MOVED, when=(), left_mm=0.2, against=("a", "b"))
    assert "sits elsewhere than in a and b, by 60 mm (sd 3 mm)" in moved.sentence
    assert moved.sentence.endswith("within 1 mm") and replace(moved, left_mm=1.2).sentence.endswith("within 2 mm")
