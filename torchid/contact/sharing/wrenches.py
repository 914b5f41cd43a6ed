"""The wrench of every contact: measured where a plate bears it alone, shared where several are on one, predicted."""

from dataclasses import replace

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchid.contact.contact import Contact
from torchid.contact.options import ContactOptions, SolverOptions
from torchid.contact.sharing.costs import Costs, Effort, ShareSolution, Task, untouched
from torchid.contact.sharing.patches import Patch, rest_of
from torchid.contact.sharing.records import ContactWrenches, Needed, WrenchSource
from torchid.contact.sharing.solver import worse
from torchid.contact.support import over_each
from torchid.filters import Smoother
from torchid.recording import Forces
from torchid.runs import dilate, spread

WIDER_S = 0.05
"""Chosen: a foot may bear for so long before and after it is seen to touch [s]: heels strike at up to 1 m/s, which
counts as touching 20 to 40 ms later (walks of three subjects, against their plates). So may other contacts."""


def contact_wrenches(
    contact: Contact,
    soles: dict[str, Float[Tensor, "frames points 3"]],
    forces: Forces,
    com: Float[Tensor, "frames 3"],
    smoother: Smoother,
    needed: Needed | None = None,
    effort: Effort | None = None,
    options: ContactOptions | None = None,
    solver: SolverOptions | None = None,
    patches: dict[str, Patch] | None = None,
) -> ContactWrenches:
    """Return the wrench of every contact of a trial, with its source and its standard deviation.

    The samples of plates are shared before they are filtered, since feet come and go within the filter's reach; shares
    of one plate sum to its wrench then as they do now. What the body needs beyond the plates is filtered already.

    Args:
        contact: which foot touches, which other contact bears, and which plate bears which.
        soles: points of each foot in W, heel first, tip of the toes last [m].
        forces: of the plates, on the clock of the markers; of none where nothing was measured.
        com: centre of mass of the body in W [m].
        smoother: filter of the motion.
        needed: what the body needs; None where only plates count.
        effort: rows of joint torques; None leaves them out.
        options: of contact; those of ``find_contact``.
        patches: of the contacts other than feet, in the order of ``contact.others``.

    Returns:
        Wrenches whose sum over the contacts of a plate is the plate's own. Those of feet beside plates sum to what the
        body needs beyond the plates; where another contact is among them, to that but for its error.
    """
    options = options or ContactOptions()
    margin, count = round(WIDER_S * smoother.rate_hz), len(contact.contacts)
    wide = _wide(contact.bearing, margin)
    raw = torch.nan_to_num(forces.wrench)
    own = torch.stack([(raw * (contact.plate == k)[..., None]).sum(1) for k in range(count)], dim=1)
    costs = Costs(soles, com, _height(forces, contact), effort, smoother, options, solver, patches or {})
    found, part = _on_plates(contact, wide, raw, own, _over(contact, soles, forces, options.margin_m), costs)
    feet = part[:, : len(soles)]
    opened = torch.cat([feet.any(dim=1, keepdim=True).expand_as(feet), part[:, len(soles) :]], dim=1)
    gone, stray = contact.beside & ~part, contact.untold & ~opened
    source = torch.where(part, int(WrenchSource.SHARED), int(WrenchSource.MEASURED))
    source = torch.where(gone | stray | (part & found.lost[:, None]), int(WrenchSource.UNKNOWN), source)
    wrench, doubt, status = smoother(found.wrench), found.doubt, found.status
    if needed is not None and bool(gone.any()):
        beside = replace(_beside(gone, needed, smoother(raw.sum(1)), margin, len(soles)), besides=wrench)
        more = costs.share(beside)
        told = beside.part[:, :count] & ~more.lost[:, None] & ~part
        wrench = wrench + torch.where(told[..., None], more.wrench[:, :count], 0.0)
        doubt = _with_needed(doubt, more.doubt[:, : 6 * count], needed.factor, told, beside)
        source = torch.where(told, int(WrenchSource.PREDICTED), source)
        status = worse(status, more.status)
    doubtful = doubt.flatten(1).any(dim=1).nonzero()[:, 0]
    return ContactWrenches(contact.contacts, wrench, source, doubtful, doubt[doubtful], status, contact.bodies)


def _with_needed(doubt: Tensor, more: Tensor, needed: Tensor, part: Tensor, task: Task) -> Tensor:
    """Doubts of shares, with those of contacts that bear a part of what the body needs, and so of its error."""
    each = (part / part.sum(dim=1, keepdim=True).clamp(min=1)).to(needed)
    errors = (each[..., None, None] * needed[:, None]).flatten(1, 2)
    whole = torch.cat([more[..., : more.shape[1]], errors], dim=2)
    if task.rest is not None:  # which has the error among the causes of its shares
        whole = torch.where(task.bearing[:, -1, None, None], more, whole)
    known = torch.cat([doubt, torch.zeros_like(needed[:, :1]).expand(-1, doubt.shape[1], -1)], dim=2)
    return torch.where(part.repeat_interleave(6, dim=1)[..., None], whole, known)


