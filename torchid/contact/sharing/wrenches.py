"""The wrench under every foot: measured where a plate bears it alone, shared where several stand on one, predicted."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchid.contact.contact import Contact
from torchid.contact.options import ContactOptions
from torchid.contact.runs import dilate, spread
from torchid.contact.sharing.expected import expected_rows, spread_of_shares
from torchid.contact.sharing.likely import Feet, likely
from torchid.contact.sharing.options import SolverOptions
from torchid.contact.sharing.problem import SharingProblem
from torchid.contact.sharing.records import ContactWrenches, Needed, Source
from torchid.contact.sharing.soles import sole_patch
from torchid.contact.sharing.solver import SharingStatus, share, worse
from torchid.contact.support import over_plates
from torchid.filters import Smoother
from torchid.recording import Forces

WIDER_S = 0.05
"""Chosen: a foot may bear for so long before and after it is seen to touch [s]: heels strike at up to 1 m/s, which
counts as touching 20 to 40 ms later (walks of three subjects, against their plates)."""
BEND_SD = 150.0
"""Derived: second derivative of a foot's force over the body's weight [1/s^2], RMS in double support at 100 Hz, heel
strikes included: twice that of the vertical component of three subjects, so that a strike is not rounded off."""
BLOCK = 2048
"""Frames that are shared together; fixed, of which the matrices take some 50 MB."""

Effort = Callable[[slice], tuple[Float[Tensor, "frames rows contacts 6"], Float[Tensor, "frames rows"]]]
"""Rows and aims of joint torques over their standard deviations, of some frames."""


@dataclass(frozen=True)
class _Task:
    """Frames whose total several feet share."""

    total: Tensor
    bearing: Tensor
    open: Tensor
    given: Tensor

    @property
    def part(self) -> Tensor:
        """(frames, feet): feet that take a share."""
        return self.open[:, None] & self.bearing


class _Found(NamedTuple):
    """Given wrenches and shares together, doubts of the shares, how they came about, and what did not settle."""

    wrench: Tensor
    doubt: Tensor
    status: SharingStatus
    lost: Tensor


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
) -> ContactWrenches:
    """Return the wrench under every foot of a trial, with its source and its standard deviation.

    The samples of plates are shared before they are filtered, since feet come and go within the filter's reach; shares
    of one plate sum to its wrench then as they do now. What the body needs beyond the plates is filtered already.

    Args:
        contact: which foot touches, and which plate bears which.
        soles: points of each foot in W, heel first, tip of the toes last [m].
        forces: of the plates, on the clock of the markers; of none where nothing was measured.
        com: centre of mass of the body in W [m].
        smoother: filter of the motion.
        needed: what the body needs; None where only plates count.
        effort: rows of joint torques; None leaves them out.
        options: of contact; those of ``find_contact``.
        solver: of the sharing.

    Returns:
        Wrenches whose sum over the contacts of a plate is the plate's own, and of those beside plates the remainder.
    """
    options = options or ContactOptions()
    wide = _wide(contact, round(WIDER_S * smoother.rate_hz))
    height = _height(forces)
    raw = torch.nan_to_num(forces.wrench)
    own = torch.stack([(raw * (contact.plate == k)[..., None]).sum(1) for k in range(len(contact.feet))], dim=1)
    shared = _shared(contact, wide, raw, own, _over(soles, forces, options.margin_m))
    costs = _Costs(soles, com, height, effort, smoother, options, solver)
    found = costs.share(shared)
    gone = contact.touching & ~contact.supported & ~shared.part
    stray = contact.touching & ((contact.plate == -2).any(dim=1) & ~shared.open)[:, None]
    source = torch.where(shared.part, int(Source.SHARED), int(Source.MEASURED))
    source = torch.where(gone | stray | (shared.part & found.lost[:, None]), int(Source.UNKNOWN), source)
    wrench, doubt, status = smoother(found.wrench), found.doubt, found.status
    if needed is not None and bool(gone.any()):
        beside = _beside(gone, needed, smoother(raw.sum(1)), round(WIDER_S * smoother.rate_hz))
        more = costs.share(beside)
        part = beside.part & ~more.lost[:, None] & ~shared.part
        wrench = wrench + torch.where(part[..., None], more.wrench, 0.0)
        doubt = _with_needed(doubt, more.doubt, needed.factor, part)
        source = torch.where(part, int(Source.PREDICTED), source)
        status = worse(status, more.status)
    doubtful = doubt.flatten(1).any(dim=1).nonzero()[:, 0]
    return ContactWrenches(contact.feet, wrench, source, doubtful, doubt[doubtful], status)


def _with_needed(doubt: Tensor, more: Tensor, needed: Tensor, part: Tensor) -> Tensor:
    """Doubts of shares, with those of contacts that bear a part of what the body needs, and so of its error."""
    each = (part / part.sum(dim=1, keepdim=True).clamp(min=1)).to(needed)
    whole = torch.cat([more, (each[..., None, None] * needed[:, None]).flatten(1, 2)], dim=2)
    known = torch.cat([doubt, torch.zeros_like(needed[:, :1]).expand(-1, doubt.shape[1], -1)], dim=2)
    return torch.where(part.repeat_interleave(6, dim=1)[..., None], whole, known)


def _wide(contact: Contact, frames: int) -> Bool[Tensor, "frames feet"]:
    """Feet that may bear: those that touch, and those about to or just gone."""
    return torch.stack([dilate(column, frames) for column in contact.touching.unbind(1)], dim=1)


def _height(forces: Forces) -> float:
    corners = [float(plate.corners[:, 2].mean()) for plate in forces.plates if plate.corners is not None]
    return sum(corners) / len(corners) if corners else 0.0


def _over(
    soles: dict[str, Tensor], forces: Forces, margin: float
) -> tuple[Bool[Tensor, "frames plates feet"], Bool[Tensor, "frames plates feet"]]:
    """Feet that are over a plate with some of the sole, and with all of it; a plate without corners may be anywhere."""
    shape = len(forces.time), len(forces.plates), len(soles)
    some = torch.ones(shape, dtype=torch.bool, device=forces.wrench.device)
    whole = torch.zeros_like(some)
    for p, plate in enumerate(forces.plates):
        if plate.corners is not None:
            inside = [over_plates(sole, [plate.corners], margin) for sole in soles.values()]
            some[:, p] = torch.stack([one.any(dim=1) for one in inside], dim=1)
            whole[:, p] = torch.stack([one.all(dim=1) for one in inside], dim=1)
    return some, whole


def _shared(contact: Contact, wide: Tensor, raw: Tensor, own: Tensor, over: tuple[Tensor, Tensor]) -> _Task:
    """Frames of plates that bear more than one foot: those that tell none or have two, and double support around them.

    A plate's pressure lies under one foot still when the other begins to bear; such frames belong to the run of frames
    in which both may bear and no other plate reads the second foot.
    """
    feet = torch.arange(len(contact.feet), device=raw.device)
    total, bearing, opened = torch.zeros_like(raw.sum(1)), torch.zeros_like(wide), wide.new_zeros(len(wide))
    given = own.clone()
    for p in range(raw.shape[1]):
        mine = contact.plate[:, p]
        others = torch.cat([contact.plate[:, :p], contact.plate[:, p + 1 :]], dim=1)
        may = wide & over[0][:, p] & ~(others[..., None] == feet).any(dim=1)
        several = (may.sum(dim=1) > 1) & (mine != -1)
        untold = mine == -2
        both = contact.touching & may
        sure = untold | (several & (((both & over[1][:, p]).sum(dim=1) > 1) | (untold.any() & (both.sum(dim=1) > 1))))
        frames = spread(sure, several) & may.any(dim=1)
        total += torch.where(frames[:, None], raw[:, p], 0.0)
        bearing |= frames[:, None] & may
        told = frames[:, None] & (mine[:, None] == feet)
        given -= torch.where(told[..., None], raw[:, p, None], 0.0)
        opened |= frames
    return _Task(total, bearing, opened, given)


def _beside(gone: Tensor, needed: Needed, plates: Tensor, frames: int) -> _Task:
    """Frames in which feet beside the plates bear what the body needs more than the plates bear."""
    bearing = torch.stack([dilate(column, frames) for column in gone.unbind(1)], dim=1)
    open_ = bearing.any(dim=1) & needed.known
    rest = torch.nan_to_num(needed.wrench) - torch.nan_to_num(plates)
    return _Task(rest, bearing, open_, torch.zeros(*bearing.shape, 6).to(rest))


@dataclass(frozen=True)
class _Costs:
    """All that tells shares beforehand."""

    soles: dict[str, Tensor]
    com: Tensor
    height: float
    effort: Effort | None
    smoother: Smoother
    options: ContactOptions
    solver: SolverOptions | None

    def share(self, task: _Task) -> _Found:
        """Share the totals of a task, block by block."""
        size = task.given[0].numel()
        none = task.given.new_zeros(len(task.given), size, size)
        found = _Found(task.given.clone(), none, SharingStatus.SOLVED, ~task.open & task.open)
        if not bool(task.open.any()):
            return found
        own = torch.where(task.open[:, None], task.total, task.given.sum(1))
        alone = task.given[..., 2] > self.options.loaded_n
        bearing = torch.where(task.open[:, None], task.bearing, alone)
        rows = expected_rows(likely(Feet(tuple(self.soles.values()), own, self.com, bearing, self.height)))
        for start in range(0, len(own), BLOCK):
            part = slice(start, start + BLOCK)
            if bool(task.open[part].any()):
                status = self._block(task, rows[part], part, found)
                found = found._replace(status=worse(found.status, status))
        return found

    def _block(self, task: _Task, rows: Tensor, part: slice, found: _Found) -> SharingStatus:
        """Fill in the shares of a block."""
        problem, some = self._problem(task, rows, part), task.open[part]
        shares = share(problem, self.solver, throw=False)
        found.wrench[part][some] += shares.wrench[some]
        sums = problem.total.new_ones(1, problem.contacts)
        found.doubt[part][some] = spread_of_shares(problem.rows[some], sums, problem.bearing[some])
        found.lost[part] = some & (shares.status is SharingStatus.UNCONVERGED)
        return shares.status

    def _problem(self, task: _Task, rows: Tensor, part: slice) -> SharingProblem:
        aim = rows.new_zeros(rows.shape[:2])
        if self.effort is not None:
            more, wanted = self.effort(part)
            rows, aim = torch.cat([rows, more], dim=1), torch.cat([aim, wanted], dim=1)
        patches = [sole_patch(sole[part], self.height, self.options.margin_m) for sole in self.soles.values()]
        points = torch.cat(patches, dim=1)
        count, device = len(patches), points.device
        owner = torch.arange(count, device=device).repeat_interleave(4)
        weight = float(task.total[task.open][:, 2].abs().max().clamp(min=1.0))
        bend = rows.new_full((3,), BEND_SD * weight / self.smoother.rate_hz**2)
        return SharingProblem(
            task.total[part, None], torch.zeros(count, dtype=torch.long, device=device), task.bearing[part], points,
            owner, rows.new_full((4 * count,), self.options.friction), torch.eye(3).to(rows).expand(4 * count, 3, 3),
            rows, aim, bend, task.given[part], task.open[part],
        )  # fmt: skip
