"""The result of ``fit_inertia_rows``: bodies by name, in terms that do not depend on the order of columns.

Rows are weighed against a prior in two ways, each with the certificate of its optimum. An optimum under an error bound
minimises mu ||Y phi - F||^2 + d(phi), mu the multiplier of the squared residual. With b the bound and w = 1 / (mu b^2),
this is ||Y phi - F||^2 / b^2 + w d(phi): the fit whose rows have noise b, the discrepancy principle (Morozov, Soviet
Math. Dokl. 7, 1966), and the prior weight w. Its standard deviations are those.
"""

from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.errors import Note
from torchid.inertia.base_parameters import Structure, structure
from torchid.inertia.bounded import solve_within
from torchid.inertia.certificate import Certificate, InertiaStatus, certify
from torchid.inertia.cone import ConeSolution
from torchid.inertia.fit import NO_DATA
from torchid.inertia.options import InertiaOptions
from torchid.inertia.posterior import uncertainty
from torchid.inertia.problem import Problem
from torchid.inertia.solve import solve
from torchid.inertia.spectrum import Spectrum, diagonalise
from torchid.inertia.weights import Weights, choose_weights
from torchid.model.pseudo import com, inertia_com, inertia_matrix

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


_AT_LIMIT = 1e-6
"""Slack of a linear limit over the size of its terms up to which it holds with equality."""


@dataclass(frozen=True)
class BodyInertia:
    """Inertia of one body in its own axes; deviations are None where the fit has none."""

    mass: float
    """Mass [kg]."""
    com: Float[Tensor, "3"]
    """Centre of mass from the body's origin [m]."""
    inertia_com: Float[Tensor, "3 3"]
    """Inertia about the centre of mass [kg m^2]."""
    inertia: Float[Tensor, "3 3"]
    """Inertia about the body's origin [kg m^2]."""
    mass_sd: float | None
    com_sd: Float[Tensor, "3"] | None
    inertia_com_sd: Float[Tensor, "3 3"] | None


@dataclass(frozen=True)
class RowsFit:
    """Identified parameters and everything that qualifies them.

    Standard deviations are Gaussian: they do not know of the LMI, of boxes and of ellipsoids, and are too wide where
    those hold with equality (``at_limit``). They exist unless an error bound holds at the prior mean's side, where the
    rows were not needed.
    """

    bodies: dict[str, BodyInertia]
    phi: Float[Tensor, "bodies 10"]
    """Ten parameters of each body, in the order of the caller's columns."""
    phi_sd: Float[Tensor, "bodies 10"] | None
    covariance: Float[Tensor, "params params"] | None
    """Covariance of the flattened ``phi``."""
    order: tuple[str, ...]
    weight: float
    """Factor of the prior against rows of ``noise_sd``: as given, of the largest evidence, or the one whose fit is the
    fit under the error bound; infinite where the bound leaves the prior untouched."""
    noise_sd: float
    """Standard deviation of one row's noise, in the units of F: as given, estimated, or the error bound."""
    residual_rms: float
    """Root mean square of Y phi - F, in the units of F."""
    at_limit: tuple[str, ...]
    """Limits that hold with equality, such as ``ellipsoid(thigh_l)``, ``com_box(foot_r)`` or ``lmi(hand_l)``."""
    certificate: Certificate
    status: InertiaStatus
    notes: tuple[Note, ...]

    @property
    def total_mass(self) -> float:
        """Return the mass of all bodies [kg]."""
        return sum(body.mass for body in self.bodies.values())


