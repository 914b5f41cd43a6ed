"""A stream: what a posture costs by the size of its batch, and how near the estimate comes to a run's.

PYTHONPATH=.:scripts python -m benchmarks.live            # simulated, a new seed each time
PYTHONPATH=.:scripts python -m benchmarks.live --seed 7
PYTHONPATH=.:scripts python -m benchmarks.live --config configs/opencap_subject4.yaml    # a real one, against its run
PYTHONPATH=.:scripts python -m benchmarks.live --standing --config configs/btk_flatfoot.yaml    # from standing alone
"""

import math
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from harness.command import Command, said_seed
from harness.pool import alone
from harness.rows import listed
from harness.runs import ran, simulated
from torch import Tensor

from torchid.config import load_config
from torchid.dynamics.rows import residual_rms
from torchid.errors import DataError
from torchid.geometry.arrow import inverse_kinematics
from torchid.geometry.tracking import track
from torchid.live.estimation.estimator import Estimator
from torchid.live.estimation.identifier import LiveSubject
from torchid.live.estimation.pipeline import Pipeline
from torchid.live.estimation.pose import PostureFollower
from torchid.live.estimation.refining import MessagePiece, Refining
from torchid.live.run import prepare_subject
from torchid.live.sources.intake import Intake
from torchid.live.sources.stream import Replay
from torchid.recording import Forces, Markers, Trial
from torchid.run import run_experiment
from torchid.session import Outcome
from torchid.session.fitting import given_mass
from torchid.session.standing import standing_weight
from torchid.simulate.options import SimulateOptions
from torchid.storage.results import OutputFolder

SESSION = SimulateOptions(fit=("squats", "hip_rom", "arms", "trunk"), heldout=(), duration_s=4.0)
WARM, LONG = 500, 6000
"""Frames before a stopwatch is started, and of the whole stream."""


def bench_live(seed: int, batches: tuple[int, ...] = (1, 2, 8, 32)) -> dict[str, float]:
    """CPU time of a posture by batch, of a step by its two ways, and distances of masses from those of a run."""
    with tempfile.TemporaryDirectory() as place:
        _, outcome = simulated(SESSION, seed, place)
    markers = _told(outcome)[0].markers
    found: dict[str, float] = {f"posture in {n} [ms]": _posture_ms(outcome, markers, n) for n in batches}
    for name, most in (("whole block", 1), ("limb by limb", 0)):
        before, inverse_kinematics.DENSE = inverse_kinematics.DENSE, most
        found[f"one frame, {name} [ms]"] = _posture_ms(outcome, markers, 1)
        inverse_kinematics.DENSE = before
    return found | _two_processes(outcome) | _against_run(outcome)


def bench_recording(config: Path, overrides: list[str]) -> dict[str, float]:
    """Distances of a stream's masses from those of the run on the same recordings, and of held-out forces."""
    with tempfile.TemporaryDirectory() as place:
        outcome = ran(config, f"{place}/out", *overrides)
    return _two_processes(outcome) | _against_run(outcome)


def bench_standing(config: Path, overrides: list[str]) -> dict[str, float]:
    """The same for a config of one trial, by a geometry that begins with standing alone and is refined on line."""
    with tempfile.TemporaryDirectory() as place:
        own = load_config(config, [f"out={place}/out", "diagnosis.enabled=false", *overrides])
        outcome = run_experiment(own)
        with OutputFolder(own.out, beside=True) as folder:
            subject, _ = prepare_subject(own, folder, lambda stage, share: None)
    (trial,), run = _told(outcome), outcome.identified
    assert run is not None
    found: dict[str, float] = {}
    for name, who in (("standing alone", replace(subject, static=None)), ("refined", subject)):
        with Pipeline(who, Replay(trial, float("inf"))) as pipeline:
            pipeline.run()
            try:
                mass = pipeline.finish().fit.mass
            except DataError:  # no posture is known
                mass = run.fit.mass * math.nan
        off = (mass - run.fit.mass).abs() / run.fit.sd.phi[:, 0]
        found[f"{name}: markers [mm]"] = 1e3 * track(pipeline.geometry[0], trial.markers).rmse
        found[f"{name}: masses from a run's, mean [sd]"] = float(off.mean())
        found[f"{name}: at most [sd]"] = float(off.max())
    return found


def _told(outcome: Outcome) -> list[Trial]:
    """Trials that told the run the inertia."""
    return [trial for trial in outcome.session.fit("inertia").values() if trial.forces is not None]


def _subject(outcome: Outcome) -> LiveSubject:
    config = outcome.config
    weight = standing_weight(outcome.followed.values(), outcome.session, config.subject.mass_kg)
    return LiveSubject(
        config,
        outcome.fit,
        outcome.prior,
        given_mass(config.inertia, config.subject, outcome),
        weight,
        outcome.cutoff_hz,
    )


