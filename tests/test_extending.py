"""What `docs/extending.md` says can be done can be done, with the files and lines that it shows and no others."""

import ast
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from effect_contract import check_class, check_words
from marker_problems import random_problem
from torch.testing import assert_close

import torchid.effects
from torchid.effects.catalogue import CATALOGUE, ENTRIES, effect, make_effect
from torchid.effects.columns import columns
from torchid.effects.effect import Effect
from torchid.effects.marker_scene import View
from torchid.effects.place import Place
from torchid.effects.recommendations import tell_apart
from torchid.effects.scene import Reading, make_scene
from torchid.model.marker_set import load_marker_set
from torchid.simulate.options import PlantedOptions, SimulateOptions
from torchid.simulate.planting import numbered_frames, planted
from torchid.simulate.subject import simulate_subject
from torchid.simulate.trial import simulate_trial

PAGE = (Path(__file__).resolve().parents[1] / "docs" / "extending.md").read_text(encoding="utf-8")
CLEAN = SimulateOptions(duration_s=2.0, marker_noise_mm=0.0, force_noise_n=0.0)


def blocks(section: str) -> dict[str, str]:
    """The titled blocks of code of a section, by title."""
    text = re.split(r"^## ", PAGE, flags=re.MULTILINE)
    (own,) = (part for part in text if part.startswith(section))
    return dict(re.findall(r'```\w+ title="([^"]+)"\n(.*?)```', own, re.DOTALL))


@pytest.fixture
def added(tmp_path, monkeypatch) -> Effect:
    """The page's effect: its file beside the others, its line in the catalogue."""
    (file, code), (_, line) = blocks("A new effect").items()
    (tmp_path / Path(file).name).write_text(code, encoding="utf-8")
    monkeypatch.setattr(torchid.effects, "__path__", [*torchid.effects.__path__, str(tmp_path)])
    made = make_effect(ast.literal_eval(line.strip().rstrip(",")))
    monkeypatch.setitem(CATALOGUE, made.name, made)
    return effect(made.name)


def test_an_effect_is_one_file_and_one_line():
    """The page shows a new file of the effects, and one line of the catalogue that looks like its others."""
    (file, _), (catalogue, line) = blocks("A new effect").items()
    package = Path(torchid.effects.__file__).parent
    assert file.startswith("torchid/effects/") and not (package / Path(file).name).exists()
    assert catalogue == "torchid/effects/catalogue.py" and len(line.splitlines()) == 1
    said = (package / "catalogue.py").read_text(encoding="utf-8")
    assert line.strip().rstrip(",") not in said and f'    "{ENTRIES[0]}",\n' in said


def test_the_new_effect_keeps_the_contract(added):
    """It is of one kind, final, sourced and told in plain words, and comes back from its reported parameters."""
    check_class(type(added))
    place = Place(("plate_1",))
    check_words(added, place)
    assert tell_apart(added.name, "plate_gain") == tell_apart("plate_gain", added.name) == added.apart["plate_gain"]
    assert added.called(("plate_1",)) == "a vertical channel that saturates of plate 1"


def test_the_simulator_plants_the_new_effect_and_its_columns_predict_it(added):
    """What hidden saturation changes in the plates is its columns times its size."""
    subject = simulate_subject(CLEAN, 5)
    hidden = planted(PlantedOptions(added.name, ("plate_1",), None, {"loss_per_kN": 0.03}))
    plain, changed = (simulate_trial(replace(subject, hidden=own), "squats", CLEAN, 5) for own in ((), (hidden,)))
    ratio = len(plain.trial.forces.time) // len(plain.trial.markers.time)
    scene = make_scene("squats", subject.model.tree, subject.geometry, plain.truth.motion, subject.phi)
    bore, read = (one.trial.forces.wrench[::ratio] for one in (plain, changed))
    reading = Reading("squats", scene.time, bore, numbered_frames(plain.trial.forces.plates))
    (first, *_) = added.places((View(scene, reading, reading),))
    assert first.where == ("plate_1",)
    guess = torch.einsum("ipt,p->it", columns(added, scene, reading, hidden.place), hidden.theta)
    exact = (read - bore).sum(1).T
    assert float(exact.abs().max()) > 1.0
    assert_close(guess, exact, rtol=1e-6, atol=1e-6)


def test_the_new_marker_set_is_read(tmp_path):
    """With what it extends."""
    ((name, text),) = blocks("A new marker set").items()
    (tmp_path / name).write_text(text, encoding="utf-8")
    found = load_marker_set(tmp_path / name)
    assert found.match(["Back Left"]).assigned["Back Left"].segment == "thorax"
    assert found.match(["knee_study"]).computed == ("knee_study",)
    assert len(found.specs) > len(load_marker_set("opencap").specs)


def test_the_new_solver_lowers_the_cost(seed):
    """From about the true postures, towards the minimum."""
    ((_, code),) = blocks("A new geometry solver").items()
    space: dict = {}
    exec(compile(code, "extending.md", "exec"), space)  # the page's own code, not a user's
    problem, q, xi = random_problem(np.random.default_rng(seed))
    found = space["solve_descent"](problem, q, xi, 30)
    assert len(found.trace) == found.iterations == 30
    assert found.cost < found.trace[0] and list(found.trace) == sorted(found.trace, reverse=True)
