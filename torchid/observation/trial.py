"""One trial as the diagnosis sees it: its rows, what effects can change in it, its markers, and their noise."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import islice

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchid.conventions import LOADED_N
from torchid.dynamics.equations_of_motion import wrench_about
from torchid.dynamics.rows import WrenchTrial, measured
from torchid.dynamics.whitening import white_scatter
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
from torchid.observation.options import ObservationOptions
from torchid.observation.unloaded_plates import UnloadedPlates, find_unloaded
from torchid.recording import Forces, Markers
from torchid.runs import runs
from torchid.storage.snapshot import in_memory

OVER_CUTOFF = 6.0
"""Resolution. Frames per second over the cut-off that are enough: products of a column, which has up to twice the
motion's frequencies, with noise that has no more than 1.2 of the cut-off."""


@dataclass(frozen=True)
class NoiseDraw:
    """The motion under another draw of the markers' noise, and the wrench that this changes."""

    motion: Motion
    """Motion as it would have been found."""
    total: Float[Tensor, "6 frames"]
    """Change of the wrench that the identified body needs, about the root's origin [N, N m]."""


@dataclass(frozen=True)
class TrialObservation:
    """One trial: its rows, what effects can change in it, and its markers."""

    rows: WrenchTrial
    """Motion and measured wrench through the same filter; its used frames are those that the diagnosis may use."""
    view: View
    """Scene, readings of plates and markers, as effects see them."""
    phi: Float[Tensor, "bodies 10"]
    """Inertial parameters as identified without any effect [kg, kg m, kg m^2]."""
    scatter: Float[Tensor, " 6"]
    """Standard deviation of the noise of the plates' total per frame about the root's origin, before the filter [N, N
    m]."""
    unloaded: UnloadedPlates
    """Readings of plates while they bear nothing."""
    raw: Float[Tensor, "frames 3"]
    """Total force of the plates before the filter [N]."""
    response: MarkerResponse | None = None
    """Markers of the trial; None where no camera is at hand."""
    room: Callable[[Sequence[int]], Tensor] = in_memory
    """Makes zeros of a shape for what takes most memory, to be filled; by default they lie in memory."""
    as_measured: bool = False
    """True where columns are taken as they are, whatever noise is in them: as the inertial fit takes them."""

    @cached_property
    def inertial(self) -> Float[Tensor, "6 params frames"]:
        """Columns of the inertial parameters about the root's origin [N, N m per unit parameter]."""
        return self.rows.rows(slice(None))[0]

    def needed(self, phi: Float[Tensor, " params"]) -> Float[Tensor, "frames 6"]:
        """Return the wrench about the root's origin that a body needs [N, N m].

        Args:
            phi: inertial parameters of the bodies, one after the other.
        """
        return (phi @ self.inertial).T

    @cached_property
    def identified(self) -> Float[Tensor, "frames 6"]:
        """Wrench about the root's origin that the identified body needs [N, N m]."""
        return self.needed(self.phi.reshape(-1))

    @cached_property
    def noise_draws(self) -> tuple[NoiseDraw, ...]:
        """Draws of the markers' noise, the more of them the louder the noise is; none where no camera shows it."""
        if self.response is None:
            return ()
        draws = (self._drawn(motion) for motion in draw_noise(self.rows.motion, self.response))
        first = tuple(islice(draws, DRAWS))
        loud = loudness(self.rows, self._needed_about_root, [one.total.T for one in first])
        wanted = round(min(LOUD_DRAWS * loud, MOST_DRAWS))
        return (*first, *islice(draws, max(0, wanted - DRAWS)))

    def _drawn(self, motion: Motion) -> NoiseDraw:
        """Return a motion as a draw, with the change of the needed wrench."""
        (needed,) = self.under(motion).needed_by(self.phi)
        return NoiseDraw(motion, (wrench_about(needed.T, self.rows.motion.q[:, :3]) - self.identified).T)

    def under(self, motion: Motion) -> Scene:
        """Return the scene as it would be, had another motion been found.

        It is made again whenever it is asked for, because the scenes of all draws take more memory than is worth
        keeping.
        """
        rows, scene = self.rows, self.view.scene
        found = make_scene(rows.name, rows.tree, rows.geometry, motion, scene.phi)
        return replace(found, recorded_kg=scene.recorded_kg)

    @property
    def thinning(self) -> int:
        """Number of frames of which one is enough for products of a motion's columns with a draw of its noise."""
        return max(1, int(self.rows.rate / (OVER_CUTOFF * self.rows.motion.smoother.cutoff_hz)))

    @cached_property
    def thinned(self) -> "TrialObservation":
        """The trial with one frame of every ``thinning``."""
        part = slice(None, None, self.thinning)
        rows = self.rows.frames(part)
        reading, measured = self.view.reading.samples(part), self.view.measured.samples(part)
        view = replace(self.view, scene=self.under(rows.motion), reading=reading, measured=measured)
        if self.response is None:
            return replace(self, rows=rows, view=view)
        response = self.response.frames(part, view.scene)
        return replace(self, rows=rows, view=replace(view, sight=response.sight), response=response)

    def bore(self, scene: Scene) -> Reading:
        """Return the wrenches that the plates bore by the model in a scene, about the origin of W [N, N m]."""
        return _borne(self.view.measured, *(needed.T for needed in scene.needed_by(scene.phi, self.phi)))

    @property
    def _needed_about_root(self) -> Float[Tensor, "frames 6"]:
        """Return the wrench that the prior's body needs, about the root's origin."""
        return wrench_about(self.view.scene.needed().T, self.rows.motion.q[:, :3])

    @cached_property
    def noise_budget(self) -> NoiseBudget | None:
        """Energy that noise has in the wrench, band by band; None where no camera shows that of the markers, or it is
        not asked for."""
        if self.response is None or self.as_measured:
            return None
        left = measured(self.rows) - self.identified
        return make_noise_budget(
            self.rows, self._needed_about_root, [one.total.T for one in self.noise_draws], self.scatter, left
        )


