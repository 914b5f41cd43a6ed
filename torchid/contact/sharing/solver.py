"""Sharing: who bears what of totals that are known, with a status that raises unless it is asked not to."""

from dataclasses import dataclass
from enum import Enum

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.contact.options import SolverOptions
from torchid.contact.sharing.alternation import alternate, bending, frame_blocks
from torchid.contact.sharing.problem import SharingProblem, checked, grasp, project_on_cones
from torchid.dynamics.equations_of_motion import wrench_about
from torchid.errors import DataError


class SharingStatus(Enum):
    """How a solution came about."""

    SOLVED = "solved"
    RELAXED = "relaxed"
    """Totals that the patches cannot bear: some cones had to give, by ``violation``."""
    UNCONVERGED = "unconverged"


def worse(one: SharingStatus, other: SharingStatus) -> SharingStatus:
    """Return the one of two that says less of its solution."""
    return max(one, other, key=list(SharingStatus).index)


@dataclass(frozen=True)
class SharedWrenches:
    """Solution of a problem of shared contact."""

    wrench: Float[Tensor, "frames contacts 6"]
    """About the world's origin; frames that are not open as they were given, NaN where nothing was."""
    violation: Float[Tensor, " frames"]
    """Distance of the point forces from their cones [N]."""
    status: SharingStatus
    iterations: int
    residual: float
    """The larger of both residuals at the end, as a part of the largest total force."""


def share(problem: SharingProblem, options: SolverOptions | None = None, throw: bool = True) -> SharedWrenches:
    """Share every frame's totals among the contacts that may bear.

    Args:
        problem: totals, contacts and costs.
        options: tolerance and weights of the solver.
        throw: whether an unconverged solution raises.

    Returns:
        Wrenches that sum to the totals whatever the status, and how far they had to leave the cones.

    Raises:
        DataError: ``sharing.unconverged``, and what ``problem.checked`` finds.
    """
    options = options or SolverOptions()
    problem, sought = checked(problem), problem.sought()
    given = problem.given
    out = torch.full_like(problem.rows[:, 0], torch.nan) if given is None else given.clone()
    gone = problem.total.new_zeros(len(problem.total))
    if not bool(sought.any()):
        return SharedWrenches(out, gone, SharingStatus.SOLVED, 0, 0.0)
    own = problem.frames(sought)
    size = float(own.total[..., :3].norm(dim=-1).max().clamp(min=1.0))
    weight = own.bearing[:, own.owner].to(own.points.dtype)[..., None]
    about = (own.points * weight).sum(1) / weight.sum(1).clamp(min=1.0)
    x, done, residual = alternate(frame_blocks(own, about, size), bending(problem, sought, size), options)
    wrench = size * (grasp(own, about) @ x.flatten(1)[:, None, :, None])[..., 0]
    out[sought] = wrench_about(wrench, -about[:, None].expand(-1, problem.contacts, -1))
    gone[sought] = size * (x - project_on_cones(x, own.friction)).flatten(1).norm(dim=1)
    status = SharingStatus.SOLVED if bool((gone < 1e2 * options.tolerance * size).all()) else SharingStatus.RELAXED
    status = status if residual <= options.tolerance else SharingStatus.UNCONVERGED
    if throw and status is SharingStatus.UNCONVERGED:
        raise DataError(
            "sharing.unconverged", "the shares of contacts did not settle",
            found=f"residual {residual:.1e} after {done} iterations",
            remedy="Ask for more iterations or a wider tolerance, or take the result with its status (throw=False).",
        )  # fmt: skip
    return SharedWrenches(out, gone, status, done, residual)
