"""How a tree hangs together with the OpenSim model that it was made of: whose bodies, and the file's first joint.

Each of the tree's bodies T is one or several bodies B of the file, welded together. Its axes are X forward, Y left,
Z up where those of the file are X forward, Y up, Z right; its origin is its proximal joint centre. The joint that
carries the person in the file is the tree's floating base, whatever that joint leaves free; all other coordinates keep
name, value and sign.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import roma
import torch
from jaxtyping import Float
from torch import Tensor

from torchid.model.coupling import pushed
from torchid.model.opensim.functions import Function
from torchid.model.opensim.model import GROUND, CoordinateKind, OsimJoint, OsimModel
from torchid.model.opensim.posing import body_pose, coupled, joint_pose
from torchid.model.opensim.rotations import R_OW, inverse, pose
from torchid.model.tree import BASE_DOFS

States = tuple[Float[Tensor, "frames dofs"], Float[Tensor, "frames dofs"], Float[Tensor, "frames dofs"]]
"""Coordinates, rates and accelerations."""
SQUARE = 1e-9
"""Resolution. Largest product of two of a joint's unit axes that stand at right angles."""
STEPS, SETTLED = 50, 1e-12
"""Resolution. Most Gauss-Newton steps to the pose nearest to a given one, and the step that is none [rad, m]."""


