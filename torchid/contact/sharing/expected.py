"""What is likely of a contact's wrench before any plate is asked, as rows of the cost of sharing."""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

CENTRE_SD_M = 0.015, 0.010
"""Derived: how far centres of pressure lie from where ``rolling`` expects them, along the sole and across [m], RMS over
the double supports of three subjects."""
LEAN_SD = 0.06
"""Derived: error of f_xy / f_z of a foot, against ``rolling``, RMS over the same, heel strikes left out."""
TWIST_SD_M = 0.004
"""Derived: free moment about the vertical over the load, of feet in double support [m]."""
LIGHT = 0.1
"""Chosen: a contact with less than this part of the total is judged as if it bore so much; a hardly loaded foot keeps
no rule."""
FAINT_N = 20.0
"""Chosen: neither is any contact judged as if it bore less than this, at which a plate counts as loaded."""


@dataclass(frozen=True)
class Expected:
    """Where contacts press, how their forces lean and what they bear, as far as it can be told beforehand."""

    centre: Float[Tensor, "frames contacts 3"]
    """Centre of pressure in W [m]."""
    along: Float[Tensor, "frames contacts 2"]
    """Horizontal unit vector along the patch."""
    centre_sd: Float[Tensor, "frames contacts 2"]
    """Of the centre, along the patch and across [m]."""
    lean: Float[Tensor, "frames contacts 2"]
    """Horizontal over vertical force."""
    load: Float[Tensor, "frames contacts"]
    """Vertical force [N], to which errors of wrenches are in proportion."""


def expected_rows(expected: Expected) -> Float[Tensor, "frames rows contacts 6"]:
    """Return five rows per contact on wrenches about the world's origin; all of them aim at zero.

    With the moment m about the origin and the centre c, the moment about c is m - c x f. Its horizontal part is the
    vertical force times the distance of the centre of pressure, its vertical part the free moment; f_xy - lean f_z is
    what the force leans beyond what is expected. Each is divided by its standard deviation times the load.
    """
    frames, contacts = expected.load.shape
    load = expected.load.clamp(min=FAINT_N)[..., None, None]
    x, y, z = expected.centre.unbind(-1)
    zero, one = torch.zeros_like(x), torch.ones_like(x)
    moment_x = torch.stack([zero, z, -y, one, zero, zero], -1)
    moment_y = torch.stack([-z, zero, x, zero, one, zero], -1)
    moment_z = torch.stack([y, -x, zero, zero, zero, one], -1)
    ex, ey = expected.along[..., 0, None], expected.along[..., 1, None]
    along, across = -ex * moment_y + ey * moment_x, ey * moment_y + ex * moment_x
    lean_x = torch.stack([one, zero, -expected.lean[..., 0], zero, zero, zero], -1)
    lean_y = torch.stack([zero, one, -expected.lean[..., 1], zero, zero, zero], -1)
    sd = torch.stack([*expected.centre_sd.unbind(-1), one * TWIST_SD_M, one * LEAN_SD, one * LEAN_SD], -1)
    own = torch.stack([along, across, moment_z, lean_x, lean_y], dim=2) / (sd[..., None] * load)
    rows = own.new_zeros(frames, contacts, 5, contacts, 6)
    for k in range(contacts):
        rows[:, k, :, k] = own[:, k]
    return rows.flatten(1, 2)


def spread_of_shares(
    rows: Float[Tensor, "frames rows contacts 6"],
    sums: Float[Tensor, "groups contacts"],
    bearing: Tensor,
) -> Float[Tensor, "frames wrenches causes"]:
    """Return how shared wrenches about the world's origin scatter, as a factor of their covariance, without the cones.

    The covariance is the upper left block of the inverse of the optimality conditions [[R'R, E'], [E, 0]]; the factor
    is its symmetric root, which changes as smoothly along the frames as the covariance does.

    Args:
        rows: of the cost, over their standard deviations.
        sums: which contacts each total sums.
        bearing: contacts that may bear; the others have no wrench and no deviation.

    Returns:
        Wrenches contact by contact, per independent standard normal cause [N, N m].
    """
    frames, _, contacts, _ = rows.shape
    active = bearing.to(rows.dtype)
    R = (rows * active[:, None, :, None]).flatten(2)
    E = torch.einsum("gc,tc,ij->tgicj", sums, active, torch.eye(6).to(rows)).reshape(frames, -1, 6 * contacts)
    scale = R.square().sum(1).clamp(min=1e-300).rsqrt() * active.repeat_interleave(6, 1) + (
        1.0 - active
    ).repeat_interleave(6, 1)
    R, E = R * scale[:, None], E * scale[:, None]
    size = E.abs().amax(dim=2, keepdim=True)
    E = E / torch.where(size > 0.0, size, 1.0)
    idle = torch.diag_embed(1.0 - active.repeat_interleave(6, 1))
    vain = torch.diag_embed((size[..., 0] == 0.0).to(rows.dtype))
    upper = torch.cat([R.mT @ R + idle, E.mT], dim=2)
    lower = torch.cat([E, -vain], dim=2)
    inverse = torch.linalg.inv(torch.cat([upper, lower], dim=1))
    own = inverse[:, : 6 * contacts, : 6 * contacts]
    value, vector = torch.linalg.eigh(0.5 * (own + own.mT))
    root = (vector * value.clamp(min=0.0).sqrt()[:, None]) @ vector.mT
    return root * (scale * active.repeat_interleave(6, 1))[:, :, None]
