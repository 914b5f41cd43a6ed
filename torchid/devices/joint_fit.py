"""Body, parts and grounded supports together: one Gaussian over base rows, and its nearest physical point.

With z = (phi of the bare body, phi of the parts, parameters of supports) and E the map that puts a part's parameters on
its segment, the rows of a trial with the device are Y E z = F. The prior of the body is the posterior of the trials
without. The point that is returned is the nearest in posterior standard deviations at which every body and every part
is physical (Wensing, Kim, Slotine, IEEE RA-L 3(1), 2018), so that no mass is negative.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from torchid.conventions import Inertial
from torchid.devices.device import SheetValue
from torchid.devices.parts import LEAST_SD, PartsPrior
from torchid.devices.result import BodyBelief
from torchid.dynamics.rows import WrenchTrial
from torchid.dynamics.whitening import (
    BlockSpectrum,
    Whitening,
    accumulate,
    estimate_whitening,
    initial_whitening,
    spectra,
)
from torchid.inertia.cone import LinearConstraints, project
from torchid.inertia.identify import ROUNDS
from torchid.model.pseudo import relative_map

FLOOR = 1e-6
"""Smallest eigenvalue of a pseudo-inertia relative to its reference's, as of ``InertiaOptions.floor``."""


@dataclass(frozen=True)
class Extra:
    """Parameters of supports: their prior, and their columns in each trial."""

    mean: Float[Tensor, " extra"]
    sd: Float[Tensor, " extra"]
    columns: tuple[Float[Tensor, "6 extra frames"], ...]
    """Derivative of the right side of Y phi = F + ... moved to the left, about the root's origin, by trial."""


@dataclass(frozen=True)
class Considered:
    """Errors that are not estimated but known to be possible: they widen the covariance and move nothing.

    An error such as a plate's gain resembles what a body in motion leaves unexplained anyway; estimated, it takes that
    up and hands its own weight to the parts (a consider covariance: Tapley, Schutz & Born, Statistical Orbit
    Determination, 2004, section 6.4).
    """

    sd: Float[Tensor, " errors"]
    columns: tuple[Float[Tensor, "6 errors frames"], ...]
    """As of ``Extra``."""


@dataclass(frozen=True)
class JointFit:
    """Body, parts and parameters of supports after the trials with the device."""

    body: Float[Tensor, "bodies 10"]
    parts: Float[Tensor, "parts 10"]
    extra: Float[Tensor, " extra"]
    covariance: Float[Tensor, "params params"]
    """Of body, parts and supports, in this order; Gaussian, without the LMI."""
    whitening: Whitening
    log_evidence: float
    """Of the base rows under this whitening, Gaussian; compare only fits of the same rows and whitening [nat]."""


def fit_jointly(
    trials: Sequence[WrenchTrial],
    body: BodyBelief,
    parts: PartsPrior,
    extra: Extra,
    known_noise: Whitening | None = None,
    considered: Considered | None = None,
    weighed: SheetValue | None = None,
) -> JointFit:
    """Update what is known of body, parts and supports by the base rows of trials with the device.

    Args:
        trials: with the device, known supports added to their wrench; each has a run of used frames.
        body: as trials without the device told it.
        parts: as the sheet tells them.
        extra: parameters of supports.
        known_noise: of the rows; None: estimated from their residuals.
        considered: errors of the rows that widen the covariance.
        weighed: mass of all parts together as a scale tells it [kg], held against rows with their errors.

    Raises:
        DataError: no solution exists.
    """
    mean = torch.cat([body.phi.reshape(-1), parts.mean.reshape(-1), extra.mean])
    covariance = torch.block_diag(body.covariance, parts.covariance, torch.diag(extra.sd.square()))
    precision = _inverse(covariance)
    errors = considered or Considered(mean.new_zeros(0), tuple(mean.new_zeros(6, 0, len(t.wrench)) for t in trials))
    n_errors = len(errors.sd)
    E = _map(len(body.phi), parts.body, len(extra.mean), mean)
    E = torch.cat([E, E.new_zeros(n_errors, E.shape[1])])
    each = zip(trials, extra.columns, errors.columns, strict=True)
    blocks = [list(spectra(trial, torch.cat([own, beside], 1))) for trial, own, beside in each]
    whitening = known_noise or initial_whitening(mean)
    for _ in range(0 if known_noise else ROUNDS - 1):
        z, found, *_ = _solve(blocks, whitening, E, mean, precision)
        lost = float(len(mean) - torch.trace(precision @ found))
        params = E @ z
        whitening = estimate_whitening(((b, params) for b in chain.from_iterable(blocks)), max(lost, 0.0))
    z, found, evidence, gram = _solve(blocks, whitening, E, mean, precision)
    n, bodies = len(mean) - len(extra.mean), 10 * len(body.phi)
    metric, moved = found, found @ (E.mT @ gram[:, len(gram) - n_errors :]) * errors.sd
    found = found + moved @ moved.mT
    if weighed is not None and len(parts.names):
        z, found = _weighed(z, found, slice(bodies, n, len(Inertial)), weighed)
    z = _physical(z, metric, n, torch.cat([body.phi, parts.reference]))
    return JointFit(z[:bodies].reshape(-1, 10), z[bodies:n].reshape(-1, 10), z[n:], found, whitening, evidence)


