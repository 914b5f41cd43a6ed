"""What every recording has a little of: integrated out, never named."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.effects.displacement import below
from torchid.effects.effect import Effect, Parameter
from torchid.effects.joint_angles import bend
from torchid.effects.marker_scene import Along, Sight, Slid, Sway, View
from torchid.effects.markers import MarkerEffect, MarkerShift, SoftTissue, cues
from torchid.effects.place import Angle, Place
from torchid.effects.plates import PlateDrift, PlateOffset
from torchid.effects.scene import Scene
from torchid.geometry.result import GeometryFit
from torchid.kinematics.recursion import cross
from torchid.model.model import GeometryPrior
from torchid.observation.trial import TrialObservation


@dataclass(frozen=True)
class GeometryError(Effect):
    """Joint centres and axes elsewhere than identified, within their prior."""

    prior: GeometryPrior

    name = "geometry_error"
    moves_markers = True

    def places(self, views: Sequence[View]) -> tuple[Place, ...]:
        return (Place(("session",)),)

    def size(self, place: Place) -> int:
        return len(self.prior.mean)

    def scale(self, place: Place) -> tuple[float, ...]:
        return tuple(self.prior.sd.tolist())

    def move(self, scene: Scene, place: Place, theta: Float[Tensor, " params"]) -> Float[Tensor, "bodies 6 frames"]:
        """Offsets move all that hangs on a joint along the parent's axes; hinge angles turn it about their axes."""
        raw, plan, at = self.prior.map @ theta, scene.state.plan, scene.state.at
        offset, hinge = raw[: self.prior.n_offset].view(-1, 3), raw[self.prior.n_offset :]
        moved = at.p.new_zeros(len(plan.order), 6, at.p.shape[2])
        for k in offset.abs().sum(1).nonzero()[:, 0].tolist():
            body = scene.tree.bodies[k]
            shift = scene.turned(scene.tree.names[body.parent], offset[k])
            moved[:, :3] += below(scene, body.name)[:, None, None] * shift
        for column, axis in zip(plan.hinges, at.hinge_axis, strict=True):
            if float(hinge[column.row]) != 0.0:
                turn = hinge[column.row] * axis
                inside = below(scene, scene.tree.names[column.body])[:, None, None]
                arm = at.p - at.p[plan.position[column.body]]
                moved[:, :3] += inside * cross(turn.expand_as(arm), arm)
                moved[:, 3:] += inside * turn
        return moved


@dataclass(frozen=True)
class SkinSlide(MarkerEffect):
    """All markers of a segment slide as one with the angle of a neighbouring joint: no residual shows it.

    The pose of the bone errs by as much, and the needed wrench with it. What a person's skin does is of the order of
    its prior (Cappozzo et al. 1996, Clin Biomech 11:90; Camomilla et al. 2017, J Biomech 62:5).
    """

    labels: tuple[str, ...]
    p_BM_B: Float[Tensor, "markers 3"]

    name = "skin_slide"
    parameters = (Parameter("shift_m", 0.005, 3), Parameter("turn_rad", 0.03, 3))

    def places(self, views: Sequence[View]) -> tuple[Place, ...]:
        """With the model's own angles: what is of a few millimetres is not told from others."""
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
        """By how much it shifts each marker of a place of ``soft_tissue``, in the segment's axes."""
        if not isinstance(effect, SoftTissue) or (own.where, own.follows) != (place.where, place.follows):
            return None
        eye = torch.eye(3).to(self.p_BM_B)
        arms = [self.p_BM_B[self.labels.index(label)] for label in place.markers]
        return torch.cat([torch.cat([eye, torch.linalg.cross(eye, p.expand(3, 3)).T], 1) for p in arms])


PLATES = ((PlateOffset(), 0.1), (PlateDrift(), 0.02))
"""Small errors that every plate has, part of their priors as effects: 0.5 N and the 0.01 N/s that charge amplifiers are
sold with are nobody's discovery. With 0.025 N/s usual on three other plates, 0.25 N/s had an sd of a third."""


def nuisances(
    observed: Sequence[TrialObservation], fit: GeometryFit | None
) -> Iterator[tuple[Effect, Place, tuple[float, ...], tuple[float, ...]]]:
    """Effect, place, and mean and standard deviation of its parameters."""
    views = [w.view for w in observed]
    for effect, share in PLATES:
        for place in effect.places(views):
            yield effect, place, (0.0,) * effect.size(place), tuple(share * s for s in effect.scale(place))
    if fit is None or observed[0].response is None:
        return
    n = len(fit.prior.mean)
    away = fit.prior.mean - fit.xi[:n]
    yield GeometryError(fit.prior), Place(("session",)), tuple(away.tolist()), tuple(fit.prior.sd.tolist())
    away = fit.attachment.mean - fit.place
    for k, label in enumerate(fit.attachment.labels):
        yield MarkerShift(), Place((label,)), tuple(away[k].tolist()), tuple(fit.attachment.sd[k].tolist())
    skin = SkinSlide(fit.attachment.labels, fit.place)
    for place in skin.places(views):
        yield skin, place, (0.0,) * skin.size(place), skin.scale(place)
