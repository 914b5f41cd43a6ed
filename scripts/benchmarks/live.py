"""A stream: what a posture costs by the size of its batch, and how near the estimate comes to a run's.

PYTHONPATH=.:scripts python -m benchmarks.live            # simulated, a new seed each time
PYTHONPATH=.:scripts python -m benchmarks.live --seed 7
PYTHONPATH=.:scripts python -m benchmarks.live --config configs/opencap_subject4.yaml    # a real one, against its run
"""

import argparse
import tempfile
import time
from pathlib import Path

import numpy as np
import torch

from torchid.config import load_config
from torchid.experiment import run_experiment
from torchid.experiment.fits import given_mass
from torchid.experiment.standing import standing_weight
from torchid.geometry.arrow import inverse_kinematics
from torchid.live.identifier import Identifier, Subject
from torchid.live.intake import Intake
from torchid.live.pose import Follower
from torchid.live.replay import Replay
from torchid.outcome import Outcome
from torchid.recording import Forces, Markers, Trial
from torchid.regressor.rows import residual_rms
from torchid.simulate.options import SimulateOptions
from torchid.simulate.session import simulate_session

SESSION = SimulateOptions(fit=("squats", "hip_rom", "arms", "trunk"), heldout=(), duration_s=4.0)
PAUSE_S = 1.0


def bench_live(seed: int, batches: tuple[int, ...] = (1, 2, 8, 32)) -> dict[str, float]:
    """CPU time of a posture by batch, of a step by its two ways, and distances of masses from those of a run."""
    with tempfile.TemporaryDirectory() as place:
        written = simulate_session(SESSION, seed, Path(place) / "recordings").config
        outcome = run_experiment(load_config(written, [f"out={place}/out", "diagnosis.enabled=false"]))
    whole = _joined([trial for trial in outcome.session.trials.values() if trial.role == "fit"])
    found: dict[str, float] = {f"posture in {n} [ms]": _posture_ms(outcome, whole.markers, n) for n in batches}
    for name, most in (("whole block", 1), ("limb by limb", 0)):
        before, inverse_kinematics.DENSE = inverse_kinematics.DENSE, most
        found[f"one frame, {name} [ms]"] = _posture_ms(outcome, whole.markers, 1)
        inverse_kinematics.DENSE = before
    return found | _against_run(outcome, whole)


def bench_recording(config: Path) -> dict[str, float]:
    """Distances of a stream's masses from those of the run on the same recordings, and of held-out forces."""
    with tempfile.TemporaryDirectory() as place:
        outcome = run_experiment(load_config(config, [f"out={place}/out", "diagnosis.enabled=false"]))
    fit = [trial for trial in outcome.session.trials.values() if trial.role == "fit" and trial.forces is not None]
    return _against_run(outcome, _joined(fit))


def _joined(trials: list[Trial]) -> Trial:
    """One after the other with a pause, as a session would be streamed."""
    step = max(float(t.markers.time[-1]) for t in trials) + PAUSE_S
    markers = [t.markers for t in trials]
    time_s = torch.cat([k * step + m.time for k, m in enumerate(markers)])
    forces = [t.forces for t in trials if t.forces is not None]
    wrench = Forces(time_s, torch.cat([f.wrench for f in forces]), forces[0].plates)
    return Trial("stream", Markers(markers[0].labels, time_s, torch.cat([m.position for m in markers])), wrench)


def _posture_ms(outcome: Outcome, markers: Markers, batch: int) -> float:
    follower, took = Follower(outcome.fit, markers.labels), []
    for start in range(0, 400 - batch, batch):
        begun = time.thread_time()
        follower(markers.frames(slice(start, start + batch)))
        took.append((time.thread_time() - begun) / batch)
    return 1e3 * float(np.median(took[1:]))


def _against_run(outcome: Outcome, whole: Trial) -> dict[str, float]:
    config = outcome.config
    weight = standing_weight(outcome.followed.values(), outcome.session, config)
    subject = Subject(config, outcome.fit, outcome.prior, given_mass(config, outcome), weight, outcome.cutoff_hz)
    rate, source = next(iter(outcome.session.trials.values())).markers.rate, Replay(whole, float("inf"))
    intake, follower = Intake(rate, rate, 0.5), Follower(outcome.fit, source.labels)
    identifier, known = Identifier(subject, rate, source.plates, rate), 0
    begun = time.thread_time()
    while (packet := source.take()) is not None:
        placed = intake.place(packet)
        postures = follower(placed.markers)
        known += int(postures.known.sum())
        identifier.add(placed.index, postures, placed.sample, placed.wrench)
    frames, spent = len(whole.markers.time), time.thread_time() - begun
    run = outcome.identified
    assert run is not None
    live = identifier.finish()
    off = (live.fit.mass - run.fit.mass).abs() / run.fit.sd.phi[:, 0]
    own = [outcome.followed[name].wrench for name in outcome.session.part("heldout", "inertia")]
    unseen = [one for one in own if one is not None]
    (force, _), (force_live, _) = (residual_rms(unseen, one.fit.phi) for one in (run, live))
    return {
        "frames a second of CPU, all stages": frames / spent, "postures known [part]": known / frames,
        "segment masses from a run's, mean [sd]": float(off.mean()), "at most [sd]": float(off.max()),
        "held-out force, run [N]": force, "held-out force, stream [N]": force_live,
    }  # fmt: skip


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=time.time_ns() % 10**6)
    parser.add_argument("--config", type=Path, help="a real session instead")
    torch.set_num_threads(1)
    arguments = parser.parse_args()
    print(arguments.config or f"seed {arguments.seed}")
    found = bench_live(arguments.seed) if arguments.config is None else bench_recording(arguments.config)
    for what, value in found.items():
        print(f"{what:45s} {value:8.3g}")
