"""What markers leave open of the geometry, in the deviations of the identified inertia.

The inertial fit takes geometry, places of markers, skin and zeros of plates for known. With errors xi of these, whose
columns G the diagnosis has as nuisances, its estimate moves by J xi with J = (Y' W Y + P^-1)^-1 Y' W G, with Y as the
fit has it: what rows say of those without noise (``inertia/reliability.py``). Markers, and what recordings usually
have, say of xi a mean m and a covariance S. So J (S + m m') J' is added to the covariance of the fit (law of
propagation of uncertainty: JCGM 100:2008, 5.1.2).
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.config.sections import Subject
from torchid.conventions import Inertial
from torchid.diagnosis.columns.assemble import make_design
from torchid.diagnosis.evidence.model import Identification, LinearModel, make_model
from torchid.diagnosis.evidence.posterior import fit
from torchid.extension.correction import corrected_config
from torchid.extension.diagnosing import forceful, observe_outcome, searched
from torchid.inertia.fit import InertiaFit
from torchid.inertia.identify import Identified
from torchid.inertia.posterior import progress_from, uncertainty
from torchid.observation.trial import TrialObservation
from torchid.session import Outcome
from torchid.session.fitting import given_mass
from torchid.storage.allocator import keeping_large
from torchid.storage.snapshot import in_memory

Mass = tuple[float, float] | None
"""Total mass and its standard deviation that a fit held to [kg]."""
Room = Callable[[Sequence[int]], Tensor]
"""Makes zeros of a shape, where columns lie until they are looked at."""


def with_open_geometry(outcome: Outcome, room: Room = in_memory) -> Outcome:
    """Return an outcome whose inertia's deviations hold what markers leave open of the geometry.

    Args:
        outcome: with the inertia that is published; without one, or without rows of forces, it is returned as it is.
            The model before its extension is widened as well.
        room: makes zeros of a shape (``OutputFolder.room``).
    """
    if outcome.base is not None:
        outcome = replace(outcome, base=with_open_geometry(outcome.base, room))
    if outcome.identified is None:
        return outcome
    return replace(outcome, identified=widened(outcome, _held_to(outcome), room))


@keeping_large()
def widened(outcome: Outcome, mass: Mass, room: Room = in_memory, counted: float = 1.0) -> Identified:
    """Return the inertia of an outcome with deviations that hold what markers leave open of the geometry.

    Args:
        outcome: with an inertia; without rows of forces it is returned as it is.
        mass: what its fit held to.
        room: as for ``with_open_geometry``.
        counted: times that each row of forces counts, where some stand for more.
    """
    found = outcome.identified
    assert found is not None
    if not (observed := _observed(outcome, room)):
        return found
    design = make_design(observed, (), outcome.fit, outcome.config.diagnosis.thresholds.naming)
    known = Identification(found.fit.prior, found.fit.omega_2, found.whitening, outcome.fit)
    share = open_share(make_model(observed, design, known), mass, found.reliability, counted)
    return replace(found, fit=_wider(found.fit, share, mass), given_motion=found.fit.covariance)


def _observed(outcome: Outcome, room: Room) -> list[TrialObservation]:
    """Return the fit trials of which something is left without their ends."""
    every = observe_outcome(outcome, "fit", searched(forceful(outcome, "fit"))).values()
    return [replace(one, room=room, as_measured=True) for one in every if any(True for _ in one.rows.blocks())]


def _held_to(outcome: Outcome) -> Mass:
    """Return the mass that the published fit held to."""
    return given_mass(outcome.config.inertia, right_subject(outcome), outcome)


def right_subject(outcome: Outcome) -> Subject:
    """Return the subject that the published fit is of: of a record that was corrected, the corrected one.

    Args:
        outcome: with its verdict, where it has one.
    """
    found = None if outcome.base is None else outcome.diagnosis
    causes = () if found is None else tuple(c for c in found.causes if c.applied)
    return corrected_config(outcome.config, causes).subject


def open_share(
    model: LinearModel, mass: Mass, reliability: Float[Tensor, "params params"] | None = None, counted: float = 1.0
) -> Float[Tensor, "params params"]:
    """Return what nuisances of a model add to the covariance of the inertial parameters, as far as markers leave them
    open.

    Args:
        model: model of nuisances alone, under the noise of the inertial fit.
        mass: what that fit held to.
        reliability: what its regressors said of those without noise; None: they were taken for exact.
        counted: times that each row of forces counts.
    """
    n, factor, scale = model.design.inertia, model.prior.inertia, model.prior.scale
    seen = fit(model.statistics_without_forces)
    of_forces = counted * (fit(model.statistics).information - seen.information)
    R = torch.eye(n).to(factor)
    if reliability is not None:
        R = torch.linalg.solve_triangular(factor, reliability @ factor, upper=False)
    own = R.mT @ of_forces[:n, :n] @ R + torch.eye(n).to(factor)
    if mass is not None:
        lever = factor[Inertial.M :: len(Inertial)].sum(0) / mass[1]
        own = own + lever[:, None] * lever
    moved = torch.cholesky_solve(R.mT @ of_forces[:n, n:], torch.linalg.cholesky(own))
    left = torch.linalg.solve_triangular(torch.linalg.cholesky(seen.information[n:, n:]), moved.mT, upper=False)
    told = moved @ (model.prior.mean[n:] / scale + seen.mean[n:])
    root = factor @ torch.cat([left.mT, told[:, None]], 1)
    return root @ root.mT


def _wider(found: InertiaFit, more: Float[Tensor, "params params"], mass: Mass) -> InertiaFit:
    """Return a fit with a wider covariance."""
    covariance = found.covariance + more
    before = found.prior.covariance / found.omega_2
    if mass is not None:
        lever = before[:, Inertial.M :: len(Inertial)].sum(1)
        spread = lever[Inertial.M :: len(Inertial)].sum() + mass[1] ** 2
        before = before - lever[:, None] * lever / spread
    base = None if found.base is None else found.base.under(covariance)
    progress = progress_from(before, covariance)
    return replace(found, covariance=covariance, sd=uncertainty(found.phi, covariance), progress=progress, base=base)
