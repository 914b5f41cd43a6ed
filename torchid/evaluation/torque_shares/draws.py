"""How far torques move with what is not known of the body, of markers and of plates: one set of draws for all trials.

What all trials have in common, such as a thigh that is too heavy, moves the torques of both conditions alike and leaves
their difference. The only place that draws.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.evaluation.torque_shares.contacts import FeetWrenches
from torchid.evaluation.torque_shares.wearing import Worn, acting
from torchid.evaluation.trials import ConditionTrial
from torchid.model.model import Geometry
from torchid.model.tree import Tree
from torchid.motion import Motion
from torchid.run.torque_bands import outcome_draws
from torchid.session import Outcome
from torchid.torque.inverse import joint_torques

SAID = "body, skin under markers, gains and places of plates, how feet share one, and numbers of the device"
"""What is drawn, in words."""


def torque_deviations(
    outcome: Outcome, trials: Sequence[ConditionTrial], feet: FeetWrenches, draws: int, seed: int
) -> dict[str, Float[Tensor, "draws frames dofs"]] | None:
    """Torques with other bodies and readings minus those that are published, by trial.

    Returns:
        None where no inertia was identified, or no draw is wanted. The device's own numbers are drawn elsewhere
        (``device_draws``).
    """
    if outcome.identified is None or not draws:
        return None
    every = with_trials(outcome, trials, feet)
    found = outcome_draws(every, [trial.name for trial in trials], draws, seed)
    return {name: drawn - found.value[name] for name, drawn in found.draws.items()}


def with_trials(outcome: Outcome, trials: Sequence[ConditionTrial], feet: FeetWrenches) -> Outcome:
    """The outcome of the body's run with the trials that it has left out, as held-out ones; readings as they were."""
    new = [trial for trial in trials if trial.name not in outcome.session.trials]
    recordings = outcome.session.trials | {trial.name: trial.recording for trial in new}
    files = outcome.session.files | {trial.name: trial.file for trial in new}
    session = replace(outcome.session, trials=recordings, files=files)
    followed = outcome.followed | {trial.name: trial.followed for trial in new}
    under = {name: one for name, one in feet.items() if one is not None}
    return replace(outcome, session=session, followed=followed, under=under, corrected={})


def device_deviations(
    worn: Worn, tree: Tree, geometry: Geometry, motion: Motion, recorded: Mapping[str, Tensor]
) -> Float[Tensor, "draws frames dofs"] | None:
    """Return the human's torques with drawn devices minus those with the identified one; None where none was drawn.

    Raises:
        ConfigError: ``device.*``.
    """
    if not worn.draws or worn.parts is None or worn.parts_draws is None:
        return None
    usual = acting(worn, tree, geometry, motion, dict(recorded)).torque
    found = []
    for device, parts in zip(worn.draws, worn.parts_draws, strict=True):
        share = usual
        if device.elements:
            share = acting(replace(worn, device=device), tree, geometry, motion, dict(recorded)).torque
        carried = joint_torques(tree, geometry, parts - worn.parts, motion, ())
        found.append(carried - (share - usual))
    return torch.stack(found)
