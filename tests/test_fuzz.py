"""Some of what `scripts/fuzz` does at length: damaged files of every kind, and the rules about what nobody can see."""

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "scripts"))

from fuzzing.changes import UNDETECTABLE, changes
from fuzzing.reading import Reading, read
from fuzzing.run import failed, verdicts
from fuzzing.seeds import KINDS, seeds

ROOT = Path(__file__).resolve().parents[1]
MODELS = ("config", "urdf", "mjcf")
TEXTS = ("trc", "mot", "sto")


@pytest.mark.parametrize("kind", KINDS)
def test_damaged_files_never_crash_hang_or_raise_anything_untyped(kind: str, seed: int) -> None:
    """Sixty mutants of each kind; of models and configs no name that nobody reads goes unsaid either."""
    found = verdicts(kind, range(60), seed)
    assert len(found) == 60
    wrong = [one for one in found if one.outcome == "bad" or kind in MODELS and failed(one)]
    assert not wrong, f"scripts/fuzz --kind {kind} --seed {seed} --only {wrong[0].number}: {wrong[0]}"


@pytest.mark.parametrize("kind", ["c3d", *TEXTS])
def test_no_cut_is_silent(kind: str, seed: int) -> None:
    """Sixty files cut short are refused, said to be short, or hold all numbers still."""
    wrong = [one for one in verdicts(kind, range(60), seed, truncate=True) if one.outcome in ("bad", "silent")]
    assert not wrong, f"scripts/fuzz --kind {kind} --truncate 60 --seed {seed} --only {wrong[0].number}: {wrong[0]}"


@pytest.mark.parametrize("kind", KINDS)
def test_sound_files_are_read(kind: str, tmp_path: Path) -> None:
    """What is damaged is sound before, and differs from itself in nothing."""
    for one in seeds(kind, tmp_path):
        for name, content in one.beside.items():
            (tmp_path / name).write_bytes(content)
        path = tmp_path / f"file{one.suffix}"
        path.write_bytes(one.content)
        first, second = read(kind, path), read(kind, path)
        assert changes(kind, first, second) == (), one.name
        assert kind != "c3d" or one.name == "markers only" or "wrench" in first.values, one.name


def _reading(**changed: object) -> Reading:
    random = np.random.default_rng(0)
    values = {
        "labels": ("a", "b"), "time": np.arange(9) / 100.0, "position": random.uniform(0.0, 1.7, (9, 2, 3)),
        "events": (), "facts": (), "plates": ("p",), "force time": np.arange(9) / 100.0,
        "wrench": random.uniform(0.0, 700.0, (9, 1, 6)), "corners": (None,),
    }  # fmt: skip
    return Reading(values | changed, frozenset())


@pytest.mark.parametrize(
    ("where", "what", "expected"),
    [
        ("position", lambda x: x[3, 1] + 0.2, ("sample",)),
        ("position", lambda x: x[3, 1] + 20.0, ("!impossible sample",)),
        ("position", lambda x: x[3, 1] * np.nan, ("gap",)),
        ("position", lambda x: x[3, 1] + 1e-6, ("rounding",)),
        ("wrench", lambda x: x[3, 0] + 30.0, ("sample",)),
        ("wrench", lambda x: x[3, 0] + 3e4, ("!impossible force", "sample")),
    ],
)
def test_a_changed_sample_is_named_by_its_rule(where: str, what, expected: tuple[str, ...]) -> None:
    """What is possible there falls under a rule, what is not is a fault of the reader."""
    before = _reading()
    changed = before.values[where].copy()
    changed[3, -1] = what(changed)
    assert changes("c3d", before, _reading(**{where: changed})) == expected


def test_whole_trials_that_change_are_faults() -> None:
    """Another clock, scale or number of frames is no rule; an exchanged column is another label."""
    before = _reading()
    position = before.values["position"]
    assert changes("c3d", before, _reading(time=np.arange(9) / 50.0)) == ("!clock of frames",)
    assert changes("c3d", before, _reading(position=position * 2.0)) == ("!all markers",)
    assert changes("c3d", before, _reading(position=position[:, ::-1])) == ("label",)
    shorter = _reading(position=position[:8], time=before.values["time"][:8])
    assert "!number of frames" in changes("c3d", before, shorter)


def test_the_rules_stand_in_the_pages() -> None:
    """Every rule of the fuzzer is written down for users, in the same words."""
    pages = "".join(" ".join(path.read_text(encoding="utf-8").split()) for path in (ROOT / "docs").glob("reading*.md"))
    missing = [name for name, text in UNDETECTABLE.items() if text not in pages]
    assert not missing
