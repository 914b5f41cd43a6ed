"""What a laboratory adds: noise, lost markers, moving skin."""

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from torchid.conventions import GRAVITY
from torchid.dynamics.equations_of_motion import dynamic_state
from torchid.motion.motion import Motion
from torchid.recording import Plate
from torchid.simulate.options import ANALOG_RATIO
from torchid.simulate.subject import SimulatedSubject

MOMENT_ARM = 0.2
"""Noise of a plate's moments about its centre against that of its forces [m]."""
BURST_S = (0.05, 0.40)
"""Length of a gap [s]."""
WHOLE_SEGMENT = 0.15
"""Part of the gaps in which a segment loses all its markers (occlusion)."""


def noisy_markers(
    rng: np.random.Generator, position: Float[Tensor, "frames markers 3"], sd: float
) -> Float[Tensor, "frames markers 3"]:
    """White noise of standard deviation ``sd`` [m] on every coordinate."""
    return position + sd * position.new_tensor(rng.normal(size=tuple(position.shape)))


def noisy_plates(
    rng: np.random.Generator, wrench: Float[Tensor, "samples plates 6"], plates: tuple[Plate, ...], sd: float
) -> Float[Tensor, "samples plates 6"]:
    """White noise on forces and on moments about each plate's centre; ``sd`` [N] of the mean over a marker frame."""
    force, moment = (
        sd * ANALOG_RATIO**0.5 * wrench.new_tensor(rng.normal(size=(*wrench.shape[:2], 3))) for _ in range(2)
    )
    centre = torch.stack([p.corners.mean(0) for p in plates if p.corners is not None]).to(wrench)
    return wrench + torch.cat([force, MOMENT_ARM * moment + torch.linalg.cross(centre.expand_as(force), force)], 2)


def lose_markers(
    rng: np.random.Generator,
    position: Float[Tensor, "frames markers 3"],
    segments: tuple[str, ...],
    fraction: float,
    rate: float,
) -> Float[Tensor, "frames markers 3"]:
    """Bursts of NaN until ``fraction`` of the samples is gone; some bursts hide all markers of a segment."""
    lost = np.zeros(tuple(position.shape[:2]), dtype=bool)
    while lost.mean() < fraction:
        start = int(rng.integers(-int(BURST_S[0] * rate), len(lost)))
        stop = start + max(1, int(rng.uniform(*BURST_S) * rate))
        marker = int(rng.integers(lost.shape[1]))
        whole = rng.random() < WHOLE_SEGMENT
        columns = [k for k, s in enumerate(segments) if k == marker or (whole and s == segments[marker])]
        lost[max(start, 0) : stop, columns] = True
    return torch.where(torch.as_tensor(lost)[:, :, None], torch.nan, position)


def skin_shift(subject: SimulatedSubject, motion: Motion, size: float) -> Float[Tensor, "frames markers 3"]:
    """Shift of every marker on its segment, in the segment's axes [m].

    Cues of a segment: its own joint's angles, those of the joint below (sines; none of them in the neutral pose), and
    the acceleration of its origin against gravity's. A cue of one (57 degrees, 1 g) shifts a thigh marker by
    about ``size``.
    """
    cues = skin_cues(subject, motion)
    shift = [size * cues[segment] @ subject.skin[k].T for k, segment in enumerate(subject.segments)]
    return torch.stack(shift, 1)


def skin_cues(subject: SimulatedSubject, motion: Motion) -> dict[str, Float[Tensor, "frames 9"]]:
    """Cues of every segment: three of its joint, three of the joint below, three accelerations in body axes."""
    tree = subject.model.tree
    columns = (x.T.contiguous() for x in (motion.q, motion.v, motion.a))
    state = dynamic_state(tree, subject.geometry, *columns)
    found = {}
    for k, body in enumerate(tree.bodies):
        place = state.plan.position[k]
        below = [child for child in tree.bodies if child.parent == k]
        rows = [[t.row for t in b.turns if t.moving] for b in (body, *below[:1])]
        R = state.at.R[place].permute(2, 1, 0)
        own = (R.mT @ state.motion.a[place].T[:, :, None])[:, :, 0] / GRAVITY
        angles = [torch.sin(_padded(motion.q, row)) for row in rows]
        angles += [torch.zeros_like(angles[0])] * (2 - len(angles))
        found[body.name] = torch.cat([*angles, own], 1)
    return found


def _padded(q: Tensor, rows: list[int]) -> Float[Tensor, "frames 3"]:
    out = q.new_zeros(len(q), 3)
    out[:, : len(rows)] = q[:, rows]
    return out
