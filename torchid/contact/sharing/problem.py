"""The problem of shared contact: totals that are known, contacts that make them up, and what is likely beforehand."""

from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from torchid.errors import DataError


@dataclass(frozen=True)
class SharingProblem:
    """Wrenches of contacts, frame by frame, whose sums are known.

    A contact is whatever may bear: a foot, a hand on a rail, a seat. It bears by forces at the points of its patch, so
    that a push, friction and a centre of pressure inside the patch are one and the same condition on those forces. A
    contact that reaches over two plates is two contacts with the same points, one per plate.
    """

    total: Float[Tensor, "frames groups 6"]
    """Sum of the wrenches of each group of contacts (of a plate, or of the whole body) about the world's origin."""
    group: Int[Tensor, " contacts"]
    """Group that each contact belongs to."""
    bearing: Bool[Tensor, "frames contacts"]
    """Whether a contact may bear."""
    points: Float[Tensor, "frames points 3"]
    """Points of all patches in W [m]."""
    owner: Int[Tensor, " points"]
    """Contact whose patch each point belongs to."""
    friction: Float[Tensor, " points"]
    """Coefficient of friction; infinite where the contact holds on."""
    axes: Float[Tensor, "points 3 3"]
    """Two tangents and the normal of the surface under each point, as rows, in W."""
    rows: Float[Tensor, "frames rows contacts 6"]
    """Rows of the cost on the wrenches about the world's origin, over the standard deviation of what each predicts."""
    aim: Float[Tensor, "frames rows"]
    """What the rows predict, over the same."""
    bend_sd: Float[Tensor, "3"] | None = None
    """Standard deviation of the second difference of a contact's force along the frames [N]; None couples no frames."""
    given: Float[Tensor, "frames contacts 6"] | None = None
    """Wrenches of the frames that are not ``open``."""
    open: Bool[Tensor, " frames"] | None = None
    """Frames whose wrenches are sought; None for all. The others only continue their forces."""

    @property
    def contacts(self) -> int:
        """Number of contacts."""
        return len(self.group)

    def sought(self) -> Bool[Tensor, " frames"]:
        """Frames whose wrenches are sought."""
        everywhere = torch.ones(len(self.total), dtype=torch.bool, device=self.total.device)
        return everywhere if self.open is None else self.open

    def frames(self, part: slice | Tensor) -> "SharingProblem":
        """Some of the frames."""
        some = {name: getattr(self, name)[part] for name in ("total", "bearing", "points", "rows", "aim")}
        rest = {name: None if getattr(self, name) is None else getattr(self, name)[part] for name in ("given", "open")}
        return replace(self, **some, **rest)


def checked(problem: SharingProblem) -> SharingProblem:
    """Return the problem if it can be posed.

    Raises:
        DataError: ``sharing.unknown`` where a sought frame holds what is not finite, ``sharing.groups`` where a contact
            belongs to no group or a point to no contact, ``sharing.friction`` where friction is negative.
    """
    sought = problem.sought()
    for name in ("total", "points", "rows", "aim"):
        finite = torch.isfinite(getattr(problem, name)[sought]).flatten(1).all(dim=1)
        if not bool(finite.all()):
            frame = int(sought.nonzero()[:, 0][~finite][0])
            raise DataError(
                "sharing.unknown", f"`{name}` of a frame to be shared is not known", place=f"frame {frame}",
                remedy="Leave the frame out of `open`.",
            )  # fmt: skip
    numbers = (problem.group, problem.total.shape[1]), (problem.owner, problem.contacts)
    for index, count in numbers:
        if len(index) and not bool(((index >= 0) & (index < count)).all()):
            raise DataError(
                "sharing.groups", "a contact without a total, or a point without a contact",
                found=str(index.tolist()), remedy=f"Number them from 0 to {count - 1}.",
            )  # fmt: skip
    if bool((problem.friction < 0.0).any()) or bool(torch.isnan(problem.friction).any()):
        raise DataError(
            "sharing.friction", "a coefficient of friction is negative or unknown",
            found=str(problem.friction.tolist()), remedy="Give 0 for a smooth surface, infinity for a grip.",
        )  # fmt: skip
    return problem


