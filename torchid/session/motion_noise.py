"""What the noise of markers is in the regressor of the inertial fit, by motions under other draws of it."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.dynamics.rows import WrenchTrial
from torchid.dynamics.whitening import BlockSpectrum, Whitening, accumulate, spectrum
from torchid.effects.scene import make_scene
from torchid.observation.noise_draws import draw_noise
from torchid.observation.trial import make_response
from torchid.session.outcome import Outcome

DRAWS = 8
"""Resolution. Of each block: the gram of its noise is known to a few parts in a hundred then."""
MOST_FRAMES = 8192
"""Resolution. Frames of a session whose noise is drawn; where more count, blocks of them stand for all."""


@dataclass(frozen=True)
class MotionNoise:
    """Noise in the regressors of a session, as differences between draws and what was found."""

    blocks: tuple[BlockSpectrum, ...]
    """Differences of all draws."""
    share: float
    """What each of them counts."""

    def __call__(self, whitening: Whitening) -> Float[Tensor, "params params"]:
        """Return their expected gram.

        Args:
            whitening: of the rows.
        """
        return self.share * accumulate(self.blocks, whitening).gram


def motion_noise(outcome: Outcome) -> MotionNoise | None:
    """Return the noise in the regressors of the trials that the inertia is fitted to; None without any rows.

    Args:
        outcome: up to the motion.
    """
    each = (outcome.followed[name].wrench for name in outcome.session.fit("inertia"))
    every = [(rows, block) for rows in each if rows is not None for block in rows.blocks()]
    if not every:
        return None
    counted = sum(block.stop - block.start for _, block in every)
    some = every[:: -(-counted // MOST_FRAMES)]
    drawn = sum(block.stop - block.start for _, block in some)
    found = tuple(one for rows, block in some for one in _differences(outcome, rows, block))
    return MotionNoise(found, counted / drawn / DRAWS)


def _differences(outcome: Outcome, rows: WrenchTrial, block: slice) -> Iterator[BlockSpectrum]:
    """Regressors of a block under draws of the noise, less what was found, moments about the same point of the root."""
    fit, item, smoother = outcome.fit, outcome.followed[rows.name], rows.motion.smoother
    margin = round(rows.rate / smoother.cutoff_hz)  # the filter knows both sides
    around = slice(max(block.start - margin, 0), block.stop + margin)
    inner = slice(block.start - around.start, block.stop - around.start)
    own = rows.frames(around)
    # Blocks of a trial draw by its name: each has one.
    name = f"{rows.name} {block.start}"
    scene = make_scene(name, rows.tree, rows.geometry, own.motion, outcome.prior.mean)
    markers = outcome.right(rows.name).markers.frames(around)
    response = make_response(scene, fit, markers, item.tracked.frames(around))
    Y, F = own.rows(inner)
    for motion in islice(draw_noise(own.motion, response), DRAWS):
        drawn, _ = WrenchTrial(name, rows.tree, rows.geometry, motion, own.wrench, own.used).rows(inner)
        away = (motion.q - own.motion.q)[inner, :3].T
        drawn[3:] += torch.linalg.cross(away[:, None].expand_as(drawn[:3]), drawn[:3], dim=0)
        yield spectrum(drawn - Y, torch.zeros_like(F), rows.rate, smoother.cutoff_hz)
