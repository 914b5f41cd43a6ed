"""Legs that reach prescribed feet: six angles per leg for the six coordinates of the foot, all frames at once."""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn.functional import conv1d, max_pool1d

from torchid.kinematics.plan import Plan, plan_tree
from torchid.kinematics.recursion import Poses, cross, poses
from torchid.model.rotation import rotation_matrix, rotation_vector
from torchid.model.skeleton import SIDES
from torchid.model.tree import Tree
from torchid.simulate.script import FootPath, Script
from torchid.simulate.subject import SimulatedSubject, Sole

CALM_S = 0.30
"""Half the time over which the highest place of the pelvis is evened out [s]."""
START = {"hip_flexion": 0.4, "knee_flexion": 0.7, "ankle_flexion": 0.3}
LEG = ("hip_flexion", "hip_adduction", "hip_rotation", "knee_flexion", "ankle_flexion", "ankle_inversion")


@dataclass(frozen=True)
class Goal:
    """What one leg has to reach."""

    R: Float[Tensor, "frames 3 3"]
    p: Float[Tensor, "frames 3"]
    """Pose of the foot."""
    foot: int
    """Tree index of the foot."""
    rows: list[int]
    """Rows of q."""


def leg_rows(tree: Tree, side: str) -> list[int]:
    """Rows of q of one leg."""
    return [tree.dof_names.index(name.replace("_", f"_{side}_", 1)) for name in LEG]


def foot_pose(path: FootPath, sole: Sole) -> tuple[Float[Tensor, "frames 3 3"], Float[Tensor, "frames 3"]]:
    """Where a foot's axes are: flat, or pitched about the point where it bears."""
    yaw = rotation_matrix(path.pitch.new_tensor([0.0, 0.0, path.yaw]))
    turn = path.pitch[:, None] * path.pitch.new_tensor([0.0, 1.0, 0.0])
    lean = path.roll[:, None] * path.roll.new_tensor([1.0, 0.0, 0.0])
    pitch = rotation_matrix(turn) @ rotation_matrix(lean)
    zero = torch.zeros_like(path.pitch)
    pivot = torch.stack([path.bearing[:, 0], zero, zero - sole.height], 1)
    moved = pivot - (pitch @ pivot[:, :, None])[:, :, 0]
    return yaw @ pitch, path.base + moved @ yaw.T


def bearing_point(path: FootPath, sole: Sole) -> Float[Tensor, "frames 3"]:
    """Centre of pressure intended under a foot, in W."""
    R, p = foot_pose(path, sole)
    local = torch.cat([path.bearing, torch.full_like(path.bearing[:, :1], -sole.height)], 1)
    return p + (R @ local[:, :, None])[:, :, 0]


def stand(
    subject: SimulatedSubject,
    script: Script,
    place: Float[Tensor, "frames 2"],
    start: Float[Tensor, "frames 12"] | None = None,
) -> tuple[Float[Tensor, "frames dofs"], Float[Tensor, "frames 12"]]:
    """Coordinates of the whole body with the pelvis above ``place`` and the feet where the script wants them.

    Args:
        subject: whose legs they are.
        script: the motion.
        place: x and y of the pelvis [m].
        start: leg angles of a nearby solution, which save iterations.

    Returns:
        The coordinates, and the angles with which both legs reach their feet's paths.
    """
    tree = subject.model.tree
    rows = [leg_rows(tree, side) for side in SIDES]
    q = script.angles.clone()
    feet = [foot_pose(path, subject.sole) for path in script.feet]
    q[:, 3:6] = script.pelvis_turn
    q[:, :2] = place
    q[:, 2] = highest(subject, script, q, [p for _, p in feet]) - script.drop
    legs = rows[0] + rows[1]
    q[:, legs] = _guess(tree, q, legs) if start is None else start
    goals = [Goal(*feet[k], tree.index(f"foot_{side}"), rows[k]) for k, side in enumerate(SIDES)]
    q = _reach(subject, q, goals, 30 if start is None else 8)
    reached = q[:, legs].clone()
    for row, path in zip(rows, script.feet, strict=True):
        q[:, row] += path.free[:, None] * (script.angles[:, row] - q[:, row])
    return q, reached


