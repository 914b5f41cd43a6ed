"""Totals that several contacts share, and all that tells their shares beforehand."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchid.contact.options import ContactOptions, SolverOptions
from torchid.contact.sharing.expected import expected_rows, spread_of_shares
from torchid.contact.sharing.likely import FeetOnGround, likely
from torchid.contact.sharing.patches import Patch, Rest, patch_rows
from torchid.contact.sharing.problem import SharingProblem
from torchid.contact.sharing.soles import sole_patch
from torchid.contact.sharing.solver import SharingStatus, share, worse
from torchid.filters import Smoother

BEND_SD = 150.0
"""Derived: second derivative of a foot's force over the body's weight [1/s^2], RMS in double support at 100 Hz, heel
strikes included: twice that of the vertical component of three subjects, so that a strike is not rounded off."""
BLOCK = 2048
"""Frames that are shared together; fixed, of which the matrices take some 50 MB."""

Effort = Callable[[slice], tuple[Float[Tensor, "frames rows contacts 6"], Float[Tensor, "frames rows"]]]
"""Rows and aims of joint torques over their standard deviations, of some frames."""


@dataclass(frozen=True)
class Task:
    """Frames whose total several contacts share."""

    total: Float[Tensor, "frames 6"]
    bearing: Bool[Tensor, "frames contacts"]
    open: Bool[Tensor, " frames"]
    given: Float[Tensor, "frames contacts 6"]
    rest: Rest | None = None
    """A last contact, of ``bearing`` and ``given`` too, that is nobody: the error of the total."""
    besides: Float[Tensor, "frames known 6"] | None = None
    """What contacts bear already besides their shares, which joints answer for; None: what is given."""

    @property
    def part(self) -> Bool[Tensor, "frames contacts"]:
        """Contacts that take a share."""
        return self.open[:, None] & self.bearing


class ShareSolution(NamedTuple):
    """Given wrenches and shares together, doubts of the shares, how they came about, and what did not settle."""

    wrench: Tensor
    doubt: Tensor
    status: SharingStatus
    lost: Tensor


@dataclass(frozen=True)
class Costs:
    """All that tells shares beforehand."""

    soles: dict[str, Float[Tensor, "frames points 3"]]
    com: Float[Tensor, "frames 3"]
    height: float
    """Of the ground [m]."""
    effort: Effort | None
    smoother: Smoother
    options: ContactOptions
    solver: SolverOptions | None
    patches: dict[str, Patch] = field(default_factory=dict)
    """Of the contacts behind the feet."""

    def share(self, task: Task) -> ShareSolution:
        """Return the shares of a task's totals, found block by block.

        Args:
            task: totals and who may bear them; of no frame, it is returned as it is given.
        """
        found = untouched(task)
        if not bool(task.open.any()):
            return found
        rows = self._rows(task)
        for start in range(0, len(task.total), BLOCK):
            part = slice(start, start + BLOCK)
            if bool(task.open[part].any()):
                status = self._block(task, rows[part], part, found)
                found = found._replace(status=worse(found.status, status))
        return found

    def _rows(self, task: Task) -> Float[Tensor, "frames rows contacts 6"]:
        """Rows of every contact by itself."""
        frames, contacts, feet = len(task.total), task.bearing.shape[1], len(self.soles)
        some, owner = [], []
        if feet:
            own = torch.where(task.open[:, None], task.total, task.given[:, :feet].sum(1))
            alone = task.given[:, :feet, 2] > self.options.loaded_n
            bearing = torch.where(task.open[:, None], task.bearing[:, :feet], alone)
            stand = likely(FeetOnGround(tuple(self.soles.values()), own, self.com, bearing, self.height))
            own_rows = expected_rows(stand)
            some += [own_rows[:, 5 * k : 5 * k + 5, k] for k in range(feet)]
        load = task.total[:, :3].norm(dim=1) / task.bearing.sum(dim=1).clamp(min=1)
        some += [patch_rows(patch, load) for patch in self.patches.values()]
        some += [] if task.rest is None else [task.rest.rows]
        for k, own_rows in enumerate(some):
            empty = own_rows.new_zeros(frames, own_rows.shape[1], contacts, 6)
            empty[:, :, k] = own_rows
            owner.append(empty)
        return torch.cat(owner, dim=1)

    def _block(self, task: Task, rows: Tensor, part: slice, found: ShareSolution) -> SharingStatus:
        """Fill in the shares of a block."""
        problem, some = self._problem(task, rows, part), task.open[part]
        shares = share(problem, self.solver, throw=False)
        found.wrench[part][some] += shares.wrench[some]
        sums = problem.total.new_ones(1, problem.contacts)
        found.doubt[part][some] = spread_of_shares(problem.rows[some], sums, problem.bearing[some])
        found.lost[part] = some & (shares.status is SharingStatus.UNCONVERGED)
        return shares.status

    def _problem(self, task: Task, rows: Tensor, part: slice) -> SharingProblem:
        aim = rows.new_zeros(rows.shape[:2])
        if self.effort is not None:
            more, wanted = self.effort(part)
            besides = (task.given if task.besides is None else task.besides)[part]
            wanted = wanted - torch.einsum("trcw,tcw->tr", more, besides)
            if task.rest is not None:
                more = torch.cat([more, torch.zeros_like(more[:, :, :1])], dim=2)
            rows, aim = torch.cat([rows, more], dim=1), torch.cat([aim, wanted], dim=1)
        surfaces = self._surfaces(task.rest, part)
        owner = [torch.full((one.points.shape[1],), k) for k, one in enumerate(surfaces)]
        friction = [rows.new_full((one.points.shape[1],), one.friction) for one in surfaces]
        axes = [one.axes.expand(one.points.shape[1], 3, 3) for one in surfaces]
        weight = float(task.total[task.open][:, :3].norm(dim=1).max().clamp(min=1.0))
        bend = rows.new_full((3,), BEND_SD * weight / self.smoother.rate_hz**2)
        group = torch.zeros(len(surfaces), dtype=torch.long, device=rows.device)
        return SharingProblem(
            task.total[part, None], group, task.bearing[part], torch.cat([one.points for one in surfaces], dim=1),
            torch.cat(owner).to(rows.device), torch.cat(friction), torch.cat(axes), rows, aim, bend, task.given[part],
            task.open[part],
        )  # fmt: skip

    def _surfaces(self, rest: Rest | None, part: slice) -> list[Patch]:
        """Patches of all contacts in some frames, feet first."""
        level, margin = torch.eye(3).to(self.com), self.options.margin_m
        found = [
            Patch(sole_patch(sole[part], self.height, margin), level, self.options.friction)
            for sole in self.soles.values()
        ]
        found += [replace(patch, points=patch.points[part]) for patch in self.patches.values()]
        return found if rest is None else [*found, Patch(rest.points[part], level, torch.inf)]


def untouched(task: Task, lost: bool = False) -> ShareSolution:
    """Return what a task gives, with no share of its totals.

    Args:
        task: totals and who may bear them.
        lost: whether its frames count as not told.
    """
    size = task.given[0].numel()
    none = task.given.new_zeros(len(task.given), size, size)
    return ShareSolution(task.given.clone(), none, SharingStatus.SOLVED, task.open & lost)
