"""The statements of model-free checks on an experiment."""

from dataclasses import replace

import torch
from jaxtyping import Bool
from torch import Tensor

from torchid.effects.scene import PlateFrame, make_scene, reading
from torchid.extension.diagnosing import MOST, spans
from torchid.model_free.panel import Panel, make_panel
from torchid.model_free.watched import Watched, watch
from torchid.session import Outcome
from torchid.session.following import soles
from torchid.session.plates import session_plates

UNRECORDED = 1.0
"""Resolution. Relative standard deviation of a mass that nobody has recorded: the template's says nothing."""


def panel_of(outcome: Outcome) -> Panel | None:
    """The statements of model-free checks on static and fit trials; None where there are none.

    Args:
        outcome: up to the inertia.
    """
    recorded, limits = float(outcome.prior.mean[:, 0].sum()), outcome.config.diagnosis.thresholds
    trials = [name for role in ("static", "fit") for name in outcome.session.part(role, "inertia")][:MOST]
    frames, parts = session_plates(outcome.session)[1], spans(outcome)
    seen = [_watched(outcome, name, frames[name], recorded, parts[name]) for name in trials if name in frames]
    who = outcome.config.subject
    part = UNRECORDED if who.mass_kg is None else (who.mass_sd_kg or 0.0) / recorded
    return make_panel([one for one in seen if one is not None], part, limits.witnesses, limits.observation)


def _watched(
    outcome: Outcome, name: str, frames: tuple[PlateFrame, ...], recorded_kg: float, part: slice
) -> Watched | None:
    """Part of a trial as model-free checks see it; None where no contact is known."""
    item, trial = outcome.followed[name], outcome.session.trials[name]
    if item.contact is None or trial.forces is None:
        return None
    measured = _known(outcome, name)
    scene = make_scene(
        name, outcome.fit.model.tree, outcome.fit.geometry, item.motion.frames(part), outcome.prior.mean
    )  # fmt: skip
    return watch(
        replace(scene, recorded_kg=recorded_kg), reading(name, trial.forces.samples(part), frames), measured[part],
        soles(outcome.fit, item.tracked.frames(part)), item.contact.frames(part),
    )  # fmt: skip


def _known(outcome: Outcome, name: str) -> Bool[Tensor, " frames"]:
    """Frames whose whole wrench is on plates and whose motion is known."""
    item, forces = outcome.followed[name], outcome.session.trials[name].forces
    assert item.contact is not None and forces is not None
    return item.contact.measured & torch.isfinite(item.tracked.error).any(1) & torch.isfinite(forces.total).all(1)
