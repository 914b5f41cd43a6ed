"""The inertial fit for callers who bring their own regressor and wrenches; the manual is docs/rows.md."""

from collections.abc import Sequence
from typing import Any, Literal

from torchid.conventions import INERTIAL_NAMES
from torchid.dynamics.row_equations import NormalEquations
from torchid.errors import ConfigError, DataError
from torchid.inertia.certificate import Certificate, InertiaStatus, judge
from torchid.inertia.options import InertiaOptions
from torchid.inertia.problem import pose
from torchid.inertia.rows_input import Limits, RowsPrior, array, column_order, read_data, read_limits, read_prior
from torchid.inertia.rows_result import RowsFit, assemble, certify_solution, solve_bounded, solve_weighed

EVIDENCE_RANGE = (1e-6, 1e6)
"""Range in which the evidence looks for the prior's weight: nothing is known of the caller's scale."""
_ANY_MASS = (1e-300, 1e300)
"""Accepted ratio of the mass that the rows ask for to the prior's: a prior may be far off, but not in sign."""
_EXPLAINED = 0.0
"""Smallest share of F' F that an accepted fit explains: below, it predicts worse than no body at all."""

_REASONS = {
    InertiaStatus.NO_INFORMATION: ("all rows are zero", "Check how the regressor was built"),
    InertiaStatus.NOT_OPTIMAL: (
        "the solution does not pass its optimality certificate",
        "Scale the rows to their noise and parameters to SI units, or report the problem",
    ),
    InertiaStatus.NOT_PHYSICAL: ("a body has no physical inertia", "Set Limits(lmi=True)"),
    InertiaStatus.PRIOR_CONFLICT: ("the rows ask for a negative total mass", "Check the sign of F and of gravity in Y"),
    InertiaStatus.UNEXPLAINED: (
        "the fit predicts the right-hand sides worse than no body at all",
        "Check sign, units and order of the rows, or give the prior less weight",
    ),
}


def fit_inertia_rows(
    data: tuple[Any, ...] | NormalEquations,
    prior: RowsPrior,
    *,
    weight: float | Literal["evidence"] | None = None,
    rms_bound: float | None = None,
    noise_sd: float | Literal["estimated"] | None = None,
    limits: Limits | None = None,
    order: Sequence[str] = INERTIAL_NAMES,
    names: Sequence[str] | None = None,
    refuse: bool = True,
) -> RowsFit:
    """Identify the ten inertial parameters of every body from rows Y phi = F, whatever they come from.

    With a ``weight`` the result minimises ||Y phi - F||^2 / noise_sd^2 + weight d(phi); with an ``rms_bound`` it
    minimises d(phi) among all parameters whose residual has that root mean square or less, as one convex program. In
    both cases every body stays physical, and ``limits`` hold. The distance d is described at ``RowsPrior``.

    Args:
        data: either (Y, F) with shapes (n, 10 bodies) and (n,), or the sums (Y' Y, Y' F, F' F, n) over all rows, or
            ``NormalEquations``. Ten columns per body, body by body, about the body's origin, in its axes; units of
            phi are kg, kg m and kg m^2, and those of F whatever the rows' are.
        prior: mean of the parameters and the distance from it.
        weight: factor of the prior, or "evidence" to choose it by the marginal likelihood of the rows.
        rms_bound: root mean square that the residual Y phi - F may have, in the units of F.
        noise_sd: standard deviation of one row's noise, in the units of F; None takes rows as whitened (1), and
            "estimated" finds it by the evidence. It goes with ``weight``; a bound takes its place.
        limits: total mass, boxes, ellipsoids and the LMI; None for ``Limits()``.
        order: names of a body's ten columns, a permutation of ``torchid.conventions.INERTIAL_NAMES``. It holds for
            rows, sums, prior mean, prior covariance and the result's ``phi``.
        names: names of the bodies; None for body_0, body_1 and so on.
        refuse: whether a bad numerical outcome is a DataError; if not, ``status`` of the result tells it.

    Returns:
        The parameters by body, with standard deviations, the residual and a certificate (see ``RowsFit``).

    Raises:
        ConfigError: an argument has a wrong shape or a value that cannot be, weight and bound are both given or both
            missing, or a body's box and ellipsoid exclude each other.
        DataError: a value is NaN or infinite, the sums cannot come from one set of rows, no parameters meet the bound
            or fulfil all limits, or the result is not accepted.

    References:
        Lee, Wensing & Park, IEEE T-RO 36(2), 2020 (the three distances, weighed and under an error bound); Wensing,
        Kim & Slotine, IEEE RA-L 3(1), 2018 (LMI; density realisability in ellipsoids); MacKay, Neural Computation 4(3),
        1992 (evidence).
    """
    _check_choice(weight, rms_bound, noise_sd)
    bodies = len(array(prior.mean, "prior.mean", (None, 10), "Give ten parameters of each body"))
    given, columns = _names(names, bodies), column_order(order, bodies)
    limits = limits or Limits()
    checked, inertial = read_limits(limits, given), read_prior(prior, columns, given)
    options = _options(prior, limits, weight, noise_sd)
    unit = float(noise_sd) if isinstance(noise_sd, int | float) else 1.0
    problem = pose(
        read_data(data, columns).scale(unit**-2), inertial, given, options, checked.mass, checked.com_box,
        exact_mass=checked.exact_mass, ellipsoids=checked.ellipsoids,
    )  # fmt: skip
    found = solve_weighed(problem, options) if rms_bound is None else solve_bounded(problem, rms_bound, options)
    certificate = certify_solution(problem, found, given, options, rms_bound)
    status = judge(certificate, options)
    if refuse and status is not InertiaStatus.ACCEPTED:
        raise _refusal(status, certificate)
    return assemble(problem, found, (certificate, status), given, (tuple(order), columns), unit)


