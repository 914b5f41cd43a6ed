"""Other bodies that the same session would allow: geometry by its posterior, skin, and inertia as it follows from both.

The inertia's own posterior holds geometry and skin still. Its rows are made anew with every draw, and the Gaussian fit
repeated on them; so a drawn body is one that markers and plates agree with as well as with the one published.

A marker goes with the sine of the angle that moves most at either end of its segment, counted from its mean over the
session, which the marker's place has taken. Its own slide over the bones shows in its residual; all markers of a
segment slide together as well, which no residual shows (Grimpampi et al., IEEE Trans Biomed Eng 61:362 (2014)).
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from operator import add

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.dynamics.row_equations import NormalEquations
from torchid.dynamics.whitening import accumulate, spectra
from torchid.effects.joint_angles import bend
from torchid.effects.markers import SkinSlide, cues
from torchid.effects.place import Angle, Place
from torchid.geometry.result import GeometryFit
from torchid.inertia.fit import InertiaFit
from torchid.inertia.identify import Identified
from torchid.inertia.spectrum import diagonalise
from torchid.model.model import Geometry
from torchid.torque.seen import KEPT, SeenTrial, by_body, shifted

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


@dataclass(frozen=True)
class BodyDraws:
    """Bodies drawn about the one that was identified."""

    xi: Float[Tensor, "draws xi"]
    """Geometry and marker places [m, rad]."""
    skin: SkinDraws
    phi: Float[Tensor, "draws bodies 10"]
    """Inertial parameters [kg, kg m, kg m^2]; Gaussian, without the bounds of what is physical."""


def draw_bodies(
    fit: GeometryFit,
    identified: Identified | None,
    phi: Float[Tensor, "bodies 10"],
    trials: Sequence[SeenTrial],
    count: int,
    generator: torch.Generator,
    mass: tuple[float, float] | None = None,
) -> BodyDraws:
    """Draw bodies from what is known of geometry and inertia together.

    Args:
        fit: geometry with its uncertainty; without one all draws have the fit's.
        identified: inertia with its covariance; None: it is taken as known.
        phi: inertia that is published.
        trials: all that anything is asked of; those that the inertia was identified on have rows.
        mass: total mass and its standard deviation [kg] that the inertial fit held to.
    """
    xi = fit.xi.expand(count, -1) + _normal(
        None if fit.uncertainty is None else fit.uncertainty.covariance, fit.xi, count, generator
    )
    skin = draw_skin(trials, count, generator)
    if identified is None:
        return BodyDraws(xi, skin, phi.expand(count, *phi.shape))
    own = _normal(identified.of_rows, phi, count, generator).view(count, *phi.shape)
    fitted = [trial for trial in trials if trial.rows is not None]
    moved = _inertia_of(fit, identified, fitted, xi, skin, mass) if fitted else torch.zeros_like(own)
    return BodyDraws(xi, skin, phi + own + moved)


def _normal(covariance: Tensor | None, like: Tensor, count: int, generator: torch.Generator) -> Tensor:
    """Draws (count, n) of zero mean and this covariance, which may be singular."""
    if covariance is None:
        return like.new_zeros(count, like.numel())
    value, vector = torch.linalg.eigh(covariance)
    white = torch.randn(count, len(value), generator=generator, dtype=torch.float64).to(covariance)
    return white @ (vector * value.clamp(min=0.0).sqrt()).mT


def _inertia_of(
    fit: GeometryFit,
    identified: Identified,
    trials: Sequence[SeenTrial],
    xi: Float[Tensor, "draws xi"],
    skin: SkinDraws,
    mass: tuple[float, float] | None,
) -> Float[Tensor, "draws bodies 10"]:
    """How far the inertia moves with each geometry and skin."""
    each = [list(_equations(trial, fit, identified, xi, skin)) for trial in trials]
    first, *others = (_solved(reduce(add, own), identified.fit, mass) for own in zip(*each, strict=True))
    return torch.stack([one - first for one in others])


def _equations(
    trial: SeenTrial, fit: GeometryFit, identified: Identified, xi: Float[Tensor, "draws xi"], skin: SkinDraws
) -> Iterator[NormalEquations]:
    """Whitened sums of a trial with the fit's geometry, then with each draw of geometry and skin."""
    assert trial.rows is not None, "only trials with rows tell of the inertia"
    yield accumulate(spectra(trial.rows), identified.whitening)
    for one, by in zip(xi, by_body(trial, fit, list(xi), skin.shift(trial)), strict=True):
        geometry = geometry_of(fit, one)
        rows = replace(trial.rows, geometry=geometry, motion=shifted(trial.rows.motion, by))
        yield accumulate(spectra(rows), identified.whitening)


def geometry_of(fit: GeometryFit, xi: Float[Tensor, " xi"]) -> Geometry:
    """Return the geometry that an entry of ``BodyDraws.xi`` stands for."""
    return replace(fit, xi=xi).geometry


def _solved(equations: NormalEquations, fit: InertiaFit, mass: tuple[float, float] | None) -> Tensor:
    """Mean of the Gaussian problem under the weights of the fit, without the LMI."""
    prior = fit.prior
    spectrum = diagonalise(equations, prior.mean.reshape(-1), prior.covariance, mass)
    return spectrum.params(spectrum.solve(fit.omega_1, fit.omega_2)).view_as(prior.mean)
