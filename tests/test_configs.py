"""The configs that ship: each parses, names recordings only, and writes to its own folder."""

import re
from pathlib import Path

import pytest

from torchid.config import Study, load_config, load_evaluation

STUDY = Path(__file__).resolve().parents[1] / "configs" / "evaluate_study.yaml"
CONFIGS = sorted(path for path in STUDY.parent.glob("*.yaml") if path != STUDY)
REFERENCES = ("reference", "subject01.osim", "coordinates.sto", "id.sto", "Models", "_ik.mot")
"""Parts of paths of other programs' results and of exact answers."""


@pytest.fixture
def empty_data(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Empty files in the place of all recordings that any config names."""
    for config in CONFIGS:
        for name in re.findall(r"\$\{TORCHID_DATA\}/([^\"]+)", config.read_text()):
            (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
            (tmp_path / name).touch()
    monkeypatch.setenv("TORCHID_DATA", str(tmp_path))
    return tmp_path


@pytest.mark.parametrize("config", CONFIGS, ids=lambda path: path.stem)
def test_config_parses_and_writes_to_a_folder_of_its_name(config: Path, empty_data: Path) -> None:
    """Keys and values are known, and results go to ``out/<name of the config>`` beside the project's folders."""
    loaded = load_config(config)
    assert loaded.out == config.resolve().parents[1] / "out" / config.stem
    assert loaded.subject.name == config.stem
    assert all(trial.file.is_relative_to(empty_data) for trial in loaded.trials)


def test_the_study_that_ships_lists_configs_that_parse(empty_data: Path) -> None:
    """Each subject into a folder of its own beneath the study's, with another seed."""
    study = load_evaluation(STUDY)
    assert isinstance(study, Study) and study.out == STUDY.parents[1] / "out" / STUDY.stem
    each = [load_config(one.config, one.set) for one in study.subjects if one.config is not None]
    assert len({one.seed for one in each}) == len({one.out for one in each}) == len(study.subjects) >= 6
    assert all(one.out.parent == study.out for one in each)


@pytest.mark.parametrize("config", CONFIGS, ids=lambda path: path.stem)
def test_no_config_reads_an_answer(config: Path, empty_data: Path) -> None:
    """Only markers and forces are named, never a result that another program or the truth brought along; a model of the
    laboratory's own only where the config's name says so."""
    loaded = load_config(config)
    named = [str(path) for trial in loaded.trials for path in (trial.file, trial.forces) if path is not None]
    assert not [path for path in named if any(part in path for part in REFERENCES)]
    own = Path(loaded.model).name if config.stem.endswith("_osim") else "whole_body"
    assert own not in REFERENCES and str(loaded.model).endswith(own)


@pytest.mark.data
@pytest.mark.parametrize("config", CONFIGS, ids=lambda path: path.stem)
def test_recordings_of_a_config_are_where_it_says(
    config: Path, data_dir: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With the shared recordings in place, no file that a config names is missing."""
    monkeypatch.setenv("TORCHID_DATA", str(data_dir))
    loaded = load_config(config)
    assert loaded.trials or loaded.simulate is not None
