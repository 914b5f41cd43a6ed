"""Every way into a session refuses the same recordings: a fault of one trial is said alike behind every door."""

import functools
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from planted_faults.planted_plates import Fault, c3d_faults

from torchid.checks.plates_against_feet.changes import Change
from torchid.checks.plates_against_feet.finding import ForceFinding
from torchid.checks.plates_against_feet.judge import judge
from torchid.checks.plates_against_feet.left_out import Reread
from torchid.config import Config, load_config, load_evaluation
from torchid.config.study import Study
from torchid.errors import TorchidError
from torchid.evaluation.evaluate import evaluate
from torchid.evaluation.study.study import subjects_of
from torchid.io import read_trial
from torchid.live.run import run_live
from torchid.model.whole_body import whole_body
from torchid.recording import Trial
from torchid.run import run_experiment
from torchid.session.checking import check_session
from torchid.simulate.options import SimulateOptions
from torchid.simulate.session import simulate_session
from torchid.storage.snapshot import DIGEST, to_bytes

BODY, REFERENCE, WORN = "walk_1", "without_walk", "with_walk"
"""A fit trial of the body, one of the reference condition, and one with a device on."""
LOADED = [0, 1]
"""Plates that every walk of the simulation loads."""


class Read(BaseException):  # noqa: N818 - no failure: a door that let its recordings in
    """Everything was read and nothing refused."""


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Config of a simulated session: a walk of the body, one of a reference and one with a device on."""
    folder = tmp_path_factory.mktemp("doors")
    options = SimulateOptions(fit=("walk", "walk", "walk"), heldout=(), duration_s=3.0, plates=2, rate_hz=60.0)
    made = simulate_session(options, 11, folder).config
    assert made is not None
    config = yaml.safe_load(made.read_text())
    for entry, name in zip(
        [t for t in config["trials"] if t.get("role") != "static"], (BODY, REFERENCE, WORN), strict=True
    ):
        entry |= {"name": name}
        entry |= {} if name == BODY else {"condition": name.split("_")[0]}
    config |= {
        "conditions": {"without": {"reference": True}, "with": {"device": "device.yaml"}},
        "diagnosis": {"enabled": False}, "out": "out",
    }  # fmt: skip
    part = {"segment": "thorax", "mass_kg": 2.0, "com_m": [0.0, 0.0, 0.1], "inertia_kgm2": (0.01 * np.eye(3)).tolist()}
    (folder / "device.yaml").write_text(yaml.safe_dump({"name": "pack", "parts": [part]}))
    (folder / "session.yaml").write_text(yaml.safe_dump(config))
    return folder / "session.yaml"


@pytest.fixture(scope="module", autouse=True)
def _each_thing_once(session: Path) -> Iterator[None]:
    """Files are read, bodies made and forces judged once for all doors, however often they are asked for.

    A judgement is known again by all that it looks at, so that a door that hands over something else is told anew.
    """
    known: dict[object, Any] = {}

    def once(key: object, make: Callable[[], Any]) -> Any:
        if key not in known:
            known[key] = make()
        return known[key]

    def read(*given: object) -> Trial:
        return once(repr(given), lambda: read_trial(*given))

    def judged(trial: Trial, mass_kg: float | None, reread: Reread) -> tuple[ForceFinding, ...]:
        seen = to_bytes((trial, reread(Change("nothing is said of them"))))[:DIGEST]
        return once((seen, mass_kg), lambda: judge(trial, mass_kg, reread))

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("torchid.checks.report.read_trial", read)
        patch.setattr("torchid.checks.plates_against_feet.session.judge", judged)
        patch.setattr("torchid.session.opening.whole_body", functools.cache(whole_body))
        yield


@pytest.fixture(autouse=True)
def _no_fits(monkeypatch: pytest.MonkeyPatch) -> None:
    """Doors end where recordings have been read."""

    def read(*_: object, **__: object) -> None:
        raise Read

    monkeypatch.setattr("torchid.run.sequence.compute_outcome", read)
    monkeypatch.setattr("torchid.live.run.prepare_subject", read)


class Told(Exception):  # noqa: N818 - what a study or a check says of recordings, and goes on
    """A refusal that is told and not raised."""


def _study(config: Config, path: Path) -> None:
    sets = [[f"subject.name={name}", f"out=out_{name}"] for name in ("one", "two")]
    study = path.with_name("study.yaml")
    members = [{"config": str(path), "set": own} for own in sets]
    study.write_text(yaml.safe_dump({"name": "two", "subjects": members}))
    loaded = load_evaluation(study)
    assert isinstance(loaded, Study)
    _, left_out = subjects_of(loaded, lambda stage, share: None)
    raise Told("; ".join(gap.why for gap in left_out))


def _check(config: Config, path: Path) -> None:
    found = list(check_session(config))
    said = [str(note) for one in found for note in getattr(one, "problems", ()) if note.code == "forces.feet"]
    refused = [one.text for one in found if hasattr(one, "text")]
    if said or refused:
        raise Told("; ".join((*said, *refused)))
    raise Read


DOORS: dict[str, tuple[str, tuple[str, ...], Callable[[Config, Path], object]]] = {
    "run": (BODY, (BODY,), lambda config, path: run_experiment(config)),
    "evaluate, reference": (REFERENCE, (REFERENCE, WORN), lambda config, path: evaluate(config)),
    "evaluate, condition": (WORN, (REFERENCE, WORN), lambda config, path: evaluate(config)),
    "study": (WORN, (REFERENCE, WORN), _study),
    "live replay": (WORN, (WORN,), lambda config, path: run_live(config, f"replay:{WORN}")),
    "check": (WORN, (WORN,), _check),
}
"""The trial in which a fault is planted, those that stand in the config beside standing, and what is called."""
MAY_GO_UNSAID = ("channels exchanged", "origin's sign", "origin's z missing", "plate late", "all late")
"""Faults whose size or channels are drawn, or that move a pressure by less than feet tell: sizes in docs/reading.md."""
OF_ITS_OWN = ("run", "evaluate, reference", "evaluate, condition")
"""Doors that have a trial of their own to mend."""


def _said(door: str, fault: Fault | None, session: Path, folder: Path, lines: str = "") -> str:
    """What a door says of a fault in its trial; empty where it lets it in."""
    trial, listed, call = DOORS[door]
    config = yaml.safe_load(session.read_text())
    config["trials"] = [t for t in config["trials"] if t.get("role") == "static" or t["name"] in listed]
    if REFERENCE not in listed:
        del config["conditions"]
    for entry in config["trials"]:
        if REFERENCE not in listed:
            entry.pop("condition", None)
        entry["file"] = str(session.parent / entry["file"])
        if entry["name"] == trial:
            entry |= yaml.safe_load(f"{{{lines}}}")
            if fault is not None:
                fault.plant(Path(entry["file"]), folder / "faulty.c3d", np.random.default_rng(3))
                entry["file"] = str(folder / "faulty.c3d")
    (folder / "device.yaml").write_text((session.parent / "device.yaml").read_text())
    path = folder / "session.yaml"
    path.write_text(yaml.safe_dump(config))
    try:
        call(load_config(path), path)
    except Read:
        return ""
    except (TorchidError, Told) as error:
        return str(error)
    raise AssertionError("the door neither refused nor read")


def _line(said: str) -> str:
    """The config line that mends what was said; empty where nothing does."""
    return said.split("`")[1] if "They agree" in said else ""


def test_nothing_is_refused_that_is_right(session, tmp_path):
    """Every door lets the recordings in as they were made."""
    for door in DOORS:
        assert _said(door, None, session, tmp_path) == "", door


@pytest.mark.slow
@pytest.mark.parametrize("fault", c3d_faults(LOADED, 70.0, []), ids=lambda fault: fault.name)
def test_a_fault_of_a_plate_is_said_alike_behind_every_door(session, tmp_path, fault):
    """A fault that one door refuses is refused by all, and the line that each advises opens it."""
    said = {door: _said(door, fault, session, tmp_path) for door in DOORS}
    refused = {door for door, text in said.items() if "forces.feet" in text}
    assert refused == set(DOORS) or (not refused and fault.name in MAY_GO_UNSAID), said
    lines = {door: _line(text) for door, text in said.items()}
    assert len({lines[door] for door in DOORS if DOORS[door][0] == WORN}) == 1, lines
    for door in filter(lines.get, OF_ITS_OWN):
        assert _said(door, fault, session, tmp_path, lines[door]) == "", (door, lines[door])
