"""Figures that several sections state: how large the residuals of trials are, what the subject weighs."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchid.conventions import GRAVITY
from torchid.dynamics.rows import measured, predict
from torchid.session import Outcome
from torchid.session.judging import Judges as Judges
from torchid.session.judging import judges as judges
from torchid.session.tables import rms
from torchid.storage.snapshot import release


@dataclass(frozen=True)
class Wrenches:
    """Ground reaction of one trial about the pelvis' origin: measured, and with either inertia predicted."""

    time: Float[Tensor, " frames"]
    measured: Float[Tensor, "frames 6"]
    identified: Float[Tensor, "frames 6"]
    """With the prior's inertia where none was identified."""
    prior: Float[Tensor, "frames 6"]
    scaled: Float[Tensor, "frames 6"]
    """Residual of the scaled template with tabulated inertia."""
    used: Bool[Tensor, " frames"]


def only(values: Float[Tensor, "frames axes"], used: Bool[Tensor, " frames"]) -> Float[Tensor, "frames axes"]:
    """NaN in other frames: there a wrench is how the filter goes on, by kilonewtons in a second."""
    return values.masked_fill(~used[:, None], torch.nan)


def wrenches(outcome: Outcome) -> dict[str, Wrenches]:
    """All trials with forces and frames in which all contact is measured."""
    found = {}
    for name, item in outcome.followed.items():
        trial, other = item.wrench, outcome.followed_scaled[name].wrench
        if trial is None or other is None or not bool(trial.used.any()):
            continue
        prior = predict(trial, outcome.prior.mean)
        found[name] = Wrenches(
            trial.motion.time, measured(trial), prior if outcome.identified is None else predict(trial, outcome.phi),
            prior, measured(other) - predict(other, outcome.prior_scaled.mean), trial.used,
        )  # fmt: skip
        release()
    return found


def some(forces: dict[str, Wrenches], names: Iterable[str]) -> dict[str, Wrenches]:
    """Those of ``names`` that have forces."""
    return {name: forces[name] for name in names if name in forces}


def force_rms(trials: dict[str, Wrenches], which: str) -> tuple[float, float]:
    """RMS residual force [N] and moment about the pelvis [N m] over the used frames of all trials.

    Args:
        which: identified, prior or scaled.
    """
    parts = [(t.scaled if which == "scaled" else t.measured - getattr(t, which))[t.used] for t in trials.values()]
    if not parts:
        return math.nan, math.nan
    both = torch.cat(parts)
    return float(both[:, :3].square().sum(1).mean().sqrt()), float(both[:, 3:].square().sum(1).mean().sqrt())


def improved(trials: dict[str, Wrenches]) -> tuple[list[str], list[str]]:
    """Trials whose force the identified model predicts better than the scaled template, and the others."""
    better = [n for n, t in trials.items() if force_rms({n: t}, "identified")[0] < force_rms({n: t}, "scaled")[0]]
    return better, [name for name in trials if name not in better]


def marker_rms(outcome: Outcome, names: Sequence[str], columns: Tensor | None = None) -> tuple[float, float]:
    """RMS distance of all markers (or some ``columns``) over all frames, identified and scaled [mm]."""
    found = []
    for followed in (outcome.followed, outcome.followed_scaled):
        errors = (followed[name].tracked.error for name in names)
        found.append(1e3 * rms(*(error if columns is None else error[:, columns] for error in errors)))
    return found[0], found[1]


def body_weight(outcome: Outcome) -> float:
    """Recorded mass times g, or that of the model where no mass is recorded [N]."""
    return GRAVITY * (outcome.config.subject.mass_kg or float(outcome.phi[:, 0].sum()))


def used_frames(outcome: Outcome, names: Sequence[str]) -> tuple[int, int]:
    """Frames with forces that took part, and all frames, of trials with forces."""
    contacts = [outcome.followed[name].contact for name in names]
    flags = [contact.used for contact in contacts if contact is not None]
    return sum(int(flag.sum()) for flag in flags), sum(len(flag) for flag in flags)
