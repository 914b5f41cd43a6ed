"""How much to trust the data (omega_1) and the prior (omega_2).

Evidence: the rows are N(Y phi, 1/omega_1), phi is N(mean, Sigma/omega_2); phi is integrated out in closed form and
both factors maximise what is left (type II maximum likelihood; MacKay, Neural Computation 4(3), 1992).
The LMI is left out of the integral. Cross-validation: each trial is predicted from the others.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.optimize import minimize
from torch import Tensor

from torchid.dynamics.row_equations import NormalEquations
from torchid.errors import ConfigError, DataError, Note
from torchid.inertia.options import InertiaOptions
from torchid.inertia.spectrum import Spectrum, diagonalise

_GRID = 25


@dataclass(frozen=True)
class Weights:
    """Factors on the information of the data and of the prior."""

    omega_1: float
    omega_2: float
    log_evidence: float
    """Natural logarithm of the marginal likelihood of the rows, up to their normalisation [nat]."""
    notes: tuple[Note, ...] = ()


def log_evidence(spectrum: Spectrum, omega_1: float, omega_2: float) -> tuple[float, float, float]:
    """Log marginal likelihood and its derivatives with respect to log omega_1 and log omega_2."""
    diagonal, denominator = spectrum.precision(omega_1, omega_2)
    w = spectrum.solve(omega_1, omega_2)
    inverse = spectrum.inverse_diagonal(omega_1, omega_2)
    residual, prior = spectrum.residual(w), float(w @ w)
    mass = float(spectrum.lever @ w) - spectrum.miss
    penalty = omega_1 * residual + omega_2 * prior + mass**2
    volume = float(np.log(diagonal).sum() + np.log(denominator))
    value = 0.5 * (spectrum.rows * np.log(omega_1) + len(w) * np.log(omega_2) - volume - penalty)
    slope_1 = 0.5 * (spectrum.rows - omega_1 * float(spectrum.gain @ inverse) - omega_1 * residual)
    slope_2 = 0.5 * (len(w) - omega_2 * float(inverse.sum()) - omega_2 * prior)
    return value, slope_1, slope_2


def maximise_evidence(
    spectrum: Spectrum, omega_1: float | None, omega_2: float | None, weight_range: tuple[float, float]
) -> Weights:
    """Weights of largest evidence; a weight that is given stays.

    Args:
        omega_1: None to estimate the noise.
        omega_2: None to search ``weight_range``.

    Raises:
        DataError: the noise is to be estimated of rows that are zero.
    """
    low_1, first, high_1 = _noise_range(spectrum) if omega_1 is None else (omega_1,) * 3
    bounds = [
        (np.log(low_1), np.log(high_1)),
        (np.log(weight_range[0]), np.log(weight_range[1])) if omega_2 is None else (np.log(omega_2),) * 2,
    ]

    def loss(x: np.ndarray) -> tuple[float, np.ndarray]:
        value, *slope = log_evidence(spectrum, *np.exp(x))
        return -value, -np.array(slope)

    # Two ridges can hold a maximum each: the prior explains the misfit, or the noise does.
    starts = np.array([[np.log(first), np.log(0.1)], [np.log(first), 0.0], [np.log(first), np.log(10.0)]])
    starts = np.clip(starts, [b[0] for b in bounds], [b[1] for b in bounds])
    start = min(starts, key=lambda x: loss(x)[0])
    found = minimize(loss, start, jac=True, method="L-BFGS-B", bounds=bounds, options={"ftol": 1e-13, "gtol": 1e-7})
    chosen_1, chosen_2 = (float(value) for value in np.exp(found.x))
    notes = () if omega_2 is not None else _at_bound(chosen_2, weight_range)
    return Weights(chosen_1, chosen_2, -float(found.fun), notes)


def _noise_range(spectrum: Spectrum) -> tuple[float, float, float]:
    """Where omega_1 is looked for: its smallest value, that of the fit with equal weights, its largest."""
    if not spectrum.smallest > 0:
        raise DataError(
            "inertia.no_noise",
            "the noise cannot be estimated: right-hand sides and what the prior mean predicts are zero in every row",
            found=f"{spectrum.rows} rows", remedy="Leave such rows out, or state the noise",
        )  # fmt: skip
    # Of data that equal the prior mean's prediction, rounding leaves any residual, zero and less among them.
    largest = max(spectrum.square, spectrum.smallest)
    residual = spectrum.residual(spectrum.solve(1.0, 1.0))
    return 1e-8 * spectrum.rows / largest, spectrum.rows / residual, spectrum.rows / spectrum.smallest


def choose_weights(
    spectrum: Spectrum,
    options: InertiaOptions,
    trials: Sequence[NormalEquations] = (),
    covariance: Float[Tensor, "params params"] | None = None,
    mass: tuple[float, float] | None = None,
) -> Weights:
    """Weights after ``options``; cross-validation needs two ``trials`` or more (ConfigError) and ``covariance``."""
    omega_1 = 1.0 if options.noise == "known" else None
    omega_2, notes = None, ()
    if options.prior_weight == "cross_validation":
        if len(trials) < 2 or covariance is None:
            raise ConfigError(
                "inertia.cross_validation", "cross-validation needs at least two fit trials",
                place="inertia.prior_weight", found=f"{len(trials)}", remedy="Use prior_weight: evidence",
            )  # fmt: skip
        omega_2 = _cross_validate(trials, spectrum.mean, covariance, mass, options)
        notes = _at_bound(omega_2, options.prior_weight_range)
    elif not isinstance(options.prior_weight, str):
        omega_2 = float(options.prior_weight)
    weights = maximise_evidence(spectrum, omega_1, omega_2, options.prior_weight_range)
    return Weights(weights.omega_1, weights.omega_2, weights.log_evidence, weights.notes + notes)


def _cross_validate(
    trials: Sequence[NormalEquations],
    mean: Float[Tensor, " params"],
    covariance: Float[Tensor, "params params"],
    mass: tuple[float, float] | None,
    options: InertiaOptions,
) -> float:
    """omega_2 whose fits predict the trial left out with the smallest squared residual."""
    grid = np.geomspace(*options.prior_weight_range, _GRID)
    loss = np.zeros(_GRID)
    for k, trial in enumerate(trials):
        others = [other for i, other in enumerate(trials) if i != k]
        spectrum = diagonalise(sum(others[1:], others[0]), mean, covariance, mass)
        for i, omega_2 in enumerate(grid):
            omega_1 = 1.0 if options.noise == "known" else None
            weights = maximise_evidence(spectrum, omega_1, float(omega_2), options.prior_weight_range)
            phi = spectrum.params(spectrum.solve(weights.omega_1, weights.omega_2))
            loss[i] += trial.residual_square(phi)
    return float(grid[int(np.argmin(loss))])


def _at_bound(omega_2: float, weight_range: tuple[float, float]) -> tuple[Note, ...]:
    """A note when the search ended at an end of its range."""
    if bool((np.abs(np.log(np.array(weight_range) / omega_2)) < 1e-3).any()):
        message = f"the prior's weight {omega_2:.3g} lies at an end of its range {weight_range}"
        return (Note("inertia.prior_weight_at_bound", message),)
    return ()
