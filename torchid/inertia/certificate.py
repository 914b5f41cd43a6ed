"""Evidence that a result is what it claims to be, recomputed in float64 and original units.

A solver's ``optimal`` says that its own scaled problem was solved: it was returned for all-zero data, for plates with
their sign flipped and for forces scaled by 1e-6. So optimality is recomputed from the equations and the prior, and the
data are held against the prior.
"""

from dataclasses import dataclass, replace
from enum import StrEnum

import torch
from jaxtyping import Float
from scipy.stats import chi2
from torch import Tensor

from torchid.conventions import Inertial
from torchid.inertia import entropic
from torchid.inertia.base_parameters import Structure
from torchid.inertia.cone import ConeSolution
from torchid.inertia.options import InertiaOptions
from torchid.inertia.problem import Problem
from torchid.inertia.spectrum import Spectrum, cholesky, total_mass
from torchid.inertia.weights import Weights
from torchid.model.pseudo import params_to_pseudo

EIGENVALUE_LIMIT = -1e-9
"""Smallest pseudo-inertia eigenvalue over trace of an accepted result."""
ACTIVE = 1e-5
"""Relative eigenvalue above the floor up to which an LMI counts as active."""


class InertiaStatus(StrEnum):
    """Why a result is accepted or not."""

    ACCEPTED = "accepted"
    NO_INFORMATION = "no_information"
    NOT_OPTIMAL = "not_optimal"
    NOT_PHYSICAL = "not_physical"
    PRIOR_CONFLICT = "prior_conflict"
    UNEXPLAINED = "unexplained"


MESSAGES = {
    InertiaStatus.NO_INFORMATION: ("the accumulated equations are empty or zero", "Check that motion was recorded"),
    InertiaStatus.NOT_OPTIMAL: ("the solution does not pass its optimality certificate", "Report the problem"),
    InertiaStatus.NOT_PHYSICAL: ("a segment has no physical inertia", "Set inertia.lmi: true"),
    InertiaStatus.PRIOR_CONFLICT: (
        "the forces ask for a total mass that the subject cannot have",
        "Check sign, unit and gain of the plates and the recorded body mass",
    ),
    InertiaStatus.UNEXPLAINED: (
        "no physical inertia explains the forces",
        "Check sign, axes and time alignment of the plates",
    ),
}


@dataclass(frozen=True)
class Optimality:
    """Karush-Kuhn-Tucker conditions of the fit; lengths are in posterior standard deviations."""

    primal: float
    """Violation of W >= floor (relative eigenvalue), of boxes and ellipsoids, and of an exact mass."""
    dual: float
    """Newton step that the gradient of the Lagrangian still asks for, and negative multipliers."""
    gap: float
    """Sum of multipliers times slacks over (1 + what the constraints cost), in units of chi-square."""


@dataclass(frozen=True)
class Conflict:
    """Data against prior, with the noise of the best free fit: both statistics are standard when they agree."""

    mass_ratio: float
    """Total mass that the data ask for over the prior's."""
    mass_z: float
    """Its distance from the prior in standard deviations of prior and data together."""
    chi_square: float
    dof: int
    p_value: float


@dataclass(frozen=True)
class Certificate:
    """Everything a reader needs to believe a fit."""

    solver: str
    iterations: int
    optimality: Optimality
    smallest_eigenvalue: Float[Tensor, " bodies"]
    """Of each pseudo-inertia, over its trace."""
    rank: int
    condition: float
    """Of the regressor with unit columns, without its null directions."""
    conflict: Conflict
    explained: float
    """Share of the squared wrench that the fit explains."""
    active: tuple[str, ...]
    """Bodies whose LMI holds with equality: there the Gaussian standard deviations are too wide."""


