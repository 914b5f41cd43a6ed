"""Tests of torchid.io.trial: markers of a C3D with the forces of a MOT beside it."""

from pathlib import Path

import numpy as np
import pytest
from c3d_bytes import C3dBuilder, labels, standing
from numpy.testing import assert_allclose

from torchid.config import load_config
from torchid.errors import DataError, InputError
from torchid.io import ReadOptions, read_trial
from torchid.io.mend import PlateAs
from torchid.session.opening import read_session

FRAMES, RATE, FIRST = 60, 100.0, 251
BEGIN = (FIRST - 1) / RATE


def c3d(folder: Path, plates: bool, **changes) -> Path:
    """Somebody standing, Z up, whose first frame is stored at 2.5 s; perhaps on a plate of the C3D's own."""
    settings = {"points": standing(FRAMES), "labels": labels(8), "rate": RATE, "first_frame": FIRST} | changes
    if plates:
        plate = {
            "USED": np.array([1]), "TYPE": np.array([2]), "CHANNEL": np.arange(1, 7)[:, None],
            "CORNERS": np.array([[600.0, 0, 0], [0, 0, 0], [0, 400, 0], [600, 400, 0]]).T[:, :, None],
            "ORIGIN": np.array([[0.0], [0.0], [-40.0]]),
        }  # fmt: skip
        settings |= {"analogs": np.tile([0.0, 0.0, -650.0, 0.0, 0.0, 0.0], (2 * FRAMES, 1)), "ratio": 2}
        settings["parameters"] = {"FORCE_PLATFORM": plate, "ANALOG": {"UNITS": ["N"] * 3 + ["Nmm"] * 3}}
    return C3dBuilder(**settings).save(folder / "a.c3d")


def mot(folder: Path, up: str, begin: float, seconds: float) -> Path:
    """A weight of 700 N that acts 0.1 m before and, in axes turned Z up, 0.2 m to the left of the origin."""
    point = {"z": [0.1, 0.2, 0.0], "y": [0.1, 0.0, -0.2]}[up]
    force = {"z": [0.0, 0.0, 700.0], "y": [0.0, 700.0, 0.0]}[up]
    row = "\t".join(str(x) for x in (*force, *point, 0, 0, 0))
    rows = [f"{begin + k / RATE:.6f}\t{row}" for k in range(round(seconds * RATE) + 1)]
    names = "\t".join(f"ground_force_1_{what}{axis}" for what in "vpm" for axis in "xyz")
    path = folder / "a.mot"
    path.write_text("\n".join(["forces", f"nRows={len(rows)}", "endheader", f"time\t{names}", *rows]) + "\n")
    return path


def codes(trial) -> set[str]:
    return {note.code for note in trial.notes}


@pytest.mark.parametrize("plates", [False, True])
@pytest.mark.parametrize("up", ["y", "z"])
def test_a_mot_stands_for_the_plates_of_a_c3d(tmp_path: Path, plates: bool, up: str) -> None:
    """Forces with their own vertical axis are turned by it; the C3D's own plates are left out, and both are said."""
    trial = read_trial("a", c3d(tmp_path, plates), mot(tmp_path, up, BEGIN, 0.59))
    assert trial.forces is not None and trial.parameters["up"] == "z"
    weight = [0.0, 0.0, 700.0, 140.0, -70.0, 0.0]
    assert_allclose(trial.forces.wrench[:, 0], np.tile(weight, (60, 1)), atol=1e-9)
    assert_allclose(trial.markers.position, standing(FRAMES) / 1000.0, atol=1e-6)
    assert ("axes.forces" in codes(trial)) == (up == "y")
    assert ("plates.replaced" in codes(trial)) == plates
    assert "plates.none" not in codes(trial)


@pytest.mark.parametrize("plates", [False, True])
def test_a_fault_of_forces_beside_a_c3d_names_their_file(tmp_path: Path, plates: bool) -> None:
    """A change that needs corners fails for the MOT, which has none, and not for the C3D."""
    options = ReadOptions(plates={1: PlateAs(mirror="x")})
    with pytest.raises(InputError, match=r"plates\.corners") as caught:
        read_trial("a", c3d(tmp_path, plates), mot(tmp_path, "z", BEGIN, 0.59), options=options)
    assert caught.value.source == str(tmp_path / "a.mot")


@pytest.mark.parametrize(
    ("begin", "seconds", "expected"), [(BEGIN, 0.59, BEGIN), (0.0, 0.59, BEGIN), (0.0, 6.0, 0.0), (2.0, 2.0, 2.0)]
)
def test_clocks_of_a_c3d_that_begins_late(tmp_path: Path, begin: float, seconds: float, expected: float) -> None:
    """The clock of the forces is the markers' where it covers them, else it counts from the first stored frame."""
    trial = read_trial("a", c3d(tmp_path, False), mot(tmp_path, "z", begin, seconds))
    assert trial.forces is not None
    assert_allclose(trial.markers.time[0], BEGIN)
    assert_allclose(trial.forces.time[0], expected)
    assert "trial.clock" in codes(trial) and "trial.overlap" not in codes(trial)


def test_forces_tell_the_axis_that_the_c3d_does_not_show(tmp_path: Path) -> None:
    """A cloud as wide as tall asks for the axis; forces beside it answer, and the user before them."""
    points = np.random.default_rng(0).uniform(100.0, 900.0, (FRAMES, 8, 3))
    with pytest.raises(InputError, match=r"axes\.unknown"):
        read_trial("a", c3d(tmp_path, False, points=points))
    forces = mot(tmp_path, "y", BEGIN, 0.59)
    trial = read_trial("a", c3d(tmp_path, False, points=points), forces)
    assert trial.parameters["up"] == "y"
    assert_allclose(trial.markers.position[..., 2], points[..., 1] / 1000.0, atol=1e-6)
    asked = read_trial("a", c3d(tmp_path, False, points=points), forces, options=ReadOptions(up="z"))
    assert_allclose(asked.markers.position[..., 2], points[..., 2] / 1000.0, atol=1e-6)
    assert asked.forces is not None
    assert_allclose(asked.forces.wrench[:, 0, 2], 700.0)


def test_a_trial_too_short_for_accelerations_is_refused(tmp_path):
    """Five frames may stand still; that they move is refused with the file and their number."""
    (tmp_path / "static.c3d").write_bytes(C3dBuilder(standing(5), labels(8)).build())
    text = "subject: {name: S, mass_kg: 70}\nmarkers: plug_in_gait\ntrials: [{name: a, file: static.c3d, role: fit}]\n"
    (tmp_path / "config.yaml").write_text(text)
    with pytest.raises(DataError, match=r"static\.c3d.*found: 5 frames.*trial\.short") as caught:
        read_session(load_config(tmp_path / "config.yaml"))
    assert "static" in caught.value.remedy