def grasp(problem: SharingProblem, about: Float[Tensor, "frames 3"]) -> Float[Tensor, "frames contacts 6 columns"]:
    """Return the map from point forces, in their surfaces' axes, to the contacts' wrenches about a point.

    Columns of contacts that do not bear are zero.

    Args:
        about: point in W of every frame [m].
    """
    axes = problem.axes.to(problem.points.dtype)
    arm = (problem.points - about[:, None])[:, :, None].expand(-1, -1, 3, -1)
    force = axes.expand(len(arm), -1, -1, -1)
    unit = torch.cat([force, torch.linalg.cross(arm, force)], dim=-1)
    own = torch.nn.functional.one_hot(problem.owner, problem.contacts).to(unit.dtype)
    active = own[None] * problem.bearing[:, None].to(unit.dtype)
    found = torch.einsum("tpjw,tpc->tcwpj", unit, active)
    return found.flatten(3)


def moved_rows(
    rows: Float[Tensor, "frames rows contacts 6"], about: Float[Tensor, "frames 3"]
) -> Float[Tensor, "frames rows contacts 6"]:
    """Return rows on wrenches about the world's origin as rows on wrenches about a point.

    The moment about the origin is m + r x f: a row with parts (a, b) becomes (a + b x r, b).
    """
    force, moment = rows[..., :3], rows[..., 3:]
    arm = about[:, None, None].expand_as(moment)
    return torch.cat([force + torch.linalg.cross(moment, arm), moment], dim=-1)


def summed(problem: SharingProblem) -> Float[Tensor, "groups contacts"]:
    """Return which contacts each total sums, as zeros and ones."""
    groups = problem.total.shape[1]
    return torch.nn.functional.one_hot(problem.group, groups).to(problem.total.dtype).T


def project_on_cones(
    force: Float[Tensor, "*batch points 3"], friction: Float[Tensor, " points"]
) -> Float[Tensor, "*batch points 3"]:
    """Return the nearest point forces that a surface can exert.

    The cone is |f_t| <= mu f_n, whose polar holds what is projected on the tip. An infinite friction is a grip, which
    pulls as well as it pushes: its forces stay as they are.

    Args:
        force: tangential, tangential and normal component of every point force [N].
        friction: coefficient mu of every point.

    Returns:
        Point forces of the same shape [N].

    Reference:
        Boyd & Vandenberghe, Convex Optimization (2004), section 8.1.1 (projection on a second-order cone).
    """
    grip = torch.isinf(friction)
    mu = torch.where(grip, torch.ones_like(friction), friction)
    slip, press = force[..., :2].norm(dim=-1), force[..., 2]
    onto = ((mu * slip + press) / (1.0 + mu.square())).clamp(min=0.0)
    inside = (slip <= mu * press) | grip
    shrink = mu * onto / slip.clamp(min=torch.finfo(force.dtype).tiny)
    nearest = torch.cat([shrink[..., None] * force[..., :2], onto[..., None]], dim=-1)
    return torch.where(inside[..., None], force, nearest)


def drawn_to_cones(
    force: Float[Tensor, "frames points 3"], friction: Float[Tensor, " points"], step: float
) -> Float[Tensor, "frames points 3"]:
    """Return the proximal point of ``step`` times each frame's distance from its cones.

    A frame that is nearer than ``step`` comes to lie on them, one that is further is drawn by ``step``. The distance
    itself, not its square, is what a minimum pays, so that the cones hold exactly wherever the totals allow it.

    Args:
        force: point forces in tangential and normal components.
        friction: coefficient of every point.
        step: length, in the unit of the forces.
    """
    nearest = project_on_cones(force, friction)
    distance = (force - nearest).flatten(1).norm(dim=1).clamp(min=torch.finfo(force.dtype).tiny)
    return force + (step / distance).clamp(max=1.0)[:, None, None] * (nearest - force)
