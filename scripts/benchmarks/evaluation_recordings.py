"""Recordings of one person whose trials differ as trials do, and for no other reason.

Pace, depth, stance, arms, noise, zeros of the plates and places of the markers are drawn for every trial, and every
cycle within it. Nothing drifts: an effect of order is a true difference of conditions recorded one after the other.
"""

from dataclasses import replace

import numpy as np
import torch

from torchid.simulate.balance import balance
from torchid.simulate.motions import make_script
from torchid.simulate.noise import MOMENT_ARM
from torchid.simulate.options import SimulateOptions
from torchid.simulate.subject import SimulatedSubject
from torchid.simulate.trial import SimulatedTrial, impossible, measure, record, with_margins

PACE_SD, DEPTH_SD = 0.08, 0.08
"""Choice. Scatter of the pace and of the depth of a whole trial, in proportion."""
PLACED_M = 0.001
"""Choice. Scatter of every marker's place from trial to trial [m]: straps slip, markers are put on again."""
ZERO_N = 2.0
"""Choice. Scatter of the plates' zero from trial to trial [N]; of moments, ``MOMENT_ARM`` times that."""
EASIER, ATTEMPTS = 0.07, 12
"""Choice. As in ``torchid.simulate.trial``: how much easier a motion is made that cannot be done, and how often."""


def perform(
    subject: SimulatedSubject, movement: str, options: SimulateOptions, key: tuple[int, ...], name: str
) -> SimulatedTrial:
    """One trial as the person does it this time, and as cameras and plates read it this time; ``key`` is of chance.

    Raises:
        RuntimeError: no attempt was in balance.
    """
    rng, frames = np.random.default_rng(key), with_margins(options.duration_s, options.rate_hz)
    pace, depth = 1.0 + np.array([PACE_SD, DEPTH_SD]) * rng.normal(size=2).clip(-2.0, 2.0)
    placed = subject.p_BM_B + PLACED_M * torch.as_tensor(rng.normal(size=subject.p_BM_B.shape))
    person = replace(subject, trial=name, p_BM_B=placed)
    for attempt in range(ATTEMPTS):
        own, effort = np.random.default_rng((*key, attempt)), float(depth) * (1.0 - EASIER * attempt)
        script = make_script(movement, own, person, pace * frames, float(pace) * options.duration_s, effort)
        script = replace(script, time=frames)
        moving = balance(person, script, options.rate_hz)
        if not impossible(person, moving):
            break
    else:
        raise RuntimeError(f"{name}: a person who cannot do {movement}: {impossible(person, moving)}")
    item = measure(person, record(person, script, moving, options), options, rng)
    assert item.trial.forces is not None
    return replace(item, trial=replace(item.trial, forces=replace(
        item.trial.forces, wrench=item.trial.forces.wrench + _zeros(item, rng)
    )))  # fmt: skip


def _zeros(item: SimulatedTrial, rng: np.random.Generator) -> torch.Tensor:
    """What every plate (plates, 6) reads of nothing in a trial."""
    assert item.trial.forces is not None
    centre = torch.stack([p.corners.mean(0) for p in item.trial.forces.plates if p.corners is not None])
    force, moment = (ZERO_N * torch.as_tensor(rng.normal(size=(len(centre), 3))) for _ in range(2))
    return torch.cat([force, MOMENT_ARM * moment + torch.linalg.cross(centre, force)], 1)