@dataclass(frozen=True)
class OsimBinding:
    """An OpenSim model and how the bodies of a tree are made of its bodies."""

    model: OsimModel
    groups: tuple[tuple[int, ...], ...]
    """For each body of the tree the bodies of the file that it is made of, the heaviest first."""
    X_TB: Float[Tensor, "bodies 4 4"]
    """Pose of each body of the file in the body of the tree that it belongs to; identity where it is in none."""
    root_row: int
    """Index of the joint that carries the root, among those of the file."""

    @property
    def root(self) -> OsimJoint:
        """The joint that carries the root."""
        return self.model.joints[self.root_row]

    @cached_property
    def bodies(self) -> frozenset[int]:
        """Bodies of the file that the tree is made of."""
        return frozenset(body for members in self.groups for body in members)

    @property
    def root_names(self) -> tuple[str, ...]:
        """Names of the root joint's coordinates, in the order of the file."""
        return tuple(self.model.coordinate_names[row] for row in self.root.rows)

    def group_of(self, body: int) -> int:
        """Index in the tree of the body that a body of the file belongs to."""
        return next(k for k, members in enumerate(self.groups) if body in members)

    def base_pose(self, q: Float[Tensor, "frames coordinates"]) -> Float[Tensor, "frames 4 4"]:
        """Return X_WT of the root.

        Args:
            q: all coordinates of the file [rad, m].
        """
        X = joint_pose(self.root, q)
        step = X if self.root.outward else inverse(X)
        before, behind = self._ends(q)
        return before @ step @ behind

    def _ends(self, q: Float[Tensor, "frames coordinates"]) -> tuple[Tensor, Tensor]:
        """Poses before and behind the root's joint: from W, and to T."""
        X_WG = pose(R_OW.T, R_OW.new_zeros(3))
        X_BT = inverse(self.X_TB[self.root.carried.body])
        before, behind = X_WG, inverse(self.root.carried.X_BF) @ X_BT
        if self.root.carrier.body != GROUND:
            before = before.to(q) @ body_pose(self.model, self.root.carrier.body, q)
        return before.to(q) @ self.root.carrier.X_BF.to(q), behind.to(q)

    def to_tree(
        self,
        names: tuple[str, ...],
        q: Float[Tensor, "frames coordinates"],
        v: Float[Tensor, "frames coordinates"],
        a: Float[Tensor, "frames coordinates"],
    ) -> States:
        """Return the state of a tree from that of the file's coordinates.

        Args:
            names: the tree's names of coordinates; six of the base, then those of the file that are free.
            q: all coordinates of the file [rad, m].
            v: their rates.
            a: their accelerations.
        """

        def rate(q: Tensor, v: Tensor) -> Tensor:
            return pushed(self.base_pose, (q,), (v,))[1]

        X = self.base_pose(q)  # first: frames keep their poses, which must not be made inside a derivative
        once, twice = pushed(rate, (q, v), (v, a))
        R = X[:, :3, :3]
        spin, turning = (x[:, :3, :3] @ R.mT for x in (once, twice))
        alpha = turning + once[:, :3, :3] @ once[:, :3, :3].mT
        rows = [self.model.coordinate_names.index(name) for name in names[BASE_DOFS:]]
        base = (
            torch.cat([X[:, :3, 3], torch.as_tensor(roma.rotmat_to_rotvec(R))], dim=1),
            torch.cat([once[:, :3, 3], _vee(spin)], dim=1),
            torch.cat([twice[:, :3, 3], _vee(alpha)], dim=1),
        )
        q, v, a = (torch.cat([b, x[:, rows]], dim=1) for b, x in zip(base, (q, v, a), strict=True))
        return q, v, a

    def from_tree(self, names: tuple[str, ...], q: Float[Tensor, "frames dofs"]) -> Float[Tensor, "frames coordinates"]:
        """Return all coordinates of the file [rad, m]: couplers hold, what the tree does not move is at its default.

        Where the joint that carries the root leaves less than six freedoms, its coordinates are those of the pose that
        is nearest: by squares of the turn between the two [rad] and of the way [m].

        Args:
            names: the tree's names of coordinates.
        """
        out = self.model.defaults.to(q).expand(len(q), -1).clone()
        rows = [self.model.coordinate_names.index(name) for name in names[BASE_DOFS:]]
        out[:, rows] = q[:, BASE_DOFS:]
        X_WT = pose(roma.rotvec_to_rotmat(q[:, 3:BASE_DOFS]), q[:, :3])
        if not is_floating(self.root):
            return coupled(self.model, self._nearest(out, X_WT))
        before, behind = self._ends(out)
        step = inverse(before) @ X_WT @ inverse(behind)
        out[:, list(self.root.rows)] = _root_values(self.root, step if self.root.outward else inverse(step))
        return coupled(self.model, out)

    def _nearest(self, q: Float[Tensor, "frames coordinates"], X_WT: Float[Tensor, "frames 4 4"]) -> Tensor:
        """Coordinates with those of the root's joint changed so that the root's pose is as near as it gets."""
        rows = list(self.root.rows)
        for _ in range(STEPS if rows else 0):
            X = self.base_pose(q)
            turn = torch.as_tensor(roma.rotmat_to_rotvec(X_WT[:, :3, :3] @ X[:, :3, :3].mT))
            miss = torch.cat([X_WT[:, :3, 3] - X[:, :3, 3], turn], dim=1)
            step = torch.linalg.lstsq(self._twists(q, rows), miss[..., None], driver="gelsd").solution[..., 0]
            q = q.index_add(1, torch.tensor(rows), step)
            if float(step.abs().max()) < SETTLED:
                break
        turns = [row for row in rows if self.model.coordinates[row].motion is CoordinateKind.ROTATIONAL]
        return q.index_copy(1, torch.tensor(turns, dtype=torch.long), _unwrapped(q[:, turns]))

    def forces(
        self, names: tuple[str, ...], q: Float[Tensor, "frames coordinates"], tau: Float[Tensor, "frames dofs"]
    ) -> dict[str, Float[Tensor, " frames"]]:
        """Return the generalised forces of a tree by the file's names of coordinates, those of its first joint first.

        A coordinate that leads others bears their share; these and locked ones have no force of their own.

        Args:
            names: the tree's names of coordinates, whatever it holds still.
            q: all coordinates of the file [rad, m].
            tau: generalised forces of the tree; those of the base are a wrench about the root's origin, in W [N, N m].
        """
        found = dict(zip(self.root_names, self._root_forces(q, tau[:, :BASE_DOFS]), strict=True))
        return found | dict(zip(names[BASE_DOFS:], tau[:, BASE_DOFS:].unbind(1), strict=True))

    def _root_forces(
        self, q: Float[Tensor, "frames coordinates"], wrench: Float[Tensor, "frames 6"]
    ) -> list[Float[Tensor, " frames"]]:
        """Generalised forces of the root joint's coordinates, of a wrench on the root about its origin in W."""
        return list((self._twists(q, self.root.rows) * wrench[..., None]).sum(1).unbind(1))

    def _twists(self, q: Float[Tensor, "frames coordinates"], rows: Sequence[int]) -> Float[Tensor, "frames 6 rows"]:
        """Velocity of the root's origin and angular velocity of the root, in W, at unit rates of coordinates."""
        X, columns = self.base_pose(q), [q.new_zeros(len(q), 6, 0)]
        for row in rows:
            seed = torch.zeros_like(q)
            seed[:, row] = 1.0
            rate = pushed(self.base_pose, (q,), (seed,))[1]
            twist = torch.cat([rate[:, :3, 3], _vee(rate[:, :3, :3] @ X[:, :3, :3].mT)], dim=1)
            columns.append(twist[..., None])
        return torch.cat(columns, dim=2)


