"""Tests of torchid.checks.recording: each planted fault is named with its cure, and a clean trial raises none."""

from dataclasses import replace
from io import StringIO

import numpy as np
import pytest
import torch
from numpy.testing import assert_allclose
from recordings import DATA
from rich.console import Console

from torchid.checks.finding import InstrumentFault
from torchid.checks.plates import moved_mass, plate_weight
from torchid.checks.recording import check_trial, format_check
from torchid.conventions import GRAVITY
from torchid.errors import DataError, Note
from torchid.io import read_trial
from torchid.recording import Forces, Markers, Plate, Trial
from torchid.session.fitting import explained_by_weight

FRAMES, RATIO, RATE, MASS = 200, 10, 100.0, 70.0


def swaying(amplitude: float = 0.0, seed: int = 0) -> Trial:
    """Somebody of 70 kg who bounces by ``amplitude`` [m] at 1 Hz over a plate of 0.6 by 0.4 m; starts off the plate."""
    random = np.random.default_rng(seed)
    time = np.arange(FRAMES) / RATE
    fine = np.arange(FRAMES * RATIO) / RATE / RATIO
    offsets = random.uniform([-0.2, -0.2, 0.1], [0.2, 0.2, 1.7], (8, 3))
    position = offsets + amplitude * np.sin(2 * np.pi * time)[:, None, None] * np.array([0, 0, 1.0])
    position = position + 1e-5 * random.normal(size=position.shape)
    vertical = MASS * (GRAVITY - amplitude * (2 * np.pi) ** 2 * np.sin(2 * np.pi * fine))
    vertical = np.where(fine < 0.3, 0.0, vertical) + 0.2 * random.normal(size=len(fine))
    wrench = np.zeros((len(fine), 1, 6))
    wrench[:, 0, 2], wrench[:, 0, 3], wrench[:, 0, 4] = vertical, 0.2 * vertical, -0.3 * vertical
    corners = torch.tensor([[0.6, 0.0, 0], [0.0, 0.0, 0], [0.0, 0.4, 0], [0.6, 0.4, 0]], dtype=torch.float64)
    forces = Forces(torch.from_numpy(fine), torch.from_numpy(wrench), (Plate("plate 1", corners),))
    markers = Markers(tuple("ABCDEFGH"), torch.from_numpy(time), torch.from_numpy(position))
    return Trial("t", markers, forces, parameters={"mass_kg": "70", "plate 1 type": "2", "units": "mm", "up": "z"})


def with_wrench(trial: Trial, change) -> Trial:
    assert trial.forces is not None
    wrench = trial.forces.wrench.clone()
    change(wrench)
    return replace(trial, forces=replace(trial.forces, wrench=wrench))


def codes(trial: Trial) -> set[str]:
    return {note.code for note in check_trial(trial).problems}


def test_a_clean_trial_has_no_problems() -> None:
    """Facts are right, nothing is flagged."""
    check = check_trial(swaying())
    assert check.problems == ()
    assert (check.markers, check.frames, check.units, check.up) == (8, FRAMES, "mm", "z")
    assert_allclose([check.rate, check.force_rate or 0.0], [RATE, RATE * RATIO])
    plate = check.plates[0]
    assert plate.kind == "2" and plate.saturated == 0 and plate.outside == 0.0
    assert plate.baseline is not None and check.weight is not None and check.mass is not None
    assert_allclose(plate.baseline, 0.0, atol=0.1)
    assert_allclose(check.weight, MASS, rtol=1e-3)
    assert_allclose(check.mass, MASS, rtol=1e-2)  # the step onto the plate is spread over two frames of 170


@pytest.mark.parametrize(
    ("change", "code"),
    [
        (lambda w: w.__setitem__((..., slice(None)), w * 1.2), "plates.weight"),
        (lambda w: w[..., 2].add_(30.0), "plates.offset"),
        (lambda w: w[..., 3:5].add_(300.0), "plates.outside"),
        (lambda w: w[..., 2].clamp_(max=800.0), "plates.saturated"),
    ],
)
def test_planted_plate_faults_are_named(change, code: str) -> None:
    """A gain of 1.2, 30 N of offset, shifted moments and a clipped force are found while somebody bounces."""
    assert code in codes(with_wrench(swaying(0.06), change))


def test_gaps_are_named() -> None:
    """A marker missing in 60 % of the frames is named with its share."""
    trial = swaying()
    position = trial.markers.position.clone()
    position[:120, 3] = torch.nan
    check = check_trial(replace(trial, markers=replace(trial.markers, position=position)))
    assert_allclose(check.gaps["D"], 60.0)
    assert_allclose(check.gap_share, 60.0 / 8)
    assert [note for note in check.warnings if note.code == "markers.gaps" and "D (60 %)" in note.message]


