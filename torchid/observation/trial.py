"""One trial as the diagnosis sees it."""

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import islice

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchid.dynamics import wrench_about
from torchid.effects.marker_scene import Sight, View
from torchid.effects.scene import PlateFrame, Reading, Scene, make_scene, reading
from torchid.geometry.result import GeometryFit
from torchid.geometry.tracking import Tracked, modelled
from torchid.geometry.trial_problem import posture_prior
from torchid.kinematics.plan import plan_tree
from torchid.motion import Motion
from torchid.observation.marker_response import MarkerResponse
from torchid.observation.noise_budget import NoiseBudget, loudness, make_noise_budget
from torchid.observation.noise_draws import DRAWS, LOUD_DRAWS, MOST_DRAWS, draw_noise
from torchid.observation.unloaded_plates import LOADED, UnloadedPlates, find_unloaded
from torchid.recording import Forces, Markers
from torchid.regressor.rows import WrenchTrial, measured, runs
from torchid.regressor.whitening import white_scatter

ENDS = 0.6
"""Periods of the cut-off from an end of the clock within which no column is trusted: those of displacements are second
derivatives of what a filter knows from one side only. A landing's last frames made a filter's lag out of 13 kN."""
OVER_CUTOFF = 6.0
"""Frames per second over the cut-off that are enough: products of a column, which has up to twice the motion's
frequencies, with noise that has no more than 1.2 of the cut-off."""
ENOUGH = 50
"""Frames that tell the noise of a plate that bears nothing."""


@dataclass(frozen=True)
class NoiseDraw:
    """The same under another draw of the markers' noise."""

    motion: Motion
    total: Float[Tensor, "6 frames"]
    """What the draw adds to the wrench that the identified body needs, about the root's origin."""


@dataclass(frozen=True)
class TrialObservation:
    """One trial: its rows, what effects can change in it, and its markers."""

    rows: WrenchTrial
    view: View
    phi: Float[Tensor, "bodies 10"]
    """As identified without any effect."""
    scatter: Float[Tensor, " 6"]
    """Noise of the plates' total per frame about the root's origin [N, N m], before the filter."""
    unloaded: UnloadedPlates
    raw: Float[Tensor, "frames 3"]
    """The plates' total force before the filter [N]."""
    response: MarkerResponse | None = None

    @cached_property
    def inertial(self) -> Float[Tensor, "6 params frames"]:
        """Columns of the inertia about the root's origin."""
        return self.rows.rows(slice(None))[0]

    def needed(self, phi: Float[Tensor, " params"]) -> Float[Tensor, "frames 6"]:
        """Wrench about the root's origin that a body needs."""
        return (phi @ self.inertial).T

    @cached_property
    def identified(self) -> Float[Tensor, "frames 6"]:
        """Wrench about the root's origin that the identified body needs."""
        return self.needed(self.phi.reshape(-1))

    @cached_property
    def noise_draws(self) -> tuple[NoiseDraw, ...]:
        """Draw by draw, the more the louder the noise; none where no camera shows it."""
        if self.response is None:
            return ()
        draws = (self._shaken(motion) for motion in draw_noise(self.rows.motion, self.response))
        first = tuple(islice(draws, DRAWS))
        loud = loudness(self.rows, self._needed_about_root, [one.total.T for one in first])
        wanted = round(min(LOUD_DRAWS * loud, MOST_DRAWS))
        return (*first, *islice(draws, max(0, wanted - DRAWS)))

    def _shaken(self, motion: Motion) -> NoiseDraw:
        (needed,) = self.under(motion).needed_by(self.phi)
        return NoiseDraw(motion, (wrench_about(needed.T, self.rows.motion.q[:, :3]) - self.identified).T)

    def under(self, motion: Motion) -> Scene:
        """The scene, had another motion been found.

        Made again whenever it is asked for: to keep those of all draws took 4 GB of new memory, and longer.
        """
        rows, scene = self.rows, self.view.scene
        found = make_scene(rows.name, rows.tree, rows.geometry, motion, scene.phi)
        return replace(found, recorded_kg=scene.recorded_kg)

    @property
    def thinning(self) -> int:
        """Of how many frames one is enough for what a motion and a draw of its noise have in common."""
        return max(1, int(self.rows.rate / (OVER_CUTOFF * self.rows.motion.smoother.cutoff_hz)))

    @cached_property
    def thinned(self) -> "TrialObservation":
        """With as few frames as that."""
        part = slice(None, None, self.thinning)
        rows = self.rows.frames(part)
        reading, measured = self.view.reading.samples(part), self.view.measured.samples(part)
        view = replace(self.view, scene=self.under(rows.motion), reading=reading, measured=measured)
        if self.response is None:
            return replace(self, rows=rows, view=view)
        response = self.response.frames(part, view.scene)
        return replace(self, rows=rows, view=replace(view, sight=response.sight), response=response)

    def bore(self, scene: Scene) -> Reading:
        """What the plates bore by the model in a scene."""
        return _borne(self.view.measured, *(needed.T for needed in scene.needed_by(scene.phi, self.phi)))

    @property
    def _needed_about_root(self) -> Float[Tensor, "frames 6"]:
        return wrench_about(self.view.scene.needed().T, self.rows.motion.q[:, :3])

    @cached_property
    def noise_budget(self) -> NoiseBudget | None:
        """What noise makes of the wrench; None where no camera shows that of the markers."""
        if self.response is None:
            return None
        left = measured(self.rows) - self.identified
        return make_noise_budget(
            self.rows, self._needed_about_root, [one.total.T for one in self.noise_draws], self.scatter, left
        )


