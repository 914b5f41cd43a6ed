"""Tests of torchid.io on real recordings, against the manifest's figures and against ezc3d as second reader."""

import os
from pathlib import Path

import ezc3d
import numpy as np
import pytest
import torch
from numpy.testing import assert_allclose, assert_array_equal

from torchid.checks.recording import check_trial
from torchid.io import read_trial
from torchid.io.c3d import read_analogs, read_points
from torchid.io.c3d_header import read_header
from torchid.io.c3d_layout import resolve_layout

DATA = Path(os.environ.get("TORCHID_DATA", Path(__file__).parents[2] / "shared" / "data"))
C3D = sorted(path for path in DATA.rglob("*") if path.suffix.lower() == ".c3d") if DATA.is_dir() else []
OPENCAP = DATA / "opencap_subject4"

pytestmark = [
    pytest.mark.data,
    pytest.mark.skipif(not C3D, reason="real recordings are not here; set TORCHID_DATA to their folder"),
]


def opencap(name: str, role: str = "fit"):
    return read_trial(name, OPENCAP / "MarkerData" / f"{name}.trc", OPENCAP / "ID" / f"{name}_grf.mot", role)


@pytest.mark.parametrize("path", C3D, ids=lambda path: path.name)
def test_two_readers_agree(path: Path) -> None:
    """Points to 0.01 mm with equal gaps, analogs to 1e-3, and plate forces equal what ezc3d reads."""
    data = path.read_bytes()
    header = read_header(data, path)
    layout = resolve_layout(header, data)
    other = ezc3d.c3d(str(path), extract_forceplat_data=True)
    points = other["data"]["points"][:3].transpose(2, 1, 0)
    points = np.where((other["data"]["meta_points"]["residuals"][0].T < 0)[..., None], np.nan, points)
    ours = read_points(data, layout, header)
    assert_array_equal(np.isnan(ours), np.isnan(points))
    assert_allclose(ours, points, atol=0.01, rtol=0)
    if layout.channels:
        analogs, _ = read_analogs(data, layout, header)
        if header.strings("ANALOG", "FORMAT")[:1] != ["UNSIGNED"]:
            assert_allclose(analogs, other["data"]["analogs"][0].T, atol=1e-3, rtol=1e-6)
    forces = read_trial("a", path).forces
    for k, platform in enumerate(other["data"].get("platform", []) if forces else []):
        assert forces is not None
        assert_allclose(forces.wrench[:, k, :3], platform["force"].T, atol=1e-3, rtol=1e-6)
        centre, metres = platform["corners"].mean(axis=1) / 1000.0, 1e-3
        if platform["unit_moment"] != "Nmm":
            centre, metres = platform["corners"].mean(axis=1), 1.0
        about_origin = platform["moment"].T * metres + np.cross(centre, platform["force"].T)
        assert_allclose(forces.wrench[:, k, 3:], about_origin, atol=2e-3, rtol=1e-5)


def test_two_encodings_of_one_trial_are_equal() -> None:
    """Eb015pi (Intel) and Eb015vi (DEC) hold the same trial."""
    pair = [read_trial("a", DATA / "btk_c3d/c3d.org/sample01" / name) for name in ("Eb015pi.c3d", "Eb015vi.c3d")]
    torch.testing.assert_close(pair[0].markers.position, pair[1].markers.position, equal_nan=True)
    assert pair[0].forces is not None and pair[1].forces is not None
    torch.testing.assert_close(pair[0].forces.wrench, pair[1].forces.wrench, rtol=1e-6, atol=1e-6)


def test_diagonal_and_full_calibration_agree() -> None:
    """TYPE-2 and TYPE-4 hold one trial with diagonal and full calibration: to 3 % of the peak and 5 % of the plate."""
    pair = [read_trial("a", DATA / "btk_c3d/c3d.org/sample10" / name).forces for name in ("TYPE-2.C3D", "TYPE-4.C3D")]
    assert pair[0] is not None and pair[1] is not None
    peak = float(pair[0].wrench[..., 2].max())
    assert_allclose(pair[0].wrench[..., :3], pair[1].wrench[..., :3], atol=0.03 * peak)
    centres = [pair[0].centre_of_pressure(200.0), pair[1].centre_of_pressure(200.0)]
    both = (centres[0] + centres[1]).isfinite().all(dim=-1)
    assert both.sum() > 100
    assert_allclose(centres[0][both], centres[1][both], atol=0.05 * 0.508)


