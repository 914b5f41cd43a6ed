"""The inertial fit: weigh data against prior, keep every body physical, certify, and say what the data decided."""

from collections.abc import Sequence
from dataclasses import dataclass

from jaxtyping import Float
from torch import Tensor

from torchid.dynamics.row_equations import NormalEquations
from torchid.errors import DataError, Note
from torchid.inertia.base_parameters import BaseParameters, base_parameters, structure
from torchid.inertia.certificate import MESSAGES, Certificate, InertiaStatus, certify, judge
from torchid.inertia.cone import ConeSolution
from torchid.inertia.options import InertiaOptions
from torchid.inertia.posterior import InertiaUncertainty, Progress, progress, uncertainty
from torchid.inertia.problem import pose
from torchid.inertia.solve import solve
from torchid.inertia.spectrum import diagonalise
from torchid.inertia.weights import Weights, choose_weights
from torchid.model.model import InertialPrior
from torchid.model.pseudo import com, inertia_com, mass

NO_DATA = Weights(1.0, 1.0, 0.0)
"""Of equations that determine nothing: the prior is the answer, whatever its weight."""


@dataclass(frozen=True)
class InertiaFit:
    """Identified inertial parameters and everything that qualifies them."""

    names: tuple[str, ...]
    phi: Float[Tensor, "bodies 10"]
    covariance: Float[Tensor, "params params"]
    """Gaussian posterior, without the LMI; of a finished run with what is left open of geometry and motion."""
    prior: InertialPrior
    omega_1: float
    omega_2: float
    log_evidence: float
    """Of the Gaussian problem; compare only fits of the same rows [nat]."""
    sd: InertiaUncertainty
    progress: Progress
    base: BaseParameters | None
    """None when not asked for or when the data have rank 0."""
    certificate: Certificate
    status: InertiaStatus
    notes: tuple[Note, ...]

    @property
    def rank(self) -> int:
        """Number of parameter combinations that the data determine at all."""
        return self.certificate.rank

    @property
    def mass(self) -> Float[Tensor, " bodies"]:
        """Mass of each body [kg]."""
        return mass(self.phi)

    @property
    def com(self) -> Float[Tensor, "bodies 3"]:
        """Centre of mass p_BC_B [m]."""
        return com(self.phi)

    @property
    def inertia_com(self) -> Float[Tensor, "bodies 3 3"]:
        """Inertia about the centre of mass, body axes [kg m^2]."""
        return inertia_com(self.phi)


def fit_inertia(
    equations: NormalEquations,
    prior: InertialPrior,
    names: tuple[str, ...],
    options: InertiaOptions | None = None,
    *,
    mass: tuple[float, float] | None = None,
    com_box: Float[Tensor, "bodies 2 3"] | None = None,
    trials: Sequence[NormalEquations] = (),
    as_seen: NormalEquations | None = None,
) -> InertiaFit:
    """Identify the ten inertial parameters of every body.

        min omega_1 ||Y phi - F||^2 + omega_2 ||phi - phi_hat||^2_P   s.t.  P(phi_b) >= floor P(phi_hat_b)

    Args:
        equations: whitened sums over all fit trials.
        prior: mean and covariance, same bodies.
        options: defaults to ``InertiaOptions()``.
        mass: total mass and its standard deviation [kg], when the prior does not hold it already.
        com_box: lower and upper corner of the box that holds each centre of mass, body axes [m].
        trials: the equations trial by trial, for ``prior_weight="cross_validation"``.
        as_seen: the equations before noise was taken out of them, which tell what the motion determines at all; None:
            they are the equations themselves.

    Raises:
        ConfigError: prior, mass or boxes cannot be.
        DataError: the equations are not finite or inconsistent, no solution exists, or the result is not accepted
            (unless ``options.refuse`` is False: then ``status`` says why).

    Reference: Wensing, Kim, Slotine, IEEE RA-L 3(1), 2018 (LMI); Traversaro et al., IROS 2016 (full consistency).
    """
    options = options or InertiaOptions()
    problem = pose(equations, prior, names, options, mass, com_box)
    spectrum = diagonalise(equations, problem.mean, problem.covariance, mass)
    data = structure(equations if as_seen is None else as_seen, options.rank_tolerance)
    weights = choose_weights(spectrum, options, trials, problem.covariance, mass) if data.rank else NO_DATA
    free = spectrum.params(spectrum.solve(weights.omega_1, weights.omega_2))
    covariance = spectrum.covariance(weights.omega_1, weights.omega_2)
    solution = solve(problem, weights, free, covariance, options)
    phi = problem.params(solution.x)
    certificate = certify(problem, spectrum, data, weights, phi, covariance, solution, names, options)
    status = judge(certificate, options)
    if options.refuse and status is not InertiaStatus.ACCEPTED:
        raise _refusal(status, certificate)
    with_base = options.base_parameters and data.rank > 0
    return InertiaFit(
        names=names, phi=phi, covariance=covariance, prior=prior, omega_1=weights.omega_1, omega_2=weights.omega_2,
        log_evidence=weights.log_evidence, sd=uncertainty(phi, covariance),
        progress=progress(spectrum, covariance, weights.omega_2),
        base=base_parameters(data, names, phi, covariance) if with_base else None,
        certificate=certificate, status=status,
        notes=weights.notes + _notes(certificate, solution, float(prior.mean[:, 0].sum())),
    )  # fmt: skip


def _refusal(status: InertiaStatus, certificate: Certificate) -> DataError:
    message, remedy = MESSAGES[status]
    conflict, optimality = certificate.conflict, certificate.optimality
    found = (
        f"rank {certificate.rank}, total mass {conflict.mass_ratio:.2f} of the prior's ({conflict.mass_z:+.1f} sd), "
        f"{100 * certificate.explained:.0f} % of the squared wrench explained, solver {certificate.solver}, "
        f"residuals {optimality.primal:.0e} {optimality.dual:.0e}, gap {optimality.gap:.0e}"
    )
    return DataError(f"inertia.{status}", message, found=found, remedy=remedy)


def _notes(certificate: Certificate, solution: ConeSolution, expected: float) -> tuple[Note, ...]:
    notes = []
    if certificate.active:
        bodies = ", ".join(certificate.active)
        notes.append(Note("inertia.lmi_active", f"at the limit of what is physical: {bodies}"))
    if abs(certificate.conflict.mass_z) > 5:
        conflict = certificate.conflict
        text = (
            f"the forces alone ask for {conflict.mass_ratio * expected:.1f} kg in all, {abs(conflict.mass_z):.1f} sd "
            f"from the {expected:.1f} kg expected"
        )
        notes.append(Note("inertia.mass_conflict", text))
    if solution.attempts > 1 or solution.status != "Solved":
        text = f"Clarabel needed {solution.attempts} settings and ended with {solution.status}"
        notes.append(Note("inertia.solver_retry", text))
    return tuple(notes)
