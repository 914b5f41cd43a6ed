"""Skin that slides over the bones: how much of it residuals show, and drawn slides that they would not tell apart.

A marker goes with the sine of the angle that moves most at either end of its segment, counted from its mean over the
session, which the marker's place has taken. Its own slide shows in its residual; all markers of a segment slide
together as well, which no residual shows (Grimpampi et al., IEEE Trans Biomed Eng 61:362 (2014)).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.effects.joint_angles import bend
from torchid.effects.markers import SkinSlide, cues
from torchid.effects.place import Angle, Place
from torchid.torque.seen import KEPT, SeenTrial

TOGETHER = 2.0
"""Times that all markers of a segment may slide as one; chosen, as the diagnosis does: on a thigh as much as against
each other (Grimpampi et al. 2014), or more (Barre et al., J Biomech 62:21 (2017))."""
TURN_PER_SHIFT = SkinSlide.parameters[1].scale / SkinSlide.parameters[0].scale
"""Turn of a segment's markers for each metre that they slide [rad/m]: that of the prior of the diagnosis."""


@dataclass(frozen=True)
class FollowedSkin:
    """Markers of one segment that follow one coordinate."""

    segment: str
    place: Place
    which: tuple[int, ...]
    mean: float
    """Of the sine of its angle over the session."""

    def course(self, trial: SeenTrial) -> Float[Tensor, " frames"]:
        """Return how far the coordinate is from its mean over the session, as a sine."""
        return bend(trial.response.sight.scene, self.place)[0] - self.mean


@dataclass(frozen=True)
class SkinDraws:
    """Slides drawn for every marker."""

    slides: tuple[FollowedSkin, ...]
    along: Float[Tensor, "draws slides markers 3"]
    """Of each marker in the axes of its segment, where the sine is one [m]; zero for markers of other segments."""

    def shift(self, trial: SeenTrial) -> Float[Tensor, "draws markers 3 frames"]:
        """Return the displacement of all markers in W [m]."""
        course = torch.stack([one.course(trial) for one in self.slides])
        local = torch.einsum("dsmi,st->dmit", self.along, course)
        sight = trial.response.sight
        return torch.stack([sight.turned(one) for one in local])


def find_slides(trials: Sequence[SeenTrial]) -> tuple[FollowedSkin, ...]:
    """Return which markers may follow which coordinates in a session."""
    sight, scenes = trials[0].response.sight, [trial.response.sight.scene for trial in trials]
    found = []
    for segment in scenes[0].tree.names:
        which = sight.on(segment)
        for dof in cues(scenes, segment) if which else ():
            place = Place((segment,), follows=Angle(dof))
            mean = torch.cat([bend(scene, place)[0] for scene in scenes]).mean()
            found.append(FollowedSkin(segment, place, which, float(mean)))
    return tuple(found)


def slide_size(slides: Sequence[FollowedSkin], trials: Sequence[SeenTrial]) -> float:
    """Return how far a marker slides by itself where the sine of its angle is one, the root mean square of all [m].

    Residuals, averaged over a tenth of a second, are regressed on the courses of their segment, trial by trial with a
    level of its own; what postures take of a slide is given back.

    Args:
        trials: whose residuals are looked at.
    """
    square, count = 0.0, 0
    for segment in dict.fromkeys(one.segment for one in slides):
        own = [one for one in slides if one.segment == segment]
        columns, rows = [], []
        for trial in trials:
            bands = trial.response.bands
            courses = torch.stack([one.course(trial)[bands.middle] for one in own], 1)
            R = trial.response.sight.scene.state.at.R[trial.response.sight.scene.at(segment)][..., bands.middle]
            error = bands.error.unflatten(1, (-1, 3))[:, list(own[0].which)]
            kept = bands.kept.view(-1, 3).mean(1)[list(own[0].which)].clamp(min=KEPT)
            local = torch.einsum("cit,tmi->tmc", R, error) / kept.sqrt()[:, None]
            columns.append(courses - courses.mean(0))
            rows.append((local - local.mean(0)).flatten(1))
        X, Y = torch.cat(columns), torch.cat(rows)
        slope = torch.linalg.lstsq(X, Y).solution
        square, count = square + float(slope.square().sum()), count + slope.numel()
    return (square / count) ** 0.5 if count else 0.0


def draw_skin(trials: Sequence[SeenTrial], count: int, generator: torch.Generator) -> SkinDraws:
    """Draw slides as large as the residuals of a session say that skin slides.

    Args:
        trials: of one body with the same markers, all that the slides are asked for in.
    """
    slides, sight = find_slides(trials), trials[0].response.sight
    size, places = slide_size(slides, trials), sight.p_BM_B
    most = SkinSlide.parameters[0].scale
    whole = min(TOGETHER * size, most)
    normal = lambda *shape: torch.randn(*shape, generator=generator, dtype=torch.float64).to(places)  # noqa: E731
    along = places.new_zeros(count, len(slides), len(places), 3)
    for k, one in enumerate(slides):
        p = places[list(one.which)]
        shift, turn = whole * normal(count, 1, 3), whole * TURN_PER_SHIFT * normal(count, 1, 3)
        together = shift + torch.linalg.cross(turn.expand(-1, len(p), -1), p.expand(count, -1, -1))
        along[:, k, list(one.which)] = together + min(size, most) * normal(count, len(p), 3)
    return SkinDraws(slides, along)
