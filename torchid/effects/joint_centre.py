"""Joint centres that glide as their joint turns.

Source: Iwaki, Pinskerova & Freeman, J Bone Joint Surg 82-B (2000), on how femur and tibia move on each other.
"""

from collections.abc import Sequence
from typing import final

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.effects.displacement import below
from torchid.effects.effect import Estimates
from torchid.effects.joint_angles import bend, lively, orders
from torchid.effects.joints import before, carried_by, joint_name, unit_ways
from torchid.effects.kinds import DisplacedBodies
from torchid.effects.marker_scene import Sight, Sway, View
from torchid.effects.parameter import Parameter, propagated, stacked
from torchid.effects.place import Place
from torchid.effects.place_words import motion_words
from torchid.effects.quantities import BODY, NamedEffect, vector
from torchid.effects.scene import Scene
from torchid.effects.traits import Origin, Site

COURSES = 101
"""Resolution. Courses of a gliding centre that are weighed."""
OWN_M = 3e-4
"""Estimator. Difference by which the glide along one axis may go another way than along the others [m]."""
OWN_WAYS = 9.2
"""Estimator. Chi-square of two degrees of freedom that one in a hundred exceeds: then each axis goes a way of its
own."""
GLIDE = "a choice: in a step, a knee travels 7 mm forward and back, 3 mm sideways and along (39 knees, PMC7477710)"


@final
class JointCentreShift(DisplacedBodies):
    """A joint's centre glides as it turns: everything beyond moves by a smooth function of its angle.

    The glide is in the axes of the segment before the joint, where its centre is. Internal are vectors that go with
    sine and one minus cosine of the angle, both zero in the neutral pose and one at 90 degrees: their sum is the shift
    there, but see ``estimated``.
    """

    name = "joint_centre_shift"
    origin = Origin.BODY
    site = Site.JOINT
    parameters = (Parameter("sine_m", 0.01, 3, source=GLIDE), Parameter("cosine_m", 0.01, 3, source=GLIDE))
    noun = "a gliding joint centre"
    link = "of"
    advice = "the joint bent slowly through its whole range with the limb unloaded"
    apart = {
        "joint_centre_shift": "each of the two joints moved alone",
        "missing_dof": "the joint bent slowly to and fro: what glides returns the same way",
    }

    def places(self, views: Sequence[View]) -> tuple[Place, ...]:
        """Each joint with each angle that its centre may follow; all angles of a joint share one chance."""
        scenes = [v.scene for v in views]
        found = []
        for k in range(1, len(scenes[0].tree.names)):
            cues = [angle for dof in lively(scenes, k) for angle in orders(scenes, dof)]
            where = joint_name(scenes[0], k)
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
        ways = unit_ways(sight.scene, place.where[0], range(3), turning=False)
        return Sway(ways, bend(sight.scene, place), pairs)

    def named(self, place: Place, theta: Float[Tensor, " params"]) -> dict[str, Tensor]:
        return {"shift_90_seg_m": theta.view(2, 3).sum(0)}

    def estimated(
        self, place: Place, theta: Float[Tensor, " params"], covariance: Float[Tensor, "params params"]
    ) -> Estimates:
        """The shift at 90 degrees of a glide that goes nearly the same way along all axes, if there may be one.

        In the plane of a hinge, markers beyond it that sit elsewhere look like a glide: of six numbers markers show
        four. Along its axis they show how it goes with the angle, and in the plane it is assumed to go so as well. The
        extension of the model rests on the internal parameters alone.
        """
        own = covariance + OWN_M**2 * torch.eye(len(theta)).to(theta)
        common = _of_one_course(theta, own)
        if common is None:
            return propagated(lambda x: self.named(place, x), theta, covariance)
        return {"shift_90_seg_m": common}

    def internal(self, place: Place, values: dict[str, Tensor]) -> Float[Tensor, " params"]:
        """All of the shift along the sine."""
        sine, none = values.get("shift_90_seg_m", torch.zeros(0)), torch.zeros(3, dtype=torch.float64)
        return stacked(self.parameters, {"sine_m": sine, "cosine_m": none}, self.name)

    def sentence(self, finding: NamedEffect) -> str:
        shift, motion = vector(finding, "shift_90_seg_m", "mm", 1e3, BODY), motion_words(finding.place.follows)
        return f"the centre of {self.located(finding.where)} glides as {motion} changes: at 90° by {shift}"


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
