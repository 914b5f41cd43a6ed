"""Markers that sit elsewhere on their segments: knocked off their place, or carried by skin that slides.

Sources: Leardini, Chiari, Della Croce & Cappozzo, Gait & Posture 21 (2005), on soft tissue artefacts; Della Croce et
al., ibid., on misplaced landmarks.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import final

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.effects.effect import Effect, Ordinary
from torchid.effects.joint_angles import bend, lively, orders
from torchid.effects.kinds import SlidingMarkers
from torchid.effects.marker_scene import Along, Sight, Slid, Sway, View
from torchid.effects.parameter import Parameter, value_of
from torchid.effects.place import Angle, Interval, Place, within
from torchid.effects.place_words import motion_words
from torchid.effects.quantities import BODY, NamedEffect, length, of, vector
from torchid.effects.scene import Scene
from torchid.effects.traits import Occurrence, Origin, Proof, Site
from torchid.geometry.result import GeometryFit
from torchid.kinematics.recursion import cross
from torchid.wording import clean


@final
class MarkerShift(SlidingMarkers):
    """A marker was knocked or stuck on again: in some trials it sits elsewhere on its segment."""

    name = "marker_shift"
    mistaken = 0.58
    proof = Proof.DISTANCES
    origin = Origin.IMITATED
    occurrence = Occurrence.SOME_RECORDINGS
    site = Site.MARKER
    parameters = (
        Parameter("shift_seg_m", 0.015, 3, source="a choice: as far apart as landmarks that are found anew by hand "
                  "(reviewed by Della Croce et al., Gait & Posture 21 (2005)), some 15 to 20 mm at iliac spines and "
                  "trochanters (Cheze, Kinematic Analysis of Human Movement (2014))"),
    )  # fmt: skip
    noun = "a displaced marker"
    advice = "a static trial before and after; look whether the marker was stuck on again"
    apart = {
        "marker_shift": "a static trial before and after each trial",
        "soft_tissue": "a static trial before and after: what was knocked stays displaced at rest",
    }

    def places(self, views: Sequence[View]) -> tuple[Place, ...]:
        """Single trials, or all from one on: what was knocked stays so. All trials are only another place."""
        found = []
        for label in sorted({label for view in views if view.sight for label in view.sight.labels}):
            trials = [v.scene for v in views]
            single = [(k,) for k in range(len(trials))] if len(trials) > 1 else []
            later = [tuple(range(k, len(trials))) for k in range(1, len(trials) - 1)]
            found += [Place((label,), tuple(_whole(trials[k]) for k in ks)) for ks in (*single, *later)]
        return tuple(found)

    def ordinary(self, views: Sequence[View], fit: GeometryFit | None) -> Iterator[Ordinary]:
        """Every marker, within what is known of its place beside the data."""
        if fit is None:
            return
        away = fit.attachment.mean - fit.place
        for k, label in enumerate(fit.attachment.labels):
            yield Ordinary(Place((label,)), tuple(away[k].tolist()), tuple(fit.attachment.sd[k].tolist()))

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

    def sentence(self, finding: NamedEffect) -> str:
        shift = vector(finding, "shift_seg_m", "mm", 1e3, BODY)
        return f"{self.located(finding.where)} sat off its usual place by {shift}"


def _whole(scene: Scene) -> Interval:
    """All of a trial."""
    return Interval(scene.trial, float(scene.time[0]), float(scene.time[-1]))


@final
class SoftTissue(SlidingMarkers):
    """Skin slides under a segment's markers as a neighbouring joint turns.

    Each marker's shift, in the segment's axes, goes with the sine of the joint's angle from the neutral pose.
    """

    name = "soft_tissue"
    origin = Origin.BODY
    site = Site.SEGMENT
    parameters = (
        Parameter("shift_90_m", 0.01, 3, source="a choice: in walks, markers went by 4 to 16 mm against their cluster "
                  "under fluoroscopy (PMC8631460), and by up to 27 mm on a thigh and 24 mm on a shank against pins in "
                  "the bones (Andersen et al., Gait & Posture 35 (2012))"),
    )  # fmt: skip
    noun = "sliding skin"
    link = "of"
    advice = "slow motion of the neighbouring joint alone, with more markers on the segment"
    apart = {
        "soft_tissue": "each of the neighbouring joints moved alone",
        "wobbling_mass": "the same motion slowly and quickly: skin slides at any speed",
        "skin_lag": "the same motion slowly and quickly: skin slides at any speed",
        "missing_dof": "more markers on both segments, some of them over bone",
        "joint_centre_shift": "more markers on both segments, some of them over bone",
    }

    def places(self, views: Sequence[View]) -> tuple[Place, ...]:
        """Each segment that has markers, with each angle that its skin may follow."""
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

    def scale(self, place: Place) -> tuple[float, ...]:
        """Return the prior of one marker for each of the place."""
        (shift,) = self.parameters
        return (shift.scale,) * (3 * len(place.markers))

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

    def sentence(self, finding: NamedEffect) -> str:
        value, sd = (x.view(-1, 3) for x in of(finding, "shift_90_m"))
        most, markers = int(value.norm(dim=1).argmax()), finding.place.markers
        label = f" (marker {clean(markers[most])})" if len(markers) == len(value) else ""
        return (
            f"skin slides under the markers of {self.located(finding.where)} as "
            f"{motion_words(finding.place.follows)} changes: by up to "
            f"{length(value[most], sd[most], 'mm', 1e3)} at 90°{label}"
        )


@final
@dataclass(frozen=True)
class SkinSlide(SlidingMarkers):
    """All markers of a segment slide as one with the angle of a neighbouring joint: no residual shows it.

    A nuisance: the pose of the bone errs by as much, and the needed wrench with it. Its prior is a choice, and narrow
    for a thigh: there, all markers together went by up to 18 mm and 10 degrees in walks of six people with a knee
    prosthesis (PMC8631460).
    """

    labels: tuple[str, ...]
    p_BM_B: Float[Tensor, "markers 3"]

    name = "skin_slide"
    parameters = (Parameter("shift_m", 0.005, 3), Parameter("turn_rad", 0.03, 3))

    def places(self, views: Sequence[View]) -> tuple[Place, ...]:
        """Return each segment with the model's own angles, from which a slide of millimetres tells no others."""
        sight, scenes = views[0].sight, [view.scene for view in views]
        some = () if sight is None else (name for name in scenes[0].tree.names if sight.on(name))
        return tuple(Place((name,), follows=Angle(dof)) for name in some for dof in cues(scenes, name))

    def slide(self, sight: Sight, place: Place, theta: Float[Tensor, " params"]) -> Slid:
        shift, turn = (sight.scene.turned(place.where[0], x) for x in theta.split(3))
        which = sight.on(place.where[0])
        arm = sight.p[list(which)] - sight.scene.state.at.p[sight.scene.at(place.where[0])]
        slid = shift + cross(turn.expand_as(arm), arm)
        return Slid(tuple(which), slid * bend(sight.scene, place)[0])

    def sway(self, sight: Sight, place: Place) -> Sway:
        which, eye = sight.on(place.where[0]), torch.eye(3).to(sight.p_BM_B)
        arm = sight.p_BM_B[list(which)].expand(3, -1, 3)
        ways = torch.cat([eye[:, None].expand_as(arm), torch.linalg.cross(eye[:, None].expand_as(arm), arm)])
        return Sway(Along(which, ways), bend(sight.scene, place)[:1], tuple((k, 0) for k in range(6)))

    def part_of(self, own: Place, effect: Effect, place: Place) -> Float[Tensor, "params 6"] | None:
        """Return its shift of each marker of a place of ``SoftTissue`` per parameter, in the segment's axes."""
        if not isinstance(effect, SoftTissue) or (own.where, own.follows) != (place.where, place.follows):
            return None
        eye = torch.eye(3).to(self.p_BM_B)
        arms = [self.p_BM_B[self.labels.index(label)] for label in place.markers]
        return torch.cat([torch.cat([eye, torch.linalg.cross(eye, p.expand(3, 3)).T], 1) for p in arms])


def cues(scenes: Sequence[Scene], segment: str) -> tuple[str, ...]:
    """The coordinates that skin of a segment may follow: at each end, the one of the joint that moves most."""
    tree = scenes[0].tree
    ends = [tree.index(segment), *(k for k, body in enumerate(tree.bodies) if body.parent == tree.index(segment))]
    return tuple(dict.fromkeys(dof for k in ends for dof in lively(scenes, k)[:1]))
