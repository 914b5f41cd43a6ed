"""Bands of joint torques of a finished experiment: everything that they come from, drawn anew."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import torch

from torchid.contact.contact import Contact
from torchid.contact.sharing.records import ContactWrenches
from torchid.effects.scene import make_scene
from torchid.observation.trial import make_response
from torchid.recording import Forces
from torchid.session import Followed, Outcome
from torchid.session.fitting import given_mass
from torchid.session.plates import session_plates
from torchid.torque.bodies import draw_bodies
from torchid.torque.draws import PlateErrors, TorqueDraws, torque_draws
from torchid.torque.inverse import Load
from torchid.torque.seen import SeenTrial

DRAWS = 64
"""Draws of an evaluation; chosen: their standard deviation is known to 9 %."""


def outcome_draws(
    outcome: Outcome, names: Sequence[str], count: int = DRAWS, seed: int = 0, plates: PlateErrors = PlateErrors()
) -> TorqueDraws:
    """Draw the torques of some trials of an experiment; all of them share the drawn bodies and plates.

    Args:
        outcome: up to the inertia.
        names: trials whose torques are asked for; without forces they have those of a body in the air.
        plates: how wrong plates are.
    """
    generator = torch.Generator().manual_seed(seed)
    fitted = [n for n in outcome.session.fit("inertia") if outcome.followed[n].wrench is not None]
    seen = {one.name: one for one in seen_trials(outcome, list(dict.fromkeys([*fitted, *names])))}
    every = [one if name in fitted else replace(one, rows=None) for name, one in seen.items()]
    mass = given_mass(outcome.config.inertia, outcome.config.subject, outcome)
    bodies = draw_bodies(outcome.fit, outcome.identified, outcome.phi, every, count, generator, mass)
    return torque_draws(outcome.fit, outcome.phi, [seen[name] for name in names], bodies, generator, plates)


def seen_trials(outcome: Outcome, names: Sequence[str]) -> list[SeenTrial]:
    """Return some trials of an experiment as cameras and plates have seen them.

    Args:
        outcome: up to the inertia.
    """
    _, frames = session_plates(outcome.session)
    found = []
    for name in names:
        item, trial = outcome.followed[name], outcome.right(name)
        scene = make_scene(name, outcome.fit.model.tree, outcome.fit.geometry, item.motion, outcome.phi)
        response = make_response(scene, outcome.fit, trial.markers, item.tracked)
        plates = [one.name for one in frames[name]] if trial.forces is not None else []
        read = {} if trial.forces is None else plate_loads(item, trial.forces, plates)
        loads = tuple(load for own in read.values() for load in own)
        more = computed_loads(outcome.under[name], read) if name in outcome.under else ()
        found.append(SeenTrial(name, item.motion, response, (*loads, *more), item.wrench))
    return found


def computed_loads(under: ContactWrenches, read: Mapping[str, Sequence[Load]]) -> tuple[Load, ...]:
    """Return what each contact bears beyond what a plate has read of it alone.

    Args:
        under: wrenches of all contacts, shared and predicted ones with their doubts.
    """
    found = []
    for k, contact in enumerate(under.contacts):
        left = under.of(contact) - sum(load.wrench for load in read.get(contact, ()))
        doubt = left.new_zeros(len(left), 6, under.doubt.shape[2])
        doubt[under.doubtful] = under.doubt[:, 6 * k : 6 * k + 6]
        if bool(doubt.any()):
            found.append(Load(under.body[k], left, doubt=doubt))
    return tuple(found)


def plate_loads(followed: Followed, forces: Forces, plates: Sequence[str]) -> dict[str, list[Load]]:
    """Return what each contact bears on each plate, through the filter of the motion.

    Args:
        forces: readings of its plates on the same clock.
    """
    contact: Contact | None = followed.contact
    if contact is None:
        return {}
    raw, found = torch.nan_to_num(forces.wrench), {name: [] for name in contact.contacts}
    for k, (name, body) in enumerate(zip(contact.contacts, contact.bodies, strict=True)):
        for p, plate in enumerate(plates):
            on = contact.plate[:, p] == k
            if bool(on.any()):
                read = raw[:, p] * on[:, None]
                smooth = followed.motion.smoother(read)
                found[name].append(Load(body, smooth, plate, read - smooth))
    return found
