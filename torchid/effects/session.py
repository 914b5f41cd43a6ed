"""Errors of the whole laboratory: where gravity points, and how long a metre is."""

from collections.abc import Sequence
from typing import final

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.conventions import GRAVITY
from torchid.effects.kinds import LoadEffect, SlidingMarkers
from torchid.effects.marker_scene import Sight, Slid, View
from torchid.effects.parameter import Parameter, value_of
from torchid.effects.place import SESSION, Place
from torchid.effects.quantities import DEGREES, NamedEffect, length, much, of
from torchid.effects.scene import Scene, at_origin
from torchid.effects.traits import Proof
from torchid.wording import number

TILT = "a choice: one degree, the slope of a floor, or of a calibration frame that rests on one corner"


@final
class GravityTilt(LoadEffect):
    """The axes of the cameras do not stand upright: a horizontal force in proportion to the weight.

    The true vertical is the z axis of W pitched about y, then rolled about x.
    """

    name = "gravity_tilt"
    parameters = (Parameter("roll_rad", 0.02, source=TILT), Parameter("pitch_rad", 0.02, source=TILT))
    noun = "a tilted vertical"
    advice = "a plumb line with two markers, or a spirit level on the calibration frame"
    apart = {
        "plate_pose": "a dead weight on each plate: gravity alone must leave no horizontal force",
        "tether": "standing at several places of the room: a spring pulls differently there",
        "external_force": "standing at several places of the room, with and without an extra load",
    }

    def places(self, views: Sequence[View]) -> tuple[Place, ...]:
        return (SESSION,)

    def load(self, scene: Scene, place: Place, theta: Float[Tensor, " params"]) -> Float[Tensor, "6 frames"]:
        roll, pitch = theta
        up = torch.stack([torch.sin(pitch), -torch.sin(roll) * torch.cos(pitch), torch.cos(roll) * torch.cos(pitch)])
        change = GRAVITY * (up - theta.new_tensor([0.0, 0.0, 1.0]))
        return at_origin(scene.centre_of_mass, (scene.mass * change)[:, None].expand(3, len(scene.time)))

    def sentence(self, finding: NamedEffect) -> str:
        (roll, roll_sd), (pitch, pitch_sd) = of(finding, "roll_rad"), of(finding, "pitch_rad")
        both = length(torch.cat([roll, pitch]), torch.cat([roll_sd, pitch_sd]), "°", DEGREES)
        return (
            f"the vertical of the cameras leans by {both} against gravity: {number(roll[0], 2, DEGREES)}° about x, "
            f"{number(pitch[0], 2, DEGREES)}° about y"
        )


@final
class MarkerScale(SlidingMarkers):
    """The cameras were calibrated with a wand of another length: all lengths and accelerations err by one factor."""

    name = "marker_scale"
    mistaken = 0.32
    proof = Proof.NOTHING
    parameters = (
        Parameter("excess", 0.02, source="a choice: a wand of another make, or its length typed wrong by a digit; a "
                  "sound calibration errs by far less (on such errors: Chiari et al., Gait & Posture 21 (2005))"),
    )  # fmt: skip
    noun = "a wrong scale of the cameras"
    advice = "the calibration wand measured with a ruler and recorded once more"
    apart = {"skin_lag": "slow motion: a wrong scale shows at any speed"}

    def places(self, views: Sequence[View]) -> tuple[Place, ...]:
        return (SESSION,)

    def slide(self, sight: Sight, place: Place, theta: Float[Tensor, " params"]) -> Slid:
        return Slid(tuple(range(len(sight.labels))), theta * sight.p)

    def named(self, place: Place, theta: Float[Tensor, " params"]) -> dict[str, Tensor]:
        return {"scale": 1.0 + theta[0]}

    def internal(self, place: Place, values: dict[str, Tensor]) -> Float[Tensor, " params"]:
        return value_of(values, self.name, "scale", 1) - 1.0

    def sentence(self, finding: NamedEffect) -> str:
        return f"all lengths that the cameras see are {much(finding, 'scale', ('long', 'short'))}"
