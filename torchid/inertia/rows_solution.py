"""Both ways to weigh rows against a prior, each with the certificate of its optimum.

An optimum under an error bound minimises mu ||Y phi - F||^2 + d(phi), mu the multiplier of the squared residual. With
b the bound and w = 1 / (mu b^2), this is ||Y phi - F||^2 / b^2 + w d(phi): the fit whose rows have noise b, the
discrepancy principle (Morozov, Soviet Math. Dokl. 7, 1966), and the prior weight w. Its standard deviations are those.
"""

from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.inertia.base_parameters import Structure, structure
from torchid.inertia.bounded import solve_within
from torchid.inertia.certificate import Certificate, certify
from torchid.inertia.cone import ConeSolution
from torchid.inertia.fit import NO_DATA
from torchid.inertia.options import InertiaOptions
from torchid.inertia.problem import Problem
from torchid.inertia.solve import solve
from torchid.inertia.spectrum import Spectrum, diagonalise
from torchid.inertia.weights import Weights, choose_weights

EXACT_MASS_SD = 1e-4
"""Standard deviation over value of an exact mass while the evidence is worked out; the fit then holds it exactly."""


@dataclass(frozen=True)
class RowsSolution:
    """An optimum, the weights whose optimum it is, and the Gaussian posterior around it."""

    phi: Float[Tensor, "bodies 10"]
    solution: ConeSolution
    weights: Weights
    """Factors omega_1 of the squared residual and omega_2 of the prior."""
    spectrum: Spectrum
    data: Structure
    noise_square: float
    """Squared standard deviation of the rows of the problem."""
    covariance: Float[Tensor, "params params"] | None
    """None where the bound holds without the data, so that they say nothing."""

    @property
    def prior_weight(self) -> float:
        """Return the factor of the prior against rows of the stated noise; infinite where the data say nothing."""
        moved = self.weights.omega_1 * self.noise_square
        return self.weights.omega_2 / moved if moved > 0 else float("inf")


def solve_weighed(problem: Problem, options: InertiaOptions) -> RowsSolution:
    """Minimise omega_1 ||Y phi - F||^2 + omega_2 d(phi) with the weights that ``options`` ask for."""
    spectrum = diagonalise(problem.equations, problem.mean, problem.covariance, problem.mass)
    data = structure(problem.equations, options.rank_tolerance)
    soft = spectrum
    if problem.exact_mass is not None:
        mass = problem.exact_mass, EXACT_MASS_SD * problem.exact_mass
        soft = diagonalise(problem.equations, problem.mean, problem.covariance, mass)
    weights = choose_weights(soft, options) if data.rank else NO_DATA
    free = spectrum.params(spectrum.solve(weights.omega_1, weights.omega_2))
    covariance = spectrum.covariance(weights.omega_1, weights.omega_2)
    solution = solve(problem, weights, free, covariance, options)
    phi = problem.params(solution.x)
    posterior = _given_mass(problem, covariance)
    return RowsSolution(phi, solution, weights, spectrum, data, 1 / weights.omega_1, posterior)


def solve_bounded(problem: Problem, rms_bound: float, options: InertiaOptions) -> RowsSolution:
    """Minimise d(phi) among parameters whose residual has a root mean square of ``rms_bound`` or less."""
    spectrum = diagonalise(problem.equations, problem.mean, problem.covariance, problem.mass)
    data = structure(problem.equations, options.rank_tolerance)
    found = solve_within(problem, spectrum, problem.equations.rows * rms_bound**2, options)
    mu, noise_square = found.multiplier, rms_bound**2
    posterior = _given_mass(problem, mu * noise_square * spectrum.covariance(mu, 1.0)) if mu > 0 else None
    phi, weights = problem.params(found.cone.x), Weights(mu, 1.0, 0.0)
    return RowsSolution(phi, found.cone, weights, spectrum, data, noise_square, posterior)


def certify_solution(
    problem: Problem, found: RowsSolution, names: tuple[str, ...], options: InertiaOptions, rms_bound: float | None
) -> Certificate:
    """Recompute the optimality conditions of the solution, those of the error bound included."""
    weights, phi = found.weights, found.phi
    metric = found.spectrum.covariance(weights.omega_1, weights.omega_2)
    certificate = certify(
        problem, found.spectrum, found.data, weights, phi, metric, found.solution, names, options
    )  # fmt: skip
    if rms_bound is None:
        return certificate
    budget = problem.equations.rows * rms_bound**2
    over = problem.equations.residual_square(phi.flatten()) / budget - 1
    price = weights.omega_1 * budget
    optimality = certificate.optimality
    bounded = replace(
        optimality,
        primal=max(optimality.primal, over),
        gap=optimality.gap + price * abs(over) / (1 + price),
    )
    return replace(certificate, optimality=bounded)


def _given_mass(problem: Problem, covariance: Float[Tensor, "params params"]) -> Float[Tensor, "params params"]:
    """Condition a Gaussian on the exact total mass, if there is one."""
    if problem.exact_mass is None:
        return covariance
    lever = covariance @ problem.mass_row
    return covariance - torch.outer(lever, lever) / (problem.mass_row @ lever)
