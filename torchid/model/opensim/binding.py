"""How a tree hangs together with the OpenSim model that it was made of: whose bodies, and the file's first joint.

Each of the tree's bodies T is one or several bodies B of the file, welded together. Its axes are X forward, Y left,
Z up where those of the file are X forward, Y up, Z right; its origin is its proximal joint centre. The joint that
carries the person in the file is the tree's floating base, whatever that joint leaves free; all other coordinates keep
name, value and sign.
"""

from dataclasses import dataclass
from functools import cached_property

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.model.coupling import pushed
from torchid.model.opensim.joint_values import closed, twists, vee, with_pose
from torchid.model.opensim.model import GROUND, OsimJoint, OsimModel
from torchid.model.opensim.posing import body_pose, coupled, joint_pose
from torchid.model.opensim.rotations import R_OW, inverse, pose
from torchid.model.rotation import rotation_matrix, rotation_vector
from torchid.model.tree import BASE_DOFS

States = tuple[Float[Tensor, "frames dofs"], Float[Tensor, "frames dofs"], Float[Tensor, "frames dofs"]]
"""Coordinates, rates and accelerations."""


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
            torch.cat([X[:, :3, 3], rotation_vector(R)], dim=1),
            torch.cat([once[:, :3, 3], vee(spin)], dim=1),
            torch.cat([twice[:, :3, 3], vee(alpha)], dim=1),
        )
        q, v, a = (torch.cat([b, x[:, rows]], dim=1) for b, x in zip(base, (q, v, a), strict=True))
        return q, v, a

    def from_tree(self, names: tuple[str, ...], q: Float[Tensor, "frames dofs"]) -> Float[Tensor, "frames coordinates"]:
        """Return all coordinates of the file [rad, m].

        Couplers hold, joints that close loops fit the bodies, and what the tree does not move is at its default.

        Where the joint that carries the root leaves less than six freedoms, its coordinates are those of the pose that
        is nearest: by squares of the turn between the two [rad] and of the way [m].

        Args:
            names: the tree's names of coordinates.
        """
        out = self.model.defaults.to(q).expand(len(q), -1).clone()
        rows = [self.model.coordinate_names.index(name) for name in names[BASE_DOFS:]]
        out[:, rows] = q[:, BASE_DOFS:]
        X_WT = pose(rotation_matrix(q[:, 3:BASE_DOFS]), q[:, :3])
        before, behind = self._ends(out)
        out = with_pose(self.model, self.root, inverse(before) @ X_WT @ inverse(behind), out)
        return closed(self.model, coupled(self.model, out))

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
        return list((twists(self.base_pose, q, self.root.rows) * wrench[..., None]).sum(1).unbind(1))
