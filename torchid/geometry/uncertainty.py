"""How well xi is determined: covariance from Jacobians of the pytorch-kinematics chain, whatever solver came before.

The Jacobian of a marker with respect to a chain joint is z x (p - o) for a turn and z for a slide, where the joint is
an ancestor of the marker's body; motion is eliminated frame by frame (Schur complement), xi keeps its prior.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.geometry.gradient_solvers import chain_residual
from torchid.geometry.problem import MarkerProblem
from torchid.kinematics.chain import base_transform, chain_of, chain_transforms
from torchid.model.tree import BASE_DOFS

SAMPLED = 240
"""Frames from which the information is computed; the others count through their number."""
CHUNK = 40
DIRECTIONS = 8
"""Undetermined directions listed at most."""
WEAK = 0.5
"""Share of the prior variance below which the motion is said not to determine a direction."""


@dataclass(frozen=True)
class Direction:
    """A combination of parameters that the motion leaves (nearly) to the prior."""

    share: float
    """Part of its prior variance that the data removed."""
    parameters: dict[str, float]
    """Largest components, in prior standard deviations."""


@dataclass(frozen=True)
class GeometryUncertainty:
    """Posterior of xi at the solution."""

    covariance: Float[Tensor, "xi xi"]
    undetermined: tuple[Direction, ...]
    residual: Float[Tensor, "markers 3 frames"]
    """Of the chain, NaN where missing [m]."""

    @property
    def sd(self) -> Float[Tensor, " xi"]:
        """Standard deviations."""
        return torch.diagonal(self.covariance).clamp(min=0.0).sqrt()


def chain_jacobian(
    problem: MarkerProblem, q: Float[Tensor, "dofs frames"], xi: Float[Tensor, " xi"]
) -> tuple[Float[Tensor, "frames rows dofs"], Float[Tensor, "frames rows xi"]]:
    """Derivatives of marker positions (rows: marker by marker, x y z) with respect to motion and xi.

    The base's rotation is differentiated by a turn in W about its origin.
    """
    geometry, place = problem.split(xi)
    tree = problem.plan.tree
    chain = chain_of(tree, q.dtype, str(q.device))
    X = (base_transform(q.T)[None] @ chain_transforms(chain, q.T, geometry)).transpose(0, 1)
    body = torch.tensor(problem.plan.order, device=q.device)[problem.body]
    frame = chain.frames[body]
    p = (X[:, frame, :3, :3] @ place[:, :, None])[..., 0] + X[:, frame, :3, 3]
    joint = X[:, chain.joint_frames]
    z = (joint[..., :3, :3] @ chain.chain.axes[:, :, None])[..., 0]
    arm = p[:, :, None] - joint[:, None, :, :3, 3]
    turn = torch.linalg.cross(z[:, None].expand_as(arm), arm)
    column = torch.where(chain.chain._dof_is_revolute[:, None], turn, z[:, None])
    column = column * (chain.chain._dof_ancestor_mask[:, frame].T * chain.signs)[:, :, None]
    raw = p.new_zeros(*p.shape[:2], len(tree.dofs) + len(problem.geometry.constant), 3)
    raw.index_add_(2, chain.q_rows, column)
    raw = raw.transpose(2, 3).reshape(len(p), 3 * p.shape[1], -1)
    J_q, J_g = raw[:, :, : len(tree.dofs)].clone(), raw[:, :, len(tree.dofs) :] @ problem.geometry.map
    J_q[:, :, :BASE_DOFS] = _base_columns(p - q[:3].T[:, None])
    return J_q, torch.cat([J_g, _place_columns(problem, X[:, frame, :3, :3])], dim=2)


def _base_columns(arm: Tensor) -> Tensor:
    eye = torch.eye(3, dtype=arm.dtype, device=arm.device)
    shape = (*arm.shape[:2], 3, 3)
    turn = torch.linalg.cross(eye.expand(shape), arm[:, :, None].expand(shape)).transpose(2, 3)
    return torch.cat([eye.expand(shape), turn], dim=3).reshape(len(arm), -1, BASE_DOFS)


def _place_columns(problem: MarkerProblem, R: Tensor) -> Tensor:
    frames, markers = R.shape[:2]
    out = R.new_zeros(frames, markers, 3, len(problem.free), 3)
    for k, marker in enumerate(problem.free.tolist()):
        out[:, marker, :, k] = R[:, marker]
    return out.reshape(frames, 3 * markers, -1)


def estimate_uncertainty(
    problem: MarkerProblem,
    q: Float[Tensor, "dofs frames"],
    xi: Float[Tensor, " xi"],
    names: tuple[str, ...],
) -> GeometryUncertainty:
    """Posterior covariance of xi, directions left to the prior, and residuals of the chain.

    Args:
        problem: with weights that match the residuals, their autocorrelation included.
        q, xi: solution.
        names: of all entries of xi.
    """
    residual = chain_residual(problem, q, xi)
    _, weight = problem.robust_cost(residual)
    frames = q.shape[1]
    index = torch.linspace(0, frames - 1, min(frames, SAMPLED), device=q.device).round().long()
    information = xi.new_zeros(len(xi), len(xi))
    for part in index.split(CHUNK):
        W = weight[:, part].T.repeat_interleave(3, dim=1)
        information += _reduced(problem.frames(part), q[:, part], xi, W)
    information *= frames / len(index)
    prior = problem.xi_precision
    covariance = torch.linalg.inv(information + torch.diag(prior))
    return GeometryUncertainty(
        covariance=0.5 * (covariance + covariance.T),
        undetermined=_undetermined(information, prior.rsqrt(), names),
        residual=torch.where(problem.weight[:, None] > 0, residual, torch.nan),
    )


def _reduced(problem: MarkerProblem, q: Tensor, xi: Tensor, W: Tensor) -> Tensor:
    """Information on xi of some frames, their motion eliminated."""
    J_q, J_x = chain_jacobian(problem, q, xi)
    WJ_q, WJ_x = W[:, :, None] * J_q, W[:, :, None] * J_x
    H = J_q.mT @ WJ_q
    _, _, curvature = problem.posture.pull(q)
    torch.diagonal(H, dim1=1, dim2=2).add_(curvature.T)
    scale = torch.diagonal(H, dim1=1, dim2=2).amax(1, keepdim=True)
    torch.diagonal(H, dim1=1, dim2=2).add_(1e-10 * scale + 1e-12)
    V = torch.linalg.solve_triangular(torch.linalg.cholesky(H), WJ_q.mT @ J_x, upper=False)
    return (J_x.mT @ WJ_x - V.mT @ V).sum(0)


def _undetermined(information: Tensor, sd: Tensor, names: tuple[str, ...]) -> tuple[Direction, ...]:
    value, vector = torch.linalg.eigh(sd[:, None] * information * sd)
    share = value.clamp(min=0.0) / (1.0 + value.clamp(min=0.0))
    found = []
    for k in range(min(DIRECTIONS, len(share))):
        if float(share[k]) >= WEAK:
            break
        top = vector[:, k].abs().argsort(descending=True)[:4].tolist()
        found.append(Direction(float(share[k]), {names[i]: float(vector[i, k]) for i in top}))
    return tuple(found)


def independent_share(residual: Float[Tensor, "markers 3 frames"], lengths: tuple[int, ...]) -> Tensor:
    """Share of frames that count as independent, per marker: 1 / (1 + 2 sum of autocorrelations).

    Geyer's initial-positive-sequence rule ends the sum (Statistical Science 7(4), 1992); trials are not joined.
    """
    share = residual.new_ones(len(residual))
    centred = torch.nan_to_num(residual)
    pieces = centred.split(list(lengths), dim=2)
    power = torch.stack([piece.square().sum((1, 2)) for piece in pieces]).sum(0)
    total = torch.ones_like(share)
    going = torch.ones_like(share, dtype=torch.bool)
    for lag in range(1, max(lengths)):
        product = sum((p[:, :, lag:] * p[:, :, :-lag]).sum((1, 2)) for p in pieces if p.shape[2] > lag)
        rho = product / power.clamp(min=1e-30)
        going &= rho > 0.05
        if not bool(going.any()):
            break
        total += torch.where(going, 2.0 * rho, 0.0)
    return share / total
