"""Tests of torchid.io.labels, missing and frame: what counts as a marker, as missing, as up."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from numpy.testing import assert_allclose, assert_array_equal

from torchid.errors import InputError
from torchid.io import missing
from torchid.io.frame import length_unit, to_world, vertical_axis
from torchid.io.labels import select_markers
from torchid.io.missing import held_samples, missing_samples
from torchid.io.options import ReadOptions
from torchid.recording import Forces, Plate

BONES = [stem + end for stem in ("PEL", "LFE", "TRX") for end in "OALP"]
OXFORD = [f"LFOF{k}" for k in range(4)] + ["LTIB1", "LHE1", "LPROXFF"]


def test_outputs_and_computed_points_are_told_from_markers() -> None:
    """Listed outputs, bones, Oxford foot axes, joint centres and centres of mass are left out, by name."""
    markers = ["LASI", "LTIB", "LANK", "C7", "T10"]
    others = [*BONES, *OXFORD, "LHJC", "L_HJC_reg", "CentreOfMass", "RightHipCenterScore", "LKneeAngles", "RHipForce"]
    found = select_markers(markers + others, "x", frozenset(["LKneeAngles", "RHipForce"]))
    assert found.labels == tuple(markers)
    assert [note for note in found.notes if note.code == "markers.outputs" and str(len(others)) in note.message]


def test_names_that_only_look_computed_stay() -> None:
    """Cluster markers LTIB1..3 without an Oxford foot, a lone bone name, and LHEA beside LHEO are markers."""
    markers = ("LTIB1", "LTIB2", "LTIB3", "PELO", "RANK1", "LHEO", "LHEA", "LHEL", "LHEP")
    assert select_markers(list(markers), "x").labels == markers


def test_unlabelled_points_are_counted_out() -> None:
    """*12, *, U_3 and empty labels are no markers."""
    found = select_markers(["LASI", "*12", "*", "U_3", "", "S:*52", "RASI"], "x")
    assert found.labels == ("LASI", "RASI") and found.columns == (0, 6)
    assert [note for note in found.notes if note.code == "markers.unlabelled" and note.message.startswith("5 ")]
    assert "markers.none" not in {note.code for note in found.notes}
    alone = select_markers(["*0", "*1", "S:*2"], "x")
    assert alone.labels == () and "markers.none" in {note.code for note in alone.notes}


def test_one_prefix_is_stripped_and_several_ask() -> None:
    """One subject's prefix goes, which is said; of several, one must be chosen and the others are counted out."""
    alone = select_markers(["Sub:LASI", "Sub:RASI"], "x")
    assert alone.labels == ("LASI", "RASI")
    assert [note.code for note in alone.notes] == ["markers.prefix"] and "Sub" in alone.notes[0].message
    several = ["A:LASI", "A:RASI", "B:LASI", "wand"]
    with pytest.raises(InputError, match=r"A \(2: LASI, RASI\), B \(1: LASI\).*subject: A \[markers\.subjects"):
        select_markers(several, "x")
    chosen = select_markers(several, "x", subject="A")
    assert chosen.labels == ("LASI", "RASI", "wand") and chosen.columns == (0, 1, 3)
    with pytest.raises(InputError, match=r"C.*markers\.subjects"):
        select_markers(several, "x", subject="C")


def test_several_bodies_of_one_person_are_taken_together() -> None:
    """A list of prefixes takes all of them, unless a label occurs under two; the question says whether one does."""
    bodies = ["Body:C7", "Arm:Elbow", "Box:B1", "wand"]
    with pytest.raises(InputError, match=r"subject: \[Arm, Body\]"):
        select_markers(bodies, "x")
    chosen = select_markers(bodies, "x", subject=("Body", "Arm"))
    assert chosen.labels == ("C7", "Elbow", "wand") and chosen.columns == (0, 1, 3)
    with pytest.raises(InputError, match=r"C7 of Arm and Body.*markers\.subjects"):
        select_markers([*bodies, "Arm:C7"], "x", subject=("Body", "Arm"))
    assert [note.code for note in select_markers(["C7"], "x", subject="Body").notes] == ["markers.subjects"]


