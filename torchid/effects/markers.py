"""Maps of markers: one that was moved, two that were swapped, a wrong scale, skin that slides, flesh that lags.

Sources: Leardini, Chiari, Della Croce & Cappozzo, Gait & Posture 21 (2005), on soft tissue artefacts; Della Croce et
al., ibid., on misplaced landmarks; Chiari et al., ibid., on instrumental errors; Wakeling & Nigg, J Appl Physiol 90
(2001), on frequencies of soft tissue.
"""

from collections.abc import Sequence
from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.conventions import GRAVITY
from torchid.effects.effect import Effect, Parameter, value_of
from torchid.effects.joint_angles import bend, lively, orders
from torchid.effects.marker_scene import Along, Sight, Slid, Sway, View
from torchid.effects.place import Interval, Place, within
from torchid.effects.scene import Scene


class MarkerEffect(Effect):
    """An effect on what cameras see."""

    moves_markers = True


class MarkerShift(MarkerEffect):
    """A marker was knocked or stuck on again: in some trials it sits elsewhere on its segment."""

    name = "marker_shift"
    per_recording = True
    widespread = True
    parameters = (Parameter("shift_seg_m", 0.015, 3),)

    def places(self, views: Sequence[View]) -> tuple[Place, ...]:
        """Single trials, or all from one on: what was knocked stays so. All trials are only another place."""
        found = []
        for label in sorted({label for view in views if view.sight for label in view.sight.labels}):
            trials = [v.scene for v in views]
            single = [(k,) for k in range(len(trials))] if len(trials) > 1 else []
            later = [tuple(range(k, len(trials))) for k in range(1, len(trials) - 1)]
            found += [Place((label,), tuple(_whole(trials[k]) for k in ks)) for ks in (*single, *later)]
        return tuple(found)

    def source(self, place: Place) -> tuple[Place, tuple[str, ...] | None]:
        return Place(place.where), None if place.when is None else tuple(i.trial for i in place.when)

    def slide(self, sight: Sight, place: Place, theta: Float[Tensor, " params"]) -> Slid:
        which = [k for k, label in enumerate(sight.labels) if label in place.where]
        moved = sight.turned(theta.expand(len(which), 3)[:, :, None], which)
        return Slid(tuple(which), moved * within(place, sight.scene.trial, sight.scene.time, 0.0))

    def sway(self, sight: Sight, place: Place) -> Sway:
        (label,) = place.where
        there = within(place, sight.scene.trial, sight.scene.time, 0.0)
        return Sway(Along((sight.labels.index(label),)), there[None], ((0, 0), (1, 0), (2, 0)))


def _whole(scene: Scene) -> Interval:
    return Interval(scene.trial, float(scene.time[0]), float(scene.time[-1]))


class MarkerSwap(MarkerEffect):
    """Two labels are exchanged for a while. The parameter is how much of the swap is there: one, or nothing."""

    name = "marker_swap"
    intermittent = True
    parameters = (Parameter("share", 1.0, positive=True),)

    def places(self, views: Sequence[View]) -> tuple[Place, ...]:
        return ()

    def slide(self, sight: Sight, place: Place, theta: Float[Tensor, " params"]) -> Slid:
        a, b = (sight.labels.index(label) for label in place.where)
        apart = theta * within(place, sight.scene.trial, sight.scene.time, 0.0) * (sight.p[b] - sight.p[a])
        return Slid((a, b), torch.stack([apart, -apart]))

    def named(self, place: Place, theta: Float[Tensor, " params"]) -> dict[str, Tensor]:
        return {}

    def internal(self, place: Place, values: dict[str, Tensor]) -> Float[Tensor, " params"]:
        return torch.ones(1, dtype=torch.float64)


class MarkerScale(MarkerEffect):
    """The cameras were calibrated with a wand of another length: all lengths and accelerations err by one factor."""

    name = "marker_scale"
    parameters = (Parameter("excess", 0.02),)

    def places(self, views: Sequence[View]) -> tuple[Place, ...]:
        return (Place(("session",)),)

    def slide(self, sight: Sight, place: Place, theta: Float[Tensor, " params"]) -> Slid:
        return Slid(tuple(range(len(sight.labels))), theta * sight.p)

    def named(self, place: Place, theta: Float[Tensor, " params"]) -> dict[str, Tensor]:
        return {"scale": 1.0 + theta[0]}

    def internal(self, place: Place, values: dict[str, Tensor]) -> Float[Tensor, " params"]:
        return value_of(values, self.name, "scale", 1) - 1.0