@dataclass(frozen=True)
class BodyEstimate:
    """Inertial parameters of the body before and after they were fitted."""

    prior: Float[Tensor, "bodies 10"]
    """Parameters before the fit [kg, kg m, kg m^2], at which effects are linearised: a fit without an effect has
    swallowed part of it."""
    phi: Float[Tensor, "bodies 10"]
    """Parameters as identified without any effect."""
    recorded_kg: float
    """Mass of the body as recorded before any force was seen [kg]."""


def observe_trial(
    rows: WrenchTrial,
    forces: Forces,
    measured: Bool[Tensor, " frames"],
    frames: tuple[PlateFrame, ...],
    known: BodyEstimate,
    seen: tuple[GeometryFit, Markers, Tracked] | None = None,
    options: ObservationOptions = ObservationOptions(),
    ends: Motion | None = None,
) -> TrialObservation:
    """Return a tracked trial as the diagnosis sees it.

    Args:
        rows: motion and total wrench of the trial.
        forces: readings of its plates, unfiltered, on the clock of the motion.
        measured: frames whose wrench is on plates.
        known: inertia before and after the fit.
        seen: geometry, markers and the coordinates that follow them; None: nothing is asked of the markers.
        options: thresholds of what is believed.
        ends: first and last frame of what was searched, where this is another part of the trial (``Scene.span``).
    """
    rows = _inner(rows, options.ends_periods)
    scene = make_scene(rows.name, rows.tree, rows.geometry, rows.motion, known.prior)
    raw = reading(rows.name, forces, frames)
    if ends is not None:
        scene = replace(scene, ends=make_scene(rows.name, rows.tree, rows.geometry, ends, known.prior))
        raw = replace(raw, begin=float(ends.time[0]))
    smooth = rows.motion.smoother(raw.wrench, measured.to(torch.float64))
    scene = replace(scene, recorded_kg=known.recorded_kg)
    zeroed = None if raw.zeroed is None else rows.motion.smoother(raw.zeroed, measured.to(torch.float64))
    read = replace(raw, time=rows.motion.time, wrench=smooth, zeroed=zeroed)
    view = View(scene, _borne(read, *(x.T for x in scene.needed_by(known.prior, known.phi))), read)
    root = rows.motion.q[:, None, :3].expand(*raw.wrench.shape[:2], 3)
    scatter = _scatter(wrench_about(raw.wrench, root), raw.wrench[..., 2], options.noise_frames)
    unloaded = find_unloaded(replace(raw, time=rows.motion.time), rows.rate, options)
    force = raw.wrench.sum(1)[:, :3]
    if seen is None:
        return TrialObservation(rows, view, known.phi, scatter, unloaded, force)
    response = make_response(scene, *seen)
    return TrialObservation(rows, replace(view, sight=response.sight), known.phi, scatter, unloaded, force, response)


