"""What an identified device leaves unsure of the human's torques: its elements' numbers, and the mass of its parts."""

from collections.abc import Mapping
from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.evaluation.torque_shares.wearing import Worn, acting
from torchid.model.model import Geometry
from torchid.model.tree import Tree
from torchid.motion import Motion
from torchid.torque.inverse import joint_torques


def device_deviations(
    worn: Worn, tree: Tree, geometry: Geometry, motion: Motion, recorded: Mapping[str, Tensor]
) -> Float[Tensor, "draws frames dofs"] | None:
    """Return the human's torques with drawn devices minus those with the identified one; None where none was drawn.

    Args:
        worn: the condition's device with its draws.
        tree: of the model.
        geometry: of the subject.
        motion: coordinates with their rates.
        recorded: channels on the motion's frames.

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
