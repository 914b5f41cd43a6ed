"""Random bodies, priors and base-row regressors for the tests of the inertial fit."""

import numpy as np
import pinocchio as pin
import torch
from torch import Tensor

from torchid.model.model import InertialPrior
from torchid.model.pseudo import pseudo_to_params, relative_map, triangle


def bodies(count: int) -> Tensor:
    """Inertial parameters of clouds of point masses of limb size."""
    points = 0.1 * torch.randn(count, 20, 3, dtype=torch.float64) + 0.1 * torch.randn(count, 1, 3, dtype=torch.float64)
    points = torch.cat([points, torch.ones(count, 20, 1, dtype=torch.float64)], dim=-1)
    mass = 1 + 9 * torch.rand(count, 1, 1, dtype=torch.float64)
    return pseudo_to_params(mass / 20 * points.mT @ points)


def names(count: int) -> tuple[str, ...]:
    """Body names."""
    return tuple(f"body_{k}" for k in range(count))


def prior(mean: Tensor, sd: float) -> InertialPrior:
    """Relative parameters scatter by ``sd``, independently."""
    T = relative_map(mean)
    return InertialPrior(mean, torch.block_diag(*(sd**2 * T @ T.mT)))


def draw(given: InertialPrior) -> Tensor:
    """A subject from the prior."""
    factor = torch.linalg.cholesky(given.covariance)
    return given.mean + (factor @ torch.randn(len(factor), dtype=torch.float64)).reshape(-1, 10)


def chain_rows(count: int, frames: int, seed: int) -> Tensor:
    """Base rows (6 frames, 10 bodies) of Pinocchio's regressor for a floating chain in random motion."""
    generator = np.random.default_rng(seed)
    pin.seed(seed % 2**32)  # of randomConfiguration
    model, parent = pin.Model(), 0
    for k in range(count):
        joint = pin.JointModelFreeFlyer() if k == 0 else pin.JointModelRY() if k % 2 else pin.JointModelSpherical()
        place = pin.SE3(np.eye(3), 0.3 * generator.normal(size=3) if k else np.zeros(3))
        parent = model.addJoint(parent, joint, place, f"joint_{k}")
    data, rows = model.createData(), []
    for _ in range(frames):
        q = pin.randomConfiguration(model, -np.ones(model.nq), np.ones(model.nq))
        v, a = generator.normal(size=model.nv), 5 * generator.normal(size=model.nv)
        rows.append(pin.computeJointTorqueRegressor(model, data, q, v, a)[:6].copy())
    return torch.from_numpy(np.concatenate(rows))


def relative(phi: Tensor, reference: Tensor) -> Tensor:
    """Relative parameters (bodies, 10)."""
    return torch.linalg.solve(relative_map(reference), phi[..., None]).squeeze(-1)


IDENTITY = triangle(torch.eye(4, dtype=torch.float64))
"""Relative parameters of the reference itself."""
