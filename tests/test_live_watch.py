"""What a laboratory does wrong is said while the stream comes, and nothing else is."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import small_session
import torch
from simulated_person.clips import make_standing, stand_still
from test_live import RATE, long, moving, subject

from torchid.live.estimation.identifier import Identifier
from torchid.live.estimation.pose import PostureFollower
from torchid.live.sources.intake import Intake
from torchid.live.sources.stream import Replay
from torchid.recording import Trial
from torchid.simulate.trial import measure

Said = list[tuple[float, tuple[tuple[str, str], ...]]]


def watched(given: Trial) -> Said:
    """Time of every block's end, and what was said then."""
    return told(given)[0]


def told(given: Trial) -> tuple[Said, Identifier]:
    """The same, and who said it."""
    who, source = subject(), Replay(given, float("inf"))
    intake, follower = Intake(RATE, source.force_rate_hz, 0.5), PostureFollower(who.fit, source.labels)
    identifier, said = Identifier(who, source.labels, RATE, source.plates, source.force_rate_hz), []
    while (packet := source.take()) is not None:
        placed = intake.place(packet)
        if len(placed.index):
            identifier.put(
                placed.index, placed.markers.position, follower(placed.markers), placed.sample, placed.wrench
            )
            identifier.work()
            said += [(end_s, tuple((one.what, one.where) for one in notices)) for end_s, notices in identifier.watched]
    return said, identifier


def offset(rng: np.random.Generator, given: Trial) -> tuple[Trial, str]:
    """A plate that nobody stands on reads some newtons."""
    forces = given.forces
    assert forces is not None
    idle = (forces.wrench[..., 2].abs() > 20.0).double().mean(0).argmin()
    wrench = forces.wrench.clone()
    wrench[:, idle, 2] += float(rng.uniform(7.0, 15.0) * rng.choice([-1, 1]))
    return replace(given, forces=replace(forces, wrench=wrench)), f"offset {forces.plates[int(idle)].name}"


def lost(rng: np.random.Generator, given: Trial) -> tuple[Trial, str]:
    """A marker falls off within the second second."""
    k = int(rng.integers(len(given.markers.labels)))
    position = given.markers.position.clone()
    position[int(rng.uniform(1.0, 2.0) * RATE) :, k] = torch.nan
    return replace(given, markers=replace(given.markers, position=position)), f"marker {given.markers.labels[k]}"


def late(rng: np.random.Generator, given: Trial) -> tuple[Trial, str]:
    """Forces come late by some hundredths of a second."""
    assert given.forces is not None
    return replace(
        given, forces=replace(given.forces, time=given.forces.time + float(rng.uniform(0.035, 0.06)))
    ), "clock "


def silent(rng: np.random.Generator, given: Trial) -> tuple[Trial, str]:
    """The plate under a foot reads nothing."""
    forces = given.forces
    assert forces is not None
    wrench, loaded = forces.wrench.clone(), forces.wrench[..., 2].mean(0).argmax()
    wrench[:, loaded] = 0.0
    return replace(given, forces=replace(forces, wrench=wrench)), "unread "


@pytest.mark.slow
def test_plates_that_disagree_about_a_weight_are_named(seed: int):
    """One of the two that are most stood on reads some per cent less or more: which is wrong nobody knows."""
    rng, given = np.random.default_rng(seed), long()
    assert given.forces is not None
    loaded = given.forces.wrench[..., 2].abs().mean(0).argsort(descending=True)[:2]
    k, gain = int(rng.choice(loaded.numpy())), 1.0 + float(rng.choice([-1, 1]) * rng.uniform(0.1, 0.2))
    wrench = given.forces.wrench.clone()
    wrench[:, k] *= gain
    said = watched(replace(given, forces=replace(given.forces, wrench=wrench)))
    named = [where.split(", ") for _, some in said for what, where in some if what == "gain"]
    name = given.forces.plates[k].name
    assert named, (name, gain, said)
    assert all(name == plates[0 if gain < 1.0 else 1] for plates in named), (name, gain, named)


@pytest.mark.slow
@pytest.mark.parametrize("fault", [offset, lost, late, silent])
def test_what_is_wrong_is_said_within_seconds(fault: Callable, seed: int):
    """By its name and place, before the third second of a moving subject is over."""
    given, expected = fault(np.random.default_rng(seed), moving())
    said = watched(given)
    names = [f"{what} {where}" for end, some in said if end <= 3.0 for what, where in some]
    assert any(name.startswith(expected) for name in names), (expected, said)


@pytest.mark.slow
def test_how_late_forces_come_is_said(seed: int):
    """To 6 ms, within three seconds, although the body has been identified from the same forces."""
    given, rng = moving(), np.random.default_rng(seed)
    assert given.forces is not None
    late_s = float(rng.choice([-1, 1]) * rng.uniform(0.03, 0.05))
    late_forces = replace(given.forces, time=given.forces.time + late_s)
    _, identifier = told(replace(given, forces=late_forces))
    found = identifier.instruments.found()
    assert found is not None and abs(found.late.seconds - late_s) < 0.006, (late_s, found)
    assert found.late.sd < 0.005


def standing(rng: np.random.Generator, seconds: float) -> Trial:
    """Somebody who stands still: all that markers and plates show of it is noise."""
    stance = make_standing(small_session.session().subject, int(rng.integers(1000)), RATE)
    still = stand_still(stance, seconds, small_session.OPTIONS)
    return measure(stance.who, still, small_session.OPTIONS, rng).trial


@pytest.mark.slow
def test_standing_still_tells_nothing_of_a_clock_or_a_gain(seed: int):
    """Not in 2 x 12 s, whatever the noise looks like; the standard deviation says why."""
    rng = np.random.default_rng(seed)
    for _ in range(2):
        said, identifier = told(standing(rng, 12.0))
        assert len(said) > 10
        assert not [(end, one) for end, names in said for one in names if one[0] in ("clock", "gain")], said
        found = identifier.instruments.found()
        assert found is not None and found.late.sd > 0.005, found


@pytest.mark.slow
def test_nothing_is_said_of_a_stream_that_is_right():
    """But for the pauses between its trials, in which nothing comes."""
    said = watched(long())
    wrong = [one for _, names in said for one in names if one[0] not in ("posture", "beside")]
    assert len(wrong) <= 0.1 * len(said), said
    assert not [names for _, names in watched(moving()) if names]