def assemble(
    problem: Problem,
    found: RowsSolution,
    judged: tuple[Certificate, InertiaStatus],
    names: tuple[str, ...],
    caller: tuple[tuple[str, ...], Tensor],
    unit: float,
) -> RowsFit:
    """Put a solution in the caller's terms.

    Args:
        problem: what was solved.
        caller: names of the caller's ten columns, and the caller's column of each parameter of torchid.
        unit: standard deviation by which the caller's rows were divided.
    """
    order, columns = caller
    back, phi, covariance = torch.argsort(columns), found.phi, found.covariance
    equations, (certificate, status) = problem.equations, judged
    turned = None if covariance is None else covariance[back][:, back]
    return RowsFit(
        bodies=_bodies(phi, covariance, names),
        phi=phi.flatten()[back].reshape(-1, 10),
        phi_sd=None if turned is None else turned.diagonal().clamp_min(0).sqrt().reshape(-1, 10),
        covariance=turned,
        order=order,
        weight=found.prior_weight,
        noise_sd=unit * found.noise_square**0.5,
        residual_rms=unit * (max(equations.residual_square(phi.flatten()), 0.0) / equations.rows) ** 0.5,
        at_limit=_at_limit(problem, phi, certificate, names),
        certificate=certificate,
        status=status,
        notes=found.weights.notes + _notes(problem, found, certificate, names),
    )


def _bodies(phi: Tensor, covariance: Tensor | None, names: tuple[str, ...]) -> dict[str, BodyInertia]:
    place, central, whole = com(phi), inertia_com(phi), inertia_matrix(phi)
    sd = None if covariance is None else uncertainty(phi, covariance)
    return {
        name: BodyInertia(
            mass=float(phi[k, 0]),
            com=place[k],
            inertia_com=central[k],
            inertia=whole[k],
            mass_sd=None if sd is None else float(sd.mass[k]),
            com_sd=None if sd is None else sd.com[k],
            inertia_com_sd=None if sd is None else sd.inertia_com[k],
        )
        for k, name in enumerate(names)
    }


def _row_names(problem: Problem, names: tuple[str, ...]) -> list[str]:
    """Return a name for every inequality of the problem: six box sides per body, then one ellipsoid per body."""
    boxes = [f"com_box({name})" for name in names for _ in range(6)]
    ellipsoids = [f"ellipsoid({name})" for name in names]
    both = {0: [], len(boxes): boxes, len(ellipsoids): ellipsoids, len(boxes + ellipsoids): boxes + ellipsoids}
    return both[len(problem.inequality)]


def _slack(problem: Problem, phi: Tensor) -> Tensor:
    """Return the slack of every inequality over the size of its terms."""
    size = (problem.inequality.abs() @ phi.flatten().abs()).clamp_min(torch.finfo(phi.dtype).tiny)
    return problem.inequality @ phi.flatten() / size


def _at_limit(problem: Problem, phi: Tensor, certificate: Certificate, names: tuple[str, ...]) -> tuple[str, ...]:
    held = (_slack(problem, phi) < _AT_LIMIT).tolist()
    rows = [name for name, touches in zip(_row_names(problem, names), held, strict=True) if touches]
    return (*(f"lmi({name})" for name in certificate.active), *dict.fromkeys(rows))


def _notes(problem: Problem, found: RowsSolution, certificate: Certificate, names: tuple[str, ...]) -> tuple[Note, ...]:
    notes, solution = [], found.solution
    outside = (_slack(problem, problem.mean) < -_AT_LIMIT).tolist()
    if any(outside):
        broken = dict.fromkeys(name for name, out in zip(_row_names(problem, names), outside, strict=True) if out)
        notes.append(Note("rows.prior_outside_limits", f"the prior mean does not fulfil {', '.join(broken)}"))
    if found.covariance is None:
        notes.append(Note("rows.bound_inactive", "the prior mean meets the error bound: the rows changed nothing"))
    if solution.attempts > 1 or solution.status != "Solved":
        text = f"Clarabel needed {solution.attempts} settings and ended with {solution.status}"
        notes.append(Note("inertia.solver_retry", text))
    if certificate.active:
        notes.append(Note("inertia.lmi_active", f"at the limit of what is physical: {', '.join(certificate.active)}"))
    return tuple(notes)