def test_duplicates_are_numbered_and_said() -> None:
    """The first of equal labels keeps its name, later ones get a free number."""
    found = select_markers(["A", "B", "A", "A#2", "A"], "x")
    assert found.labels[:2] == ("A", "B") and found.labels[3] == "A#2"
    assert len(set(found.labels)) == 5
    assert [note for note in found.notes if note.code == "markers.duplicates"]


def moving(frames: int = 60, markers: int = 6) -> np.ndarray:
    random = np.random.default_rng(3)
    walk = np.linspace(0, 1, frames)[:, None, None] * np.array([1.0, 0.0, 0.0])
    return walk + random.uniform(0.2, 1.5, (1, markers, 3)) + 1e-4 * random.normal(size=(frames, markers, 3))


def test_held_runs_are_found_while_others_move() -> None:
    """A marker on one number for 15 frames of a walk is masked after its first sample; 9 frames are not enough."""
    position = moving()
    position[20:36, 2] = position[20, 2]
    position[40:50, 3] = position[40, 3]
    expected = np.zeros(position.shape[:2], bool)
    expected[21:36, 2] = True
    held, notes = held_samples(position, 100.0, tuple("ABCDEF"), "x")
    assert_array_equal(held, expected)
    assert "C (15)" in notes[0].message


def test_everything_still_is_not_held() -> None:
    """Somebody who stands still is no fault of the recording."""
    position = np.repeat(moving(1), 50, axis=0)
    assert not held_samples(position, 100.0, tuple("ABCDEF"), "x")[0].any()


def test_pieces_of_a_long_recording_are_judged_as_a_whole(monkeypatch: pytest.MonkeyPatch) -> None:
    """Zeros, codes and held runs are found wherever the pieces are cut, and the array stays as it was."""
    position = moving()
    position[3, 1], position[30, 4], position[20:36, 2] = 0.0, 5000.0, position[20, 2]
    position.setflags(write=False)
    found = missing_samples(position, "x"), held_samples(position, 100.0, tuple("ABCDEF"), "x")
    assert found[0][0].sum() == 2 and found[1][0].sum() == 15
    for piece in (1, 7, 59):
        monkeypatch.setattr(missing, "PIECE", piece)
        again = missing_samples(position, "x"), held_samples(position, 100.0, tuple("ABCDEF"), "x")
        for (mask, notes), (other, same) in zip(found, again, strict=True):
            assert_array_equal(mask, other)
            assert notes == same


def forces(axis: int, sign: float = 1.0) -> Forces:
    wrench = torch.zeros(50, 1, 6, dtype=torch.float64)
    wrench[10:, 0, axis] = sign * 700.0
    return Forces(torch.arange(50, dtype=torch.float64) / 100, wrench, (Plate("p"),))


def cloud(axis: int) -> np.ndarray:
    size = np.array([0.4, 0.4, 0.4])
    size[axis] = 1.7
    return np.tile(np.random.default_rng(0).uniform(0, 1, (1, 20, 3)) * size, (5, 1, 1))


@pytest.mark.parametrize(
    ("force", "stated", "markers", "expected"),
    [(1, "", 2, "y"), (2, "", 1, "z"), (None, "y", 2, "y"), (None, "", 1, "y"), (None, "", 2, "z")],
)
def test_evidence_for_the_vertical_axis(force: int | None, stated: str, markers: int, expected: str) -> None:
    """The ground reaction decides, then the file, then the markers."""
    measured = None if force is None else forces(force)
    axis, notes = vertical_axis(cloud(markers), measured, stated, "z", ReadOptions(), "x")
    assert axis == expected and notes[0].code == "axes.up"
    against = [note.message for note in notes if note.code == "axes.markers"]
    assert against == (
        []
        if "xyz"[markers] == expected
        else [f"the marker cloud is tallest along {'XYZ'[markers]}, not {expected.upper()}"]
    )


