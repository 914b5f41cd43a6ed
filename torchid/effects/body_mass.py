"""A record of the person's mass that is wrong."""

from collections.abc import Mapping, Sequence
from typing import final

from jaxtyping import Float
from torch import Tensor

from torchid.effects.kinds import RecordEffect
from torchid.effects.marker_scene import View
from torchid.effects.parameter import Parameter, value_of
from torchid.effects.place import Place
from torchid.effects.quantities import NamedEffect, of, size
from torchid.effects.scene import Scene
from torchid.effects.traits import ColumnNoise
from torchid.wording import number


@final
class BodyMass(RecordEffect):
    """The recorded mass is not the person's: plates and record disagree everywhere alike.

    A common gain of all plates does the same to the plates; only a second scale tells which. Internal is what the
    body weighs beyond the record [kg], spread over it as its mass is.
    """

    name = "body_mass"
    mistaken = 0.05
    column_noise = ColumnNoise.CORRECTED
    grid_keys = ("recorded_kg",)
    parameters = (
        Parameter("excess_kg", 4.0, source="a choice: shoes, clothes and a weight that somebody told instead of being "
                  "weighed (reviewed by Connor Gorber et al., Obesity Reviews 8 (2007))"),
    )  # fmt: skip
    noun = "a wrong body mass"
    advice = "the person standing still, weighed on another scale"
    apart = {"payload": "quiet standing with the load taken off, and the load on a scale"}

    def places(self, views: Sequence[View]) -> tuple[Place, ...]:
        return (Place(("session",), grid={"recorded_kg": views[0].scene.recorded_kg}),)

    def load(self, scene: Scene, place: Place, theta: Float[Tensor, " params"]) -> Float[Tensor, "6 frames"]:
        return theta / scene.mass * scene.needed()

    def rigid(self, scene: Scene, place: Place) -> Float[Tensor, "bodies 10 params"]:
        return (scene.phi / scene.mass)[:, :, None]

    def named(self, place: Place, theta: Float[Tensor, " params"]) -> dict[str, Tensor]:
        recorded = theta.new_tensor(place.grid["recorded_kg"])
        return {"mass_kg": recorded + theta[0], "recorded_kg": recorded}

    def internal(self, place: Place, values: dict[str, Tensor]) -> Float[Tensor, " params"]:
        return value_of(values, self.name, "mass_kg", 1) - value_of(values, self.name, "recorded_kg", 1)

    def entries(self, finding: NamedEffect) -> Mapping[str, float]:
        mass, sd = (float(x) for x in of(finding, "mass_kg"))
        return {"mass_kg": mass, "mass_sd_kg": sd}

    def sentence(self, finding: NamedEffect) -> str:
        said = f"the person weighs {size(finding, 'mass_kg', 'kg')}"
        if "recorded_kg" not in finding.parameters:
            return f"{said}, not what is on record"
        return f"{said}, not the {number(of(finding, 'recorded_kg')[0][0])} kg on record"
