"""Contacts that no plate sees for a while."""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import final

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.effects.effect import Estimates
from torchid.effects.kinds import LoadEffect
from torchid.effects.marker_scene import View
from torchid.effects.parameter import Parameter, propagated, stacked
from torchid.effects.place import Interval, Place, mean_within
from torchid.effects.quantities import ROOM, NamedEffect, length, of, vector
from torchid.effects.scene import Scene, anchor, at_origin, passing
from torchid.effects.traits import Occurrence, Site

SPACING_S = (0.1, 0.2, 0.4)
"""Resolution. Distances of the knots of a finer course [s]."""
END_S = 0.1
"""Estimator. Error of each end of an interval [s]: what rises smoothly begins nowhere in particular."""
MOST_KNOTS = 16
"""Resolution. Knots of an interval at most."""


class CoursedForce(LoadEffect):
    """A force on a point of a segment that comes, stays and goes.

    It is constant within its intervals, or changes steadily from knot to knot of each: then internal are its vectors at
    the knots, interval by interval.
    """

    occurrence = Occurrence.INTERVALS
    site = Site.SEGMENT

    @final
    def places(self, views: Sequence[View]) -> tuple[Place, ...]:
        return tuple(Place((name,)) for name in views[0].scene.tree.names)

    @final
    def finer(self, place: Place) -> tuple[Place, ...]:
        """Return the place with knots about as far apart as ``SPACING_S``, each number of knots once."""
        assert place.when is not None
        (own,) = place.when
        knots = {min(MOST_KNOTS, max(3, 1 + round((own.t1 - own.t0) / spacing))) for spacing in SPACING_S}
        return tuple(replace(place, grid={"knots": float(k)}) for k in sorted(knots))

    @final
    def scale(self, place: Place) -> tuple[float, ...]:
        (force,) = self.parameters
        vectors = 1 if _knots(place) == 1 else _knots(place) * len(place.when or ())
        return (force.scale,) * (3 * vectors)

    @final
    def load(self, scene: Scene, place: Place, theta: Float[Tensor, " params"]) -> Float[Tensor, "6 frames"]:
        (segment,) = place.where
        at = scene.point(segment, anchor(scene, place))
        if _knots(place) == 1:
            return -at_origin(at.p, theta[:, None].expand(3, len(scene.time)) * passing(scene, place))
        course = scene.passed((place.when, _knots(place), "knots"), lambda: _hats(place, scene))
        return -at_origin(at.p, theta.view(-1, 3).T @ course)

    @final
    def named(self, place: Place, theta: Float[Tensor, " params"]) -> dict[str, Tensor]:
        """Mean over the intervals, and impulse."""
        force, length = theta * mean_within(place), theta.new_tensor([i.t1 - i.t0 for i in place.when or ()])
        if _knots(place) > 1:
            weight = torch.ones(_knots(place)).to(theta)
            weight[[0, -1]] = 0.5
            each = torch.einsum("k,ikx->ix", weight / weight.sum(), theta.view(len(length), -1, 3))
            force = length @ each / length.sum()
        return {"force_N": force, "impulse_Ns": force * length.sum()}

    @final
    def estimated(
        self, place: Place, theta: Float[Tensor, " params"], covariance: Float[Tensor, "params params"]
    ) -> Estimates:
        """The impulse is what forces tell; its mean is as uncertain as the ends that it is taken between."""
        told, when = propagated(lambda x: self.named(place, x), theta, covariance), place.when or ()
        force, sd = told["force_N"]
        ends = END_S * math.sqrt(2.0 * len(when)) / sum(one.t1 - one.t0 for one in when)
        return told | {"force_N": (force, (sd.square() + (ends * force).square()).sqrt())}

    @final
    def internal(self, place: Place, values: dict[str, Tensor]) -> Float[Tensor, " params"]:
        """Return the vector of a force without knots that has the mean ``force_N``."""
        return stacked(self.parameters, values, self.name) / mean_within(place)


@final
class UnmeasuredContact(CoursedForce):
    """A contact that no plate sees for a while: a rail, a seat, a box, a foot beside the plates or on a silent one."""

    name = "unmeasured_contact"
    parameters = (
        Parameter("force_N", 50.0, 3, source="a choice: a hand on a rail; a seat or a foot, which bear ten times as "
                  "much, are told by their size before any prior (``diagnosis.candidates.missing_weight``)"),
    )  # fmt: skip
    noun = "a contact that no plate sees"
    link = "of"
    advice = "the same motion with rails, seats and boxes out of reach and both feet on plates"

    def sentence(self, finding: NamedEffect) -> str:
        impulse = length(*of(finding, "impulse_Ns"), "N s") if "impulse_Ns" in finding.parameters else ""
        force = vector(finding, "force_N", "N", 1.0, ROOM)
        said = f"{self.located(finding.where)} touches something that no plate measures, with {force}"
        return f"{said}; impulse {impulse}" if impulse else said


def _knots(place: Place) -> int:
    """Number of knots in each interval; one: the force is constant."""
    return int(place.grid.get("knots", 1.0))


def _hats(place: Place, scene: Scene) -> Float[Tensor, "knots frames"]:
    """Courses that are 1 at their knot and 0 at the others, straight between, and zero outside their interval."""
    assert place.when is not None
    return torch.cat([_interval_hats(own, _knots(place), scene) for own in place.when])


def _interval_hats(own: Interval, knots: int, scene: Scene) -> Float[Tensor, "knots frames"]:
    at = (scene.time - own.t0) / (own.t1 - own.t0) * (knots - 1)
    inside = (at >= 0.0) & (at <= knots - 1.0)
    return inside * (1.0 - (at - torch.arange(knots).to(at)[:, None]).abs()).clamp(min=0.0)