def is_floating(joint: OsimJoint) -> bool:
    """Return whether a joint leaves all six freedoms: turns about and slides along three axes at right angles, each led
    by a coordinate of its own that moves nothing else."""
    axes = (*joint.turns, *joint.slides)
    led = sorted(row for axis in axes for row in axis.rows)
    if led != sorted(joint.rows) or len(joint.turns) != 3 or len(joint.slides) != 3:
        return False
    units = [torch.stack([axis.unit for axis in kind]) for kind in (joint.turns, joint.slides)]
    square = all(float((unit @ unit.T - torch.eye(3).to(unit)).abs().max()) <= SQUARE for unit in units)
    return square and all(affine(axis.function) is not None for axis in axes)


def affine(function: Function) -> tuple[float, float] | None:
    """Return slope and intercept of a function of one coordinate; None where it is not straight."""
    if function.n_arguments != 1:
        return None
    low, start, high = (float(function(torch.tensor([x], dtype=torch.float64))) for x in (-7.3, 0.0, 7.3))
    slope = (high - start) / 7.3
    straight = abs(high + low - 2.0 * start) <= 1e-12 * max(abs(high), abs(low), 1.0)
    return (slope, start) if straight and slope != 0.0 else None


def _root_values(root: OsimJoint, X: Float[Tensor, "frames 4 4"]) -> Float[Tensor, "frames 6"]:
    """Values of the root joint's coordinates that make poses X of its child in its parent, without jumps of angles."""
    axis = torch.stack([turn.unit for turn in root.turns]).to(X)
    R = X[:, :3, :3]
    # R = Rot(u1, a1) Rot(u2, a2) Rot(u3, a3) of axes at right angles: u1' R u3 tells a2, rows and columns the others.
    hand = torch.linalg.det(axis)
    inner = axis @ R @ axis.T  # (i, k): u_i' R u_k
    second = hand * inner[:, 0, 2].clamp(-1.0, 1.0).asin()
    first = torch.atan2(-hand * inner[:, 1, 2], inner[:, 2, 2])
    third = torch.atan2(-hand * inner[:, 0, 1], inner[:, 0, 0])
    angles = _unwrapped(torch.stack([first, second, third], dim=1))
    along = torch.stack([slide.unit for slide in root.slides], dim=1).to(X)
    shifts = torch.linalg.solve(along, X[:, :3, 3].T).T
    out = X.new_empty(len(X), BASE_DOFS)
    for one, value in zip((*root.turns, *root.slides), (*angles.unbind(1), *shifts.unbind(1)), strict=True):
        line = affine(one.function)
        assert line is not None, "a joint that floats is straight"
        out[:, root.rows.index(one.rows[0])] = (value - line[1]) / line[0]
    return out


def _unwrapped(angles: Float[Tensor, "frames angles"]) -> Float[Tensor, "frames angles"]:
    step = torch.diff(angles, dim=0)
    turns = torch.round(step / (2.0 * torch.pi)).cumsum(0)
    return torch.cat([angles[:1], angles[1:] - 2.0 * torch.pi * turns])


def _vee(S: Float[Tensor, "frames 3 3"]) -> Float[Tensor, "frames 3"]:
    """The vector of a skew matrix."""
    return torch.stack([S[:, 2, 1], S[:, 0, 2], S[:, 1, 0]], dim=1)
