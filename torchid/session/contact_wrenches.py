"""Wrenches of the contacts of one followed trial: what plates, the body's need and its joints tell together."""

import math
from collections.abc import Iterator
from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.contact.contact import Contact, find_contact
from torchid.contact.options import ContactOptions
from torchid.contact.sharing.costs import Effort
from torchid.contact.sharing.records import ContactWrenches, Needed, WrenchSource
from torchid.contact.sharing.solver import SharingStatus
from torchid.contact.sharing.wrenches import contact_wrenches
from torchid.conventions import GRAVITY
from torchid.dynamics.equations_of_motion import (
    DynamicState,
    body_rows,
    body_wrenches,
    dynamic_state,
    generalised_forces,
    joint_axes,
    wrench_about,
)
from torchid.errors import Note
from torchid.geometry.result import GeometryFit
from torchid.model.model import Geometry
from torchid.model.tree import Tree
from torchid.motion import Motion
from torchid.recording import Forces, Trial
from torchid.session import Followed
from torchid.session.following import SPREAD, limb, soles
from torchid.session.other_contacts import others_of, patches_of
from torchid.torque.inverse import CHUNK

TORQUE_SD = 1.0
"""Chosen: standard deviation of a joint torque over the body's mass [N m/kg]: the largest of walking are 0.5 at the
knee, 1 at the hip and 1.5 at the ankle (Winter, Biomechanics and Motor Control of Human Movement, 2009)."""
NEEDED_SD = 0.05, 0.03
"""Chosen: standard deviation of what a body needs where no plate has told it: of the force over the weight, and of the
moment over the weight [m]."""


def wrenches_under(
    followed: Followed,
    fit: GeometryFit,
    phi: Float[Tensor, "bodies 10"],
    trial: Trial,
    options: ContactOptions,
    given: Float[Tensor, "frames dofs"] | None = None,
) -> ContactWrenches | None:
    """Return the wrench of every contact of a trial; None for a body without any, or where nobody may tell more than
    plates do of one contact alone.

    Args:
        followed: the trial's motion, and its contacts where it has forces.
        phi: inertia of the body with what it carries.
        options: of contact; ``torques`` tells what may be shared or predicted.
        given: generalised forces of a device, supports from the ground included, NaN where nobody knows them; base
            rows about the root's origin in W. Neither contacts nor the person supply them.

    Returns:
        Wrenches through the filter of the motion, and where each comes from; without feet in a trial without plates
        whose wrenches are not predicted.
    """
    untold = options.torques == "measured" or (followed.contact is None and options.torques != "predicted")
    # Without plates and unpredicted nobody tells of feet, not even that they are in the air.
    outlines = {} if followed.contact is None and untold else soles(fit, followed.tracked)
    if math.isinf(followed.motion.smoother.rate_hz) or not (options.others or (outlines and not untold)):
        return None
    tree, geometry, motion = fit.model.tree, fit.geometry, followed.motion
    forces, contact = _plates(followed, fit, trial, outlines, options)
    patches = None if contact.others is None else patches_of(fit, followed.tracked, options, contact.others.bearing)
    com, needed = body_needs(tree, geometry, motion, phi)
    given = torch.zeros_like(motion.q) if given is None else given
    needed = needed - wrench_about(given[:, :6], -motion.q[:, :3])
    predicted = _needed(followed, contact, needed, motion, phi) if options.torques == "predicted" else None
    return contact_wrenches(
        contact, outlines, forces, com, motion.smoother, predicted,
        _effort(tree, geometry, motion, phi, contact.bodies, given), options, patches=patches,
    )  # fmt: skip


def _plates(
    followed: Followed, fit: GeometryFit, trial: Trial, outlines: dict[str, Tensor], options: ContactOptions
) -> tuple[Forces, Contact]:
    """Plates and contacts; of a trial without plates, contacts by the motion alone."""
    if trial.forces is not None and followed.contact is not None:
        return trial.forces, followed.contact
    motion, smoother = followed.motion, followed.motion.smoother
    none = Forces(motion.time, motion.q.new_zeros(len(motion.time), 0, 6), ())
    seen = torch.isfinite(followed.tracked.error).any(dim=1)
    others = others_of(fit, followed.tracked, replace(trial, forces=None), options)
    spread_s = SPREAD / smoother.cutoff_hz
    return none, find_contact(outlines, none, seen, smoother.rate_hz, spread_s, options, others=others)


def _states(tree: Tree, geometry: Geometry, motion: Motion) -> Iterator[tuple[slice, DynamicState]]:
    for start in range(0, len(motion.q), CHUNK):
        part = slice(start, start + CHUNK)
        yield part, dynamic_state(tree, geometry, *(x[part].T.contiguous() for x in (motion.q, motion.v, motion.a)))


