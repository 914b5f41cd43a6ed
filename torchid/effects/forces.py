"""Forces at a point of the body that no plate measures: the ground supplies so much less.

Source: Winter, Biomechanics and Motor Control of Human Movement (2009), on forces by inverse dynamics.
"""

from abc import abstractmethod
from collections.abc import Sequence
from typing import ClassVar, final

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.conventions import GRAVITY
from torchid.effects.kinds import LoadEffect
from torchid.effects.marker_scene import View
from torchid.effects.parameter import Parameter, stacked
from torchid.effects.place import Place
from torchid.effects.quantities import ROOM, NamedEffect, of, size, vector
from torchid.effects.scene import BodyPoint, Scene, anchor, at_origin, passing
from torchid.effects.traits import Response, Site
from torchid.wording import number


class PointForce(LoadEffect):
    """A force on a point of a segment, where no other is given on its centre of mass."""

    site = Site.SEGMENT
    segments: ClassVar[tuple[str, ...]] = ()
    """Segments on which it may act; empty: all."""

    @final
    def places(self, views: Sequence[View]) -> tuple[Place, ...]:
        names = views[0].scene.tree.names
        return tuple(Place((name,)) for name in names if not self.segments or name in self.segments)

    @final
    def load(self, scene: Scene, place: Place, theta: Float[Tensor, " params"]) -> Float[Tensor, "6 frames"]:
        (segment,) = place.where
        at = scene.point(segment, anchor(scene, place))
        force = self.force(scene, at, theta) * passing(scene, place)
        return -at_origin(at.p, force)

    @abstractmethod
    def force(self, scene: Scene, at: BodyPoint, theta: Float[Tensor, " params"]) -> Float[Tensor, "3 frames"]:
        """The force on the body, in W [N]."""


@final
class ExternalForce(PointForce):
    """A constant force in W: a cable over a pulley, a hand that steadies, wind."""

    name = "external_force"
    mistaken = 0.07
    parameters = (
        Parameter("force_N", 20.0, 3, source="a choice: a hand that steadies, or a weight of 2 kg on a cable"),
    )
    noun = "a constant force"
    advice = "quiet standing with and without whatever may pull at the person"
    apart = {
        "external_force": "leaning and bending, so that the places where the force may act move apart",
        "body_weight_support": "quiet standing without the harness",
        "body_mass": "quick squats and hops: mass resists acceleration, a constant force does not",
        "payload": "quick squats and hops: a load resists acceleration, a constant force does not",
        "tether": "slow leaning to all sides: a spring's force changes, a constant one does not",
        "unmeasured_contact": "quiet standing in the middle of the plates, nothing else in reach",
        "plate_offset": "every plate unloaded for two seconds",
    }

    def force(self, scene: Scene, at: BodyPoint, theta: Float[Tensor, " params"]) -> Float[Tensor, "3 frames"]:
        return theta[:, None].expand(3, len(scene.time))

    def sentence(self, finding: NamedEffect) -> str:
        force = vector(finding, "force_N", "N", 1.0, ROOM)
        return f"a constant force that no plate measures acts on {self.located(finding.where)}: {force}"


@final
class BodyWeightSupport(PointForce):
    """A harness that carries part of the weight, whatever the body does."""

    name = "body_weight_support"
    mistaken = 0.06
    parameters = (
        Parameter("force_N", 100.0, positive=True, source="a choice: 15 % of the weight of 70 kg, a harness that "
                  "carries little"),
    )  # fmt: skip
    segments = ("pelvis", "thorax")
    noun = "a harness"
    link = "at"
    advice = "quiet standing with the harness slack and with it tight"
    apart = {
        "body_weight_support": "bending of the trunk, so that pelvis and thorax move apart",
        "body_mass": "quiet standing with the harness slack",
        "payload": "quick squats and hops: a load resists acceleration, a harness does not",
    }

    def force(self, scene: Scene, at: BodyPoint, theta: Float[Tensor, " params"]) -> Float[Tensor, "3 frames"]:
        up = theta.new_tensor([0.0, 0.0, 1.0])[:, None]
        return (theta * up).expand(3, len(scene.time))

    def sentence(self, finding: NamedEffect) -> str:
        weight = number(of(finding, "force_N")[0][0] / GRAVITY)
        carried = size(finding, "force_N", "N")
        return f"a harness at {self.located(finding.where)} carries {carried}, the weight of {weight} kg"


