"""A simulated subject does what it is advised to, without a leap, and its plates bear what its motion needs."""

import os
import re
import subprocess
import sys
from concurrent.futures import Executor, Future
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from simulated_person import clips
from simulated_person.clips import make_clip, make_standing, stand_still
from simulated_person.source import HEAR_S, STAND_S, SimulatedSource
from torch.testing import assert_close

from torchid.conventions import GRAVITY
from torchid.errors import ConfigError
from torchid.filters import differentiate
from torchid.kinematics.plan import plan_tree
from torchid.kinematics.recursion import poses
from torchid.live.exercises.advice import Advice
from torchid.live.exercises.exercises import LIBRARY, Exercise, Possibilities, allowed
from torchid.live.sources.stream import Packet
from torchid.simulate.options import SimulateOptions
from torchid.simulate.subject import SimulatedSubject, simulate_subject

PROJECT = Path(__file__).resolve().parents[1]
CLEAN = SimulateOptions(fit=(), heldout=(), plates=2, marker_noise_mm=0.0, force_noise_n=0.0)
RATE = 100.0
FASTEST_M_S = 8.0
"""Of any marker: the hands of the quickest exercise go half as fast."""
STILL_M_S = 1e-3
"""Of any marker within a frame of where one piece follows another."""
BEGUN_S = 2.0
"""By when an exercise has begun after it was asked for, on this clock: it stands a moment, and was prepared at once."""


class AtOnce(Executor):
    """Prepares an exercise before it returns."""

    def submit(self, fn: Any, /, *args: Any, **kwargs: Any) -> Future:
        """The result of a call."""
        done: Future = Future()
        done.set_result(fn(*args, **kwargs))
        return done


def asking(name: str, gain: float = 1.0) -> Advice:
    """Advice to do an exercise."""
    return Advice(name, "", 10.0, gain, ("head",))


def taken(source: SimulatedSource, clock: list[float], seconds: float, rng: np.random.Generator) -> list[Packet]:
    """What comes in so many seconds, asked for at odd times."""
    found, end = [], clock[0] + seconds
    while clock[0] < end:
        packet = source.take()
        assert packet is not None and packet.forces is not None and packet.arrived_s <= clock[0] + 1e-9
        found.append(packet)
        clock[0] += float(rng.uniform(0.0, 0.03))
    return found


def performed(seed: int, who: SimulatedSubject, exercises: list[Exercise]) -> tuple[SimulatedSource, list[Packet]]:
    """A stream in which exercises are asked for one after the other."""
    rng, clock = np.random.default_rng(seed), [100.0]
    source = SimulatedSource(who, CLEAN, seed, lambda: clock[0], AtOnce())
    packets = taken(source, clock, 1.0, rng)
    for k, one in enumerate(exercises):
        source.hear(asking(one.name, float(k)), None)
        packets += taken(source, clock, one.seconds, rng)
    return source, packets + taken(source, clock, 1.0, rng)


@pytest.mark.slow
def test_one_exercise_follows_another_without_a_leap_and_plates_bear_what_they_need(seed):
    """Frames and samples are uniform; each exercise is the one asked for; forces are those of the simulator's truth."""
    who = simulate_subject(CLEAN, seed)
    chosen = [allowed(Possibilities())[k] for k in np.random.default_rng(seed).permutation(8)[:3]]
    source, packets = performed(seed, who, chosen)
    markers, time = (torch.cat([getattr(one.markers, name) for one in packets]) for name in ("position", "time"))
    wrench = torch.cat([one.forces.wrench for one in packets if one.forces is not None])
    assert_close(time, torch.arange(len(time), dtype=torch.float64) / RATE)
    assert len(wrench) == 10 * len(markers)
    speed = RATE * (markers[1:] - markers[:-1]).norm(dim=2).amax(1)
    assert float(speed.max()) < FASTEST_M_S
    assert [one.exercise for one in source.done] == [one.name for one in chosen]
    standing = make_standing(who, seed, RATE)
    for k, (one, exercise) in enumerate(zip(source.done, chosen, strict=True)):
        asked_s = 1.0 + sum(other.seconds for other in chosen[:k])
        assert 0.0 <= one.start_s - asked_s < BEGUN_S
        first, count = round(one.start_s * RATE), round(one.seconds * RATE)
        assert float(speed[[first - 2, first - 1, first, first + count - 2, first + count - 1]].max()) < STILL_M_S
        short = replace(exercise, seconds=exercise.seconds - HEAR_S)
        truth = make_clip(short, standing, CLEAN, seed + 1 + k).truth
        assert float(truth.motion.q.std(0).max()) > 0.02, "it moves"
        part = slice(first, first + count)
        assert_close(markers[part], truth.markers)
        assert_close(wrench[::10].sum(1)[part], truth.wrench, atol=1e-6, rtol=0)
        assert_close(truth.wrench[5:-5, :3], newton(who, truth.motion.q)[5:-5], atol=0.5, rtol=0)
        assert bool(truth.complete.all()), "both feet are on the plates"
    rest = stand_still(standing, STAND_S, CLEAN).truth.wrench
    assert_close(wrench[0].sum(0), rest[0], atol=1e-6, rtol=0)
    assert float(rest[0, 2]) == pytest.approx(GRAVITY * who.mass)


