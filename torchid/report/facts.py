"""Figures that several sections state: which trials judge, how large their residuals are, what the subject weighs."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.conventions import GRAVITY
from torchid.experiment.outcome import Outcome
from torchid.experiment.stages import residual_rms
from torchid.regressor.rows import WrenchTrial


@dataclass(frozen=True)
class Judges:
    """Trials on which the model is judged."""

    names: tuple[str, ...]
    words: str
    """``held-out trials``, or what stands in for them."""
    heldout: bool


def judges(outcome: Outcome) -> Judges:
    """Held-out trials; where there are none, the fit trials, and without these all."""
    for role, words in (("heldout", "held-out trials"), ("fit", "fit trials")):
        names = tuple(outcome.session.role(role))
        if names:
            return Judges(names, words, role == "heldout")
    return Judges(tuple(outcome.session.trials), "all trials", False)


def with_forces(outcome: Outcome, names: Sequence[str]) -> dict[str, WrenchTrial]:
    """Trials among ``names`` that have forces and frames in which all contact is measured."""
    found = {name: outcome.followed[name].wrench for name in names}
    return {name: trial for name, trial in found.items() if trial is not None and bool(trial.used.any())}


def marker_rms(outcome: Outcome, names: Sequence[str], columns: Tensor | None = None) -> tuple[float, float]:
    """RMS distance of all markers (or some ``columns``) over all frames, identified and scaled [mm]."""
    both = []
    for followed in (outcome.followed, outcome.followed_scaled):
        errors = [followed[name].tracked.error for name in names]
        errors = [error if columns is None else error[:, columns] for error in errors]
        both.append(1e3 * rms(torch.cat([error.reshape(-1) for error in errors]))) if errors else both.append(math.nan)
    return both[0], both[1]


def rms(x: Float[Tensor, " values"]) -> float:
    """Root mean square of what is finite."""
    known = x[torch.isfinite(x)]
    return float(known.square().mean().sqrt()) if len(known) else math.nan


def force_rms(outcome: Outcome, names: Sequence[str], identified: bool) -> tuple[float, float]:
    """RMS residual force [N] and moment about the pelvis [N m], with the identified inertia or the prior's."""
    trials = list(with_forces(outcome, names).values())
    return residual_rms(trials, outcome.phi if identified else outcome.prior.mean)


def body_weight(outcome: Outcome) -> float:
    """Recorded mass times g, or that of the model where no mass is recorded [N]."""
    return GRAVITY * (outcome.config.subject.mass_kg or float(outcome.phi[:, 0].sum()))


def used_frames(outcome: Outcome, names: Sequence[str]) -> tuple[int, int]:
    """Frames with forces that took part, and all frames, of trials with forces."""
    contacts = [outcome.followed[name].contact for name in names]
    flags = [contact.used for contact in contacts if contact is not None]
    return sum(int(flag.sum()) for flag in flags), sum(len(flag) for flag in flags)
