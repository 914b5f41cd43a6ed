"""A whole synthetic session, in memory or as C3D files with a config and, apart from them, the truth."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from torchid.io.c3d_write import write_c3d
from torchid.simulate.options import SimulateOptions
from torchid.simulate.planting import check_places
from torchid.simulate.subject import MARKER_SET, SimulatedSubject, simulate_subject
from torchid.simulate.trial import SimulatedTrial, TrialTruth, simulate_trial
from torchid.storage.files import atomic_write, write_json, write_text, writing

TRUTH = "truth"
"""Folder beside the recordings that no fit reads."""


@dataclass(frozen=True)
class SimulatedSession:
    """A subject and all trials."""

    subject: SimulatedSubject
    trials: tuple[SimulatedTrial, ...]
    """The static one first."""
    config: Path | None = None
    """Of the written session."""

    def trial(self, name: str) -> SimulatedTrial:
        """The trial called ``name``."""
        return next(t for t in self.trials if t.trial.name == name)


def simulate_session(
    options: SimulateOptions | None = None, seed: int = 0, out: str | Path | None = None
) -> SimulatedSession:
    """Simulate a subject and its trials; with ``out``, write C3D files, ``config.yaml`` and ``truth/`` there.

    Args:
        options: motions, rates, noise.
        seed: of everything.
        out: folder, made where it does not exist; None keeps the session in memory.

    Raises:
        ConfigError: an unknown motion, an impossible subject, or something hidden where nothing is.
        InputError: the folder cannot be written.
    """
    options = options or SimulateOptions()
    subject = simulate_subject(options, seed)
    listed = [("static", "static"), *((m, "fit") for m in options.fit), *((m, "heldout") for m in options.heldout)]
    names = []
    for k, (motion, _) in enumerate(listed):
        before = sum(other == motion for other, _ in listed[:k])
        names.append(f"{motion}_{before + 1}" if before else motion)
    check_places(subject.hidden, _places(subject, options, names), subject.labels)
    trials = tuple(
        simulate_trial(subject, motion, options, seed, name=name, role=role)
        for name, (motion, role) in zip(names, listed, strict=True)
    )
    session = SimulatedSession(subject, trials)
    return session if out is None else write_session(session, options, Path(out))


def _places(subject: SimulatedSubject, options: SimulateOptions, trials: Sequence[str]) -> set[str]:
    """All that an effect may be at, beside markers."""
    tree = subject.model.tree
    joints = {name.rpartition("_")[0] for name in tree.dof_names}
    return {"session", *trials, *tree.names, *joints, *(f"plate_{k + 1}" for k in range(options.plates))}


def write_session(session: SimulatedSession, options: SimulateOptions, out: Path) -> SimulatedSession:
    """Write the recordings, ``config.yaml`` and, under ``truth/``, ``subject.json`` and one ``.npz`` per trial."""
    with writing(out):
        (out / TRUTH).mkdir(parents=True, exist_ok=True)
    for item in session.trials:
        write_c3d(out / f"{item.trial.name}.c3d", item.trial)
        _write_truth(out / TRUTH / f"{item.trial.name}.npz", item.truth)
    write_json(out / TRUTH / "subject.json", subject_truth(session.subject, options))
    config = out / "config.yaml"
    write_text(config, yaml.safe_dump(session_config(session), sort_keys=False))
    return SimulatedSession(session.subject, session.trials, config)


def session_config(session: SimulatedSession) -> dict[str, object]:
    """The config that identifies the session."""
    s = session.subject
    return {
        "subject": {
            "name": f"S{s.seed:02d}",
            "mass_kg": s.recorded_mass,
            "mass_sd_kg": 0.3,
            "height_m": s.recorded_height,
            "sex": s.sex,
        },
        "model": "whole_body",
        "markers": MARKER_SET,
        "trials": [{"name": t.trial.name, "file": f"{t.trial.name}.c3d", "role": t.trial.role} for t in session.trials],
        "out": "out",
        "seed": s.seed,
    }


def subject_truth(subject: SimulatedSubject, options: SimulateOptions) -> dict[str, object]:
    """The truth about the subject, by name."""
    tree, prior = subject.model.tree, subject.model.geometry
    return {
        "options": options,
        "seed": subject.seed,
        "sex": subject.sex,
        "height_m": subject.height,
        "mass_kg": subject.mass,
        "xi": dict(zip(prior.names, subject.xi.tolist(), strict=True)),
        "offset_m": dict(zip(tree.names, subject.geometry.offset.tolist(), strict=True)),
        "hinge_rad": dict(zip(tree.hinges, subject.geometry.hinge.tolist(), strict=True)),
        "phi": dict(zip(tree.names, subject.phi.tolist(), strict=True)),
        "markers": {
            label: {"segment": segment, "p_BM_B": place}
            for label, segment, place in zip(subject.labels, subject.segments, subject.p_BM_B.tolist(), strict=True)
        },
    }


def _write_truth(path: Path, truth: TrialTruth) -> None:
    arrays: dict[str, Any] = {
        "time": truth.motion.time,
        "q": truth.motion.q,
        "v": truth.motion.v,
        "a": truth.motion.a,
        "markers": truth.markers,
        "wrench": truth.wrench,
        "foot_wrench": truth.feet.wrench,
        "foot_plate": truth.feet.plate,
        "complete": truth.complete,
    }
    with atomic_write(path) as file:
        np.savez_compressed(file, **{name: value.numpy() for name, value in arrays.items()})
