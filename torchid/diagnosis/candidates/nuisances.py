"""Small errors that every recording has are nuisances: they are integrated out and never named."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import final

from jaxtyping import Float
from torch import Tensor

from torchid.effects.catalogue import CATALOGUE
from torchid.effects.displacement import below
from torchid.effects.effect import Effect
from torchid.effects.kinds import DisplacedBodies
from torchid.effects.marker_scene import View
from torchid.effects.markers import SkinSlide
from torchid.effects.place import SESSION, Place
from torchid.effects.scene import Scene
from torchid.geometry.result import GeometryFit
from torchid.kinematics.recursion import cross
from torchid.model.model import GeometryPrior
from torchid.observation.trial import TrialObservation

Nuisance = tuple[Effect, Place, tuple[float, ...], tuple[float, ...]]
"""Effect, place, and mean and standard deviation of its parameters there."""


@final
@dataclass(frozen=True)
class GeometryError(DisplacedBodies):
    """Joint centres and axes elsewhere than identified, within their prior."""

    prior: GeometryPrior
    """Prior of the geometry, in whose parameters the error is."""

    name = "geometry_error"

    def places(self, views: Sequence[View]) -> tuple[Place, ...]:
        """Return the session: geometry is the same in all trials."""
        return (SESSION,)

    def scale(self, place: Place) -> tuple[float, ...]:
        """Return the standard deviations of the geometry's prior."""
        return tuple(self.prior.sd.tolist())

    def move(self, scene: Scene, place: Place, theta: Float[Tensor, " params"]) -> Float[Tensor, "bodies 6 frames"]:
        """Return the displacement of the bodies' origins [m] and their rotation [rad] in W by a change of the geometry.

        Offsets move all that hangs on a joint along the parent's axes; hinge angles turn it about their axes.

        Args:
            scene: motion of the trial.
            place: the session.
            theta: change of the prior's parameters.
        """
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


def nuisances(observed: Sequence[TrialObservation], fit: GeometryFit | None) -> Iterator[Nuisance]:
    """Yield small errors of plates; then, where cameras are at hand, of geometry, of markers' places and of skin.

    Args:
        observed: trials.
        fit: geometry that they were tracked with; None: no error of it is asked for.
    """
    views = [one.view for one in observed]
    seen = fit if observed[0].response is not None else None
    yield from _ordinary(views, seen, moving_markers=False)
    if seen is None:
        return
    away = seen.prior.mean - seen.xi[: len(seen.prior.mean)]
    yield GeometryError(seen.prior), SESSION, tuple(away.tolist()), tuple(seen.prior.sd.tolist())
    yield from _ordinary(views, seen, moving_markers=True)
    skin = SkinSlide(seen.attachment.labels, seen.place)
    for place in skin.places(views):
        yield skin, place, (0.0,) * skin.size(place), skin.scale(place)


def _ordinary(views: Sequence[View], fit: GeometryFit | None, moving_markers: bool) -> Iterator[Nuisance]:
    """Yield what effects of the catalogue say that every recording has of them."""
    for effect in CATALOGUE.values():
        if effect.moves_markers is moving_markers:
            for own in effect.ordinary(views, fit):
                yield effect, own.place, own.mean, own.sd