def certify(
    problem: Problem,
    spectrum: Spectrum,
    data: Structure,
    weights: Weights,
    phi: Float[Tensor, "bodies 10"],
    covariance: Float[Tensor, "params params"],
    solution: ConeSolution,
    names: tuple[str, ...],
    options: InertiaOptions,
) -> Certificate:
    """Optimality, physical consistency and agreement with the prior in original units."""
    floor = options.floor if options.lmi and problem.divergence is None else 0.0
    factor = torch.linalg.cholesky(params_to_pseudo(problem.mean.reshape(-1, 10)))
    inverse = torch.linalg.inv(factor)
    multiplier = inverse.mT @ phi.new_tensor(solution.lmi_dual) @ inverse
    length = (problem.inequality @ torch.block_diag(*problem.T)).norm(dim=-1)
    inequality = problem.inequality, phi.new_tensor(solution.inequality_dual) / length
    gradient, price = _gradient(problem, spectrum, weights, phi)
    rows, value = problem.equality
    gradient = gradient - rows.mT @ phi.new_tensor(solution.equality_dual)
    miss = float(((rows @ phi.flatten() - value).abs() / value.abs()).max()) if len(value) else 0.0
    optimality = check_optimality(phi, gradient, covariance, (factor, multiplier, floor), inequality, price)
    pseudo, square = params_to_pseudo(phi), problem.equations.square
    lowest = torch.linalg.eigvalsh(inverse @ pseudo @ inverse.mT)[:, 0]
    return Certificate(
        solver=solution.status,
        iterations=solution.iterations,
        optimality=replace(optimality, primal=max(optimality.primal, miss)),
        smallest_eigenvalue=torch.linalg.eigvalsh(pseudo)[:, 0] / pseudo.diagonal(dim1=-2, dim2=-1).sum(-1),
        rank=data.rank,
        condition=data.condition,
        conflict=compare_with_prior(spectrum, data.rank),
        explained=1 - problem.equations.residual_square(phi.flatten()) / square if square > 0 else 0.0,
        active=tuple(name for name, low in zip(names, lowest, strict=True) if floor and float(low) < floor + ACTIVE),
    )


def _gradient(
    problem: Problem, spectrum: Spectrum, weights: Weights, phi: Float[Tensor, "bodies 10"]
) -> tuple[Float[Tensor, " params"], float]:
    """Of the objective, from the equations and the prior; and how far it lies above its unconstrained minimum.

    With the entropic prior the minimum is not known in closed form: 0.
    """
    flat = phi.flatten()
    gram, moment = problem.data_terms(weights.omega_1)
    gradient = 2 * (gram @ flat - moment)
    if problem.divergence is None:
        difference = (flat - problem.mean)[:, None]
        gradient = gradient + 2 * weights.omega_2 * torch.cholesky_solve(difference, cholesky(problem.covariance))[:, 0]
        free = spectrum.params(spectrum.solve(weights.omega_1, weights.omega_2))
        return gradient, 0.5 * float(gradient @ (flat - free))
    x = torch.linalg.solve(problem.T, phi[..., None]).squeeze(-1)
    slope = weights.omega_2 * problem.divergence[:, None] * entropic.divergence_slope(x)
    return gradient + torch.linalg.solve(problem.T.mT, slope[..., None]).flatten(), 0.0