def _wide(bearing: Bool[Tensor, "frames contacts"], frames: int) -> Bool[Tensor, "frames contacts"]:
    """Contacts that may bear: those that do, and those about to or just gone."""
    return torch.stack([dilate(column, frames) for column in bearing.unbind(1)], dim=1)


def _height(forces: Forces, contact: Contact) -> float:
    plates = forces.plates if contact.floor is None else [forces.plates[p] for p in contact.floor]
    corners = [float(plate.corners[:, 2].mean()) for plate in plates if plate.corners is not None]
    return sum(corners) / len(corners) if corners else 0.0


def _over(
    contact: Contact, soles: dict[str, Tensor], forces: Forces, margin: float
) -> tuple[Bool[Tensor, "frames plates contacts"], Bool[Tensor, "frames plates contacts"]]:
    """Contacts that may be on a plate with a part of them, and those that are on it with all."""
    some, whole = over_each(soles, forces, margin)
    if contact.floor is not None:
        high = [p for p in range(len(forces.plates)) if p not in contact.floor]
        some[:, high] = whole[:, high] = False
    if contact.others is None:
        return some, whole
    plates = torch.arange(len(forces.plates), device=some.device)[:, None]
    theirs = plates == torch.tensor(contact.others.column, device=some.device)
    return tuple(torch.cat([one, theirs.expand(len(one), -1, -1)], dim=2) for one in (some, whole))  # type: ignore[return-value]


def _on_plates(
    contact: Contact, wide: Tensor, raw: Tensor, own: Tensor, over: tuple[Tensor, Tensor], costs: Costs
) -> tuple[ShareSolution, Bool[Tensor, "frames contacts"]]:
    """Shares of plates that bear several contacts, and which contacts have one: of the floor, and of every other."""
    plates = range(raw.shape[1])
    floor = plates if contact.floor is None else contact.floor
    groups = [list(floor), *([p] for p in plates if p not in floor)]
    empty = Task(raw.new_zeros(len(raw), 6), torch.zeros_like(wide), wide.new_zeros(len(wide)), own)
    found, part = untouched(empty), torch.zeros_like(wide)
    for group in groups:
        task = _shared(contact, wide, raw, found.wrench, over, group)
        more = untouched(task, lost=True) if costs.options.torques == "measured" else costs.share(task)
        part = part | task.part
        found = ShareSolution(
            more.wrench, found.doubt + more.doubt, worse(found.status, more.status), found.lost | more.lost
        )
    return found, part


def _shared(
    contact: Contact, wide: Tensor, raw: Tensor, given: Tensor, over: tuple[Tensor, Tensor], plates: list[int]
) -> Task:
    """Frames of plates that bear more than one contact: those that tell none or have two, and double support around
    them.

    A plate's pressure lies under one foot still when the other begins to bear; such frames belong to the run of frames
    in which both may bear and no other plate reads the second foot.
    """
    contacts = torch.arange(wide.shape[1], device=raw.device)
    total, bearing, opened = torch.zeros_like(raw.sum(1)), torch.zeros_like(wide), wide.new_zeros(len(wide))
    given = given.clone()
    for p in plates:
        mine = contact.plate[:, p]
        others = torch.cat([contact.plate[:, :p], contact.plate[:, p + 1 :]], dim=1)
        may = wide & over[0][:, p] & ~(others[..., None] == contacts).any(dim=1)
        several = (may.sum(dim=1) > 1) & (mine != -1)
        untold = mine == -2
        both = contact.bearing & may
        sure = untold | (several & (((both & over[1][:, p]).sum(dim=1) > 1) | (untold.any() & (both.sum(dim=1) > 1))))
        frames = spread(sure, several) & may.any(dim=1)
        total += torch.where(frames[:, None], raw[:, p], 0.0)
        bearing |= frames[:, None] & may
        told = frames[:, None] & (mine[:, None] == contacts)
        given -= torch.where(told[..., None], raw[:, p, None], 0.0)
        opened |= frames
    return Task(total, bearing, opened, given)


def _beside(gone: Tensor, needed: Needed, plates: Tensor, frames: int, feet: int) -> Task:
    """Frames in which contacts beside the plates bear what the body needs more than the plates bear.

    Feet bear whatever is needed; other contacts bear what they can, and leave the rest.
    """
    bearing = _wide(gone, frames)
    open_ = bearing.any(dim=1) & needed.known
    total = torch.nan_to_num(needed.wrench) - torch.nan_to_num(plates)
    rest = rest_of(needed) if bearing.shape[1] > feet else None
    if rest is not None:
        bearing = torch.cat([bearing, bearing[:, feet:].any(dim=1, keepdim=True)], dim=1)
    return Task(total, bearing, open_, total.new_zeros(*bearing.shape, 6), rest)
