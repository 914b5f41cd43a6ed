"""OpenSim models as trees: every joint one body's slides and turns, driven by coordinates or by functions of them.

A coordinate that drives one turn or slide in proportion 1 does so itself. Everything else is a follower of the tree's
coupling: functions of custom joints, coordinates that follow others, locked coordinates, constants. Slides of a joint
add, so that those in any directions are three along the axes of its frame. Bodies that are welded together are one.
"""

import hashlib
from dataclasses import dataclass, field, replace

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.model.coupling import CoupledAxis, Coupling
from torchid.model.mechanics import as_rotation
from torchid.model.model import Geometry
from torchid.model.opensim.binding import OsimBinding
from torchid.model.opensim.functions import Constant, Function, LinearFunction
from torchid.model.opensim.joint_values import affine
from torchid.model.opensim.model import OsimJoint, OsimModel, TransformAxis
from torchid.model.opensim.posing import joint_pose
from torchid.model.opensim.reversed_slides import ReversedSlide
from torchid.model.opensim.roots import Root, root_of
from torchid.model.opensim.rotations import R_OW, inverse, pose
from torchid.model.skeleton import BASE_SD
from torchid.model.tree import BASE_DOFS, Body, Dof, Slide, Tree, Turn
from torchid.model.tree_of_links import leaning_turn
from torchid.storage.snapshot import to_bytes


def tree_of_osim(model: OsimModel) -> tuple[Tree, Geometry, OsimBinding]:
    """Return the tree of an OpenSim model, its geometry, and how the two hang together.

    The tree's base floats, whatever freedoms the file gives the body that carries the person; what stands in the file
    beside the person is no part of the tree.

    A coupler that goes beyond the coordinates of the tree is opened: the binding's model is without it.
    """
    root = root_of(model)
    groups, joints = _welded(model, root)
    model = _uncoupled(model, {row for joint in joints for row in joint.rows}, set(model.joints[root.row].rows))
    poses = _poses_in_groups(model, root, joints)
    binding = OsimBinding(model, tuple(map(tuple, groups)), poses, root.row)
    builder = _Builder(model, binding, [joint.rows for joint in joints])
    for k, joint in enumerate(joints):
        builder.add(k, joint)
    return builder.tree(), builder.geometry(), binding


def _uncoupled(model: OsimModel, rows: set[int], roots: set[int]) -> OsimModel:
    """The model without couplers of coordinates of the tree, ``rows``, with others: those of what stands beside and of
    joints that close loops, and ``roots``, those of the joint that carries the person."""
    coupled = [(one, {one.dependent, *one.independents}) for one in model.couplers]
    kept = [one for one, own in coupled if not own & roots and (own <= rows or not own & rows)]
    return replace(model, couplers=tuple(kept))


def _welded(model: OsimModel, root: Root) -> tuple[list[list[int]], list[OsimJoint]]:
    """Groups of bodies that are welded together, the heaviest first, and the joint that carries each group."""
    group: dict[int, int] = {}
    groups: list[list[int]] = []
    joints: list[OsimJoint] = []
    for row, joint in enumerate(model.joints):
        if joint.carried.body not in root.bodies:
            continue
        still = not any(axis.rows and axis.function.n_arguments for axis in (*joint.turns, *joint.slides))
        if still and row != root.row:
            group[joint.carried.body] = group[joint.carrier.body]
            groups[group[joint.carrier.body]].append(joint.carried.body)
        else:
            group[joint.carried.body] = len(groups)
            groups.append([joint.carried.body])
            joints.append(joint)
    mass = model.inertias.mass.tolist()
    return [sorted(members, key=lambda body: -mass[body]) for members in groups], joints


