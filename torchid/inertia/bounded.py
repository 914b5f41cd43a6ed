"""The point nearest to the prior whose rows are met to a given error: "point-to-set" identification.

    min d(phi, prior)   s.t.   ||Y phi - F||^2 <= budget,   and all other constraints

is one convex program: a second-order cone holds the residual. Its multiplier mu makes the same point the optimum of
mu ||Y phi - F||^2 + d(phi, prior), whose certificate is that of the weighed fit. The solver leaves five to six digits
of mu, so the point is carried to rounding afterwards: by Newton steps with the log-det prior, by weighed fits with
secant steps of mu where LMIs may hold with equality.

The program's variables are scaled by the Hessian of mu ||Y phi - F||^2 + d(phi) at the mu that the problem without
cones has, the root of the secular equation of a trust region (Conn, Gould & Toint, Trust-Region Methods, 2000).

Reference: Lee, Wensing, Park, IEEE T-RO 36(2), 2020 ("point-to-set").
"""

# Clarabel's extension module has no stubs.
# pyright: reportAttributeAccessIssue=false

from dataclasses import dataclass

import clarabel
import cvxpy as cp
import numpy as np
import scipy.sparse as sp
import torch
from jaxtyping import Float
from scipy.optimize import brentq
from torch import Tensor

from torchid.errors import DataError
from torchid.inertia import cone, entropic
from torchid.inertia.cone import unit_axes
from torchid.inertia.newton import Matrix, QuadraticMisfit, Surface, Vector
from torchid.inertia.options import InertiaOptions
from torchid.inertia.problem import Problem
from torchid.inertia.solve import relative_precision, relative_rows, solve
from torchid.inertia.spectrum import Spectrum
from torchid.inertia.weights import Weights

_NULL = 1e-14
"""Eigenvalue of the data's Hessian, over its largest, below which only rounding is left of it."""
ACTIVE = 1e-9
"""Multiplier of the bound times its budget up to which the bound does not matter."""
_DECADES = 40.0
"""Natural logarithms around 1 / budget within which the multiplier is looked for: seventeen decades each way."""


@dataclass(frozen=True)
class BoundedTask:
    """The question of a fit under an error bound, in relative parameters x."""

    problem: Problem
    spectrum: Spectrum
    budget: float
    options: InertiaOptions
    misfit: QuadraticMisfit
    precision: Matrix
    """Inverse covariance of the prior's Gaussian."""
    mass_hessian: Matrix
    mass_pull: Vector
    """Square of the weighed total mass: x' mass_hessian x - 2 mass_pull' x."""

    def active(self, multiplier: float) -> float:
        """The multiplier, or 0 where the bound does not matter."""
        return multiplier if multiplier * self.budget > ACTIVE else 0.0

    def relative(self, phi: Tensor) -> Vector:
        """Relative parameters of ``phi``."""
        return torch.linalg.solve(self.problem.T, phi.reshape(-1, 10, 1)).flatten().cpu().numpy()


@dataclass(frozen=True)
class ScaledProgram:
    """The program in w, x = centre + rotate @ w, of which the residual is ||root @ w - target||^2 + rest."""

    centre: Vector
    rotate: Matrix
    root: Float[np.ndarray, "rank params"]
    target: Float[np.ndarray, " rank"]
    radius: float
    """Square root of budget - rest."""
    multiplier: float
    """Multiplier of the squared residual in the problem without cones."""


def pose_bounded(problem: Problem, spectrum: Spectrum, budget: float, options: InertiaOptions) -> BoundedTask:
    """Bring data, prior and weighed mass to relative parameters."""
    block = torch.block_diag(*problem.T)

    def relative(gram: Tensor, moment: Tensor) -> tuple[Matrix, Vector]:
        return (block.mT @ gram @ block).cpu().numpy(), (block.mT @ moment).cpu().numpy()

    equations = problem.equations
    misfit = QuadraticMisfit(*relative(equations.gram, equations.moment), equations.square)
    mass_hessian, mass_pull = relative(*problem.data_terms(0.0))
    precision = relative_precision(problem).cpu().numpy()
    return BoundedTask(problem, spectrum, budget, options, misfit, precision, mass_hessian, mass_pull)