@dataclass(frozen=True)
class BodyEstimate:
    """What is known of the body before and after its inertia was fitted."""

    prior: Float[Tensor, "bodies 10"]
    """Where effects are linearised: a fit without an effect has swallowed part of it."""
    phi: Float[Tensor, "bodies 10"]
    recorded_kg: float
    """Mass of the body before any force was seen."""


def observe_trial(
    rows: WrenchTrial,
    forces: Forces,
    measured: Bool[Tensor, " frames"],
    frames: tuple[PlateFrame, ...],
    known: BodyEstimate,
    seen: tuple[GeometryFit, Markers, Tracked] | None = None,
) -> TrialObservation:
    """A followed trial as the diagnosis sees it.

    Args:
        rows: motion and total wrench.
        forces: of its plates, raw, on the clock of the motion.
        measured: frames whose wrench is on plates.
        frames: of its plates.
        known: inertia.
        seen: geometry, markers and how they were followed; None: nothing is asked of the markers.
    """
    rows = _inner(rows)
    scene = make_scene(rows.name, rows.tree, rows.geometry, rows.motion, known.prior)
    raw = reading(rows.name, forces, frames)
    smooth = rows.motion.smoother(raw.wrench, measured.to(torch.float64))
    scene = replace(scene, recorded_kg=known.recorded_kg)
    read = replace(raw, time=rows.motion.time, wrench=smooth)
    view = View(scene, _borne(read, *(x.T for x in scene.needed_by(known.prior, known.phi))), read)
    root = rows.motion.q[:, None, :3].expand(*raw.wrench.shape[:2], 3)
    scatter = _scatter(wrench_about(raw.wrench, root), raw.wrench[..., 2])
    unloaded = find_unloaded(replace(raw, time=rows.motion.time), rows.rate)
    force = raw.wrench.sum(1)[:, :3]
    if seen is None:
        return TrialObservation(rows, view, known.phi, scatter, unloaded, force)
    response = _cameras(scene, *seen)
    return TrialObservation(rows, replace(view, sight=response.sight), known.phi, scatter, unloaded, force, response)


def _inner(rows: WrenchTrial) -> WrenchTrial:
    margin = round(ENDS / rows.motion.smoother.cutoff_hz * rows.rate)
    used = rows.used.clone()
    used[:margin] = used[len(used) - margin :] = False
    return replace(rows, used=used)


def _cameras(scene: Scene, fit: GeometryFit, markers: Markers, tracked: Tracked) -> MarkerResponse:
    position = markers.select(fit.attachment.labels).position.to(fit.xi)
    seen = torch.isfinite(position).all(2)
    error = torch.where(seen[:, :, None], position - modelled(fit, tracked.q), 0.0)
    body = torch.tensor(plan_tree(fit.model.tree).position, device=fit.xi.device)[fit.attachment.body]
    sight = Sight(scene, fit.attachment.labels, body, fit.place)
    weight = (seen / fit.sigma.square()).T.contiguous()
    return MarkerResponse(sight, weight, error.permute(1, 2, 0).contiguous(), posture_prior(fit).precision[:, 0])


def _borne(measured: Reading, prior: Float[Tensor, "frames 6"], needed: Float[Tensor, "frames 6"]) -> Reading:
    """What the plates bore: their readings, the model's residual taken off in proportion to their loads.

    Readings hold the noise that the total holds. As columns they would explain it by itself: an unloaded plate was
    found to gain 30 %.

    Args:
        measured: what they read.
        prior: what the motion needs of a body of tables, and ...
        needed: ... of the identified one, about the origin of W.
    """
    read = measured.wrench
    load = read[..., 2:3].clamp(min=0.0) * (read[..., 2:3] > LOADED)
    share = load / load.sum(1, keepdim=True).clamp(min=LOADED)
    read = read * (load > 0.0)
    bore = read - share * (read.sum(1) - needed)[:, None]
    return replace(measured, wrench=bore, unborne=prior - bore.sum(1))


def _scatter(read: Float[Tensor, "frames plates 6"], load: Float[Tensor, "frames plates"]) -> Float[Tensor, " 6"]:
    """Of the total, plates independent: each as it is while it bears nothing, or as in the rest of the trial."""
    found = []
    for k in range(read.shape[1]):
        unloaded = [part for part in runs(load[:, k].abs() < LOADED) if part[1] - part[0] >= ENOUGH]
        longest = max(unloaded, key=lambda part: part[1] - part[0], default=(0, len(read)))
        found.append(white_scatter(read[slice(*longest), k]).square())
    return torch.stack(found).sum(0).sqrt()
