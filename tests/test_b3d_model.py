"""The OpenSim model inside a .b3d is the model that the same text is as an .osim file."""

from pathlib import Path

import numpy as np
import pytest
import torch
from b3d_bytes import write_b3d
from osim_files import MARKER, NAMES, joint, osim
from test_io_b3d import stored
from torch.testing import assert_close
from walker import walking_trial

from torchid.config import load_config
from torchid.errors import InputError
from torchid.folder.config_text import config_text
from torchid.folder.proposal import propose
from torchid.io.resample import synchronise
from torchid.model.files import load_model
from torchid.model.opensim.reading import read_osim
from torchid.model.opensim.writing_back import write_back
from torchid.run.sequence import inputs, run_key
from torchid.session.opening import setup_of
from torchid.simulate.options import SimulateOptions
from torchid.simulate.session import simulate_session

KINEMATICS, DYNAMICS, FILTER = range(3)
"""Types of passes, as the published schema numbers them."""
SIX = [f"q{k}" for k in range(6)]
MARKERS = MARKER.format("M1", "/bodyset/a") + MARKER.format("M2", "/bodyset/b")
TEXT = osim(
    joint("FreeJoint", *SIX),
    joint("PinJoint", "q6", parent="/bodyset/a", child="/bodyset/b"),
    bodies="ab",
    rest=f'<MarkerSet name="m"><objects>{MARKERS}</objects></MarkerSet>',
)
"""Two bodies with a marker each."""
HEAVIER = TEXT.replace("<mass>2</mass>", "<mass>3.25</mass>", 1)


def save(path: Path, *models: tuple[int, str], seed: int = 1) -> Path:
    """A .b3d of a walk with the models of its passes."""
    walk = walking_trial(seed, corners=False)
    return write_b3d(path, walk.markers.labels, [stored(walk)], walk.markers.rate, models=models)


def config(folder: Path, model: str) -> Path:
    """A config of a walk with a model."""
    trial = "{name: walk, file: S1.b3d/walk, role: fit}"
    text = f"subject: {{name: S1}}\nmodel: {model}\nmarkers: model\ntrials: [{trial}]\n"
    (folder / "c.yaml").write_text(text)
    return folder / "c.yaml"


def assert_same(one: Path, other: Path) -> None:
    """The models of two files are the same to the last bit, and so is what was said of them."""
    (found, said), (wanted, known) = load_model(one), load_model(other)
    assert found.tree == wanted.tree and found.landmarks == wanted.landmarks and found.height == wanted.height
    for a, b in ((found.inertia, wanted.inertia), (found.geometry, wanted.geometry)):
        assert_close(a.mean, b.mean, rtol=0, atol=0)
    assert_close(found.inertia.covariance, wanted.inertia.covariance, rtol=0, atol=0)
    assert [note.code for note in said] == [note.code for note in known]


@pytest.mark.parametrize(
    "models",
    [
        ((KINEMATICS, HEAVIER),),
        ((KINEMATICS, TEXT), (DYNAMICS, HEAVIER)),
        ((KINEMATICS, TEXT), (DYNAMICS, HEAVIER), (FILTER, TEXT)),
        ((KINEMATICS, HEAVIER), (DYNAMICS, " ")),
    ],
)
def test_the_last_pass_that_fitted_a_model_has_it(tmp_path: Path, models: tuple[tuple[int, str], ...]) -> None:
    """A filter leaves the model as it was, and a pass may hold none."""
    assert HEAVIER != TEXT
    (tmp_path / "a.osim").write_text(HEAVIER)
    assert_same(save(tmp_path / "S1.b3d", *models), tmp_path / "a.osim")


@pytest.mark.data
@pytest.mark.parametrize("name", NAMES)
def test_models_of_laboratories_are_the_same_inside(name: str, data_dir: Path, tmp_path: Path) -> None:
    """Of all shared OpenSim files."""
    if not (data_dir / name).exists():
        pytest.skip(f"no {data_dir / name}")
    text = (data_dir / name).read_bytes().decode()
    assert_same(save(tmp_path / "S1.b3d", (DYNAMICS, text)), data_dir / name)


def test_what_is_identified_is_written_as_an_osim_file(tmp_path: Path) -> None:
    """The model's own text with other numbers, and nothing of the .b3d about it."""
    model, _ = read_osim(save(tmp_path / "S1.b3d", (DYNAMICS, TEXT)))
    write_back(model, tmp_path / "model.osim")
    assert (tmp_path / "model.osim").read_text() == TEXT


@pytest.mark.parametrize(
    ("models", "code", "found"),
    [
        ((), "b3d.model", "passes: none"),
        (((FILTER, TEXT), (7, TEXT)), "b3d.model", "passes: low-pass filter and type 7"),
        (((KINEMATICS, ""), (DYNAMICS, "\n")), "b3d.model", "passes: kinematics and dynamics"),
        (((DYNAMICS, TEXT[:200]),), "xml.syntax", ""),
        (((DYNAMICS, "<OpenSimDocument/>"),), "osim.version", ""),
    ],
)
def test_a_model_that_is_not_there_is_refused(
    tmp_path: Path, models: tuple[tuple[int, str], ...], code: str, found: str
) -> None:
    """With the file's name and what is in place of it."""
    path = save(tmp_path / "S1.b3d", *models)
    with pytest.raises(InputError, match=r"S1\.b3d") as refused:
        load_model(path)
    assert refused.value.code == code and found in refused.value.found


def test_a_run_reads_it_and_depends_on_it(tmp_path: Path) -> None:
    """As the config names it, never by itself; another model in the file makes another run."""
    path = save(tmp_path / "S1.b3d", (DYNAMICS, TEXT))
    chosen = load_config(config(tmp_path, "S1.b3d"))
    assert path in inputs(chosen)
    setup = setup_of(chosen)
    assert {spec.landmark for spec in setup.markers.specs.values()} == {"M1", "M2"}
    assert float(setup.model.inertia.mean[0, 0]) == 2.0
    before = run_key(chosen)
    save(path, (DYNAMICS, HEAVIER))
    assert run_key(chosen) != before and torch.any(setup_of(chosen).model.inertia.mean[:, 0] == 3.25)
    assert setup_of(load_config(config(tmp_path, "whole_body"), ["markers=plug_in_gait"])).model.osim is None


@pytest.mark.parametrize("text", [TEXT, ""])
def test_a_proposal_mentions_it_and_does_not_take_it(tmp_path: Path, text: str, seed: int) -> None:
    """In a comment, where the file holds one; what the comment says is what a config takes."""
    person = simulate_session(SimulateOptions(fit=("squats",), heldout=(), duration_s=2.0), seed)
    markers = person.trial("squats").trial.markers
    trials = [stored(synchronise(item.trial), item.trial.name) for item in person.trials]
    path = write_b3d(tmp_path / "S1.b3d", markers.labels, trials, markers.rate, 4, ((DYNAMICS, text),))
    (tmp_path / "new.yaml").write_text(config_text(propose(path), tmp_path))
    made = (tmp_path / "new.yaml").read_text()
    assert ("model: S1.b3d" in made) == bool(text)
    assert load_config(tmp_path / "new.yaml").model == "whole_body"
    if text:
        taken = load_config(tmp_path / "new.yaml", ["model=S1.b3d", "markers=model"])
        assert np.isfinite(setup_of(taken).model.inertia.mean.numpy()).all()
