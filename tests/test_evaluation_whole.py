"""The harness of whole evaluations without an effect: it finds one where there is one, and counts as it should."""

import json
import sys
from dataclasses import replace
from pathlib import Path

import pytest
import torch

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "scripts"))

from benchmarks import evaluation_whole
from benchmarks.evaluation_recordings import perform
from benchmarks.evaluation_whole import Plan, evaluated, run, summary

LADEN_KG = 50.0
"""Carried on the thorax in a condition that does something, and known to nobody."""


def line(number: int, found: list[str]) -> dict:
    """Of the file of results."""
    said = {"found": found, "courses": len(found), "covered": 0.95}
    return {"seed": 0, "number": number, "movement": "squats", "cycles": 9, "seconds": 1.0,
            "identified": said, "template": said | {"found": [], "courses": 0}}  # fmt: skip


def test_rates_have_exact_intervals() -> None:
    """Three of twenty: Clopper and Pearson's interval is 3.2 to 37.9 %; what failed is not counted."""
    lines = [line(k, ["hip_l_flexion range_deg"] if k < 3 else []) for k in range(20)]
    said = summary([*lines, {"seed": 0, "number": 20, "movement": "squats", "failed": "evaluate.no_cycles"}])
    own = said["identified"]
    assert said["evaluations"] == 20 and said["failed"] == ["evaluate.no_cycles"]
    assert (own["with_findings"], own["rate"], own["courses"]) == (3, 0.15, 3)
    assert own["low"] == pytest.approx(0.0321, abs=1e-4) and own["high"] == pytest.approx(0.3789, abs=1e-4)
    assert said["template"]["rate"] == said["template"]["low"] == 0.0
    assert own["found"] == {"hip_l_flexion range_deg": 3}


@pytest.mark.slow
@pytest.mark.battery
def test_a_real_difference_is_found_and_a_run_goes_on(
    tmp_path: Path, seed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A load that nobody knows of, from files to findings; evaluations that are there are not made again."""

    def laden(subject, movement, options, key, name):
        thorax, phi = subject.model.tree.index("thorax"), subject.phi.clone()
        phi[thorax] *= 1.0 + LADEN_KG / float(phi[thorax, 0])
        who = replace(subject, phi=phi) if name.startswith("with_") else subject
        return perform(who, movement, options, key, name)

    monkeypatch.setattr(evaluation_whole, "perform", laden)
    plan = Plan("apart", ("squats",), seed=seed % 1000)
    first = run(plan, 1, tmp_path)
    (said,) = map(json.loads, (tmp_path / plan.file).read_text().splitlines())
    assert said["identified"]["units"].endswith("trials") and said["identified"]["least"] <= 0.05
    assert any("knee" in name for name in said["identified"]["found"]), said
    monkeypatch.setattr(evaluation_whole, "evaluation", lambda *given: pytest.fail("made again"))
    assert run(plan, 1, tmp_path) == first


@pytest.mark.slow
def test_the_label_of_a_trial_changes_nothing_that_is_said_of_it(
    tmp_path: Path, seed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The same recordings under the other condition, in another order: on this the exactness of permutations rests."""
    plan, write = Plan("apart", ("squats",), trials=2, seed=seed % 1000), evaluation_whole.written

    def written(*given):
        config = write(*given)
        return config.model_copy(update={"geometry": replace(config.geometry, max_frames=100)})

    monkeypatch.setattr(evaluation_whole, "written", written)

    def swapped(subject, movement, options, key, name):
        return perform(subject, movement, options, (*key[:2], (key[2] + plan.trials) % (2 * plan.trials)), name)

    found = []
    for k, recorded in enumerate((perform, swapped)):
        monkeypatch.setattr(evaluation_whole, "perform", recorded)
        (tmp_path / str(k)).mkdir()
        found.append(evaluated(plan, 0, tmp_path / str(k), tmp_path).identified.sample)
    other = {"without": "with", "with": "without"}
    one, two = (
        {name: own.values[[k for k, x in enumerate(own.trials) if x == name]] for name in own.trials} for own in found
    )
    for name, values in one.items():
        condition, _, number = name.partition("_")
        partner = f"{other[condition]}_{number}"
        torch.testing.assert_close(two[partner], values, rtol=0, atol=0, equal_nan=True)