def _two_processes(outcome: Outcome) -> dict[str, float]:
    """Frames a second that a stream's two processes work off, once both have begun."""
    trial = _there_and_back(max(_told(outcome), key=lambda one: len(one.markers.time)))
    with Pipeline(_subject(outcome), Replay(trial, float("inf"))) as pipeline:
        pipeline.run(stop=lambda: pipeline.performance()["frames"] >= WARM)
        _caught_up(pipeline)
        begun, warm = time.monotonic(), pipeline.performance()["frames"]
        pipeline.run()
        _caught_up(pipeline)
        return {"frames a second, two processes": (len(trial.markers.time) - warm) / (time.monotonic() - begun)}


def _caught_up(pipeline: Pipeline) -> None:
    while pipeline.performance()["backlog"]:
        time.sleep(0.01)


def _there_and_back(trial: Trial) -> Trial:
    """A trial forwards and backwards until it is long: the laws of motion are the same."""
    count, markers, forces = math.ceil(LONG / len(trial.markers.time)), trial.markers, trial.forces
    assert forces is not None

    def several(x: Tensor) -> Tensor:
        return torch.cat([x.flip(0) if k % 2 else x for k in range(count)])

    position, wrench = several(markers.position), several(forces.wrench)
    time_s, own = (torch.arange(len(x)) / rate for x, rate in ((position, markers.rate), (wrench, forces.rate)))
    return Trial(trial.name, Markers(markers.labels, time_s.double(), position),
                 Forces(own.double(), wrench, forces.plates))  # fmt: skip


def _posture_ms(outcome: Outcome, markers: Markers, batch: int) -> float:
    follower, took = PostureFollower(outcome.fit, markers.labels), []
    for start in range(0, 400 - batch, batch):
        begun = time.thread_time()
        follower(markers.frames(slice(start, start + batch)))
        took.append((time.thread_time() - begun) / batch)
    return 1e3 * float(np.median(took[1:]))


def _against_run(outcome: Outcome) -> dict[str, float]:
    """Streams the trials one after the other, each with its own markers and plates, into one estimate."""
    subject, estimator, frames, known = _subject(outcome), None, 0, 0
    begun = time.thread_time()
    for trial in _told(outcome):
        own, followed = _identifier(subject, trial, estimator)
        estimator, frames, known = own.identifier.estimator, frames + len(trial.markers.time), known + followed
        live = own.finish()
    spent = time.thread_time() - begun
    run = outcome.identified
    assert run is not None
    off = (live.fit.mass - run.fit.mass).abs() / run.fit.sd.phi[:, 0]
    own = [outcome.followed[name].wrench for name in outcome.session.part("heldout", "inertia")]
    unseen = [one for one in own if one is not None]
    (force, _), (force_live, _) = (residual_rms(unseen, one.fit.phi) for one in (run, live))
    return {
        "frames a second of CPU, all stages": frames / spent, "postures known [part]": known / frames,
        "segment masses from a run's, mean [sd]": float(off.mean()), "at most [sd]": float(off.max()),
        "held-out force, run [N]": force, "held-out force, stream [N]": force_live,
    }  # fmt: skip


def _identifier(subject: LiveSubject, trial: Trial, estimator: Estimator | None) -> tuple[Refining, int]:
    """What a trial has told, behind what is known already; and how many postures were known at once."""
    source, known = Replay(trial, float("inf")), 0
    intake, follower = Intake(source.rate_hz, source.force_rate_hz, 0.5), PostureFollower(subject.fit, source.labels)
    own = Refining(subject, source.labels, source.rate_hz, source.plates, source.force_rate_hz)
    own.identifier.estimator = own.identifier.estimator if estimator is None else estimator
    while (packet := source.take()) is not None:
        placed = intake.place(packet)
        postures = follower(placed.markers)
        known += int(postures.known.sum())
        own.put(MessagePiece(placed.index, placed.markers.position, postures, placed.sample, placed.wrench))
        own.work()
    return own, known


def main() -> None:
    """Run from the command line."""
    alone()
    asked = Command(
        __doc__, ("overrides",), seed=int, config=(Path, "a real session instead"),
        standing=(False, "geometry of the real session from its standing trial"),
        overrides=({"nargs": "*"}, "key=value of the config"),
    ).asked()  # fmt: skip
    if asked.config is None:
        listed(bench_live(said_seed(asked.seed, 10**6)), 45)
        return
    print(asked.config)
    listed((bench_standing if asked.standing else bench_recording)(asked.config, asked.overrides), 45)


if __name__ == "__main__":
    main()
