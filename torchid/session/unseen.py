"""Bodies that nobody saw moving: how much of the mass they are, and what is known of them.

Without markers above the pelvis, trunk and arms are taken to move with it. What their motion would have explained is
noise in the rows (``dynamics.whitening``); it must not become their mass. Their deviations then say how far the total
mass is known, and a choice (``HELD``), not what anybody has measured of them.
"""

from dataclasses import replace

import torch
from jaxtyping import Bool
from torch import Tensor

from torchid.config.sections import Inertia
from torchid.conventions import Inertial
from torchid.errors import DataError
from torchid.geometry.result import GeometryFit
from torchid.model.model import InertialPrior

UNSEEN = 0.35
"""A choice. Share of the mass on bodies without markers above which these are held: head, hands and abdomen together
are 0.24 of the mass, trunk and arms 0.5."""
HELD = 0.2
"""A choice. Part of its scatter in tables that the shape of a held body keeps."""


def unseen_mass(fit: GeometryFit, prior: InertialPrior) -> tuple[float, tuple[str, ...]]:
    """Return the share of the mass, by the prior, on bodies without markers, and their names.

    Args:
        fit: whose markers show bodies.
        prior: of the same bodies.
    """
    bare, mass = _bare(fit), prior.mean[:, Inertial.M]
    names = tuple(name for name, own in zip(fit.model.tree.names, bare.tolist(), strict=True) if own)
    return float(mass[bare].sum() / mass.sum()), names


def hold_unseen(options: Inertia, prior: InertialPrior, fit: GeometryFit) -> tuple[Inertia, InertialPrior]:
    """Return options and prior of the inertial fit, in which bodies without markers are held, if they are more than
    ``UNSEEN`` of the mass.

    The evidence of rows that hold the motion of what nobody saw does not say how near a body is to the tables, so that
    the prior then keeps the weight that these give it. What is named in the rows is named beside the tables alone
    (``diagnosis``): a tight prior would leave that motion to causes.

    Args:
        options: as asked for.
        prior: of all bodies, as tables have it.
        fit: whose markers show bodies.
    """
    if unseen_mass(fit, prior)[0] <= UNSEEN:
        return options, prior
    weighed = replace(options, prior_weight=1.0) if options.prior_weight == "evidence" else options
    return weighed, hold_shape(prior, _bare(fit), HELD)


def hold_shape(prior: InertialPrior, bodies: Bool[Tensor, " bodies"], part: float) -> InertialPrior:
    """Return the prior in which some bodies go with the total mass, and scatter less about that.

    The prior is conditioned on the parameters of these bodies, less what the total mass makes of them, being as in
    tables; what it says of the total mass stays.

    Args:
        prior: of all bodies.
        bodies: those that are held.
        part: of the standard deviations that they have where the total mass is known.
    """
    C = prior.covariance
    mass = torch.zeros_like(C[0])
    mass[Inertial.M :: len(Inertial)] = 1.0
    common = C @ mass / (mass @ C @ mass).sqrt()
    own = (C - torch.outer(common, common))[:, bodies.repeat_interleave(len(Inertial))]
    factor = torch.linalg.cholesky(own[bodies.repeat_interleave(len(Inertial))])
    told = torch.linalg.solve_triangular(factor, own.T, upper=False)
    return replace(prior, covariance=C - (1.0 - part**2) * told.T @ told)


def refuse_unseen(fit: GeometryFit, prior: InertialPrior) -> None:
    """Refuse to identify, while it moves, a body that nobody sees.

    Args:
        fit: whose markers show bodies.
        prior: of the same bodies.

    Raises:
        DataError: more of the mass than ``UNSEEN`` is on bodies without markers.
    """
    share, names = unseen_mass(fit, prior)
    if share > UNSEEN:
        raise DataError(
            "inertia.unseen_bodies", f"no marker shows how {100.0 * share:.0f} % of the body's mass moves",
            found=f"no markers on {', '.join(names)}",
            remedy="Record markers on them (inertia.refuse: false goes on)",
        )  # fmt: skip


def _bare(fit: GeometryFit) -> Bool[Tensor, " bodies"]:
    """Mask of the bodies without markers."""
    bare = torch.ones(len(fit.model.tree.names), dtype=torch.bool)
    bare[fit.attachment.body.cpu()] = False
    return bare
