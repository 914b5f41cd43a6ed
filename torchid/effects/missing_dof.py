"""Joints that move along or about an axis that the model does not have.

Source: Andersen, Benoit, Damsgaard, Ramsey & Rasmussen, J Biomech 43 (2010), on constrained joints against free ones.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import product
from typing import final

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.effects.evidence import TrialEvidence
from torchid.effects.joints import directed, joint_name, unit_ways
from torchid.effects.kinds import DisplacedBodies
from torchid.effects.marker_scene import Sight, Sway, View
from torchid.effects.parameter import Parameter, value_of
from torchid.effects.place import Place
from torchid.effects.quantities import DEGREES, NamedEffect, main_axis, of, size
from torchid.effects.scene import Scene
from torchid.effects.traits import Occurrence, Origin, Site
from torchid.model.tree import Body

MODES = 12
"""Resolution. Courses of a planted motion, and the least number of any."""
FASTEST_HZ = 1.5
"""Estimator. Frequency up to which a joint's free motion is followed [Hz]."""
MOST_MODES = 48
"""Resolution. Courses of the longest trials."""
JOINTS = 2
"""Proposal. Joints proposed for sliding, and for turning."""
SLIDES_M, TURNS_RAD = 0.005, 0.05
"""Estimator. Prior standard deviation of a whole motion."""


@final
class MissingDof(DisplacedBodies):
    """A joint moves along or about an axis that the model does not have, in its own time.

    It slides along axes of the segment before the joint, or turns about axes of the one beyond it. Internal are the
    coefficients of a constant and slow cosines for each axis that the joint lacks, in every trial anew; the direction
    in which the cosines are largest is reported. Grid keys are ``x``, ``y``, ``z`` (whether the joint lacks each),
    ``modes`` and ``turning``.
    """

    name = "missing_dof"
    origin = Origin.BODY
    occurrence = Occurrence.ANEW_PER_TRIAL
    site = Site.JOINT
    parameters = (
        Parameter("course", 0.02, 3 * MODES, source="unused, see ``scale``, whose 5 mm and 3 degrees are a choice, of "
                  "the order of what a knee does beside flexion in a step: ranges of 3 to 7 mm, and of 4 and 12 "
                  "degrees (biplane radiography of 39 knees, PMC7477710)"),
    )  # fmt: skip
    noun = "an unmodelled motion"
    link = "of"
    advice = "the joint moved slowly about each of its axes, one at a time"
    apart = {"missing_dof": "each of the two joints moved alone"}

    def places(self, views: Sequence[View]) -> tuple[Place, ...]:
        """Each joint that lacks axes to slide along, and each that lacks axes to turn about."""
        scene, modes, found = views[0].scene, float(_modes(views)), []
        for k in range(1, len(scene.tree.names)):
            for turning in (False, True):
                grid = _lacking(scene.tree.bodies[k], turning)
                if any(grid.values()):
                    grid |= {"modes": modes, "turning": float(turning)}
                    found.append(Place((joint_name(scene, k),), grid=grid))
        return tuple(found)

    def propose(self, observed: Sequence[TrialEvidence]) -> tuple[Place, ...]:
        """Joints whose markers follow motion of their own, by the evidence of markers alone."""
        if observed[0].markers is None:
            return ()
        places = self.places([one.view for one in observed])
        scales = [self.scale(place)[0] for place in places]
        told = []
        for one in observed:
            assert one.markers is not None
            sways = [self.sway(one.markers.sight, place) for place in places]
            # Geometry that errs is a constant.
            told.append(one.evidence_of_courses([replace(s, courses=s.courses[1:]) for s in sways], scales))
        score = torch.tensor(told, dtype=torch.float64).sum(0)
        best = []
        for turning in (0.0, 1.0):
            own = [k for k, place in enumerate(places) if place.grid["turning"] == turning]
            best += sorted(own, key=lambda k: -float(score[k]))[:JOINTS]
        return tuple(replace(places[k], odds=1.0 / len(places)) for k in best)

    def grid(self, values: Mapping[str, Tensor]) -> dict[str, float]:
        """A joint that is taken to lack all three axes."""
        return {"turning": float("range_rad" in values), "modes": float(MODES), "x": 1.0, "y": 1.0, "z": 1.0}

    def scale(self, place: Place) -> tuple[float, ...]:
        """Motion of 5 mm or 3 degrees in all, shared by the cosines of each axis."""
        modes, own = place.grid["modes"], TURNS_RAD if place.grid["turning"] else SLIDES_M
        return (own / math.sqrt(modes),) * (len(_axes(place)) * int(modes))

    def move(self, scene: Scene, place: Place, theta: Float[Tensor, " params"]) -> Float[Tensor, "bodies 6 frames"]:
        course, free = theta.new_zeros(3, len(scene.time)), _axes(place)
        course[free] = theta.view(len(free), -1) @ courses(scene.time, int(place.grid["modes"]), scene.span.time)
        return directed(scene, place.where[0], course, bool(place.grid["turning"]))

    def sway(self, sight: Sight, place: Place) -> Sway:
        scene, modes, free = sight.scene, int(place.grid["modes"]), _axes(place)
        ways = unit_ways(scene, place.where[0], free, bool(place.grid["turning"]))
        return Sway(ways, courses(scene.time, modes, scene.span.time), tuple(product(range(len(free)), range(modes))))

    def named(self, place: Place, theta: Float[Tensor, " params"]) -> dict[str, Tensor]:
        """Direction of the cosines, and the range along it, mean over the trials."""
        free = _axes(place)
        own = theta.view(-1, len(free), int(place.grid["modes"]))
        # Among the lacking axes alone: with the others, equal eigenvalues of zero would have no derivative. Without the
        # constant: geometry knows as little where the joint stands.
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
        return (axis[_axes(place), None] / axis.norm() * reach * shape / (own.max() - own.min())).reshape(-1)

    def sentence(self, finding: NamedEffect) -> str:
        turning = "range_rad" in finding.parameters
        reach = size(finding, "range_rad", "°", DEGREES) if turning else size(finding, "range_m", "mm", 1e3)
        main = main_axis(of(finding, "axis_seg" if turning else "direction_seg")[0])
        verb, along = ("turns", "about") if turning else ("slides", "along")
        moving = f"{self.located(finding.where)} {verb} by {reach} {along}"
        return f"{moving} an axis that the model lacks, mostly the segment's {main} axis"