def _weighed(z: Tensor, covariance: Tensor, masses: slice, total: SheetValue) -> tuple[Tensor, Tensor]:
    """Condition on the sum of some parameters (Gaussian conditioning on one linear measurement)."""
    lever = covariance[:, masses].sum(1)
    variance = lever[masses].sum() + max(total.sd, LEAST_SD[0]) ** 2
    return z + lever * ((total.value - z[masses].sum()) / variance), covariance - torch.outer(lever, lever) / variance


def _map(bodies: int, on: tuple[int, ...], extra: int, like: Tensor) -> Float[Tensor, "columns params"]:
    """E: a part's parameters act in its segment's columns."""
    eye = torch.eye(10, dtype=like.dtype, device=like.device)
    onto = like.new_zeros(10 * bodies, 10 * len(on))
    for k, body in enumerate(on):
        onto[10 * body : 10 * body + 10, 10 * k : 10 * k + 10] = eye
    base = torch.eye(10 * bodies, dtype=like.dtype, device=like.device)
    return torch.block_diag(torch.cat([base, onto], 1), torch.eye(extra, dtype=like.dtype, device=like.device))


def _solve(
    blocks: list[list[BlockSpectrum]], whitening: Whitening, E: Tensor, mean: Tensor, precision: Tensor
) -> tuple[Float[Tensor, " params"], Float[Tensor, "params params"], float, Float[Tensor, "columns columns"]]:
    """Posterior mean, covariance and log evidence, and the Gram matrix of all columns."""
    sums = [accumulate(own, whitening) for own in blocks]
    total = sum(sums[1:], sums[0])
    total.check()
    found = _inverse(E.mT @ total.gram @ E + precision)
    start = E @ mean
    pull = E.mT @ (total.moment - total.gram @ start)
    miss = total.square - 2.0 * float(total.moment @ start) + float(start @ total.gram @ start)
    step = found @ pull
    volume = float(torch.logdet(_scaled(found)[0]) + _scaled(found)[1] + torch.logdet(_scaled(precision)[0]))
    evidence = 0.5 * (float(pull @ step) - miss + volume + float(_scaled(precision)[1]))
    return mean + step, found, evidence, total.gram


def _scaled(matrix: Tensor) -> tuple[Tensor, Tensor]:
    """A matrix with unit diagonal, and the logarithm of the determinant that this took out of it."""
    scale = matrix.diagonal().rsqrt()
    return scale[:, None] * matrix * scale, -2.0 * scale.log().sum()


def _inverse(matrix: Tensor) -> Tensor:
    """Inverse of a positive definite matrix, scaled to a unit diagonal first."""
    scale = matrix.diagonal().rsqrt()
    factor = torch.linalg.cholesky(_scaled(matrix)[0])
    return scale[:, None] * torch.cholesky_inverse(factor) * scale


def _physical(
    z: Float[Tensor, " params"], covariance: Tensor, n: int, reference: Float[Tensor, "bodies 10"]
) -> Float[Tensor, " params"]:
    """The nearest point at which every body and part is physical; supports follow by their correlation."""
    T = torch.block_diag(*relative_map(reference))
    precision = _inverse(covariance[:n, :n])
    hessian = (T.mT @ precision @ T).cpu().numpy()
    start = torch.linalg.solve(T, z[:n]).cpu().numpy()
    none = LinearConstraints(np.zeros((0, n)), np.zeros((0, n)), np.zeros(0))
    moved = T @ z.new_tensor(project(start, hessian, none, lmi=True, floor=FLOOR).x)
    shift = covariance[n:, :n] @ (precision @ (moved - z[:n]))
    return torch.cat([moved, z[n:] + shift])