def _inner(rows: WrenchTrial, periods: float) -> WrenchTrial:
    """Return the rows without the frames near the ends of the clock."""
    margin = round(periods / rows.motion.smoother.cutoff_hz * rows.rate)
    used = rows.used.clone()
    used[:margin] = used[len(used) - margin :] = False
    return replace(rows, used=used)


def make_response(scene: Scene, fit: GeometryFit, markers: Markers, tracked: Tracked) -> MarkerResponse:
    """Return the markers of a trial, with their distance from the fitted model."""
    position = markers.select(fit.attachment.labels).position.to(fit.xi)
    seen = torch.isfinite(position).all(2)
    error = torch.where(seen[:, :, None], position - modelled(fit, tracked.q), 0.0)
    body = torch.tensor(plan_tree(fit.model.tree).position, device=fit.xi.device)[fit.attachment.body]
    sight = Sight(scene, fit.attachment.labels, body, fit.place)
    weight = (seen / fit.sigma.square()).T.contiguous()
    return MarkerResponse(sight, weight, error.permute(1, 2, 0).contiguous(), posture_prior(fit).precision[:, 0])


def _borne(measured: Reading, prior: Float[Tensor, "frames 6"], needed: Float[Tensor, "frames 6"]) -> Reading:
    """Return what the plates bore: their readings, with the model's residual taken off in proportion to their loads.

    Readings hold the noise that the total holds, which columns made of them would explain by themselves.

    Args:
        measured: filtered readings.
        prior: wrench about the origin of W that the motion needs of a body of tables [N, N m].
        needed: wrench about the origin of W that the motion needs of the identified body [N, N m].
    """
    read = measured.wrench
    load = read[..., 2:3].clamp(min=0.0) * (read[..., 2:3] > LOADED_N)
    share = load / load.sum(1, keepdim=True).clamp(min=LOADED_N)
    read = read * (load > 0.0)
    bore = read - share * (read.sum(1) - needed)[:, None]
    return replace(measured, wrench=bore, unborne=prior - bore.sum(1))


def _scatter(
    read: Float[Tensor, "frames plates 6"], load: Float[Tensor, "frames plates"], frames: int
) -> Float[Tensor, " 6"]:
    """Return the standard deviation of the noise of the plates' total, plates being independent [N, N m].

    Args:
        read: readings about the root's origin.
        load: vertical force of each plate [N].
        frames: length of a run of unloaded frames from which a plate's noise is taken; without one, the whole trial is.
    """
    found = []
    for k in range(read.shape[1]):
        unloaded = [part for part in runs(load[:, k].abs() < LOADED_N) if part[1] - part[0] >= frames]
        longest = max(unloaded, key=lambda part: part[1] - part[0], default=(0, len(read)))
        found.append(white_scatter(read[slice(*longest), k]).square())
    return torch.stack(found).sum(0).sqrt()
