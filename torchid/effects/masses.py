"""Masses that a segment carries rigidly.

Source: Atkeson, An & Hollerbach, IJRR 5 (1986), on loads of known inertia.
"""

from collections.abc import Sequence
from typing import final

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.effects.kinds import AttachedLoad
from torchid.effects.marker_scene import View
from torchid.effects.parameter import Parameter, value_of
from torchid.effects.place import Place
from torchid.effects.quantities import BODY, NamedEffect, of, parts, size
from torchid.effects.scene import Scene, anchor, lift, passing
from torchid.effects.traits import ColumnNoise, Occurrence, Response, Site
from torchid.kinematics.recursion import cross
from torchid.wording import number

LOAD = (
    Parameter("mass_kg", 2.0, positive=True, source="a choice: a bag, a brace, a part of an exoskeleton"),
    Parameter("moment_seg_kgm", 0.3, 3, source="a choice: 2 kg, 15 cm from the segment's centre of mass"),
)
"""Estimator. Mass and first moment of what a segment carries, with their priors."""


class PointMass(AttachedLoad):
    """A point mass fixed to a segment: weight beyond the recorded mass, inertia beyond the segment's prior.

    Internal are the mass [kg] and its first moment about the place's point [kg m]; the inertia about its own centre is
    left out. An absent mass has no place, and its columns lack what the square of its distance does.
    """

    site = Site.SEGMENT
    column_noise = ColumnNoise.CORRECTED

    @final
    def load(self, scene: Scene, place: Place, theta: Float[Tensor, " params"]) -> Float[Tensor, "6 frames"]:
        """A point mass needs m (a - g); the moment of m p is linear in the first moment but for its square over m."""
        (segment,) = place.where
        mass, moment = self.split(theta)
        k, motion = scene.at(segment), scene.state.motion
        carrier = scene.point(segment, anchor(scene, place))
        arm = scene.turned(segment, moment)
        needed = carrier.a + lift(theta)
        swing = cross(motion.alpha[k], arm) + cross(motion.w[k], cross(motion.w[k], arm))
        force = mass * needed + swing
        square = torch.where(mass > 0.0, cross(arm, swing) / mass, 0.0)
        total = torch.cat([force, cross(carrier.p, force) + cross(arm, needed) + square])
        return total * passing(scene, place)

    @final
    def rigid(self, scene: Scene, place: Place) -> Float[Tensor, "bodies 10 params"] | None:
        """Mass, first moment and inertia of a point mass m at p, and of a moment d of it: m p p' + p d' + d p'."""
        if place.when is not None:
            return None
        p, eye = anchor(scene, place), torch.eye(3).to(scene.phi)
        sides = torch.cat([0.5 * p[None], eye])
        second = p[:, None] * sides[:, None] + sides[:, :, None] * p
        about = second.diagonal(dim1=1, dim2=2).sum(1)[:, None, None] * eye - second
        row, column = torch.tril_indices(3, 3)
        first = torch.cat([eye.new_tensor([[1.0, 0.0, 0.0, 0.0]]), torch.cat([p[:, None], eye], 1)])
        found = scene.phi.new_zeros(len(scene.tree.bodies), 10, 4)
        found[scene.tree.index(place.where[0])] = torch.cat([first, about[:, row, column].T])
        return found

    @final
    def named(self, place: Place, theta: Float[Tensor, " params"]) -> dict[str, Tensor]:
        mass, moment = self.split(theta)
        return {"mass_kg": mass[0], "point_seg_m": theta.new_tensor(_point(place)) + moment / mass}

    @final
    def internal(self, place: Place, values: dict[str, Tensor]) -> Float[Tensor, " params"]:
        mass = value_of(values, self.name, "mass_kg", 1)
        arm = value_of(values, self.name, "point_seg_m", 3) - torch.tensor(_point(place), dtype=torch.float64)
        return torch.cat([mass, mass * arm])


@final
class Payload(PointMass):
    """A load that a segment carries throughout."""

    name = "payload"
    mistaken = 0.34
    response = Response.NONLINEAR
    parameters = LOAD
    noun = "a load"
    advice = "the same motion with the load taken off, and quiet standing with and without it"
    apart = {"payload": "the same motion with the load weighed, and moved to another segment"}

    def places(self, views: Sequence[View]) -> tuple[Place, ...]:
        return _centres(views[0].scene, views[0].scene.tree.names)

    def sentence(self, finding: NamedEffect) -> str:
        value, sd = of(finding, "point_seg_m")
        said = f"{self.located(finding.where)} carries {size(finding, 'mass_kg', 'kg')} more than its own mass"
        where = parts(value, sd, "mm", 1e3, BODY)
        where = f"{where} from" if where else "about at"
        return f"{said}, {where} the segment's origin (sd up to {number(sd.max(), 0, 1e3)} mm)"


@final
class GraspedObject(PointMass):
    """A payload of a hand that comes and goes."""

    name = "grasped_object"
    mistaken = 0.05
    occurrence = Occurrence.INTERVALS
    parameters = LOAD
    noun = "an object in the hand"
    link = "of"
    advice = "the same motion with empty hands, and the object weighed"
    apart = {
        "unmeasured_contact": "the object moved up and down quickly in the hand: only mass resists",
        "payload": "the same motion with empty hands",
    }

    def places(self, views: Sequence[View]) -> tuple[Place, ...]:
        return _centres(views[0].scene, [n for n in views[0].scene.tree.names if n.startswith("hand")])

    def sentence(self, finding: NamedEffect) -> str:
        return f"{self.located(finding.where)} holds {size(finding, 'mass_kg', 'kg')}"


def _centres(scene: Scene, names: Sequence[str]) -> tuple[Place, ...]:
    """The centres of mass of segments as places."""
    found = []
    for name in names:
        x, y, z = scene.centre(name).tolist()
        found.append(Place((name,), point=(x, y, z)))
    return tuple(found)


def _point(place: Place) -> tuple[float, float, float]:
    assert place.point is not None, "a payload's place has a point"
    return place.point
