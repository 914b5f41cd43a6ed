"""What the noise of markers is in the regressor of the inertial fit, by motions under other draws of it."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import islice

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.dynamics.rows import WrenchTrial
from torchid.dynamics.whitening import BlockSpectrum, Whitening, accumulate, spectra
from torchid.effects.scene import make_scene
from torchid.observation.noise_draws import draw_noise
from torchid.observation.trial import make_response
from torchid.session.outcome import Outcome

DRAWS = 8
"""Resolution. Of each piece: the gram of its noise is known to a few parts in a hundred then."""
MOST_FRAMES = 4096
"""Resolution. Frames of a trial whose noise is drawn; of longer ones, pieces of it stand for all."""
PIECES = 8
"""Resolution. Number of these."""


@dataclass(frozen=True)
class MotionNoise:
    """Noise in the regressors of some trials, as differences between draws and what was found."""

    pieces: tuple[tuple[tuple[BlockSpectrum, ...], float], ...]
    """Differences of all draws of a part of a trial, and what each counts."""

    def __call__(self, whitening: Whitening) -> Float[Tensor, "params params"]:
        """Return their expected gram.

        Args:
            whitening: of the rows.
        """
        return torch.stack([share * accumulate(blocks, whitening).gram for blocks, share in self.pieces]).sum(0)


def motion_noise(outcome: Outcome) -> MotionNoise | None:
    """Return the noise in the regressors of the trials that the inertia is fitted to; None without any rows.

    Args:
        outcome: up to the motion.
    """
    found = []
    for name in outcome.session.fit("inertia"):
        rows = outcome.followed[name].wrench
        if rows is not None:
            found += _of_trial(outcome, rows)
    return MotionNoise(tuple(found)) if found else None


def _of_trial(outcome: Outcome, rows: WrenchTrial) -> Iterator[tuple[tuple[BlockSpectrum, ...], float]]:
    fit, item = outcome.fit, outcome.followed[rows.name]
    markers, parts = outcome.right(rows.name).markers, [one for one in _parts(rows) if _counted(_inside(rows, *one))]
    share = _counted(rows) / max(sum(_counted(_inside(rows, *one)) for one in parts), 1) / DRAWS
    for part, inner in parts:
        own = _inside(rows, part, inner)
        scene = make_scene(rows.name, rows.tree, rows.geometry, own.motion, outcome.prior.mean)
        response = make_response(scene, fit, markers.frames(part), item.tracked.frames(part))
        found, drawn = list(spectra(own)), []
        for motion in islice(draw_noise(own.motion, response), DRAWS):
            for before, after in zip(found, spectra(replace(own, motion=motion)), strict=True):
                drawn.append(replace(before, Y=after.Y - before.Y, F=torch.zeros_like(before.F)))
        yield tuple(drawn), share


def _parts(rows: WrenchTrial) -> list[tuple[slice, slice]]:
    """All of a trial, or pieces of a long one, evenly over it; and the frames inside, where the filter knows both
    sides."""
    frames = len(rows.used)
    if frames <= MOST_FRAMES:
        return [(slice(0, frames), slice(0, frames))]
    length, margin = MOST_FRAMES // PIECES, round(rows.rate / rows.motion.smoother.cutoff_hz)
    starts = torch.linspace(0, frames - length, PIECES).round().int().tolist()
    return [(slice(max(start - margin, 0), start + length + margin), slice(start, start + length)) for start in starts]


def _inside(rows: WrenchTrial, part: slice, inner: slice) -> WrenchTrial:
    """Some frames of a trial, of which those inside count."""
    used = torch.zeros_like(rows.used)
    used[inner] = rows.used[inner]
    return replace(rows, used=used).frames(part)


def _counted(rows: WrenchTrial) -> int:
    return sum(part.stop - part.start for part in rows.blocks())