def secular_multiplier(spectrum: Spectrum, budget: float) -> float:
    """The mu at which the problem without cones meets the budget with equality; 0 where it is met anyway."""

    def excess(log_mu: float) -> float:
        return float(np.log(spectrum.residual(spectrum.solve(np.exp(log_mu), 1.0)) / budget))

    low, high = (-np.log(budget) + side * _DECADES for side in (-1.0, 1.0))
    if excess(low) <= 0:
        return 0.0
    if excess(high) >= 0:
        return float(np.exp(high))
    root = brentq(excess, low, high)
    assert isinstance(root, float)
    return float(np.exp(root))


def scale(task: BoundedTask) -> ScaledProgram | None:
    """The program around the optimum without cones; None when even the best parameters miss the budget."""
    problem, spectrum, misfit = task.problem, task.spectrum, task.misfit
    mu = secular_multiplier(spectrum, task.budget)
    centre = task.relative(spectrum.params(spectrum.solve(mu, 1.0)) if mu > 0 else problem.mean)
    rotate = unit_axes(mu * misfit.hessian + task.precision + task.mass_hessian)
    values, axes = np.linalg.eigh(rotate.T @ misfit.hessian @ rotate)
    solid = values > _NULL * max(float(values[-1]), np.finfo(float).tiny)
    gain = np.sqrt(values[solid])
    target = -(axes[:, solid].T @ (rotate.T @ misfit.slope(centre))) / (2 * gain)
    room = float(target @ target) - misfit.excess(centre, task.budget)
    return ScaledProgram(centre, rotate, gain[:, None] * axes[:, solid].T, target, room**0.5, mu) if room > 0 else None


_REACH = 1e6
"""Price of the whole budget against one unit of prior distance, when the smallest reachable residual is looked for."""
_SECANTS = 30
"""Largest number of secant steps, each at most a factor e; from the cone program's multiplier two are usual."""
_NUDGE = 1e-4
"""First step of the logarithm of the multiplier."""
_MET = 1e-10
"""Relative difference of squared residual and budget at which the bound is met."""


@dataclass(frozen=True)
class BoundedSolution:
    """Optimum under an error bound, and the multiplier of the squared residual; 0 where the bound does not matter."""

    cone: cone.ConeSolution
    multiplier: float


def solve_within(problem: Problem, spectrum: Spectrum, budget: float, options: InertiaOptions) -> BoundedSolution:
    """Minimise the prior's distance with a squared residual of ``budget`` or less.

    Raises:
        DataError: no parameters that fulfil the other constraints meet the budget, or Clarabel found no solution.
    """
    task = pose_bounded(problem, spectrum, budget, options)
    untouched = _weighed(task, 0.0)
    if _log_excess(task, untouched) <= 0:
        return untouched
    scaled = scale(task)
    if scaled is None:
        raise _out_of_reach(task, "without cones, the best parameters miss the bound")
    return _quadratic(task, scaled) if problem.divergence is None else _entropic(task, scaled)


def _quadratic(task: BoundedTask, scaled: ScaledProgram) -> BoundedSolution:
    """Euclidean and pull-back priors: one second-order cone program with LMIs."""
    options, precision = task.options, task.precision
    rows = cone.cone_rows(len(scaled.centre), relative_rows(task.problem), lmi=options.lmi, floor=options.floor)
    away = precision @ (scaled.centre - task.relative(task.problem.mean))
    slope = 2 * scaled.rotate.T @ (away + task.mass_hessian @ scaled.centre - task.mass_pull)
    curve = scaled.rotate.T @ (precision + task.mass_hessian) @ scaled.rotate
    ball = np.vstack([np.zeros(len(slope)), -scaled.root / scaled.radius])
    A = sp.csc_array(sp.vstack([sp.csc_array(rows.A @ scaled.rotate), sp.csc_array(ball)]))
    b = np.concatenate([rows.b - rows.A @ scaled.centre, [1.0], -scaled.target / scaled.radius])
    cones = [*rows.cones, clarabel.SecondOrderConeT(len(ball))]
    solution, _ = cone.clarabel_solve(sp.csc_array(np.triu(2 * curve)), slope, A, b, cones)
    status = str(solution.status)
    if "PrimalInfeasible" in status:
        raise _out_of_reach(task, f"Clarabel: {status}")
    if status not in cone.SOLVED:
        return _refine(task, scaled.multiplier)
    multiplier = float(np.asarray(solution.z)[len(rows.b)]) / (2 * scaled.radius**2)
    return _refine(task, task.active(multiplier))