def highest(
    subject: SimulatedSubject, script: Script, q: Float[Tensor, "frames dofs"], ankles: list[Tensor]
) -> Float[Tensor, " frames"]:
    """Smooth height of the pelvis at which no leg is stretched beyond the script's reach [m].

    The lowest limit within ``CALM_S`` is averaged with weights that vanish at ``CALM_S``, so the mean stays below.
    """
    tree, offset = subject.model.tree, subject.geometry.offset
    R = rotation_matrix(q[:, 3:6])
    limits = []
    for side, ankle in zip(SIDES, ankles, strict=True):
        hip = R @ offset[tree.index(f"thigh_{side}")]
        length = script.reach * (offset[tree.index(f"shank_{side}")].norm() + offset[tree.index(f"foot_{side}")].norm())
        across = (q[:, :2] + hip[:, :2] - ankle[:, :2]).square().sum(1)
        limits.append(ankle[:, 2] + (length**2 - across).clamp(min=0.25 * length**2).sqrt() - hip[:, 2])
    half = max(1, round(CALM_S / float(script.time[1] - script.time[0])))
    limit = torch.stack(limits).amin(0)[None]
    lowest = -max_pool1d(_hold_ends(-limit, half), 2 * half + 1, stride=1)
    x = torch.arange(-half, half + 1, dtype=q.dtype, device=q.device) / (half + 1)
    kernel = (1.0 - x**2) ** 4
    return conv1d(_hold_ends(lowest, half)[None], (kernel / kernel.sum())[None, None])[0, 0]


def _hold_ends(x: Tensor, count: int) -> Tensor:
    return torch.cat([x[:, :1].expand(-1, count), x, x[:, -1:].expand(-1, count)], 1)


def _guess(tree: Tree, q: Tensor, rows: list[int]) -> Tensor:
    value = [START.get(tree.dof_names[r].replace("_l_", "_").replace("_r_", "_"), 0.0) for r in rows]
    return q.new_tensor(value).expand(len(q), -1)


def _reach(subject: SimulatedSubject, q: Tensor, goals: list[Goal], iterations: int) -> Tensor:
    """Gauss-Newton on both feet's poses with bounded steps."""
    plan = plan_tree(subject.model.tree)
    for _ in range(iterations):
        at = poses(plan, q.T.contiguous(), subject.geometry)
        steps = [_leg_step(plan, at, goal) for goal in goals]
        for goal, step in zip(goals, steps, strict=True):
            q[:, goal.rows] += step
        if max(float(step.abs().max()) for step in steps) < 1e-12:
            break
    return q


def _leg_step(plan: Plan, at: Poses, goal: Goal) -> Float[Tensor, "frames 6"]:
    column = {c.row: k for k, c in enumerate(plan.turns)}
    turns = [column[row] for row in goal.rows]
    foot = plan.position[goal.foot]
    axis = at.turn_axis[turns]
    arm = at.p[foot][None] - at.p[[plan.position[plan.turns[k].body] for k in turns]]
    J = torch.cat([cross(axis, arm), axis], 1).permute(2, 1, 0)
    error = _foot_error(at, foot, goal.R, goal.p)
    H = J.mT @ J + 1e-9 * torch.eye(6, dtype=error.dtype, device=error.device)
    step = torch.linalg.solve(H, J.mT @ error[:, :, None])[:, :, 0]
    return step * (0.5 / step.abs().amax(1, keepdim=True)).clamp(max=1.0)


def _foot_error(at: Poses, foot: int, R: Tensor, p: Tensor) -> Float[Tensor, "frames 6"]:
    """Shift and rotation vector in W from the foot to where it should be."""
    now = at.R[foot].permute(2, 1, 0)
    return torch.cat([p - at.p[foot].T, rotation_vector(R @ now.mT)], 1)
