"""This module says how well xi is determined, by a covariance from Jacobians of the pytorch-kinematics chain.

The Jacobian of a marker with respect to a chain joint is z x (p - o) for a turn and z for a slide, where the joint is
an ancestor of the marker's body; motion is eliminated frame by frame (Schur complement), xi keeps its prior.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.geometry.gradient_solvers import chain_residual
from torchid.geometry.problem import MarkerProblem
from torchid.geometry.sliding_skin import SlideSums, slid_covariance, slides_of
from torchid.kinematics.chain import base_transform, chain_of, chain_transforms
from torchid.model.tree import BASE_DOFS

SAMPLED = 240
"""Frames from which the information is computed; the others count through their number. The value is chosen."""
CHUNK = 40
"""Frames whose Jacobians are held at a time; chosen for memory."""
DIRECTIONS = 8
"""Undetermined directions that are listed at most; chosen."""
WEAK = 0.5
"""A direction is undetermined when the motion removes less than this share of its prior variance; chosen."""


@dataclass(frozen=True)
class Direction:
    """A combination of parameters that the motion leaves (nearly) to the prior."""

    share: float
    """Share of its prior variance that the data removed, 0 to 1."""
    parameters: dict[str, float]
    """The four largest components by name, in prior standard deviations."""


@dataclass(frozen=True)
class GeometryUncertainty:
    """The posterior of xi at the solution, to first order, and how far skin may have led it astray.

    The solution knows nothing of skin that slides with angles: where that is far, deviations exceed the prior's.
    """

    covariance: Float[Tensor, "xi xi"]
    undetermined: tuple[Direction, ...]
    residual: Float[Tensor, "markers 3 frames"]
    """Residuals of the markers through the chain, NaN where missing [m]."""
    skin_m_rad: float = 0.0
    """The length of the slide of skin under a marker with an angle of a joint near it, root mean square [m/rad]."""

    @property
    def sd(self) -> Float[Tensor, " xi"]:
        """Return the standard deviations of xi."""
        return torch.diagonal(self.covariance).clamp(min=0.0).sqrt()


def chain_jacobian(
    problem: MarkerProblem, q: Float[Tensor, "dofs frames"], xi: Float[Tensor, " xi"]
) -> tuple[Float[Tensor, "frames rows dofs"], Float[Tensor, "frames rows xi"], Float[Tensor, "frames markers 3 3"]]:
    """Return the derivatives of marker positions with respect to motion and xi.

    The base's rotation is differentiated by a turn in W about its origin.

    Returns:
        Two Jacobians, whose rows are the markers' coordinates, marker by marker, x y z; and the orientations R_WB of
        the markers' segments.
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
    n = tree.n_axes
    raw = p.new_zeros(*p.shape[:2], n + len(problem.geometry.constant), 3)
    raw.index_add_(2, chain.q_rows, column)
    raw = raw.transpose(2, 3).reshape(len(p), 3 * p.shape[1], -1)
    J_q = tree.fold(q, raw[:, :, :n].permute(2, 1, 0)).permute(2, 1, 0).clone()
    J_g = raw[:, :, n:] @ problem.geometry.map
    J_q[:, :, :BASE_DOFS] = _base_columns(p - q[:3].T[:, None])
    R_WB = X[:, frame, :3, :3]
    return J_q, torch.cat([J_g, _place_columns(problem, R_WB)], dim=2), R_WB


def _base_columns(arm: Tensor) -> Tensor:
    """Return the derivatives by the base's six coordinates for arms (frames, markers, 3) from its origin."""
    eye = torch.eye(3, dtype=arm.dtype, device=arm.device)
    shape = (*arm.shape[:2], 3, 3)
    turn = torch.linalg.cross(eye.expand(shape), arm[:, :, None].expand(shape)).transpose(2, 3)
    return torch.cat([eye.expand(shape), turn], dim=3).reshape(len(arm), -1, BASE_DOFS)


def _place_columns(problem: MarkerProblem, R: Tensor) -> Tensor:
    """Return the derivatives by the free markers' places for rotations R (frames, markers, 3, 3) of their bodies."""
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
    loose: Float[Tensor, " markers"],
) -> GeometryUncertainty:
    """Return the posterior of xi, wider by sliding skin, the directions left to the prior, and the residuals.

    Args:
        problem: markers with weights that match the residuals, their autocorrelation included.
        q: coordinates at the solution.
        xi: geometry and marker places at the solution.
        names: names of all entries of xi.
        loose: how far skin slides under each marker, beside others.
    """
    residual = chain_residual(problem, q, xi)
    _, weight = problem.robust_cost(residual)
    frames = q.shape[1]
    index = torch.linspace(0, frames - 1, min(frames, SAMPLED), device=q.device).round().long()
    body = [problem.plan.order[k] for k in problem.body.tolist()]
    slides = slides_of(problem.plan.tree, body, q, loose)
    information, sums = xi.new_zeros(len(xi), len(xi)), SlideSums.nothing(slides, len(xi))
    for part in index.split(CHUNK):
        information += _add_frames(problem, q, xi, weight, part, sums)
    factor = frames / len(index)
    information *= factor
    prior = problem.xi_precision
    covariance = torch.linalg.inv(information + torch.diag(prior))
    covariance = 0.5 * (covariance + covariance.T)
    moment = slides.moment(problem.residual(q, xi)[0].R[problem.body], weight, residual)
    slid, skin = slid_covariance(sums.scaled(factor), moment, covariance)
    return GeometryUncertainty(
        covariance=covariance + slid,
        undetermined=_undetermined(information, prior.rsqrt(), names),
        residual=torch.where(problem.weight[:, None] > 0, residual, torch.nan),
        skin_m_rad=3.0**0.5 * skin,
    )


def _add_frames(
    problem: MarkerProblem, q: Tensor, xi: Tensor, weight: Tensor, part: Tensor, sums: SlideSums
) -> Float[Tensor, "xi xi"]:
    """Return the information on xi of some frames, their motion eliminated, and add what they say of slides."""
    few = problem.frames(part)
    J_q, J_x, R_WB = chain_jacobian(few, q[:, part], xi)
    W = weight[:, part].T.repeat_interleave(3, dim=1)
    WJ_q, WJ_x = W[:, :, None] * J_q, W[:, :, None] * J_x
    H = J_q.mT @ WJ_q
    _, _, curvature = few.posture.pull(q[:, part])
    torch.diagonal(H, dim1=1, dim2=2).add_(curvature.T)
    scale = torch.diagonal(H, dim1=1, dim2=2).amax(1, keepdim=True)
    torch.diagonal(H, dim1=1, dim2=2).add_(1e-10 * scale + 1e-12)
    V = torch.linalg.solve_triangular(torch.linalg.cholesky(H), WJ_q.mT, upper=False)
    score = WJ_x - V.mT @ (V @ J_x)
    sums.add(part, R_WB.mT, weight[:, part].T, V, score)
    return J_x.flatten(0, 1).mT @ score.flatten(0, 1)


def _undetermined(information: Tensor, sd: Tensor, names: tuple[str, ...]) -> tuple[Direction, ...]:
    """List the directions of xi, in prior standard deviations, of which the data determine least."""
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
    """Return the share of each marker's frames that count as independent (markers,), 0 to 1.

    The share is 1 / (1 + 2 sum of autocorrelations). A rule like Geyer's initial positive sequence (Statistical Science
    7(4), 1992) ends the sum, at the first autocorrelation of at most 0.05.

    Args:
        residual: residuals trial after trial, NaN where missing [m].
        lengths: frames of each trial; no product reaches from one trial into the next.
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
