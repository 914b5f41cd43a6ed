"""Rotors in segments.

Source: Lemus, Berry, Jabeen et al., Sci Rep 10 (2020), on worn gyroscopes.
"""

from collections.abc import Sequence
from typing import final

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.effects.kinds import AttachedLoad
from torchid.effects.marker_scene import View
from torchid.effects.parameter import Parameter
from torchid.effects.place import Place
from torchid.effects.quantities import NamedEffect, length, main_axis, of
from torchid.effects.scene import Scene
from torchid.effects.traits import Site
from torchid.kinematics.recursion import cross


@final
class Flywheel(AttachedLoad):
    """A rotor of constant momentum in a segment: it resists turning across its axis (a gyroscope, a running motor)."""

    name = "flywheel"
    site = Site.SEGMENT
    parameters = (
        Parameter("momentum_seg_Nms", 1.0, 3, source="a choice: a disc of 1 kg and 0.1 m that turns 2000 times a "
                  "minute"),
    )  # fmt: skip
    noun = "something that spins"
    link = "inside"
    advice = "turns of the trunk about all three axes with the device switched off and on"
    apart = {"flywheel": "turns of one segment after the other"}

    def places(self, views: Sequence[View]) -> tuple[Place, ...]:
        return tuple(Place((name,)) for name in views[0].scene.tree.names)

    def load(self, scene: Scene, place: Place, theta: Float[Tensor, " params"]) -> Float[Tensor, "6 frames"]:
        (segment,) = place.where
        moment = cross(scene.state.motion.w[scene.at(segment)], scene.turned(segment, theta))
        return torch.cat([torch.zeros_like(moment), moment])

    def sentence(self, finding: NamedEffect) -> str:
        value, sd = of(finding, "momentum_seg_Nms")
        momentum, axis = length(value, sd, "N m s"), main_axis(value)
        inside = self.located(finding.where)
        return f"something spins inside {inside}: angular momentum {momentum}, mostly about its {axis} axis"
