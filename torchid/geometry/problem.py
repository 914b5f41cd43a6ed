"""This module is the one least-squares problem that every geometric solver minimises.

    1/2 sum_t sum_m rho_m(|| p_m(q_t, xi) - p_hat_m(t) ||^2 w_mt)
    + 1/2 || xi - mean ||^2_prior + 1/2 sum_t || q_t - mean_t ||^2_prior

xi holds the named geometric parameters and, behind them, the places of the markers that are free on their segments.
A missing marker has weight zero.
"""

from dataclasses import dataclass, replace

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchid.kinematics.plan import Plan
from torchid.kinematics.recursion import Poses, points, poses
from torchid.kinematics.tables import Joints, make_joints
from torchid.model.model import Geometry, GeometryPrior
from torchid.model.rotation import after
from torchid.model.tree import BASE_DOFS


@dataclass(frozen=True)
class PosturePrior:
    """Independent normal priors on the coordinates, with soft limits; a precision of zero is no prior."""

    mean: Float[Tensor, "dofs #frames"]
    """Expected coordinates [m or rad]."""
    precision: Float[Tensor, "dofs #frames"]
    """Inverse variances about the mean [1/m^2 or 1/rad^2]."""
    lower: Float[Tensor, "dofs 1"]
    upper: Float[Tensor, "dofs 1"]
    limit_precision: float
    """Inverse variance of what lies beyond a limit [1/m^2 or 1/rad^2]."""

    def frames(self, index: Tensor | slice) -> "PosturePrior":
        """Return the prior of some frames; a prior that all frames share stays as it is."""
        cut = [x if x.shape[1] == 1 else x[:, index] for x in (self.mean, self.precision)]
        return replace(self, mean=cut[0], precision=cut[1])

    def rows(self, rows: list[int]) -> "PosturePrior":
        """Return the prior of the coordinates in these rows of q."""
        mean, precision, lower, upper = (x[rows] for x in (self.mean, self.precision, self.lower, self.upper))
        return PosturePrior(mean, precision, lower, upper, self.limit_precision)

    def cost(self, q: Float[Tensor, "*options dofs frames"]) -> Float[Tensor, "*options dofs frames"]:
        """Return half the squared misfit of every coordinate and frame, in standard deviations, limits included."""
        beyond = self._beyond(q)
        return 0.5 * (self.precision * (q - self.mean).square() + self.limit_precision * beyond.square())

    def pull(self, q: Float[Tensor, "dofs frames"]) -> tuple[Tensor, Tensor, Tensor]:
        """Return the quadratic model of the prior at q, along the increments of ``retract``.

        Returns:
            Cost (frames,), gradient (dofs, frames) and diagonal of the second derivative (dofs, frames).
        """
        error, beyond = q - self.mean, self._beyond(q)
        gradient = self.precision * error + self.limit_precision * beyond
        curvature = self.precision + self.limit_precision * (beyond != 0.0)
        cost = self.cost(q).sum(0)
        gradient[3:BASE_DOFS] = _along_turns(q[3:BASE_DOFS], gradient[3:BASE_DOFS])
        return cost, gradient, curvature.expand_as(q)

    def _beyond(self, q: Tensor) -> Tensor:
        """Return how far q lies past the limits, negative past the lower one."""
        return (q - self.upper).clamp(min=0.0) - (self.lower - q).clamp(min=0.0)


@dataclass(frozen=True)
class SubjectShape:
    """The shape of a subject that xi stands for: joints, and the markers' places p_BM_B [m]."""

    joints: Joints
    place: Float[Tensor, "markers 3"]


@dataclass(frozen=True)
class ProblemPoint:
    """Poses, residuals, weights and cost of a problem at one point (q, xi)."""

    at: Poses
    """Poses of all bodies."""
    p: Float[Tensor, "markers 3 frames"]
    """p_WM_W of the model's markers [m]."""
    residual: Float[Tensor, "markers 3 frames"]
    """p minus the target [m]; arbitrary where the weight is zero."""
    weight: Float[Tensor, "markers frames"]
    """Weights of the equivalent least-squares problem (``robust_cost``) [1/m^2]."""
    cost: Float[Tensor, " frames"]
    """Cost of markers and posture, without the prior on xi."""
    pull: Float[Tensor, "dofs frames"]
    """Gradient of the posture prior."""
    curvature: Float[Tensor, "dofs frames"]
    """Diagonal of the posture prior's second derivative."""


