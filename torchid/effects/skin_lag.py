"""Flesh under markers that gives way.

Source: Wakeling & Nigg, J Appl Physiol 90 (2001), on frequencies of soft tissue.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import final

from jaxtyping import Float
from torch import Tensor

from torchid.conventions import GRAVITY
from torchid.effects.kinds import SlidingMarkers
from torchid.effects.marker_scene import Sight, Slid, View
from torchid.effects.parameter import Parameter, value_of
from torchid.effects.place import Place
from torchid.effects.quantities import NamedEffect, of
from torchid.effects.traits import ColumnNoise, Origin, Response, Site
from torchid.wording import listing, segment, stated


@final
class SkinLag(SlidingMarkers):
    """The flesh under markers is a spring: where the bone is accelerated, they stay behind.

    A marker stays behind by the acceleration over the square of the flesh's own angular frequency, some 10 Hz. Where
    flesh is equally soft everywhere no residual of markers shows it, but what they say of the body is too lively: by a
    few percent at the pace of a run. Each segment has one softness: how far 1 g takes its markers [m]. What gravity
    does is left to the places of markers and to skin that slides.
    """

    name = "skin_lag"
    origin = Origin.WHOLE_BODY
    response = Response.NONLINEAR
    column_noise = ColumnNoise.CORRECTED
    site = Site.SEGMENT
    parameters = (
        Parameter("shift_1g_m", 0.0025, positive=True, source="a choice: 1 g shifts what rings at 10 Hz by "
                  "g / w^2 = 2.5 mm; soft tissue of the leg rings at the frequencies of impacts in running (Wakeling & "
                  "Nigg, J Appl Physiol 90 (2001))"),
    )  # fmt: skip
    noun = "lagging skin"
    link = "of"
    advice = "the same motion slowly, and with markers on pins or tight wraps"
    apart = {"wobbling_mass": "heel drops: soft mass rings on in the forces, skin in the markers alone"}

    def places(self, views: Sequence[View]) -> tuple[Place, ...]:
        """All segments that have markers, together."""
        sight = views[0].sight
        if sight is None:
            return ()
        return (Place(tuple(name for name in sight.scene.tree.names if sight.on(name))),)

    def scale(self, place: Place) -> tuple[float, ...]:
        """Return the prior of one segment for each of the place."""
        (softness,) = self.parameters
        return (softness.scale,) * len(place.where)

    def positives(self, place: Place) -> int:
        return self.size(place)

    def slide(self, sight: Sight, place: Place, theta: Float[Tensor, " params"]) -> Slid:
        soft = _softness(sight, place, theta)
        which = soft.nonzero()[:, 0].tolist()
        return Slid(tuple(which), -soft[which][:, None, None] / GRAVITY * sight.a[which])

    def beneath(self, sight: Sight, place: Place, theta: Float[Tensor, " params"]) -> Sight:
        """The sight of bones through this flesh: what is seen is livelier than they are."""
        return replace(sight, soft=_softness(sight, place, theta).clamp(min=0.0))

    def named(self, place: Place, theta: Float[Tensor, " params"]) -> dict[str, Tensor]:
        return {"shift_1g_m": theta}

    def internal(self, place: Place, values: dict[str, Tensor]) -> Float[Tensor, " params"]:
        return value_of(values, self.name, "shift_1g_m", len(place.where))

    def sentence(self, finding: NamedEffect) -> str:
        value, sd = of(finding, "shift_1g_m")
        most, least = int(value.argmax()), int(value.argmin())
        # A softness is never negative: what is none within its error is no size to read.
        ends = [
            (stated(value[k], sd[k], "mm", 1e3) if value[k] > 2.0 * sd[k] else "hardly anything")
            + f" on the {segment(finding.where[k])}"
            for k in dict.fromkeys((most, least))
        ]
        behind = f"where a segment is accelerated by 1 g they stay behind, by {listing(ends)}"
        return f"the soft tissue under the markers gives way: {behind}"


def _softness(sight: Sight, place: Place, theta: Float[Tensor, " segments"]) -> Float[Tensor, " markers"]:
    """Return the way of each marker under 1 g by its segment [m]; it is zero on segments that the place leaves out."""
    soft = theta.new_zeros(len(sight.scene.tree.bodies))
    soft[[sight.scene.at(name) for name in place.where]] = theta
    return soft[sight.body]