def _poses_in_groups(model: OsimModel, root: Root, joints: list[OsimJoint]) -> Float[Tensor, "bodies 4 4"]:
    """X_TB of every body of the file: the carried one of a group's joint stands turned about its joint's centre."""
    X_TB: dict[int, Tensor] = {}
    for joint in joints:
        X_TB[joint.carried.body] = inverse(pose(R_OW, joint.carried.X_BF[:3, 3]))
    for joint in model.joints:
        if joint.carried.body not in X_TB and joint.carried.body in root.bodies:
            X = joint_pose(joint, model.defaults)
            step = X if joint.outward else inverse(X)
            place = joint.carrier.X_BF @ step @ inverse(joint.carried.X_BF)
            X_TB[joint.carried.body] = X_TB[joint.carrier.body] @ place
    left_out = torch.eye(4, dtype=torch.float64)
    return torch.stack([X_TB.get(body, left_out) for body in range(len(model.bodies))])


@dataclass
class _Builder:
    """Bodies, followers and hinge angles so far."""

    model: OsimModel
    binding: OsimBinding
    rows: list[tuple[int, ...]]
    """Coordinates of the joints of the tree."""
    bodies: list[Body] = field(default_factory=list)
    offset: list[Tensor] = field(default_factory=list)
    followers: list[CoupledAxis] = field(default_factory=list)
    hinges: list[str] = field(default_factory=list)
    angles: list[float] = field(default_factory=list)

    def __post_init__(self) -> None:
        """Number the coordinates: free ones are the tree's, the others follow."""
        model, root = self.model, set(self.binding.root.rows)
        following = {one.dependent for one in model.couplers}
        rest = [row for row in range(len(model.coordinates)) if row not in root]
        moved = {row for rows in self.rows for row in rows} - following
        self.free = [row for row in rest if row in moved and not model.coordinates[row].locked]
        self.row = {row: BASE_DOFS + k for k, row in enumerate(self.free)}
        self.n_dofs = BASE_DOFS + len(self.free)
        self.busy: set[int] = set()
        for row in rest:
            if row not in self.row and row not in following:
                one = model.coordinates[row]
                self.row[row] = self.follow(one.name, (), Constant(one.default))
        for coupler in model.couplers:
            name = model.coordinates[coupler.dependent].name
            rows = tuple(self.row[row] for row in coupler.independents)
            self.row[coupler.dependent] = self.follow(name, rows, coupler.function)

    def follow(self, name: str, rows: tuple[int, ...], function: Function) -> int:
        """A new follower's row."""
        taken = {one.name for one in self.followers}
        name = name if name not in taken else f"{name}_{len(self.followers)}"
        self.followers.append(CoupledAxis(name, rows, function))
        return self.n_dofs + len(self.followers) - 1

    def add(self, index: int, joint: OsimJoint) -> None:
        """A group of welded bodies and the joint that carries it."""
        groups, names = self.binding.groups, self.model.bodies
        name = names[groups[index][0]]
        if joint is self.binding.root:
            self.bodies.append(Body(name, -1))
            self.offset.append(torch.zeros(3, dtype=torch.float64))
            return
        X_PF = self.binding.X_TB[joint.carrier.body] @ joint.carrier.X_BF
        X_FT = inverse(joint.carried.X_BF) @ inverse(self.binding.X_TB[joint.carried.body])
        turns = joint.turns if joint.outward else joint.turns[::-1]
        made = [turn for axis in turns for turn in self._turn(joint, axis)]
        slides = self._slides(joint)
        R_PJ, R_JB = (as_rotation(X[:3, :3].numpy()) for X in (X_PF, X_FT))
        parent = self.binding.group_of(joint.carrier.body)
        self.bodies.append(Body(name, parent, tuple(made), tuple(slides), R_PJ, R_JB))
        self.offset.append(X_PF[:3, 3])

    def _turn(self, joint: OsimJoint, axis: TransformAxis) -> list[Turn]:
        sign = 1.0 if joint.outward else -1.0
        line = affine(axis.function) if len(axis.rows) == 1 else None
        if line is not None and abs(line[0]) == 1.0 and line[1] == 0.0:
            sign *= line[0]
            row = self._alone(joint, self.row[axis.rows[0]])
        else:
            row = self._value(joint, axis)
        return leaning_turn(f"{joint.name}_{row}", sign * axis.unit.numpy(), row, self.hinges, self.angles)

    def _alone(self, joint: OsimJoint, row: int) -> int:
        """The row itself where it drives nothing yet, else a follower of it."""
        if row in self.busy:
            return self.follow(f"{joint.name}_again", (row,), LinearFunction(torch.ones(1, dtype=torch.float64), 0.0))
        self.busy.add(row)
        return row

    def _value(self, joint: OsimJoint, axis: TransformAxis) -> int:
        rows = tuple(self.row[row] for row in axis.rows)
        return self.follow(f"{joint.name}_axis", rows if axis.function.n_arguments else (), axis.function)

    def _slides(self, joint: OsimJoint) -> list[Slide]:
        """Slides along the axes of the joint's frame, each the sum of what the file's slides do there."""
        if joint.slides and not joint.outward:
            return self._reversed(joint)
        values = [self._value(joint, slide) for slide in joint.slides]
        units = [slide.unit.tolist() for slide in joint.slides]
        found = []
        for component in range(3):
            parts = [(row, unit[component]) for row, unit in zip(values, units, strict=True) if unit[component]]
            if len(parts) == 1 and parts[0][1] == 1.0:
                found.append(Slide(component, self._alone(joint, parts[0][0])))
            elif parts:
                slopes = torch.tensor([share for _, share in parts], dtype=torch.float64)
                rows = tuple(row for row, _ in parts)
                found.append(Slide(component, self.follow(f"{joint.name}_slide", rows, LinearFunction(slopes, 0.0))))
        return found

    def _reversed(self, joint: OsimJoint) -> list[Slide]:
        """Slides that follow all turns and slides of a joint whose child carries its parent."""
        rows = tuple(self._value(joint, axis) for axis in (*joint.turns, *joint.slides))
        axes, directions = (
            torch.stack([axis.unit for axis in kind]) if kind else torch.zeros(0, 3, dtype=torch.float64)
            for kind in (joint.turns, joint.slides)
        )
        functions = [ReversedSlide(component, axes, directions) for component in range(3)]
        return [Slide(k, self.follow(f"{joint.name}_slide", rows, one)) for k, one in enumerate(functions)]

    def tree(self) -> Tree:
        """The tree of all that was added."""
        followers = tuple(self.followers)
        key = hashlib.sha256(to_bytes((self.n_dofs, followers))).hexdigest()
        return Tree(tuple(self.bodies), self._dofs(), tuple(self.hinges), Coupling(key, self.n_dofs, followers))

    def geometry(self) -> Geometry:
        """The file's own offsets and the leans of its axes."""
        return Geometry(torch.stack(self.offset), torch.tensor(self.angles, dtype=torch.float64))

    def _dofs(self) -> tuple[Dof, ...]:
        """The base at its default pose, and the free coordinates; a range limits where the file clamps it."""
        model, root = self.model, self.bodies[0].name
        q = model.defaults[None]
        rest = self.binding.to_tree((), q, torch.zeros_like(q), torch.zeros_like(q))[0][0].tolist()
        units = [(axis, "m") for axis in "xyz"] + [(f"r{axis}", "rad") for axis in "xyz"]
        base = [
            Dof(f"{root}_{axis}", unit, rest=value, sd=BASE_SD) for (axis, unit), value in zip(units, rest, strict=True)
        ]
        return (*base, *(_dof(model, row) for row in self.free))


def _dof(model: OsimModel, row: int) -> Dof:
    one = model.coordinates[row]
    if not one.clamped:
        return Dof(one.name, one.unit, rest=one.default)
    return Dof(one.name, one.unit, one.lower, one.upper, min(max(one.default, one.lower), one.upper))