def check_optimality(
    phi: Float[Tensor, "bodies 10"],
    gradient: Float[Tensor, " params"],
    covariance: Float[Tensor, "params params"],
    lmi: tuple[Float[Tensor, "bodies 4 4"], Float[Tensor, "bodies 4 4"], float],
    inequality: tuple[Float[Tensor, "inequalities params"], Float[Tensor, " inequalities"]],
    price: float,
) -> Optimality:
    """Karush-Kuhn-Tucker residuals of phi.

    Args:
        gradient: of the objective with respect to phi, from the equations and the prior, less what equalities carry.
        covariance: inverse of half its Hessian.
        lmi: factor L of the prior's pseudo-inertia, multipliers of P - floor L L' >= 0 in inverse units, floor.
        inequality: C with C phi >= 0, and its multipliers.
        price: objective above its unconstrained minimum.
    """
    factor, multiplier, floor = lmi
    rows, row_dual = inequality
    pseudo = params_to_pseudo(phi)
    slack = pseudo - floor * factor @ factor.mT
    units = params_to_pseudo(torch.eye(10, dtype=phi.dtype, device=phi.device))
    support = torch.einsum("bij,kij->bk", multiplier, units).flatten() + rows.mT @ row_dual
    scale = max(1.0, 0.5 * _length(support, covariance))
    row_slack = rows @ phi.flatten()
    gap = float((multiplier * slack).sum().abs() + (row_dual * row_slack).abs().sum())
    half = torch.linalg.solve_triangular(factor, slack, upper=False)
    relative = torch.linalg.solve_triangular(factor, half.mT, upper=False)
    # Linear rows are compared with the size of their own terms.
    size = (rows.abs() @ phi.flatten().abs()).clamp_min(torch.finfo(phi.dtype).tiny)
    shortfall = torch.cat([-torch.linalg.eigvalsh(relative).flatten() * (floor > 0), -row_slack / size])
    negative = torch.cat([-torch.linalg.eigvalsh(factor.mT @ multiplier @ factor).flatten(), -row_dual])
    newton = 0.5 * _length(gradient - support, covariance)
    return Optimality(
        primal=float(shortfall.clamp_min(0).max()),
        dual=max(newton, float(negative.clamp_min(0).max())) / scale,
        gap=gap / (1 + max(price, 0.0)),
    )


def _length(vector: Tensor, covariance: Tensor) -> float:
    return max(float(vector @ covariance @ vector), 0.0) ** 0.5


def compare_with_prior(spectrum: Spectrum, rank: int) -> Conflict:
    """How far the data lie from the prior, from the prior-predictive distribution of the projected rows.

    Along each axis omega pull ~ N(0, g (g + 1)) with g = omega gain when the prior is right.
    """
    solid = (spectrum.gain > 1e-12 * spectrum.gain.max()) & (spectrum.gain > 0)
    gain, pull = spectrum.gain[solid], spectrum.pull[solid]
    best = max(spectrum.square - float(pull @ (pull / gain)), spectrum.smallest)
    omega = max(spectrum.rows - rank, 1) / best if best > 0 else 1.0
    share = omega * gain / (omega * gain + 1)
    everything = total_mass(spectrum.basis)
    lever = everything[solid]
    spread = float(lever @ (lever * share)) ** 0.5
    shift = float((lever * share * pull / gain).sum())
    # Shrinkage pulls the shift towards zero: divided by the share of prior variance that the data see.
    seen = spread**2 / float(everything @ everything)
    expected = float(spectrum.mean[Inertial.M :: len(Inertial)].sum())
    statistic = float(omega * pull @ (pull / gain * (1 - share)))
    return Conflict(
        mass_ratio=1 + shift / seen / expected if seen > 1e-3 else 1.0,
        mass_z=shift / spread if spread > 0 else 0.0,
        chi_square=statistic,
        dof=len(gain),
        p_value=float(chi2.sf(statistic, max(len(gain), 1))),
    )


def judge(certificate: Certificate, options: InertiaOptions) -> InertiaStatus:
    """First reason that speaks against the result, in the order in which a user would want to hear them."""
    low, high = options.mass_ratio
    conflict, optimality = certificate.conflict, certificate.optimality
    if certificate.rank == 0:
        return InertiaStatus.NO_INFORMATION
    if not low <= conflict.mass_ratio <= high and abs(conflict.mass_z) > 5:
        return InertiaStatus.PRIOR_CONFLICT
    # Not of their largest: beside a number, ``max`` may pass over NaN.
    if not all(size <= options.gap_limit for size in (optimality.primal, optimality.dual, optimality.gap)):
        return InertiaStatus.NOT_OPTIMAL
    if options.lmi and float(certificate.smallest_eigenvalue.min()) < EIGENVALUE_LIMIT:
        return InertiaStatus.NOT_PHYSICAL
    if certificate.explained < options.explained_limit:
        return InertiaStatus.UNEXPLAINED
    return InertiaStatus.ACCEPTED
