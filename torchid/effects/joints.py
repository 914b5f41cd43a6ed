"""Joints that are not what the model takes them for.

Sources: Iwaki, Pinskerova & Freeman, J Bone Joint Surg 82-B (2000), on the knee's moving axis; Andersen, Benoit,
Damsgaard, Ramsey & Rasmussen, J Biomech 43 (2010), on constrained joints against free ones.
"""

import math
from collections.abc import Sequence
from itertools import product

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.effects.displacement import below
from torchid.effects.effect import Effect, Parameter, value_of
from torchid.effects.joint_angles import bend, lively, orders
from torchid.effects.marker_scene import Carried, Sight, Sway, View
from torchid.effects.place import Place
from torchid.effects.scene import Scene
from torchid.errors import ConfigError
from torchid.kinematics.recursion import cross
from torchid.model.tree import Body


def joint_name(scene: Scene, body: int) -> str:
    """What a body's proximal joint is called: its coordinates' names up to the last word."""
    rows = [turn.row for turn in scene.tree.bodies[body].turns if turn.moving]
    return scene.tree.dof_names[rows[0]].rpartition("_")[0] if rows else scene.tree.names[body]


def carried_by(scene: Scene, joint: str) -> str:
    """The body behind a joint.

    Raises:
        ConfigError: the model has no such joint.
    """
    for k, name in enumerate(scene.tree.names):
        if k and joint == joint_name(scene, k):
            return name
    known = ", ".join(joint_name(scene, k) for k in range(1, len(scene.tree.names)))
    raise ConfigError("effect.joint", "the model has no such joint", place=joint, remedy=f"Known are {known}")


def before(scene: Scene, body: str) -> int:
    """Plan position of the body before the joint that carries ``body``."""
    tree = scene.tree
    return scene.at(tree.names[tree.bodies[tree.names.index(body)].parent])


class JointCentreShift(Effect):
    """A joint's centre glides as it turns: everything beyond moves by a smooth function of its angle.

    In the axes of the segment before the joint, where its centre is. Internal are vectors that go with sine and one
    minus cosine of the angle, both zero in the neutral pose and one at 90 degrees: their sum is the shift there, but
    see ``estimated``.
    """

    name = "joint_centre_shift"
    bodily = True
    parameters = (Parameter("sine_m", 0.01, 3), Parameter("cosine_m", 0.01, 3))
    moves_markers = True

    def places(self, views: Sequence[View]) -> tuple[Place, ...]:
        scenes = [v.scene for v in views]
        found = []
        for k in range(1, len(scenes[0].tree.names)):
            cues, where = (
                [angle for dof in lively(scenes, k) for angle in orders(scenes, dof)],
                joint_name(scenes[0], k),
            )
            # One chance for each joint: forearms that turn more than elbows bend hid what the elbow's flexion did.
            found += [Place((where,), odds=1.0 / len(cues), follows=angle) for angle in cues]
        return tuple(found)

    def move(self, scene: Scene, place: Place, theta: Float[Tensor, " params"]) -> Float[Tensor, "bodies 6 frames"]:
        body = carried_by(scene, place.where[0])
        local = theta.view(2, 3).T @ bend(scene, place)
        shift = torch.einsum("crt,ct->rt", scene.state.at.R[before(scene, body)], local)
        moved = torch.cat([shift, torch.zeros_like(shift)])
        return below(scene, body)[:, None, None] * moved

    def sway(self, sight: Sight, place: Place) -> Sway:
        pairs = tuple((axis, course) for course in range(2) for axis in range(3))
        return Sway(_ways(sight.scene, place.where[0], range(3), turning=False), bend(sight.scene, place), pairs)

    def named(self, place: Place, theta: Float[Tensor, " params"]) -> dict[str, Tensor]:
        return {"shift_90_seg_m": theta.view(2, 3).sum(0)}

    def estimated(
        self, place: Place, theta: Float[Tensor, " params"], covariance: Float[Tensor, "params params"]
    ) -> dict[str, tuple[Float[Tensor, "*size"], Float[Tensor, "*size"]]]:
        """The shift at 90 degrees of a glide that goes nearly the same way along all axes, if there may be one.

        In the plane of a hinge, markers beyond it that sit elsewhere look like a glide: of six numbers markers show
        four. Along its axis they show how it goes with the angle, and in the plane it is assumed to go so as well.
        Without that, 7 mm at an elbow had an sd of 6 mm. The extension rests on the internal parameters alone.
        """
        own = covariance + OWN_M**2 * torch.eye(len(theta)).to(theta)
        common = _of_one_course(theta, own)
        if common is None:
            return super().estimated(place, theta, covariance)
        return {"shift_90_seg_m": common}

    def internal(self, place: Place, values: dict[str, Tensor]) -> Float[Tensor, " params"]:
        """All of it along the sine."""
        shift = super().internal(place, {"sine_m": values.get("shift_90_seg_m", torch.zeros(0)), "cosine_m": ZERO})
        return shift