def test_gaps_of_most_markers_are_a_problem() -> None:
    """Few of many markers can be done without, most of them cannot."""
    for count, problem in ((1, False), (4, False), (5, True), (8, True)):
        trial = swaying()
        position = trial.markers.position.clone()
        position[:120, :count] = torch.nan
        check = check_trial(replace(trial, markers=replace(trial.markers, position=position)))
        assert ("markers.gaps" in {note.code for note in check.problems}) == problem, count


def test_notes_of_reading_become_problems_with_a_cure() -> None:
    """Held markers and reversed plates, found on reading, are told apart by what harms; a choice of axes is neither."""
    notes = (Note("markers.held", "held: C"), Note("plates.sign", "down"), Note("axes.up", "vertical axis Z"))
    check = check_trial(replace(swaying(), notes=notes))
    assert [note.code for note in check.problems] == ["plates.sign"]
    assert [note.code for note in check.warnings] == ["markers.held"]
    assert all("Cure: " in note.message for note in (*check.problems, *check.warnings))
    assert [note.code for note in check.notes] == ["axes.up"]


def test_bouncing_does_not_pass_for_another_weight() -> None:
    """Part of a bounce biases the mean force; with the markers' acceleration the mass is right."""
    trial = swaying(0.08)
    assert trial.forces is not None
    part = slice(300, 800)
    cut = Forces(trial.forces.time[part], trial.forces.wrench[part], trial.forces.plates)
    assert abs((plate_weight(replace(trial, forces=cut)) or 0.0) / MASS - 1.0) > 0.05
    assert_allclose(moved_mass(replace(trial, forces=cut)) or 0.0, MASS, rtol=0.01)
    assert "plates.weight" not in codes(replace(trial, forces=cut))


def hopping(seed: int) -> tuple[Trial, float]:
    """Somebody who hops all through a recording that begins and ends anywhere in a hop, and the mass [kg]."""
    random = np.random.default_rng([seed, 48])
    mass, contact, flight = random.uniform(30, 110), random.uniform(0.18, 0.3), random.uniform(0.08, 0.25)
    period, rate = contact + flight, 120.0
    time = np.arange(round(random.uniform(6.0, 9.0) * period * rate)) / rate
    phase = (time + random.uniform(0.0, period)) % period
    push = GRAVITY * period / contact * np.pi / 2.0  # its mean over a cycle is g
    force = np.where(phase < contact, push * np.sin(np.pi * phase / contact), 0.0)
    rate_up = np.cumsum(force - GRAVITY) / rate
    height = np.cumsum(rate_up - np.polyval(np.polyfit(time, rate_up, 1), time)) / rate
    position = random.uniform([-0.2, -0.2, 0.1], [0.2, 0.2, 1.7], (8, 3)) + height[:, None, None] * np.array(
        [0, 0, 1.0]
    )
    wrench = torch.zeros(len(time), 1, 6, dtype=torch.float64)
    wrench[:, 0, 2] = torch.from_numpy(mass * force)
    markers = Markers(tuple("ABCDEFGH"), torch.from_numpy(time), torch.from_numpy(position))
    return Trial("hops", markers, Forces(markers.time, wrench, (Plate("plate 1", None),))), mass


def test_who_hops_is_weighed_over_whole_cycles(seed: int) -> None:
    """Wherever the recording is cut and however long the flights: the weight is right by force and by motion."""
    trial, mass = hopping(seed)
    assert_allclose([plate_weight(trial) or 0.0, moved_mass(trial) or 0.0], mass, rtol=0.05)
    assert trial.forces is not None
    off = replace(
        trial,
        markers=replace(trial.markers, position=trial.markers.position[:1].expand(len(trial.markers.time), -1, -1)),
    )
    assert (plate_weight(off) or 0.0) > 1.2 * mass  # who does not fall meanwhile stands beside the plates


