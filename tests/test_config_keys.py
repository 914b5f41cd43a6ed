"""Every key of a config: documented with unit and default, accepted with another value, and read by the library."""

import ast
import json
import sys
import types
from pathlib import Path
from typing import Annotated, Any, Literal, Union, get_args, get_origin

import pytest

from torchid.config import Config, Study, load_config, load_evaluation

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "scripts"))

from documentation.config_keys import PART, Key, in_words, is_section, keys, rows, sections

PROJECT = Path(__file__).resolve().parents[1]
SECTIONS = [section for root in (Config, Study) for section in sections(root)]
PLACED = [(section, key) for section in SECTIONS for key in keys(section)]
VALUES = [
    (section, key) for section, key in PLACED if "section" not in in_words(key.hint, dict.fromkeys(SECTIONS, "x"))
]
"""Keys that hold no section: the keys of sections are keys of their own."""
FILES = {"file": "a.c3d", "forces": "a.mot", "channels": "a.csv", "model": "a.urdf", "markers": "a.yaml"}
GIVEN: dict[tuple[str, str], Any] = {
    ("MotionOptions", "cutoff_hz"): 6.0,
    ("SimulateOptions", "plates"): 2,
    ("GivenCycle", "t1"): 2.0,
    ("Interval", "t1"): 2.0,
    ("NearPlace", "at_m"): [0.1, 0.2, 0.3],
    ("TrialFile", "condition"): "bare",
    ("Interval", "t0"): 0.1,
    ("Inertia", "prior_weight_range"): [2.0, 5.0],
    ("SimulateOptions", "fit"): ["squats"],
    ("EvaluateOptions", "draws"): 32,
    ("EvaluateOptions", "measures"): ["range_deg"],
    ("OtherContact", "when"): "always",
    ("PlateAs", "corners"): [2, 1, 4, 3],
    ("GivenCycle", "t0"): 0.1,
    ("Member", "config"): "a.yaml",
}  # fmt: skip
"""Values of keys that their type alone does not tell."""
HOLDERS: dict[str, dict[str, Any]] = {
    "TrialFile": {"name": "a", "file": "a.c3d"},
    "OtherContact": {"segment": "thorax", "plate": 1},
    "NearPlace": {"at_m": [0.0, 0.0, 1.0]},
    "GivenCycle": {"trial": "a", "t0": 0.0, "t1": 1.0},
    "PlantedOptions": {"effect": "drag"},
    "Interval": {"trial": "a", "t0": 0.0, "t1": 1.0},
    "EventCycles": {"event": "Toe Off"},
    "CoordinateCycles": {"coordinate": "pelvis_z"},
}
"""What a section must hold beside the key that is set."""


def test_the_page_lists_the_keys_as_they_are():
    """docs/config.md is what the models say; ``python -m documentation.config_keys`` writes it."""
    assert PART.read() == "\n".join(rows()).rstrip()


@pytest.mark.parametrize("section", SECTIONS, ids=lambda section: section.__name__)
def test_every_key_says_what_it_means(section):
    """A key without a docstring would have a row without a meaning."""
    assert not [key.name for key in keys(section) if not key.meaning]


def other(hint: Any, default: Any) -> Any:
    """A legal value that is not the default, by type and bounds."""
    origin, parts = get_origin(hint), get_args(hint)
    if origin is Annotated:
        return other(parts[0], default)
    if origin is Literal:
        return next(part for part in parts if part != default)
    if origin in (Union, types.UnionType):
        kinds = [part for part in parts if part is not type(None) and not is_section(part)]
        return other(kinds[0], default)
    if origin is tuple:
        count = 1 if parts[-1] is Ellipsis else len(parts)
        return [other(parts[0], one) for one in (default or [None])[:count]] * (1 if default else count)
    if origin is dict:
        return {"1": other(parts[1], None)}
    if hint is bool:
        return not default
    if hint is int:
        return default + 1 if default else 1
    if hint is float:
        return 0.9 * default if default else 0.5
    return "a" if hint in (str, Path) else {}


