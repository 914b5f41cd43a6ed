"""One small synthetic session and its fits, made once for all the tests that need a moving person.

Its seed is that of this module (``draws.seed_of``), the same in every process. Where ``$TORCHID_TEST_SHARED`` names a
folder (``scripts/test`` makes one), the first process that asks for something keeps it there for the others.
"""

import functools
import os
import pickle
import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

import torch
from balance import in_balance
from draws import seed_of
from filelock import FileLock

from torchid.config import load_config
from torchid.dynamics.rows import WrenchTrial
from torchid.extension.diagnosing import observe_outcome
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
from torchid.observation.trial import TrialObservation
from torchid.recording import Markers
from torchid.run import run_experiment
from torchid.session import Outcome
from torchid.simulate.options import SimulateOptions
from torchid.simulate.session import SimulatedSession, simulate_session, write_session

SHARED = Path(os.environ["TORCHID_TEST_SHARED"]) if "TORCHID_TEST_SHARED" in os.environ else None
"""Folder that all processes of a run share, or None if they share nothing."""


Make = TypeVar("Make", bound=Callable[..., Any])


def shared(make: Make) -> Make:
    """What a function makes, once for all processes that share a folder, else once in this one."""

    def of_all(*args: object) -> object:
        if SHARED is None:
            return make(*args)
        path = SHARED / "-".join(map(str, (make.__name__, *args)))
        with FileLock(path.with_name(path.name + ".lock")):
            if not path.exists():
                path.write_bytes(pickle.dumps(make(*args)))
            return pickle.loads(path.read_bytes())  # noqa: S301 - of this run

    return functools.cache(functools.wraps(make)(of_all))  # type: ignore[return-value]


SEED = seed_of(__name__)
"""Of the session."""
OPTIONS = SimulateOptions(fit=("squats", "hip_rom", "arms", "trunk"), heldout=("sway_steps",), duration_s=4.0)
GEOMETRY = GeometryOptions(max_frames=80)


@shared
def session() -> SimulatedSession:
    """A static trial, four fit trials and a held-out one, with 1 mm and 2 N of noise."""
    return in_balance(lambda seed: simulate_session(OPTIONS, seed), SEED)


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


def fit(free: bool = True) -> GeometryFit:
    """The geometric fit, or the scaled template."""
    return _fit(free)


@shared
def _fit(free: bool) -> GeometryFit:
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
def _temporary() -> tempfile.TemporaryDirectory:
    """A folder that is gone when the tests end."""
    return tempfile.TemporaryDirectory(prefix="torchid-")


@shared
def folder() -> Path:
    """Where the session and its results are written."""
    made = SHARED or Path(_temporary().name)
    write_session(session(), OPTIONS, made / "recordings")
    return made


def config() -> Path:
    """Config of the written session."""
    return folder() / "recordings" / "config.yaml"


def overrides(out: Path) -> list[str]:
    """Of the config, for the experiment that all tests share.

    Args:
        out: folder of its results.
    """
    return [f"out={out}", f"geometry.max_frames={GEOMETRY.max_frames}", "diagnosis.enabled=false"]


def run_again() -> Outcome:
    """The whole experiment on the written session, into ``out`` beside it."""
    return run_experiment(load_config(config(), overrides(folder() / "out")))


@shared
def outcome() -> Outcome:
    """The first run."""
    return run_again()


@functools.cache
def observed(role: str = "fit") -> dict[str, TrialObservation]:
    """Its trials of a role as evidence."""
    return observe_outcome(outcome(), role)


def without(given: Markers, labels: tuple[str, ...], frames: slice = slice(None)) -> Markers:
    """The markers with some lost."""
    position = given.position.clone()
    for label in labels:
        position[frames, given.labels.index(label)] = torch.nan
    return replace(given, position=position)
