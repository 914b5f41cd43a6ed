"""Rotations over time: filtering as quaternions, angular rates, and the angles of three-axis joints."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.filters import Smoother, differentiate
from torchid.model.rotation import log, rotation_matrix, unit_quaternion
from torchid.model.tree import Turn

POLE = 1e-3
"""Sine of the angle to the pole below which angle rates are taken from damped least squares."""


@dataclass(frozen=True)
class AngularMotion:
    """A rotation over time with its angular velocity and acceleration, both in the axes it starts from."""

    R: Float[Tensor, "frames 3 3"]
    w: Float[Tensor, "frames 3"]
    alpha: Float[Tensor, "frames 3"]


def filter_rotation(
    R: Float[Tensor, "frames 3 3"], smoother: Smoother, weight: Float[Tensor, " frames"] | None = None
) -> AngularMotion:
    """Low-pass a rotation and differentiate it: w = 2 Im(n' n*), alpha = 2 Im(n'' n*) for the unit quaternion n."""
    y = smoother(continuous_quaternion(R), weight)
    yd, ydd = differentiate(y, smoother.rate_hz)
    r = y.norm(dim=1, keepdim=True)
    n = y / r
    s = (n * yd).sum(1, keepdim=True)
    nd = (yd - n * s) / r
    ndd = (ydd - nd * s) / r - nd * s / r
    return AngularMotion(rotation_matrix(log(n.T).T), _turning(nd, n), _turning(ndd, n))


def _turning(x: Float[Tensor, "frames 4"], n: Float[Tensor, "frames 4"]) -> Float[Tensor, "frames 3"]:
    """2 Im(x n*) of quaternions (vector, scalar)."""
    return 2.0 * (n[:, 3:] * x[:, :3] - x[:, 3:] * n[:, :3] - torch.linalg.cross(x[:, :3], n[:, :3]))


def continuous_quaternion(R: Float[Tensor, "frames 3 3"]) -> Float[Tensor, "frames 4"]:
    """Unit quaternions (vector, scalar) without sign flips along the frames."""
    n = unit_quaternion(R)
    flips = (n[1:] * n[:-1]).sum(1) < 0.0
    sign = torch.cat([n.new_ones(1), 1.0 - 2.0 * (torch.cumsum(flips, 0) % 2).to(n)])
    return n * sign[:, None]


def turns_to_rotation(turns: Sequence[Turn], q: Float[Tensor, "frames turns"]) -> Float[Tensor, "frames 3 3"]:
    """Product of the turns."""
    R = _about_axis(turns[0], q[:, 0])
    for k, turn in enumerate(turns[1:], start=1):
        R = R @ _about_axis(turn, q[:, k])
    return R


def _about_axis(turn: Turn, angle: Float[Tensor, " frames"]) -> Float[Tensor, "frames 3 3"]:
    """Rotation about an axis of the frame: that of any vector takes ten times as long for few frames."""
    k, i, j = (int(turn.axis + n) % 3 for n in range(3))
    sine, cosine = turn.sign * torch.sin(angle), torch.cos(angle)
    R = angle.new_zeros(len(angle), 3, 3)
    R[:, k, k] = 1.0
    R[:, i, i] = R[:, j, j] = cosine
    R[:, j, i], R[:, i, j] = sine, -sine
    return R


def rotation_to_turns(
    turns: Sequence[Turn], R: Float[Tensor, "frames 3 3"], near: Float[Tensor, "frames 3"]
) -> Float[Tensor, "frames 3"]:
    """Angles of three different axes that make R, on the branch nearest to ``near``."""
    sign = near.new_tensor([turn.sign for turn in turns])
    first = _three_angles(tuple(int(turn.axis) for turn in turns), R)
    other = torch.stack([first[:, 0] + torch.pi, torch.pi - first[:, 1], first[:, 2] + torch.pi], dim=1)
    options = torch.stack([first, other]) * sign
    options = options + 2.0 * torch.pi * torch.round((near - options) / (2.0 * torch.pi))
    miss = (options - near).square().sum(2)
    return torch.where((miss[0] <= miss[1])[:, None], options[0], options[1])


def _three_angles(axes: tuple[int, ...], R: Float[Tensor, "frames 3 3"]) -> Float[Tensor, "frames 3"]:
    """Angles about three different axes whose turns, one after the other, make R; the second one's cosine is positive.

    At the pole, where the first and the last turn about one line, any first angle will do, and the last one follows it.
    """
    i, j, k = axes
    sign = 1.0 if (j - i) % 3 == 1 else -1.0
    a = torch.atan2(-sign * R[:, j, k], R[:, k, k])
    b = torch.atan2(sign * R[:, i, k], torch.hypot(R[:, j, k], R[:, k, k]))
    sine, cosine = sign * torch.sin(a), torch.cos(a)
    c = torch.atan2(sign * (cosine * R[:, j, i] + sine * R[:, k, i]), cosine * R[:, j, j] + sine * R[:, k, j])
    return torch.stack([a, b, c], 1)


def joint_rates(
    turns: Sequence[Turn], q: Float[Tensor, "frames 3"], moving: AngularMotion
) -> tuple[Float[Tensor, "frames 3"], Float[Tensor, "frames 3"]]:
    """Rates and accelerations of the angles that reproduce the angular motion (damped at the pole)."""
    R = torch.eye(3, dtype=q.dtype, device=q.device).expand(len(q), 3, 3)
    before = [R, *(turns_to_rotation(turns[:k], q[:, :k]) for k in range(1, len(turns)))]
    axes = [turn.sign * R[:, :, turn.axis] for turn, R in zip(turns, before, strict=True)]
    S = torch.stack(axes, dim=2)
    v = _solve(S, moving.w)
    a0, a1, a2 = (axes[k] * v[:, k, None] for k in range(3))
    bias = torch.linalg.cross(a0, a1) + torch.linalg.cross(a0 + a1, a2)
    return v, _solve(S, moving.alpha - bias)


def _solve(S: Tensor, x: Tensor) -> Tensor:
    near_pole = (torch.linalg.det(S).abs() < POLE).to(S)
    normal = S.mT @ S + (POLE**2) * near_pole[:, None, None] * torch.eye(3, dtype=S.dtype, device=S.device)
    safe = torch.linalg.solve(normal, (S.mT @ x[:, :, None]))[:, :, 0]
    plain = torch.linalg.solve(torch.where(near_pole[:, None, None] > 0, normal, S), x[:, :, None])[:, :, 0]
    return torch.where(near_pole[:, None] > 0, safe, plain)