def test_a_vertical_axis_that_nothing_shows_is_asked_for() -> None:
    """Without force, statement and a tall cloud the user is asked, in words that are keys; the answer is obeyed."""
    with pytest.raises(InputError, match=r"up: z or up: y \[axes\.unknown") as caught:
        vertical_axis(cloud(0), None, "", "z", ReadOptions(), "x")
    assert "1.6" in caught.value.found
    assert vertical_axis(cloud(0), None, "", "z", ReadOptions(up="y"), "x")[0] == "y"
    nothing = np.full((5, 20, 3), np.nan)
    assert vertical_axis(nothing, None, "", "z", ReadOptions(), "x")[0] == "z"


@pytest.mark.parametrize(("other", "axis"), [(1, "z"), (2, "y")])
def test_floor_and_plates_show_the_vertical_axis(other: int, axis: str) -> None:
    """Nobody stands below the floor, and plates that carry nobody still face up."""
    lying = cloud(0)
    lying[..., other] -= 0.5
    assert vertical_axis(lying, None, "", "", ReadOptions(), "x")[0] == axis
    corners = torch.tensor([[0.6, 0, 0], [0, 0, 0], [0, 0.4, 0.4], [0.6, 0.4, 0.4]], dtype=torch.float64)
    corners[:, "xyz".index(axis)] = 0.0
    unloaded = replace(forces(2, 0.0), plates=(Plate("p", corners),))
    assert vertical_axis(cloud(0), unloaded, "", "", ReadOptions(), "x")[0] == axis


def test_contradictions_about_the_vertical_axis_are_refused() -> None:
    """A file or a user against the ground reaction, and a reaction along X, are refused."""
    with pytest.raises(InputError, match=r"axes\.contradiction"):
        vertical_axis(cloud(2), forces(2), "y", "z", ReadOptions(), "x")
    with pytest.raises(InputError, match=r"axes\.contradiction"):
        vertical_axis(cloud(2), forces(2), "z", "z", ReadOptions(up="y"), "x")
    with pytest.raises(InputError, match=r"axes\.unsupported"):
        vertical_axis(cloud(2), forces(0), "", "z", ReadOptions(), "x")
    assert vertical_axis(cloud(2), forces(2), "y", "z", ReadOptions(up="z"), "x")[0] == "z"


def test_y_up_wrenches_rotate_in_both_halves() -> None:
    """Force and moment turn by +90 degrees about X."""
    wrench = torch.tensor([1.0, 2.0, 3.0, 4.0, 5.0, 6.0], dtype=torch.float64)
    expected = torch.tensor([1.0, -3.0, 2.0, 4.0, -6.0, 5.0], dtype=torch.float64)
    torch.testing.assert_close(to_world(wrench, "y"), expected)
    torch.testing.assert_close(to_world(wrench, "z"), wrench)


@pytest.mark.parametrize(("unit", "factor"), [("mm", 1e3), ("CM", 1e2), ("m", 1.0), ("mete", 1.0), ("inches", 39.37)])
def test_units_and_their_spellings(unit: str, factor: float) -> None:
    """A stated unit that fits the cloud is taken, in any spelling, even cut short."""
    found, _ = length_unit(unit, cloud(2) * factor, ReadOptions(), "x")
    assert found == {"inches": "in", "mete": "m"}.get(unit, unit.lower())


def test_units_that_cannot_be_ask() -> None:
    """A stated unit a thousand times off, and an unknown one, are refused with the likely one in the remedy."""
    for unit, factor in (("mm", 1.0), ("m", 1e3), ("furlong", 1.0)):
        with pytest.raises(InputError) as caught:
            length_unit(unit, cloud(2) * factor, ReadOptions(), "x")
        assert caught.value.code in ("units.implausible", "units.missing")
        assert ("mm" if factor == 1e3 else "m") in caught.value.remedy
    assert_allclose(len(length_unit("mm", cloud(2), ReadOptions(units="m"), "x")[1]), 1)
