"""Tests of torchid.io.c3d_write: what is written reads back by us and by ezc3d."""

import resource
from dataclasses import replace
from pathlib import Path

import ezc3d
import numpy as np
import pytest
import torch
from numpy.testing import assert_allclose, assert_array_equal

from torchid.errors import InputError
from torchid.io.c3d import read_c3d
from torchid.io.c3d_write import write_c3d
from torchid.recording import Event, Forces, Markers, Plate, Trial

FRAMES, RATIO = 40, 10


def example(rate: float = 100.0, first: int = 120, seed: int = 0) -> Trial:
    """A trial with gaps, two plates (one with corners in the wrong sense), an event and a subject."""
    random = torch.Generator().manual_seed(seed)
    time = (first + torch.arange(FRAMES, dtype=torch.float64)) / rate
    position = 0.5 * torch.randn(FRAMES, 7, 3, generator=random, dtype=torch.float64) + torch.tensor([0.0, 0.0, 1.0])
    position[3:8, 2] = torch.nan
    corners = torch.tensor([[1.0, 1.0, 0], [0.4, 1.0, 0], [0.4, 0.5, 0], [1.0, 0.5, 0]], dtype=torch.float64)
    plates = (Plate("plate 1", corners), Plate("plate 2", corners[[0, 3, 2, 1]] + torch.tensor([0.7, 0.0, 0.0])))
    wrench = 20.0 * torch.randn(FRAMES * RATIO, 2, 6, generator=random, dtype=torch.float64)
    wrench[..., 2] += 400.0
    forces = Forces(time[0] + torch.arange(FRAMES * RATIO, dtype=torch.float64) / rate / RATIO, wrench, plates)
    markers = Markers(tuple("ABCDEFG"), time, position)
    event = Event("Foot Strike", "Left", float(time[10]))
    return Trial("t", markers, forces, "fit", (event,), (), {"subject": "S 1", "mass_kg": "70.5", "height_m": "1.8"})


@pytest.mark.parametrize("rate", [100.0, 59.94, 250.0])
def test_round_trip(tmp_path: Path, rate: float) -> None:
    """Markers to 1e-6 m, wrenches to 1e-3, time, gaps, events, subject: all come back."""
    trial = example(rate)
    write_c3d(tmp_path / "a.c3d", trial)
    back = read_c3d(tmp_path / "a.c3d")
    assert back.forces is not None and trial.forces is not None
    torch.testing.assert_close(back.markers.position, trial.markers.position, atol=1e-6, rtol=0, equal_nan=True)
    assert_allclose(back.markers.time, trial.markers.time, atol=1e-6)
    assert_allclose(back.forces.time, trial.forces.time, atol=1e-6)
    assert_allclose(back.forces.wrench, trial.forces.wrench, atol=1e-3, rtol=0)
    assert back.markers.labels == trial.markers.labels
    assert [(e.label, e.side) for e in back.events] == [("Foot Strike", "Left")]
    assert_allclose(back.events[0].time, trial.events[0].time, atol=1e-5)
    assert {key: back.parameters[key] for key in trial.parameters} == trial.parameters
    assert [path.name for path in tmp_path.iterdir()] == ["a.c3d"]


def test_ezc3d_reads_the_same(tmp_path: Path) -> None:
    """The second reader finds the markers, the gaps and the forces of both plates."""
    trial = example()
    write_c3d(tmp_path / "a.c3d", trial)
    other = ezc3d.c3d(str(tmp_path / "a.c3d"), extract_forceplat_data=True)
    points = other["data"]["points"][:3].transpose(2, 1, 0) / 1000.0
    position = trial.markers.position.numpy()
    seen = ~np.isnan(position).any(axis=-1)
    assert_allclose(points[seen], position[seen], atol=1e-6)
    assert_array_equal(other["data"]["meta_points"]["residuals"][0].T < 0, ~seen)
    assert trial.forces is not None
    for k in range(2):
        platform = other["data"]["platform"][k]
        assert_allclose(platform["force"].T, trial.forces.wrench[:, k, :3], atol=1e-3)


def test_markers_alone(tmp_path: Path) -> None:
    """A trial without forces is written and read without them."""
    trial = replace(example(), forces=None)
    write_c3d(tmp_path / "a.c3d", trial)
    assert read_c3d(tmp_path / "a.c3d").forces is None


def test_trials_that_do_not_fit_are_refused(tmp_path: Path) -> None:
    """Too few samples, another start, NaN, plates without corners and half frames are refused; nothing is left."""
    trial = example()
    forces = trial.forces
    assert forces is not None
    late = replace(trial.markers, time=trial.markers.time + 0.004)
    bad = [
        ("write.forces", "trial t", {"forces": replace(forces, time=forces.time[:-9], wrench=forces.wrench[:-9])}),
        ("write.forces", "trial t", {"forces": replace(forces, time=forces.time + 0.05)}),
        ("write.forces", "trial t", {"forces": replace(forces, wrench=forces.wrench * torch.nan)}),
        ("write.corners", "b", {"forces": replace(forces, plates=(forces.plates[0], Plate("b")))}),
        ("write.time", "", {"markers": late}),
    ]
    for code, place, change in bad:
        with pytest.raises(InputError) as caught:
            write_c3d(tmp_path / "a.c3d", replace(trial, **change))
        assert (caught.value.code, caught.value.place) == (code, place) and caught.value.remedy
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("room", [0, 1, 512, 2500, -1500, -1])
def test_a_file_that_finds_no_room_is_an_error(tmp_path: Path, room: int) -> None:
    """Where the system takes fewer bytes than the file has, which ezc3d does not tell, the path is named."""
    write_c3d(tmp_path / "whole.c3d", example())
    data = 4 * (4 * 7 * FRAMES + 2 * 6 * FRAMES * RATIO)  # what follows is padding to a whole block
    whole = (tmp_path / "whole.c3d").read_bytes()
    needed = 512 * (int.from_bytes(whole[16:18], "little") - 1) + data
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    try:
        resource.setrlimit(resource.RLIMIT_FSIZE, (room % needed, hard))
        with pytest.raises(InputError, match=r"a\.c3d: cannot be written"):
            write_c3d(tmp_path / "a.c3d", example())
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert [path.name for path in tmp_path.iterdir()] == ["whole.c3d"]