def newton(who: SimulatedSubject, q: torch.Tensor) -> torch.Tensor:
    """Force that the centre of mass needs, by its own second derivative."""
    plan = plan_tree(who.model.tree)
    at, phi = poses(plan, q.T.contiguous(), who.geometry), who.phi[list(plan.order)]
    moment = at.p * phi[:, :1, None] + sum(at.R[:, a] * phi[:, 1 + a, None, None] for a in range(3))
    _, a = differentiate(moment.sum(0).T / who.mass, RATE)
    return who.mass * (a + a.new_tensor([0.0, 0.0, GRAVITY]))


def test_it_stands_while_nothing_is_asked_and_ends_once_everything_is_known(seed):
    rng, clock = np.random.default_rng(seed), [0.0]
    source = SimulatedSource(simulate_subject(CLEAN, seed), replace(CLEAN, marker_noise_mm=1.0), seed, lambda: clock[0],
                             AtOnce())  # fmt: skip
    source.hear(None, None)
    position = torch.cat([one.markers.position for one in taken(source, clock, 3.0, rng)])
    assert float((position.std(0) - 1e-3).abs().max()) < 3e-4, "noise that is drawn anew, and nothing else"
    assert not source.done
    source.hear(asking(LIBRARY[0].name), torch.full((16,), 0.89, dtype=torch.float64))
    assert source.take() is not None
    source.hear(asking(LIBRARY[0].name), torch.full((16,), 0.91, dtype=torch.float64))
    assert source.take() is None


def test_the_newest_advice_counts_and_the_same_one_is_not_done_twice(seed):
    rng, clock = np.random.default_rng(seed), [0.0]
    source = SimulatedSource(simulate_subject(CLEAN, seed), CLEAN, seed, lambda: clock[0], AtOnce())
    with source:
        taken(source, clock, 0.1, rng)
        for name in ("squats", "head", "head"):
            source.hear(asking(name), None)
        taken(source, clock, 12.0, rng)
    assert [one.exercise for one in source.done] == ["head"]


def test_an_exercise_that_is_beyond_a_body_is_said(seed, monkeypatch):
    who = simulate_subject(CLEAN, seed)
    monkeypatch.setattr(clips, "impossible", lambda *_: "nothing holds")
    monkeypatch.setattr(clips, "ATTEMPTS", 1)
    with pytest.raises(ConfigError, match=r"nothing holds.*simulate\.balance"):
        make_clip(LIBRARY[2], make_standing(who, seed, RATE), CLEAN, seed)


def test_the_script_tells_the_two_demonstrations_apart(tmp_path):
    """``--live`` takes the extra that a page needs, and the script of that name; all else is as it was."""
    (tmp_path / "scripts").mkdir()
    (tmp_path / "scripts" / "environment").write_text('echo "extra:${1:-}"\n')
    text = (PROJECT / "scripts" / "demo").read_text()
    (tmp_path / "scripts" / "demo").write_text(re.sub("exec (python|torchid)", "exec echo", text))
    for words, expected in (
        (("--live", "7"), "extra:live\nscripts/demo_live.py 7\n"), (("7",), "extra:\ndemo 7\n")
    ):  # fmt: skip
        script = str(tmp_path / "scripts" / "demo")
        done = subprocess.run(["bash", script, *words], check=True, capture_output=True, text=True)
        assert done.stdout == expected


@pytest.mark.slow
@pytest.mark.battery
def test_the_demonstration_does_what_is_asked_and_knows_more_after_it(seed, tmp_path):
    """In a process of its own, in real time, without a page."""
    words = ["--headless", "--seconds", "30", str(seed), "--out", str(tmp_path)]
    paths = os.pathsep.join([str(PROJECT), str(PROJECT / "scripts")])
    done = subprocess.run(
        [sys.executable, str(PROJECT / "scripts" / "demo_live.py"), *words], check=False, capture_output=True,
        text=True, timeout=300, env={**os.environ, "PYTHONPATH": paths},
    )  # fmt: skip
    print(done.stdout, done.stderr)  # noqa: T201
    assert done.returncode == 0
    asked = re.findall(r"^ *(\d+) s  asked for (\w+),", done.stdout, re.MULTILINE)
    did = re.findall(r"^ *(\d+) s  it does (\w+) for", done.stdout, re.MULTILINE)
    left = iter(asked)
    assert did and all(any(name == other and int(t) >= int(since) for since, other in left) for t, name in did)
    found = re.search(r"Identified mass ([\d.]+) ± ([\d.]+) kg, in truth ([\d.]+) kg", done.stdout)
    assert found is not None
    mass, _, truth = map(float, found.groups())
    assert mass == pytest.approx(truth, rel=0.02)
    rises = [float(x) for x in re.findall(r"^\w+ +\d+ +[\d.]+ +([\d.-]+)%$", done.stdout, re.MULTILINE)]
    assert len(rises) >= 2 and all(one > 0.0 for one in rises)
    known = [float(x) for x in re.findall(r"^\w+ +(\d+)% +\d+% ", done.stdout, re.MULTILINE)]
    assert len(known) == 16 and np.mean(known) > 5.0