def body_needs(
    tree: Tree, geometry: Geometry, motion: Motion, phi: Float[Tensor, "bodies 10"]
) -> tuple[Float[Tensor, "frames 3"], Float[Tensor, "frames 6"]]:
    """Return the centre of mass in W [m] and the wrench about the world's origin that the motion needs [N, N m]."""
    com, needed = motion.q.new_empty(len(motion.q), 3), motion.q.new_empty(len(motion.q), 6)
    for part, state in _states(tree, geometry, motion):
        own, at = phi[list(state.plan.order)], state.at
        first = at.p * own[:, 0, None, None] + torch.einsum("bcit,bc->bit", at.R, own[:, 1:4])
        com[part] = (first.sum(0) / own[:, 0].sum()).T
        about_root = body_wrenches(state.plan, body_rows(state), phi).sum(0).T
        needed[part] = wrench_about(about_root, -motion.q[part, :3])
    return com, needed


def _needed(followed: Followed, contact: Contact, needed: Tensor, motion: Motion, phi: Tensor) -> Needed:
    """What the body needs, and how far that is from what plates measured of the whole body."""
    told = torch.isfinite(needed).all(dim=1)
    known = torch.isfinite(followed.tracked.error).any(dim=1) & told
    weight = float(phi[:, 0].sum()) * GRAVITY
    sd = needed.new_tensor([NEEDED_SD[0] * weight] * 3 + [NEEDED_SD[1] * weight] * 3)
    if followed.wrench is not None and bool((contact.used & told).any()):
        gap = wrench_about(needed - followed.wrench.wrench, motion.q[:, :3])
        sd = gap[contact.used & told].square().mean(0).sqrt()
    return Needed(needed, known, sd, motion.q[:, :3])


def _effort(
    tree: Tree, geometry: Geometry, motion: Motion, phi: Tensor, bodies: tuple[str, ...], given: Tensor
) -> Effort:
    """The person's torques of the joints between root and contacts as rows on the contacts' wrenches, over their
    deviation; of frames in which nobody knows what a device gives, as if it gave nothing.

    tau = S' (what the bodies beyond the joint need - the wrenches on them), with S a joint's twist about the root's
    origin r: in terms of a wrench (f, m) about the world's origin, S_l f + S_a (m - r x f).
    """
    limbs = [limb(tree, body) for body in bodies]
    rows = list(dict.fromkeys(row for own in limbs for row in own))
    beyond = motion.q.new_tensor([[float(row in own) for own in limbs] for row in rows])
    sd = TORQUE_SD * float(phi[:, 0].sum())

    def effort(part: slice) -> tuple[Tensor, Tensor]:
        part = slice(part.start, min(part.stop, len(motion.q)))
        state = dynamic_state(tree, geometry, *(x[part].T.contiguous() for x in (motion.q, motion.v, motion.a)))
        needed = generalised_forces(state, body_wrenches(state.plan, body_rows(state), phi))
        needed = needed - torch.nan_to_num(given[part]).T
        S = tree.fold(state.at.q, joint_axes(state)[0])
        own = S[rows].permute(2, 0, 1)
        root = motion.q[part, None, :3].expand(-1, len(rows), -1)
        force, moment = own[..., :3], own[..., 3:]
        moved = torch.cat([force - torch.linalg.cross(moment, root), moment], dim=2) / sd
        return moved[:, :, None] * beyond[..., None], needed[rows].T / sd

    return effort


def sharing_notes(under: dict[str, ContactWrenches]) -> list[Note]:
    """Return what a reader must hear of wrenches that no plate measured by itself."""
    notes = []
    for name, feet in under.items():
        frames = len(feet.source)
        words = {
            WrenchSource.SHARED: ("contact.shared", "contacts share a plate, and the wrench of each is estimated"),
            WrenchSource.PREDICTED: ("contact.predicted", "contacts beside plates bear what the body needs"),
        }
        for source, (code, said) in words.items():
            own = feet.source == source
            count, which = int(own.any(dim=1).sum()), own.any(dim=0).nonzero()[:, 0].tolist()
            # Contacts that a body names are feet.
            named = dict.fromkeys("feet" if feet.contacts[k] == feet.body[k] else feet.contacts[k] for k in which)
            if count:
                notes.append(Note(code, f"in {count} of {frames} frames {said}: {', '.join(named)}", name))
        if feet.status is SharingStatus.UNCONVERGED:
            notes.append(
                Note("contact.unsettled", "shares of a plate did not settle; their torques are left out", name)
            )
    return notes
