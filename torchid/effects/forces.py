"""Forces at a point of the body that no plate measures: the ground supplies so much less.

Sources: Winter, Biomechanics and Motor Control of Human Movement (2009), chapter 5; Hof, Gazendam & Sinke, J Biomech 38
(2005), on whole-body balance of forces.
"""

import math
from collections.abc import Sequence
from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.effects.effect import Effect, Parameter, anchor
from torchid.effects.marker_scene import View
from torchid.effects.place import Interval, Place, mean_within
from torchid.effects.scene import Point, Scene, at_origin, passing


class PointForce(Effect):
    """A force on the centre of mass of a segment."""

    segments: tuple[str, ...] = ()
    """Where it may act; empty: everywhere."""

    def places(self, views: Sequence[View]) -> tuple[Place, ...]:
        names = views[0].scene.tree.names
        return tuple(Place((name,)) for name in names if not self.segments or name in self.segments)

    def load(self, scene: Scene, place: Place, theta: Float[Tensor, " params"]) -> Float[Tensor, "6 frames"]:
        (segment,) = place.where
        at = scene.point(segment, anchor(scene, place))
        force = self.force(scene, at, theta) * passing(scene, place)
        return -at_origin(at.p, force)

    def force(self, scene: Scene, at: Point, theta: Float[Tensor, " params"]) -> Float[Tensor, "3 frames"]:
        """On the body, in W."""
        raise NotImplementedError


class ExternalForce(PointForce):
    """A constant force in W: a cable over a pulley, a hand that steadies, wind."""

    name = "external_force"
    parameters = (Parameter("force_N", 20.0, 3),)

    def force(self, scene: Scene, at: Point, theta: Float[Tensor, " params"]) -> Float[Tensor, "3 frames"]:
        return theta[:, None].expand(3, len(scene.time))


class BodyWeightSupport(PointForce):
    """A harness that carries part of the weight, whatever the body does."""

    name = "body_weight_support"
    parameters = (Parameter("force_N", 100.0, positive=True),)
    segments = ("pelvis", "thorax")

    def force(self, scene: Scene, at: Point, theta: Float[Tensor, " params"]) -> Float[Tensor, "3 frames"]:
        up = theta.new_tensor([0.0, 0.0, 1.0])[:, None]
        return (theta * up).expand(3, len(scene.time))


class Drag(PointForce):
    """A force against velocity: water, a parachute, a sled."""

    name = "drag"
    parameters = (Parameter("coefficient_Ns_m", 10.0, positive=True),)

    def force(self, scene: Scene, at: Point, theta: Float[Tensor, " params"]) -> Float[Tensor, "3 frames"]:
        return -theta * at.v


class Tether(PointForce):
    """A spring to a fixed anchor, such as a cable, a band or a hose: force along position.

    Internal are the stiffness k, and k times the anchor's place, typically a metre away, and the rest length. That it
    is slack up to its rest length shows once the anchor is known: along the spring it is stiffer than across.
    """

    name = "tether"
    nonlinear = True
    parameters = (
        Parameter("stiffness_N_m", 30.0, positive=True), Parameter("pull_N", 30.0, 3), Parameter("slack_N", 30.0),
    )  # fmt: skip

    def force(self, scene: Scene, at: Point, theta: Float[Tensor, " params"]) -> Float[Tensor, "3 frames"]:
        stiffness, pull, slack = self.split(theta)
        stretched = pull[:, None] - stiffness * at.p
        taut = (1.0 - slack / stretched.norm(dim=0).clamp(min=1e-9)).clamp(min=0.0)
        return stretched * torch.where(stiffness > 0.0, taut, 1.0)

    def named(self, place: Place, theta: Float[Tensor, " params"]) -> dict[str, Tensor]:
        stiffness, pull, slack = self.split(theta)
        return {"stiffness_N_m": stiffness[0], "anchor_m": pull / stiffness, "rest_m": slack[0] / stiffness[0]}

    def internal(self, place: Place, values: dict[str, Tensor]) -> Float[Tensor, " params"]:
        stiffness, anchor, rest = (
            torch.as_tensor(values.get(key, default), dtype=torch.float64)
            for key, default in (("stiffness_N_m", 0.0), ("anchor_m", []), ("rest_m", 0.0))
        )
        products = {"pull_N": stiffness * anchor, "slack_N": stiffness * rest}
        return super().internal(place, {"stiffness_N_m": stiffness} | products)


