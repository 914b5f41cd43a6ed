"""Everything that could be hidden: every effect at every place, as columns beside those of the inertia."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from torchid.dynamics import wrench_about
from torchid.effects.effect import Effect, Place, columns
from torchid.effects.plates import PlateDrift, PlateOffset
from torchid.effects.scene import PlateFrame, Reading, Scene, make_scene, reading
from torchid.recording import Forces
from torchid.regressor.rows import WrenchTrial

NUISANCE = ((PlateOffset(), 0.2), (PlateDrift(), 0.1))
"""Small errors that every plate has, part of their priors as effects: 1 N and 0.05 N/s are nobody's discovery."""
LOADED = 20.0
"""Vertical force below which a plate bears nothing [N]."""


@dataclass(frozen=True)
class Watched:
    """One trial: its rows, its bodies and what its plates read, all through the same filter."""

    rows: WrenchTrial
    scene: Scene
    reading: Reading


@dataclass(frozen=True)
class Candidate:
    """An effect at a place and its columns in the design."""

    effect: Effect
    place: Place
    columns: slice


@dataclass(frozen=True)
class Design:
    """Columns of all candidates, behind the inertia's and the nuisances'."""

    inertia: int
    """Number of inertial parameters."""
    base: int
    """Number of columns of inertia and nuisances."""
    candidates: tuple[Candidate, ...]
    scale: Float[Tensor, " more"]
    """Prior standard deviations of everything behind the inertia."""
    extra: tuple[Float[Tensor, "6 more frames"], ...]
    """Per trial."""
    nuisances: tuple[Candidate, ...]

    @property
    def all(self) -> tuple[Candidate, ...]:
        """Whose columns ``extra`` holds, in their order."""
        return (*self.nuisances, *self.candidates)

    def columns(self, chosen: Sequence[Candidate]) -> Int[Tensor, " columns"]:
        """Of the model with these effects."""
        behind = [k for c in chosen for k in range(c.columns.start, c.columns.stop)]
        return torch.tensor([*range(self.base), *behind])


def watch(
    rows: WrenchTrial,
    forces: Forces,
    measured: Bool[Tensor, " frames"],
    frames: tuple[PlateFrame, ...],
    phi: Float[Tensor, "bodies 10"],
    recorded_kg: float,
) -> Watched:
    """A followed trial as the diagnosis sees it.

    Args:
        rows: motion and total wrench.
        forces: of its plates, raw, on the clock of the motion.
        measured: frames whose wrench is on plates.
        frames: of its plates.
        phi: inertia at which effects are linearised.
        recorded_kg: mass of the body before any force was seen.
    """
    scene = make_scene(rows.name, rows.tree, rows.geometry, rows.motion, phi)
    scene = replace(scene, recorded_kg=recorded_kg)
    raw = reading(rows.name, forces, frames)
    smooth = rows.motion.smoother(raw.wrench, measured.to(torch.float64))
    return Watched(rows, scene, replace(raw, time=rows.motion.time, wrench=_borne(smooth, scene.needed().T)))


def _borne(
    read: Float[Tensor, "frames plates 6"], needed: Float[Tensor, "frames 6"]
) -> Float[Tensor, "frames plates 6"]:
    """What the plates bore: their readings, the model's residual taken off in proportion to their loads.

    Readings hold the noise that the total holds. As columns they would explain it by itself: an unloaded plate was
    found to gain 30 %.
    """
    load = read[..., 2:3].clamp(min=0.0) * (read[..., 2:3] > LOADED)
    share = load / load.sum(1, keepdim=True).clamp(min=LOADED)
    read = read * (load > 0.0)
    return read - share * (read.sum(1) - needed)[:, None]


def make_design(watched: Sequence[Watched], effects: Sequence[Effect]) -> Design:
    """Columns of every effect at every place, trial by trial."""
    scenes, readings = [w.scene for w in watched], [w.reading for w in watched]
    inertia = watched[0].scene.phi.numel()
    small = [(e, place, share) for e, share in NUISANCE for place in e.places(scenes, readings)]
    tried = [(e, place, 1.0) for e in effects for place in e.places(scenes, readings)]
    at, candidates = inertia, []
    for effect, place, _ in (*small, *tried):
        candidates.append(Candidate(effect, place, slice(at, at + effect.size)))
        at += effect.size
    scale = [share * s for effect, _, share in (*small, *tried) for s in effect.scale]
    return Design(
        inertia,
        candidates[len(small)].columns.start if tried else at,
        tuple(candidates[len(small) :]),
        scenes[0].phi.new_tensor(scale),
        tuple(extra_columns(w, candidates) for w in watched),
        tuple(candidates[: len(small)]),
    )


def extra_columns(watched: Watched, candidates: Sequence[Candidate]) -> Float[Tensor, "6 more frames"]:
    """Columns about the root's origin."""
    found = torch.cat([columns(c.effect, watched.scene, watched.reading, c.place) for c in candidates], 1)
    point = watched.rows.motion.q[:, :3]
    return wrench_about(found.permute(1, 2, 0), point.expand(found.shape[1], -1, -1)).permute(2, 0, 1)
