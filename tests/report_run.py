"""A finished run with hostile names, and causes as a verdict has them, for tests of what a report says."""

import json
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import torch

from torchid.config import load_config
from torchid.diagnosis.verdict.records import Alternative, Cause, Twin
from torchid.effects.catalogue import effect
from torchid.effects.place import Angle, Interval, Place
from torchid.effects.traits import Site
from torchid.run import run_experiment
from torchid.session import Outcome
from torchid.session.outcome import Criterion, QualityLevel
from torchid.simulate.options import SimulateOptions
from torchid.simulate.session import simulate_session, write_session

SUBJECT = '<script>alert("subject")</script>'
TRIAL = '"><img src=x onerror=alert(1)>'
LABEL = "<i>$x^{"


@dataclass(frozen=True)
class Run:
    """A tiny simulated session with hostile names, identified into a folder."""

    outcome: Outcome
    out: Path

    @property
    def page(self) -> str:
        """What the run wrote."""
        return (self.out / "report.html").read_text(encoding="utf-8")


@cache
def finished_run(folder: Path) -> Run:
    """Simulate three short trials, give them names that attack a page, and run them from the files.

    Args:
        folder: for all of it; one folder is one run, whichever tests ask.
    """
    options = SimulateOptions(fit=("squats",), heldout=("sway_steps",), duration_s=2.0, rate_hz=50.0, gap_fraction=0.02)
    session = simulate_session(options, seed=3)
    trials = tuple(replace(t, trial=_renamed(t.trial)) for t in session.trials)
    config = write_session(replace(session, trials=trials), options, folder).config
    assert config is not None
    text = config.read_text(encoding="utf-8").replace("name: S03", f"name: {json.dumps(SUBJECT)}")
    text = text.replace("name: sway_steps", f"name: {json.dumps(TRIAL)}")
    config.write_text(text, encoding="utf-8")
    loaded = load_config(
        config, ["geometry.max_frames=60", "geometry.temporal=false", "motion.cutoff_hz=6.0", "diagnosis.enabled=false"]
    )
    return Run(run_experiment(loaded), loaded.out)


def _renamed(trial):
    """The trial with one marker's label replaced; the rest keeps the names of the marker set."""
    labels = tuple(LABEL if label == "LTHI" else label for label in trial.markers.labels)
    assert LABEL in labels
    return replace(trial, markers=replace(trial.markers, labels=labels))


GRID = {"frequency_hz": 3.0, "damping_ratio": 0.2, "recorded_kg": 70.0, "modes": 12.0, "turning": 1.0,
        "x": 1.0, "y": 1.0, "z": 1.0}  # fmt: skip
WHERE = {Site.PLATE: ("plate_1",), Site.MARKER: ("LTHI",), Site.SEGMENT: ("thorax",), Site.JOINT: ("knee_l",)}
PAIRS = {"marker_swap": ("LTHI", "RTHI"), "plate_assignment": ("plate_1", "plate_2")}
MASSES = {"mass_kg": 74.0, "recorded_kg": 70.0}


def cause(name: str, scale: float = 1.0) -> Cause:
    """One of an effect's places with every internal parameter at its prior's scale."""
    own = effect(name)
    where = PAIRS.get(name) or WHERE.get(own.site, ("session",))
    when = (Interval(TRIAL, 0.5, 1.25),) if own.intermittent or own.per_recording else None
    follows = Angle("knee_l_flexion") if name in ("soft_tissue", "joint_centre_shift") else None
    place = Place(where, when, (0.0, 0.0, 0.1), GRID, follows=follows, markers=("LTHI", "LKNE"))
    theta = scale * torch.tensor(own.scale(place), dtype=torch.float64)
    values = {k: {"value": v, "sd": 0.1 * v.abs()} for k, v in own.named(place, theta).items()}
    gain = {"heldout_log_likelihood": 1.0, "force_rmse_pct": 1.0, "moment_rmse_pct": 1.0}
    rivals = Alternative("body_mass", ("session",), 0.2), Alternative("payload", ("hand_l",), 0.05)
    heavier = {key: {"value": torch.tensor(kg), "sd": torch.tensor(1.0)} for key, kg in MASSES.items()}
    twin = Twin("body_mass", ("session",), 0.2, Place(("session",)), heavier)
    return Cause(name, where, when, values, 0.9, rivals, (twin,), gain, place, theta[None], ("squats",), when is None)


def figure(name: str, value: float, norm: float, level: QualityLevel = QualityLevel.CARE) -> Criterion:
    """A figure of a run."""
    return Criterion(name, level, value, norm, name, "norm", "", f"mend {name}")
