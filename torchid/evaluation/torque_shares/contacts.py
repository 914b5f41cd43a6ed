"""Wrenches of the contacts of every trial, and where they come from, condition by condition."""

from collections.abc import Mapping, Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.config import Config
from torchid.contact.sharing.records import ContactWrenches, WrenchSource
from torchid.devices import Device
from torchid.devices.device import Handle
from torchid.errors import ConfigError
from torchid.evaluation.evaluation import ContactCount
from torchid.evaluation.torque_shares.wearing import Worn, acting, carried
from torchid.evaluation.trials import ConditionTrial
from torchid.geometry.result import GeometryFit
from torchid.session.contact_wrenches import wrenches_under

FeetWrenches = Mapping[str, ContactWrenches | None]
"""Wrenches under the feet by trial; None where nobody tells more than the plates do."""


def feet_of(
    config: Config,
    trials: Sequence[ConditionTrial],
    fit: GeometryFit,
    phi: Float[Tensor, "bodies 10"],
    scaled: bool,
    worn: Mapping[str, Worn],
    recorded: Mapping[str, dict[str, Tensor]],
) -> FeetWrenches:
    """Wrenches of the contacts of all trials, shared and predicted ones too, as ``contact.torques`` wants them.

    Contacts bear what the body with the device's parts needs beyond what supports from the ground give.

    Args:
        phi: inertia of the body alone.
        scaled: whether it is the scaled template that follows the markers.

    Raises:
        ConfigError: ``device.*``.
    """
    tree, found = fit.model.tree, {}
    for t in trials:
        followed, device = t.scaled if scaled else t.followed, worn[t.condition]
        given = acting(device, tree, fit.geometry, followed.motion, recorded[t.name]).torque
        both = carried(device, tree, phi)
        found[t.name] = wrenches_under(followed, fit, both, t.recording, config.contact, given)
    return found


def refuse_twice(config: Config, devices: Mapping[str, Device | None]) -> None:
    """Refuse a segment whose support is told both by a device's recorded forces and by a plate: it would count twice.

    Args:
        config: of the evaluation, with its contacts.
        devices: by condition, None where none is worn.

    Raises:
        ConfigError: ``evaluate.support``.
    """
    for condition, device in devices.items():
        trials = {trial.name for trial in config.trials if trial.condition == condition}
        held = {e.line.point.segment: e.name for e in device.elements if isinstance(e.line, Handle)} if device else {}
        for name, one in config.contact.others.items():
            bears = not isinstance(one.when, dict) or bool(trials & one.when.keys())
            if one.segment in held and one.plate is not None and bears:
                raise ConfigError(
                    "evaluate.support", "a device's channels and a plate both measure what holds this segment",
                    place=f"contact.others.{name}", found=f"{one.segment}, held by {held[one.segment]} in {condition}",
                    remedy="Leave the element to the device if the support belongs to it and records its own force, "
                    "and the contact to contact.others if a plate measures it",
                )  # fmt: skip


def count_contacts(trials: Sequence[ConditionTrial], feet: FeetWrenches) -> tuple[ContactCount, ...]:
    """Shares of every contact, feet first, in every condition.

    Args:
        trials: of all conditions; those without forces have none of their contact measured.
    """
    found = []
    for condition in dict.fromkeys(trial.condition for trial in trials):
        own = [t for t in trials if t.condition == condition and t.followed.contact is not None]
        for foot in own[0].followed.contact.contacts if own and own[0].followed.contact else ():
            down = torch.cat([_sources(trial, feet[trial.name], foot) for trial in own])
            frames = len(down)
            shares = [float((down == source).double().mean()) if frames else 0.0 for source in WrenchSource]
            beside = shares[WrenchSource.PREDICTED] + shares[WrenchSource.UNKNOWN]
            found.append(
                ContactCount(
                    condition, foot, frames, shares[WrenchSource.MEASURED], shares[WrenchSource.SHARED], beside
                )
            )
    return tuple(found)


def _sources(trial: ConditionTrial, under: ContactWrenches | None, foot: str) -> Tensor:
    """Source of a contact's wrench in every frame that it bears in; without estimates, plates tell of one alone."""
    contact = trial.followed.contact
    assert contact is not None, "the caller has looked"
    k = contact.contacts.index(foot)
    down = contact.bearing[:, k]
    if under is not None:
        return under.source[down, under.contacts.index(foot)]
    alone = ~(contact.beside | contact.untold)[:, k]
    return torch.where(alone, int(WrenchSource.MEASURED), int(WrenchSource.UNKNOWN))[down]