@pytest.mark.parametrize(
    ("file", "weight"),
    [
        ("biomechzoo_pig/HC030A01.c3d", 45.84),
        ("biomechzoo_pig/HC040A04.c3d", 27.21),
        ("btk_c3d/PiG/PiG_Calibration-FlatFoot-Full.c3d", 46.29),
        ("btk_c3d/others/FunctionalStatic.c3d", 59.63),
        ("welk007_functional/c3d_Trimmed_static1.c3d", 57.13),
        ("welk007_functional/c3d_Trimmed_RHJC1.c3d", 56.25),
    ],
)
def test_standing_weights_of_the_manifest(file: str, weight: float) -> None:
    """Static trials stand on the plates with the manifest's weight (within 0.1 %, it divides by 9.81)."""
    found = check_trial(read_trial("static", DATA / file, role="static")).weight
    assert found is not None
    assert_allclose(found * 9.80665 / 9.81, weight, rtol=1e-3)


def test_opencap_weights_of_the_manifest() -> None:
    """The same person weighs 60.03 to 60.12 kg on one pair of plates and 63.2 to 63.9 kg on another."""
    for name in ("static1", "squats1"):
        weight = check_trial(opencap(name, "static")).weight
        assert weight is not None and 60.0 < weight * 9.80665 / 9.81 < 60.15
    for name in ("walking1", "walking2", "walking4", "walkingTS1"):
        weight = check_trial(opencap(name)).weight
        assert weight is not None and 63.1 < weight < 64.0, name


def test_plug_in_gait_outputs_stay_out() -> None:
    """The children's walks have 59 markers among some 290 points; subject and mass are stated."""
    for name in ("HC030A05", "HC040A14", "HC040A40"):
        trial = read_trial("walk", DATA / "biomechzoo_pig" / f"{name}.c3d")
        assert len(trial.markers.labels) == 59
        assert {"LASI", "RANK", "LTIB", "RTOE", "C7"} <= set(trial.markers.labels)
        assert trial.parameters["subject"] == name[:6]


def test_computed_hip_centres_of_a_trc_stay_out() -> None:
    """OpenCap's regression hip centres are no markers; Y up is found by the ground reaction."""
    trial = opencap("walking1")
    assert len(trial.markers.labels) == 47 and not [label for label in trial.markers.labels if "HJC" in label]
    assert trial.parameters["up"] == "y"
    assert 1.2 < float(trial.markers.select(("C7",)).position[..., 2].nanmean()) < 1.6


def test_padded_header_and_rounded_times() -> None:
    """Rajagopal's double tabs read as mm, gait2354's rounded column as 60 and 600 Hz."""
    folder = DATA / "opensim_rajagopal_walk"
    assert read_trial("walk", folder / "markers_walk.trc", folder / "grf_walk.mot").parameters["units"] == "mm"
    folder = DATA / "opensim_subject01_gait2354"
    trial = read_trial("walk", folder / "subject01_walk1.trc", folder / "subject01_walk1_grf.mot")
    assert trial.forces is not None
    assert_allclose([trial.markers.rate, trial.forces.rate], [60.0, 600.0])


def test_feet_are_above_their_centres_of_pressure() -> None:
    """In walking the centre of pressure lies within 15 cm of a foot marker's ground point: axes and signs fit."""
    trial = opencap("walking1")
    assert trial.forces is not None
    centre = trial.forces.centre_of_pressure(400.0)[:, :, :2]
    feet = trial.markers.select(("L_calc", "L_toe", "L_5meta", "r_calc", "r_toe", "r_5meta")).position[..., :2]
    distance = (centre[:, :, None] - feet[:, None]).norm(dim=-1).nan_to_num(9.0).amin(dim=-1)
    loaded = centre.isfinite().all(dim=-1)
    assert loaded.sum() > 50
    assert float(distance[loaded].max()) < 0.15
