"""Coulomb's cones of point forces: the projection on them, and the point that a give-limited cone draws towards."""

import torch
from jaxtyping import Float
from torch import Tensor


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
