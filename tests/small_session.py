"""One small synthetic session and its fits, made once for all the tests that need a moving person.

The seed is new in every test run, or ``$TORCHID_SEED``; tests print it, so that pytest shows it when one fails.
"""

import functools
import os
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import torch

from torchid.config import load_config
from torchid.experiment import run_experiment
from torchid.filters import Smoother
from torchid.geometry.assign import Assignment, assign_markers
from torchid.geometry.fit import fit_geometry
from torchid.geometry.options import GeometryOptions
from torchid.geometry.result import GeometryFit
from torchid.io.resample import synchronise
from torchid.model.marker_set import load_marker_set
from torchid.model.model import Model
from torchid.model.whole_body import whole_body
from torchid.motion import smooth_motion
from torchid.outcome import Outcome
from torchid.recording import Markers
from torchid.regressor.rows import WrenchTrial
from torchid.simulate.options import SimulateOptions
from torchid.simulate.session import Session, simulate_session, write_session

SEED = int(os.environ.get("TORCHID_SEED", time.time_ns() % 2**32))
OPTIONS = SimulateOptions(fit=("squats", "hip_rom", "arms", "trunk"), heldout=("sway_steps",), duration_s=4.0)
GEOMETRY = GeometryOptions(max_frames=80)


@functools.cache
def session() -> Session:
    """A static trial, four fit trials and a held-out one, with 1 mm and 2 N of noise."""
    return simulate_session(OPTIONS, SEED)


@functools.cache
def template() -> Model:
    """What a laboratory would scale for this person."""
    who = session().subject
    return whole_body(who.recorded_height, who.recorded_mass, who.sex, 0.3)


@functools.cache
def assignment() -> Assignment:
    """The session's markers on the template."""
    model = template()
    marker_set = load_marker_set("simulated", model.tree.names, tuple(model.landmarks))
    return assign_markers(model, marker_set, tuple(item.trial for item in session().trials))


def markers(role: str) -> dict[str, Markers]:
    """Marker trajectories of the trials of a role."""
    return {item.trial.name: item.trial.markers for item in session().trials if item.trial.role == role}


@functools.cache
def fit(free: bool = True) -> GeometryFit:
    """The geometric fit, or the scaled template."""
    given = assignment()
    return fit_geometry(given.model, given.attachment, markers("fit"), markers("static")["static"], GEOMETRY, free)


@functools.cache
def true_rows(role: str = "fit", cutoff_hz: float = 10.0) -> tuple[WrenchTrial, ...]:
    """Noisy plates with the true motion and geometry: the inertial problem without the errors of the geometric one."""
    subject, found = session().subject, []
    for item in session().trials:
        if item.trial.role != role:
            continue
        trial = synchronise(item.trial)
        assert trial.forces is not None
        smoother = Smoother(cutoff_hz, trial.markers.rate)
        motion = smooth_motion(subject.model.tree, trial.markers.time, item.truth.motion.q, smoother)
        finite = torch.isfinite(trial.forces.total).all(dim=1)
        wrench = smoother(torch.nan_to_num(trial.forces.total), finite.to(torch.float64))
        used = finite & item.truth.complete
        found.append(WrenchTrial(trial.name, subject.model.tree, subject.geometry, motion, wrench, used))
    return tuple(found)


@functools.cache
def folder() -> tempfile.TemporaryDirectory:
    """Where the session and its results are written; gone when the tests end."""
    made = tempfile.TemporaryDirectory(prefix="torchid-")
    write_session(session(), OPTIONS, Path(made.name) / "recordings")
    return made


def config() -> Path:
    """Config of the written session."""
    return Path(folder().name) / "recordings" / "config.yaml"


def run_again() -> Outcome:
    """The whole experiment on the written session, into ``out`` beside it."""
    overrides = [
        f"out={Path(folder().name) / 'out'}",
        f"geometry.max_frames={GEOMETRY.max_frames}",
        "diagnosis.enabled=false",
    ]
    return run_experiment(load_config(config(), overrides))


@functools.cache
def outcome() -> Outcome:
    """The first run."""
    return run_again()


def without(given: Markers, labels: tuple[str, ...], frames: slice = slice(None)) -> Markers:
    """The markers with some lost."""
    position = given.position.clone()
    for label in labels:
        position[frames, given.labels.index(label)] = torch.nan
    return replace(given, position=position)