def _refine(task: BoundedTask, multiplier: float) -> BoundedSolution:
    """Meet the bound to rounding: secant steps of the multiplier, each an accurate fit with that weight.

    The cone program leaves five to six digits of the multiplier, and the residual falls steadily with it. Where the
    program ends without a solution, the steps start from the multiplier of the problem without cones.
    """
    found = _weighed(task, multiplier)
    if multiplier == 0:
        return found
    last, excess = np.log(multiplier), _log_excess(task, found)
    position = last + _NUDGE
    for _ in range(_SECANTS):
        found = _weighed(task, float(np.exp(position)))
        now = _log_excess(task, found)
        if abs(now) < _MET or now == excess:
            break
        step = -now * (position - last) / (now - excess)
        last, excess, position = position, now, position + float(np.clip(step, -1.0, 1.0))
    return found


def _weighed(task: BoundedTask, multiplier: float) -> BoundedSolution:
    """Return the optimum of multiplier * ||Y phi - F||^2 + d(phi)."""
    spectrum, weights = task.spectrum, Weights(multiplier, 1.0, 0.0)
    free, covariance = spectrum.params(spectrum.solve(multiplier, 1.0)), spectrum.covariance(multiplier, 1.0)
    return BoundedSolution(solve(task.problem, weights, free, covariance, task.options), multiplier)


def _log_excess(task: BoundedTask, found: BoundedSolution) -> float:
    square = task.problem.equations.residual_square(task.problem.params(found.cone.x).flatten())
    return float(np.log(max(square, np.finfo(float).tiny) / task.budget))


def _entropic(task: BoundedTask, scaled: ScaledProgram) -> BoundedSolution:
    """Log-det prior: exponential cones besides, then Newton steps on the bound's surface."""
    problem = task.problem
    assert problem.divergence is not None
    weights, linear = problem.divergence.cpu().numpy(), relative_rows(problem)
    w = cp.Variable(len(scaled.centre))
    x = scaled.centre + scaled.rotate @ w
    bound = cp.SOC(cp.Constant(1.0), (scaled.root @ w - scaled.target) / scaled.radius)
    objective = entropic.divergence_terms(x, weights)
    if problem.mass is not None:
        row = (problem.mass_row @ torch.block_diag(*problem.T)).cpu().numpy()
        objective = objective + cp.square((row @ x - problem.mass[0]) / problem.mass[1])
    program, dual = entropic.solve_program(objective, x, linear, [bound])
    if w.value is None:
        raise _out_of_reach(task, entropic.ending(program))
    assert bound.dual_value is not None
    multiplier = task.active(float(np.asarray(bound.dual_value[0]).item()) / (2 * scaled.radius**2))
    smooth = entropic.smooth(task.mass_hessian, task.mass_pull, weights)
    surface = Surface(task.misfit, task.budget, multiplier) if multiplier > 0 else None
    point = scaled.centre + scaled.rotate @ w.value
    return BoundedSolution(*entropic.finish(point, smooth, linear, dual, program, float(weights.min()), surface))


def _out_of_reach(task: BoundedTask, ending: str) -> DataError:
    """The error of a bound that no parameters meet, with the residual that they can reach."""
    problem, mu = task.problem, _REACH / task.budget
    free = task.relative(task.spectrum.params(task.spectrum.solve(mu, 1.0)))
    hessian = mu * task.misfit.hessian + task.precision + task.mass_hessian
    linear, options = relative_rows(problem), task.options
    nearest = cone.project(free, hessian, linear, lmi=options.lmi, floor=options.floor)
    square = max(problem.equations.residual_square(problem.params(nearest.x).flatten()), 0.0)
    if square < task.budget:
        return cone.no_solution(ending)
    rows = problem.equations.rows
    return DataError(
        "rows.bound_out_of_reach", "no parameters within the constraints meet the error bound", place="rms_bound",
        found=f"RMS {(task.budget / rows) ** 0.5:.4g}; the best parameters reach about {(square / rows) ** 0.5:.4g}",
        remedy="Raise the bound, widen boxes and ellipsoids, or check order, sign and units of the rows",
    )  # fmt: skip