def value_of(section: type, key: Key) -> Any:
    """A legal value of a key that is not its default."""
    if (section.__name__, key.name) in GIVEN:
        return GIVEN[section.__name__, key.name]
    if key.name in FILES and section.__name__ in ("Config", "TrialFile"):
        return FILES[key.name]
    return other(key.hint, key.default)


def around(section: type, key: Key) -> dict[str, Any]:
    """A config into which a section can be put."""
    if section in sections(Study):
        own_folder = (section.__name__, key.name) == ("Member", "out")
        return {"name": "study", "subjects": [{} if own_folder else {"config": "a.yaml"}, {"out": "b"}]}
    if (section.__name__, key.name) == ("Condition", "reference"):
        conditions: dict[str, Any] = {}  # the only one may be the reference
    else:
        conditions = {"bare": {"reference": True}}
    names = ["1", *conditions] if section.__name__ == "Condition" else list(conditions)
    trials = [{"name": f"trial {name}", "file": "a.c3d", "condition": name} for name in names]
    body = {"subject": {"name": "A", "mass_kg": 70.0}, "markers": "plug_in_gait"}
    return {**body, "trials": trials, "conditions": conditions}


def document(section: type, key: Key, value: Any) -> tuple[dict[str, Any], list[str]]:
    """A config in which a key of a section has a value, and the way to it."""
    root = Study if section in sections(Study) else Config
    place = sections(root)[section][0].replace("[]", ".0").replace("NAME", "1").replace("ID", "1")
    steps = place.split(".") if place else []
    found = around(section, key)
    holder: Any = found
    for step, following in zip(steps, [*steps[1:], ""], strict=False):
        if isinstance(holder, dict):
            holder.setdefault(step, [{}] if following == "0" else {})
        holder = holder[int(step) if isinstance(holder, list) else step]
    complete(found)
    holder.update({**HOLDERS.get(section.__name__, {}), key.name: value})
    return found, [*steps, key.name]


def complete(found: dict[str, Any]) -> None:
    """Give sections on the way what they must hold, in place."""
    for contact in found.get("contact", {}).get("others", {}).values():
        contact.update({**HOLDERS["OtherContact"], **contact})
    for planted in found.get("simulate", {}).get("effects", []):
        planted.update({**HOLDERS["PlantedOptions"], **planted})


@pytest.mark.parametrize(("section", "key"), VALUES, ids=[f"{own.__name__}.{key.name}" for own, key in VALUES])
def test_every_key_takes_another_value(section, key, tmp_path):
    """The config accepts it, and the options of the stage that it belongs to hold it."""
    for name in (*FILES.values(), "a"):
        (tmp_path / name).touch()
    value = value_of(section, key)
    assert value != key.default
    written, way = document(section, key, value)
    path = tmp_path / "config.json"
    path.write_text(json.dumps(written))
    config: Any = load_evaluation(path) if "subjects" in written else load_config(path)
    for step in way:
        config = at(config, step)
    assert plain(config) in (value, str(tmp_path / str(value)))


def at(holder: Any, step: str) -> Any:
    """One step into what a config holds."""
    if isinstance(holder, dict):
        return holder[step] if step in holder else holder[int(step)]
    return holder[int(step)] if isinstance(holder, tuple) else getattr(holder, step)


def plain(value: Any) -> Any:
    """As JSON has it."""
    if isinstance(value, dict):
        return {str(name): plain(one) for name, one in value.items()}
    return (
        [plain(one) for one in value] if isinstance(value, tuple) else str(value) if isinstance(value, Path) else value
    )


def test_every_key_is_read():
    """A key that no line of the library reads would do nothing."""
    read: set[str] = set()
    for path in (PROJECT / "torchid").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Load):
                read.add(node.attr)
    assert not [f"{section.__name__}.{key.name}" for section, key in PLACED if key.name not in read]