def _check_choice(weight: object, rms_bound: float | None, noise_sd: object) -> None:
    if (weight is None) == (rms_bound is None):
        raise ConfigError(
            "rows.weight_or_bound", "a weight or an error bound is needed, and not both", place="weight, rms_bound",
            found=f"weight {weight}, rms_bound {rms_bound}",
            remedy="Give weight=\"evidence\" if you know neither",
        )  # fmt: skip
    if rms_bound is not None and noise_sd is not None:
        raise ConfigError(
            "rows.noise_with_bound", "an error bound takes the place of the noise", place="noise_sd, rms_bound",
            found=f"noise_sd {noise_sd}, rms_bound {rms_bound}", remedy="Leave noise_sd out",
        )  # fmt: skip
    words = {"weight": "evidence", "noise_sd": "estimated"}
    for name, value in (("weight", weight), ("rms_bound", rms_bound), ("noise_sd", noise_sd)):
        if value is None or value == words.get(name):
            continue
        if not isinstance(value, int | float) or not 0 < value < float("inf"):
            other = f' or "{words[name]}"' if name in words else ""
            raise ConfigError(
                "rows.option", f"must be a positive number{other}", place=name, found=str(value),
                remedy="Give one, or leave it out",
            )  # fmt: skip


def _names(names: Sequence[str] | None, bodies: int) -> tuple[str, ...]:
    given = tuple(names) if names is not None else tuple(f"body_{k}" for k in range(bodies))
    if len(given) != bodies or len(set(given)) != bodies:
        raise ConfigError("rows.names", "every body needs a name of its own", place="names", found=", ".join(given),
                          remedy=f"Give {bodies} different names")  # fmt: skip
    return given


def _options(prior: RowsPrior, limits: Limits, weight: object, noise_sd: object) -> InertiaOptions:
    return InertiaOptions(
        lmi=limits.lmi,
        prior="entropic" if prior.kind == "entropic" else "quadratic",
        prior_weight=float(weight) if isinstance(weight, int | float) else "evidence",
        noise="estimated" if noise_sd == "estimated" else "known",
        floor=limits.floor,
        prior_weight_range=EVIDENCE_RANGE,
        mass_ratio=_ANY_MASS,
        explained_limit=_EXPLAINED,
    )


def _refusal(status: InertiaStatus, certificate: Certificate) -> DataError:
    message, remedy = _REASONS[status]
    optimality = certificate.optimality
    found = (
        f"rank {certificate.rank}, {100 * certificate.explained:.0f} % of F' F explained, solver {certificate.solver}, "
        f"residuals {optimality.primal:.0e} {optimality.dual:.0e}, gap {optimality.gap:.0e}"
    )
    return DataError(f"rows.{status}", message, place="data", found=found, remedy=remedy)
