"""The constrained optimum of a posed problem with chosen weights."""

import numpy as np
import torch
from torch import Tensor

from torchid.inertia import cone, entropic
from torchid.inertia.options import InertiaOptions
from torchid.inertia.problem import Problem
from torchid.inertia.spectrum import cholesky
from torchid.inertia.weights import Weights


def solve(
    problem: Problem, weights: Weights, free: Tensor, covariance: Tensor, options: InertiaOptions
) -> cone.ConeSolution:
    """The constrained optimum in relative parameters.

    Args:
        free, covariance: optimum and inverse half Hessian of the Gaussian problem without constraints.
    """
    gram, moment = problem.data_terms(weights.omega_1)
    for _ in range(2):
        # The diagonalisation is exact to rounding times its condition number: iterative refinement in phi.
        pulled = weights.omega_2 * torch.cholesky_solve((free - problem.mean)[:, None], cholesky(problem.covariance))
        free = free + covariance @ (moment - gram @ free - pulled[:, 0])
    start = torch.linalg.solve(problem.T, free.reshape(-1, 10, 1)).flatten().cpu().numpy()
    linear, block = relative_rows(problem), torch.block_diag(*problem.T)
    if problem.divergence is not None:
        hessian = (block.mT @ gram @ block).cpu().numpy()
        pull = (block.mT @ moment).cpu().numpy()
        omega = weights.omega_2 * problem.divergence.cpu().numpy()
        return entropic.minimise(start, hessian, pull, omega, linear)
    if not options.lmi and not len(linear.inequality) and not len(linear.value):
        zero = np.zeros((len(problem.T), 4, 4))
        return cone.ConeSolution(start, zero, np.zeros(0), "Solved", 0, 1)
    hessian = block.mT @ gram @ block + weights.omega_2 * relative_precision(problem)
    return cone.project(start, hessian.cpu().numpy(), linear, lmi=options.lmi, floor=options.floor)


def relative_precision(problem: Problem) -> Tensor:
    """Inverse of the prior's covariance, in relative parameters."""
    factor = torch.linalg.solve_triangular(cholesky(problem.covariance), torch.block_diag(*problem.T), upper=False)
    return factor.mT @ factor


def relative_rows(problem: Problem) -> cone.LinearConstraints:
    """Linear constraints over relative parameters, each inequality of unit length."""
    block = torch.block_diag(*problem.T)
    inequality, (equality, value) = problem.inequality @ block, problem.equality
    inequality = inequality / inequality.norm(dim=-1, keepdim=True)
    return cone.LinearConstraints(inequality.cpu().numpy(), (equality @ block).cpu().numpy(), value.cpu().numpy())