@dataclass(frozen=True)
class MarkerProblem:
    """The markers of many frames on one tree with weights and priors; tensors have the frames last."""

    plan: Plan
    geometry: GeometryPrior
    """Prior of the named geometric parameters."""
    body: Int[Tensor, " markers"]
    """Plan position of the body that carries each marker."""
    target: Float[Tensor, "markers 3 frames"]
    """p_WM_W [m], zero where missing."""
    weight: Float[Tensor, "markers frames"]
    """1 / sigma^2 [1/m^2], zero where missing."""
    place: Float[Tensor, "markers 3"]
    """Places p_BM_B: the prior mean, or the value itself where fixed [m]."""
    place_sd: Float[Tensor, "markers 3"]
    """Prior scatter of the free places [m]."""
    free: Int[Tensor, " free"]
    """Indices of the markers whose place is unknown."""
    posture: PosturePrior
    robust: float | None = None
    """Residuals beyond this many standard deviations lose their influence (Geman-McClure); None: least squares."""

    @property
    def n_named(self) -> int:
        """Return the number of named geometric parameters, which come first in xi; marker places follow."""
        return len(self.geometry.mean)

    @property
    def xi_mean(self) -> Float[Tensor, " xi"]:
        """Return the prior mean of xi: named parameters and marker places."""
        return torch.cat([self.geometry.mean, self.place[self.free].reshape(-1)])

    @property
    def xi_precision(self) -> Float[Tensor, " xi"]:
        """Return the prior precision of every entry of xi."""
        return torch.cat([self.geometry.sd, self.place_sd[self.free].reshape(-1)]).square().reciprocal()

    def shape(self, xi: Float[Tensor, " xi"]) -> SubjectShape:
        """Return joints and marker places at xi, in the form that the recursion takes."""
        geometry, place = self.split(xi)
        return SubjectShape(make_joints(self.plan, geometry), place)

    def split(self, xi: Float[Tensor, " xi"]) -> tuple[Geometry, Float[Tensor, "markers 3"]]:
        """Return the geometry and the places p_BM_B of all markers at xi [m]."""
        place = self.place.clone()
        place[self.free] = xi[self.n_named :].reshape(-1, 3)
        return self.geometry.geometry(xi[: self.n_named]), place

    def frames(self, index: Tensor | slice) -> "MarkerProblem":
        """Return the same problem on some of its frames."""
        return replace(
            self,
            target=self.target[:, :, index],
            weight=self.weight[:, index],
            posture=self.posture.frames(index),
        )

    def residual(
        self, q: Float[Tensor, "dofs frames"], xi: Float[Tensor, " xi"]
    ) -> tuple[Poses, Float[Tensor, "markers 3 frames"], Float[Tensor, "markers 3 frames"]]:
        """Return poses, marker positions p_WM_W [m] and their residuals [m], at (q, xi).

        Residuals are arbitrary where the weight is zero.
        """
        shape = self.shape(xi)
        at = poses(self.plan, q, shape.joints)
        p = points(at, self.body, shape.place)
        return at, p, p - self.target

    def evaluate(self, q: Float[Tensor, "dofs frames"], shape: SubjectShape) -> ProblemPoint:
        """Evaluate poses, residuals, cost and weights of every frame at q, for a shape from ``shape``."""
        at = poses(self.plan, q, shape.joints)
        p = points(at, self.body, shape.place)
        residual = p - self.target
        cost, weight = self.robust_cost(residual)
        prior, pull, curvature = self.posture.pull(q)
        return ProblemPoint(at, p, residual, weight, cost + prior, pull, curvature)

    def robust_cost(
        self, residual: Float[Tensor, "markers 3 frames"]
    ) -> tuple[Float[Tensor, " frames"], Float[Tensor, "markers frames"]]:
        """Return the markers' cost per frame and the weights of the equivalent least-squares problem.

        The loss is that of Geman & McClure (1985): rho(s) = c^2 s / (c^2 + s) of the normalised squared residual s.
        Reweighting by rho'(s) = (c^2 / (c^2 + s))^2 majorises the cost, since rho is concave in s.
        """
        s = residual.square().sum(1) * self.weight
        if self.robust is None:
            return 0.5 * s.sum(0), self.weight
        c2 = 3.0 * self.robust**2
        shrink = c2 / (c2 + s)
        return 0.5 * (shrink * s).sum(0), self.weight * shrink.square()

    def frame_cost(self, q: Float[Tensor, "dofs frames"], xi: Float[Tensor, " xi"]) -> Float[Tensor, " frames"]:
        """Return the cost of each frame (markers and posture), without the prior on xi."""
        return self.evaluate(q, self.shape(xi)).cost

    def xi_cost(self, xi: Float[Tensor, " xi"]) -> float:
        """Return the cost of the prior on xi."""
        return 0.5 * float((self.xi_precision * (xi - self.xi_mean).square()).sum())


def retract(q: Tensor, dq: Tensor) -> Tensor:
    """Return q moved by dq.

    Args:
        q: coordinates (dofs, frames); rows 3-5 are the base's rotation vector.
        dq: increments (dofs, frames); rows 3-5 are a rotation of the base in W, applied after its own.
    """
    new = q + dq
    new[3:BASE_DOFS] = after(dq[3:BASE_DOFS], q[3:BASE_DOFS])
    return new


def _along_turns(r: Tensor, gradient: Tensor) -> Tensor:
    """Turn a gradient in a rotation vector r (3, frames) into one in rotations in W.

    The map is the transpose of the inverse left Jacobian (Sola et al. 2018, eq. 146).
    """
    angle = (r * r).sum(0).sqrt().clamp(min=1e-3)
    factor = angle.square().reciprocal() - 0.5 / (angle * (0.5 * angle).tan())
    once = torch.linalg.cross(r, gradient, dim=0)
    return gradient + 0.5 * once + factor * torch.linalg.cross(r, once, dim=0)