def test_who_has_a_foot_beside_the_plates_is_weighed_without_those_frames(seed: int) -> None:
    """While one foot stands on the floor, the plates carry any part of a body."""
    random = np.random.default_rng([seed, 481])
    trial = swaying()
    feet = np.array([[x, y, 0.02] for y in (0.1, 0.9) for x in (0.2, 0.42)])
    position = np.concatenate([trial.markers.position.numpy(), np.broadcast_to(feet, (FRAMES, 4, 3))], axis=1)
    labels = (*trial.markers.labels, "LHEE", "LTOE", "RHEE", "RTOE")
    markers = Markers(labels, trial.markers.time, torch.from_numpy(position))
    beside, part = int(random.integers(60, 120)), random.uniform(0.55, 0.9)
    left = np.where(np.arange(FRAMES) < beside, part, 0.5) * MASS * GRAVITY
    right = np.where(np.arange(FRAMES) < beside, 0.0, 0.5) * MASS * GRAVITY
    wrench = torch.zeros(FRAMES, 2, 6, dtype=torch.float64)
    for k, (vertical, y) in enumerate(((left, 0.1), (right, 0.9))):
        wrench[:, k, 2], wrench[:, k, 3] = torch.from_numpy(vertical), torch.from_numpy(y * vertical)
        wrench[:, k, 4] = torch.from_numpy(-0.3 * vertical)
    forces = Forces(markers.time, wrench, (Plate("plate 1", None), Plate("plate 2", None)))
    found = replace(trial, markers=markers, forces=forces)
    assert_allclose([plate_weight(found) or 0.0, moved_mass(found) or 0.0], MASS, rtol=0.02)
    one = replace(forces, wrench=wrench.sum(dim=1, keepdim=True), plates=(Plate("plate 1", None),))
    # A pressure between both feet is on a plate that both share.
    assert_allclose(moved_mass(replace(found, forces=one)) or 0.0, MASS, rtol=0.02)


@pytest.mark.parametrize("child", ["HC030A05", "HC031A06", "HC033A10", "HC038A11", "HC044A15"])
def test_a_walk_over_two_plates_weighs_what_standing_did(child: str) -> None:
    """Straight walks of children, first and last step beside the plates, against their standing (5 to 8 % short)."""
    stood = {"HC030A05": 45.85, "HC031A06": 27.70, "HC033A10": 51.47, "HC038A11": 56.79, "HC044A15": 39.54}[child]
    file = DATA / "biomechzoo_pig" / f"{child}.c3d"
    if not file.exists():
        pytest.skip(f"{file} is not here")
    assert_allclose(moved_mass(read_trial("walk", file)) or 0.0, stood, rtol=0.01)


def test_a_trial_without_forces_or_frames_is_checked() -> None:
    """Missing parts are facts, not crashes."""
    trial = replace(swaying(), forces=None)
    assert check_trial(trial).weight is None and check_trial(trial).plates == ()
    none = Markers((), torch.zeros(0, dtype=torch.float64), torch.zeros(0, 0, 3, dtype=torch.float64))
    assert check_trial(replace(trial, markers=none)).gap_share == 0.0


def test_checking_changes_nothing() -> None:
    """The trial is the same before and after."""
    trial = swaying()
    assert trial.forces is not None
    before = trial.forces.wrench.clone(), trial.markers.position.clone()
    check_trial(trial)
    torch.testing.assert_close((trial.forces.wrench, trial.markers.position), before)


def test_a_load_beyond_the_body_is_said_alike_by_check_and_run() -> None:
    """A squat under 60 % more than the person: a run that cannot fit it ends with the figures and cure of ``check``."""
    trial = replace(with_wrench(swaying(0.06), lambda w: w.__setitem__((..., slice(None)), w * 1.6)), name="squat")
    (said,) = (one for one in check_trial(trial, MASS).problems if one.code == "plates.weight")
    assert said.fault is InstrumentFault.WEIGHT and said.unit == "kg" and abs((said.size or 0.0) - 0.6 * MASS) < 1.5
    refused = DataError("inertia.prior_conflict", "no such mass", remedy="")
    error = explained_by_weight(refused, [swaying(0.06), trial], MASS, "on record")
    assert said.evidence in str(error) and error.remedy == said.remedy() and error.source == "squat"
    other = DataError("inertia.no_information", "nothing", remedy="")
    assert explained_by_weight(other, [trial], MASS, "on record") is other
    assert explained_by_weight(refused, [trial], None, "by standing") is refused


def test_the_table_shows_labels_as_they_are() -> None:
    """Text from files is shown, not interpreted as markup."""
    trial = replace(swaying(), name="[bold]walk[/bold]", parameters={"subject": "[red]S1"})
    console = Console(width=160, file=(shown := StringIO()))
    console.print(format_check(check_trial(trial, mass_kg=90.0)))
    text = shown.getvalue()
    assert "[bold]walk[/bold]" in text and "[red]S1" in text
    assert "plates.weight" in text and "Cure:" in text