ZERO = torch.zeros(3, dtype=torch.float64)
COURSES = 101
"""Of a gliding centre that are weighed."""
OWN_M = 3e-4
"""By which the glide along one axis may go another way than along the others [m]."""
OWN_WAYS = 9.2
"""Chi-square of two degrees of freedom that one in a hundred exceeds: then each axis goes a way of its own."""


def _of_one_course(
    theta: Float[Tensor, " 6"], covariance: Float[Tensor, "6 6"]
) -> tuple[Float[Tensor, " 3"], Float[Tensor, " 3"]] | None:
    """Mean and sd of a vector whose parts along sine and one minus cosine are theta, over all courses between these."""
    eye, precision = torch.eye(3).to(theta), torch.linalg.inv(covariance)
    part = torch.linspace(0.0, 1.0, COURSES).to(theta)[:, None, None]
    B = torch.cat([part * eye, (1.0 - part) * eye], 1)
    told = B.mT @ precision @ B
    shift = torch.linalg.solve(told, B.mT @ precision @ theta)
    left = theta - (B @ shift[:, :, None])[:, :, 0]
    miss = ((left @ precision) * left).sum(1)
    if float(miss.min()) > OWN_WAYS:
        return None
    weight = torch.softmax(-0.5 * (miss + torch.logdet(told)), 0)
    mean = weight @ shift
    spread = torch.linalg.inv(told).diagonal(dim1=1, dim2=2) + (shift - mean).square()
    return mean, (weight @ spread).sqrt()


MODES = 12
"""Of the course of a planted motion."""


class MissingDof(Effect):
    """A joint moves along or about an axis that the model does not have, in its own time.

    Along axes of the segment before the joint, or about axes of the one beyond it. Internal are the coefficients of
    a constant and slow cosines for each axis that the joint lacks, in every trial anew; the direction in which the
    cosines are largest is reported.
    """

    name = "missing_dof"
    bodily = True
    parameters = (Parameter("course", 0.02, 3 * MODES),)
    moves_markers = True
    per_trial = True

    def places(self, views: Sequence[View]) -> tuple[Place, ...]:
        scene, modes, found = views[0].scene, float(_modes(views)), []
        for k in range(1, len(scene.tree.names)):
            for turning in (False, True):
                grid = lacking(scene.tree.bodies[k], turning)
                if any(grid.values()):
                    grid |= {"modes": modes, "turning": float(turning)}
                    found.append(Place((joint_name(scene, k),), grid=grid))
        return tuple(found)

    def size(self, place: Place) -> int:
        return len(axes(place)) * int(place.grid["modes"])

    def scale(self, place: Place) -> tuple[float, ...]:
        """Motion of 5 mm or 3 degrees in all, shared by the cosines."""
        own = 0.05 if place.grid["turning"] else 0.005
        return (own / math.sqrt(place.grid["modes"]),) * self.size(place)

    def move(self, scene: Scene, place: Place, theta: Float[Tensor, " params"]) -> Float[Tensor, "bodies 6 frames"]:
        course = theta.new_zeros(3, len(scene.time))
        course[axes(place)] = theta.view(len(axes(place)), -1) @ courses(scene.time, int(place.grid["modes"]))
        return directed(scene, place.where[0], course, bool(place.grid["turning"]))

    def sway(self, sight: Sight, place: Place) -> Sway:
        scene, modes = sight.scene, int(place.grid["modes"])
        ways = _ways(scene, place.where[0], axes(place), bool(place.grid["turning"]))
        return Sway(ways, courses(scene.time, modes), tuple(product(range(len(axes(place))), range(modes))))

    def named(self, place: Place, theta: Float[Tensor, " params"]) -> dict[str, Tensor]:
        free = axes(place)
        own = theta.view(-1, len(free), int(place.grid["modes"]))
        # Of the lacking axes alone: with the others, equal eigenvalues of zero had no derivative, and the sd was NaN.
        # Nor by where it stands, which geometry knows as little.
        moving = own[:, :, 1:]
        way = torch.linalg.eigh(torch.einsum("bik,bjk->ij", moving, moving))[1][:, -1]
        way = way * torch.sign(way[way.abs().argmax()])
        axis = theta.new_zeros(3).index_put((torch.tensor(free, device=theta.device),), way)
        time = torch.linspace(0.0, 1.0, 200).to(theta)
        along = torch.einsum("i,bik->bk", way, own) @ courses(time, own.shape[2])
        reach = (along.amax(1) - along.amin(1)).mean()
        keys = ("axis_seg", "range_rad") if place.grid["turning"] else ("direction_seg", "range_m")
        return dict(zip(keys, (axis, reach), strict=True))

    def internal(self, place: Place, values: dict[str, Tensor]) -> Float[Tensor, " params"]:
        """Two cosines along the axis."""
        turning = bool(place.grid["turning"])
        axis = value_of(values, self.name, "axis_seg" if turning else "direction_seg", 3)
        reach = value_of(values, self.name, "range_rad" if turning else "range_m", 1)
        shape = torch.zeros(int(place.grid["modes"]), dtype=torch.float64)
        shape[5], shape[8] = 1.0, 0.6
        own = shape @ courses(torch.linspace(0.0, 1.0, 200, dtype=torch.float64), len(shape))
        return (axis[axes(place), None] / axis.norm() * reach * shape / (own.max() - own.min())).reshape(-1)