@final
class Drag(PointForce):
    """A force against velocity: water, a parachute, a sled."""

    name = "drag"
    parameters = (Parameter("coefficient_Ns_m", 10.0, positive=True, source="a choice: 10 N at the pace of a walk"),)
    noun = "a drag"
    advice = "the same motion twice, slowly and as fast as possible"
    apart = {"drag": "quick motion of one segment after the other"}

    def force(self, scene: Scene, at: BodyPoint, theta: Float[Tensor, " params"]) -> Float[Tensor, "3 frames"]:
        return -theta * at.v

    def sentence(self, finding: NamedEffect) -> str:
        drag = size(finding, "coefficient_Ns_m", "N s/m")
        return f"{self.located(finding.where)} moves against a drag of {drag}"


CERTAIN = 2.0
"""Wording. Standard deviations from which a rest length is worth a word."""
PULL = "a choice: the stiffness at a metre from the anchor"


@final
class Tether(PointForce):
    """A spring to a fixed anchor, such as a cable, a band or a hose: force along position.

    Internal are the stiffness k, and k times the anchor's place, typically a metre away, and k times the rest length.
    That a spring is slack up to its rest length shows once the anchor is known: along it, it is stiffer than across.
    """

    name = "tether"
    mistaken = 0.09
    response = Response.NONLINEAR
    parameters = (
        Parameter("stiffness_N_m", 30.0, positive=True, source="a choice: a soft rubber band or a hose"),
        Parameter("pull_N", 30.0, 3, source=PULL),
        Parameter("slack_N", 30.0, source=PULL),
    )
    noun = "a spring"
    advice = "slow leaning to all sides, far from and near to where the spring is fixed"
    apart = {"tether": "bending and leaning, so that the places where the spring may pull move apart"}

    def force(self, scene: Scene, at: BodyPoint, theta: Float[Tensor, " params"]) -> Float[Tensor, "3 frames"]:
        stiffness, pull, slack = self.split(theta)
        stretched = pull[:, None] - stiffness * at.p
        taut = (1.0 - slack / stretched.norm(dim=0).clamp(min=1e-9)).clamp(min=0.0)
        return stretched * torch.where(stiffness > 0.0, taut, 1.0)

    def named(self, place: Place, theta: Float[Tensor, " params"]) -> dict[str, Tensor]:
        stiffness, pull, slack = self.split(theta)
        return {"stiffness_N_m": stiffness[0], "anchor_m": pull / stiffness, "rest_m": slack[0] / stiffness[0]}

    def internal(self, place: Place, values: dict[str, Tensor]) -> Float[Tensor, " params"]:
        """The products of stiffness, anchor and rest length; without a stated one, the rest length is zero."""
        stiffness, fixed, rest = (
            torch.as_tensor(values.get(key, default), dtype=torch.float64)
            for key, default in (("stiffness_N_m", 0.0), ("anchor_m", []), ("rest_m", 0.0))
        )
        products = {"stiffness_N_m": stiffness, "pull_N": stiffness * fixed, "slack_N": stiffness * rest}
        return stacked(self.parameters, products, self.name)

    def sentence(self, finding: NamedEffect) -> str:
        fixed = ", ".join(number(x, 2) for x in of(finding, "anchor_m")[0].tolist())
        stiffness = size(finding, "stiffness_N_m", "N/m")
        rest, sd = (float(x) for x in of(finding, "rest_m"))
        slack = f", once it is longer than {size(finding, 'rest_m', 'm')}" if rest > CERTAIN * sd else ""
        pulled = self.located(finding.where)
        return f"a spring of {stiffness} pulls {pulled} towards a fixed point at x, y, z = {fixed} m{slack}"