def _lacking(body: Body, turning: bool) -> dict[str, float]:
    """1 for each of x, y, z about which (or along which) the body's proximal joint does not move, else 0."""
    own = {turn.axis for turn in body.turns if turn.moving} if turning else {slide.axis for slide in body.slides}
    return {axis: float(k not in own) for k, axis in enumerate("xyz")}


def _axes(place: Place) -> list[int]:
    """The axes that the joint of a place lacks."""
    return [k for k, axis in enumerate("xyz") if place.grid[axis]]


def courses(
    time: Float[Tensor, " frames"], modes: int, span: Float[Tensor, " others"] | None = None
) -> Float[Tensor, "modes frames"]:
    """A constant and cosines of 1, 2, ... half periods in a span of time; outside it they stay as they are.

    With the constant, which is another in every trial, axes and centres of other joints need not make up for where a
    loose joint stands.

    Args:
        time: of each frame [s].
        modes: number of courses.
        span: times of which the first and the last count [s]; None: ``time``.
    """
    own = time if span is None else span
    part = ((time - own[0]) / (own[-1] - own[0])).clamp(0.0, 1.0)
    k = torch.arange(modes).to(time)
    return torch.cos(math.pi * k[:, None] * part)


def _modes(views: Sequence[View]) -> int:
    """Courses that the longest trial needs for ``FASTEST_HZ``."""
    longest = max(float(v.scene.time[-1] - v.scene.time[0]) for v in views)
    return min(MOST_MODES, max(MODES, 1 + math.ceil(2.0 * FASTEST_HZ * longest)))
