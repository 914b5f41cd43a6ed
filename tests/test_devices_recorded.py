"""Channels of a device from files, on the frames of a motion."""

from pathlib import Path

import numpy as np
import pytest
import torch

from torchid.devices import on_frames, read_channels
from torchid.errors import InputError
from torchid.io.c3d_write import write_c3d
from torchid.io.storage import write_storage
from torchid.simulate.options import SimulateOptions
from torchid.simulate.subject import simulate_subject
from torchid.simulate.trial import simulate_trial

TIME = torch.arange(100, dtype=torch.float64) / 100.0


def test_a_faster_channel_is_averaged(seed: int) -> None:
    """Over each frame's time: a straight line stays, and noise falls as its samples say."""
    rng = np.random.default_rng(seed)
    fine = np.arange(-50, 1100) / 1000.0
    found = on_frames({"line": (fine, 2.0 * fine), "noise": (fine, rng.normal(size=len(fine)))}, TIME)
    torch.testing.assert_close(found["line"], 2.0 * TIME)
    assert 0.2 < float(found["noise"].std()) < 0.45


def test_beyond_the_record_there_is_nothing() -> None:
    """NaN, and no last value that goes on."""
    found = on_frames({"x": (np.array([0.2, 0.5]), np.array([1.0, 4.0]))}, TIME)["x"]
    assert bool(found[:5].isnan().all()) and bool(found[80:].isnan().all())
    torch.testing.assert_close(found[30], torch.tensor(2.0, dtype=torch.float64))


@pytest.mark.parametrize("suffix", ["csv", "sto", "mot"])
def test_columns_are_read(tmp_path: Path, suffix: str) -> None:
    """By their names, on the file's clock."""
    path, time = tmp_path / f"device.{suffix}", TIME.numpy()
    values = np.stack([np.sin(time), np.cos(time)], 1)
    if suffix == "csv":
        rows = [f"{t!r},{a!r},{b!r}" for t, (a, b) in zip(time.tolist(), values.tolist(), strict=True)]
        path.write_text("\n".join(["time,force,angle", *rows]) + "\n")
    else:
        write_storage(path, ("force", "angle"), time, values)
    found = read_channels(path, TIME)
    torch.testing.assert_close(found["angle"], TIME.cos(), atol=1e-10, rtol=0.0)
    assert set(found) == {"force", "angle"}


def test_analogs_of_a_c3d_are_read(tmp_path: Path) -> None:
    """Every channel by its label; here those of the plates, whose vertical force bears the subject."""
    options = SimulateOptions(duration_s=2.0, marker_noise_mm=0.0, force_noise_n=0.0)
    trial = simulate_trial(simulate_subject(options, 1), "static", options, 1).trial
    write_c3d(tmp_path / "static.c3d", trial)
    found = read_channels(tmp_path / "static.c3d", trial.markers.time)
    vertical = sum(values for name, values in found.items() if name.upper().startswith("FZ"))
    assert isinstance(vertical, torch.Tensor) and trial.forces is not None
    expected = trial.forces.total[:, 2].reshape(-1, 10).mean()
    torch.testing.assert_close(vertical.abs().nanmean(), expected, rtol=0.01, atol=0.0)


@pytest.mark.parametrize("name, content", [("a.csv", "time,x\n0,1\n0,2\n"), ("a.csv", "time\n"), ("a.xdf", "")])
def test_other_files_are_refused(tmp_path: Path, name: str, content: str) -> None:
    """With what would be read."""
    (tmp_path / name).write_text(content)
    with pytest.raises(InputError) as caught:
        read_channels(tmp_path / name, TIME)
    assert caught.value.code == "device.channels" and caught.value.remedy