class SoftTissue(MarkerEffect):
    """Skin slides under a segment's markers as a neighbouring joint turns.

    Each marker's shift, in the segment's axes, goes with the sine of the joint's angle from the neutral pose.
    """

    name = "soft_tissue"
    bodily = True
    parameters = (Parameter("shift_90_m", 0.01, 3),)

    def places(self, views: Sequence[View]) -> tuple[Place, ...]:
        sight, found = views[0].sight, []
        if sight is None:
            return ()
        scenes = [v.scene for v in views]
        for name in sight.scene.tree.names:
            labels = tuple(sight.labels[k] for k in sight.on(name))
            if labels:
                angles = [angle for dof in cues(scenes, name) for angle in orders(scenes, dof)]
                found += [Place((name,), follows=angle, markers=labels) for angle in angles]
        return tuple(found)

    def size(self, place: Place) -> int:
        return 3 * len(place.markers)

    def scale(self, place: Place) -> tuple[float, ...]:
        return super().scale(place) * len(place.markers)

    def slide(self, sight: Sight, place: Place, theta: Float[Tensor, " params"]) -> Slid:
        which = [sight.labels.index(label) for label in place.markers]
        local = theta.view(-1, 3, 1) * bend(sight.scene, place)[0]
        return Slid(tuple(which), sight.turned(local, which))

    def sway(self, sight: Sight, place: Place) -> Sway:
        which = tuple(sight.labels.index(label) for label in place.markers)
        return Sway(Along(which), bend(sight.scene, place)[:1], tuple((k, 0) for k in range(self.size(place))))

    def named(self, place: Place, theta: Float[Tensor, " params"]) -> dict[str, Tensor]:
        return {"shift_90_m": theta.view(-1, 3)}

    def internal(self, place: Place, values: dict[str, Tensor]) -> Float[Tensor, " params"]:
        return value_of(values, self.name, "shift_90_m", 3 * len(place.markers))


class SkinLag(MarkerEffect):
    """The flesh under markers is a spring: where the bone is accelerated, they stay behind.

    By the acceleration of each over the square of the flesh's own angular frequency, some 10 Hz. Where it is equally
    soft everywhere no residual of markers shows it, but what they say of the body is too lively: by a few percent at
    the pace of a run. One softness for each segment. What gravity does is left to the places of markers and to skin
    that slides: with it, a run was explained no better.
    """

    name = "skin_lag"
    bodily = True
    whole_body = True
    follows_acceleration = nonlinear = True
    parameters = (Parameter("shift_1g_m", 0.0025, positive=True),)

    def places(self, views: Sequence[View]) -> tuple[Place, ...]:
        sight = views[0].sight
        if sight is None:
            return ()
        return (Place(tuple(name for name in sight.scene.tree.names if sight.on(name))),)

    def size(self, place: Place) -> int:
        return len(place.where)

    def scale(self, place: Place) -> tuple[float, ...]:
        return super().scale(place) * len(place.where)

    def positives(self, place: Place) -> int:
        return self.size(place)

    def slide(self, sight: Sight, place: Place, theta: Float[Tensor, " params"]) -> Slid:
        soft = _softness(sight, place, theta)
        which = soft.nonzero()[:, 0].tolist()
        return Slid(tuple(which), -soft[which][:, None, None] / GRAVITY * sight.a[which])

    def beneath(self, sight: Sight, place: Place, theta: Float[Tensor, " params"]) -> Sight:
        """What is seen is livelier than the bone: of 3 mm, a tenth was lacking."""
        return replace(sight, soft=_softness(sight, place, theta).clamp(min=0.0))

    def named(self, place: Place, theta: Float[Tensor, " params"]) -> dict[str, Tensor]:
        return {"shift_1g_m": theta}

    def internal(self, place: Place, values: dict[str, Tensor]) -> Float[Tensor, " params"]:
        return value_of(values, self.name, "shift_1g_m", len(place.where))


def _softness(sight: Sight, place: Place, theta: Float[Tensor, " segments"]) -> Float[Tensor, " markers"]:
    """Of what each marker sits on."""
    soft = theta.new_zeros(len(sight.scene.tree.bodies))
    soft[[sight.scene.at(name) for name in place.where]] = theta
    return soft[sight.body]


def cues(scenes: Sequence[Scene], segment: str) -> tuple[str, ...]:
    """Of the joints at both ends of a segment, the coordinate that moves most."""
    tree = scenes[0].tree
    ends = [tree.index(segment), *(k for k, body in enumerate(tree.bodies) if body.parent == tree.index(segment))]
    return tuple(dof for k in ends for dof in lively(scenes, k)[:1])