class UnmeasuredContact(PointForce):
    """A contact that no plate sees for a while: a rail, a seat, a box, a foot beside the plate.

    A force that comes, stays and goes, or one that changes steadily from knot to knot of its interval.
    """

    name = "unmeasured_contact"
    parameters = (Parameter("force_N", 50.0, 3),)
    intermittent = True

    def finer(self, place: Place) -> tuple[Place, ...]:
        assert place.when is not None
        (own,) = place.when
        knots = {min(MOST_KNOTS, max(3, 1 + round((own.t1 - own.t0) / spacing))) for spacing in SPACING_S}
        return tuple(replace(place, grid={"knots": float(k)}) for k in sorted(knots))

    def size(self, place: Place) -> int:
        return 3 * _knots(place) * (1 if _knots(place) == 1 else len(place.when or ()))

    def scale(self, place: Place) -> tuple[float, ...]:
        return super().scale(place) * (self.size(place) // 3)

    def load(self, scene: Scene, place: Place, theta: Float[Tensor, " params"]) -> Float[Tensor, "6 frames"]:
        if _knots(place) == 1:
            return super().load(scene, place, theta)
        (segment,) = place.where
        at = scene.point(segment, anchor(scene, place))
        course = scene.passed((place.when, _knots(place), "knots"), lambda: _hats(place, scene))
        return -at_origin(at.p, theta.view(-1, 3).T @ course)

    def force(self, scene: Scene, at: Point, theta: Float[Tensor, " params"]) -> Float[Tensor, "3 frames"]:
        return theta[:, None].expand(3, len(scene.time))

    def named(self, place: Place, theta: Float[Tensor, " params"]) -> dict[str, Tensor]:
        force, length = theta * mean_within(place), theta.new_tensor([i.t1 - i.t0 for i in place.when or ()])
        if _knots(place) > 1:
            weight = torch.ones(_knots(place)).to(theta)
            weight[[0, -1]] = 0.5
            each = torch.einsum("k,ikx->ix", weight / weight.sum(), theta.view(len(length), -1, 3))
            force = length @ each / length.sum()
        return {"force_N": force, "impulse_Ns": force * length.sum()}

    def estimated(
        self, place: Place, theta: Float[Tensor, " params"], covariance: Float[Tensor, "params params"]
    ) -> dict[str, tuple[Float[Tensor, "*size"], Float[Tensor, "*size"]]]:
        """The impulse is what forces tell; its mean is as uncertain as the ends that it is taken between.

        Of eight forces that rose smoothly, errors were 11 % of the mean and the sd without the ends 4 %.
        """
        told, when = super().estimated(place, theta, covariance), place.when or ()
        force, sd = told["force_N"]
        ends = END_S * math.sqrt(2.0 * len(when)) / sum(one.t1 - one.t0 for one in when)
        return told | {"force_N": (force, (sd.square() + (ends * force).square()).sqrt())}

    def internal(self, place: Place, values: dict[str, Tensor]) -> Float[Tensor, " params"]:
        return super().internal(place, values) / mean_within(place)


SPACING_S = (0.1, 0.2, 0.4)
END_S = 0.1
"""By which each end of an interval may be off: what rises smoothly begins nowhere in particular."""
MOST_KNOTS = 16


def _knots(place: Place) -> int:
    return int(place.grid.get("knots", 1.0))


def _hats(place: Place, scene: Scene) -> Float[Tensor, "knots frames"]:
    """Each 1 at its knot and 0 at the others, straight between; zero outside its interval."""
    assert place.when is not None
    return torch.cat([_interval_hats(own, _knots(place), scene) for own in place.when])


def _interval_hats(own: Interval, knots: int, scene: Scene) -> Float[Tensor, "knots frames"]:
    at = (scene.time - own.t0) / (own.t1 - own.t0) * (knots - 1)
    inside = (at >= 0.0) & (at <= knots - 1.0)
    return inside * (1.0 - (at - torch.arange(knots).to(at)[:, None]).abs()).clamp(min=0.0)