def lacking(body: Body, turning: bool) -> dict[str, float]:
    """1 for each of x, y, z about which (or along which) a joint does not move."""
    own = {turn.axis for turn in body.turns if turn.moving} if turning else {slide.axis for slide in body.slides}
    return {axis: float(k not in own) for k, axis in enumerate("xyz")}


def axes(place: Place) -> list[int]:
    """Those that a place of ``missing_dof`` is about."""
    return [k for k, axis in enumerate("xyz") if place.grid[axis]]


def _ways(scene: Scene, joint: str, along: Sequence[int], turning: bool) -> Carried:
    """Everything beyond a joint moved or turned by one, see ``directed``."""

    def bodies() -> Float[Tensor, "ways bodies 6 frames"]:
        ones = torch.eye(3).to(scene.q)[list(along), :, None].expand(-1, 3, len(scene.time))
        return torch.stack([directed(scene, joint, one, turning) for one in ones])

    return Carried((joint, tuple(along), turning), bodies)


def directed(
    scene: Scene, joint: str, course: Float[Tensor, "3 frames"], turning: bool
) -> Float[Tensor, "bodies 6 frames"]:
    """Everything beyond a joint moved along axes of the segment before it, or turned about those of the one there."""
    body = carried_by(scene, joint)
    k, at = scene.at(body), scene.state.at
    world = torch.einsum("crt,ct->rt", at.R[k if turning else before(scene, body)], course)
    arm = at.p - at.p[k]
    moved = cross(world.expand_as(arm), arm) if turning else world.expand_as(arm)
    turn = world if turning else torch.zeros_like(world)
    return below(scene, body)[:, None, None] * torch.cat([moved, turn.expand_as(moved)], 1)


def courses(time: Float[Tensor, " frames"], modes: int) -> Float[Tensor, "modes frames"]:
    """A constant and slow cosines: without the constant, which is another in every trial, axes and centres of joints
    moved with the mean of each."""
    part = (time - time[0]) / (time[-1] - time[0])
    k = torch.arange(modes).to(time)
    return torch.cos(math.pi * k[:, None] * part)


def _modes(views: Sequence[View]) -> int:
    longest = max(float(v.scene.time[-1] - v.scene.time[0]) for v in views)
    return min(MOST_MODES, max(MODES, 1 + math.ceil(2.0 * FASTEST_HZ * longest)))


FASTEST_HZ = 1.5
"""Of a free motion of a joint; of courses up to 1.2 Hz, 0.8 Hz let a third of the range go."""
MOST_MODES = 48
