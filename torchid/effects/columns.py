"""Columns of what plates read, by central differences of the effects themselves."""

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.effects.effect import Effect
from torchid.effects.place import Place
from torchid.effects.scene import Reading, Scene

STEP = 1e-3
"""Of the central differences, in prior standard deviations: exact for parameters that act linearly."""


def columns(
    effect: Effect, scene: Scene, reading: Reading, place: Place, theta: Float[Tensor, " params"] | None = None
) -> Float[Tensor, "6 params frames"]:
    """Change of the plates' total per internal parameter; scene and reading on one clock.

    Args:
        effect: which.
        scene: motion and inertia as estimated.
        reading: of the plates: as the effect found it, or left it if it is ``inverted``.
        place: where.
        theta: where to linearise; absent, where the effect is.
    """
    start = reading.wrench.new_zeros(effect.size(place)) if theta is None else theta
    found = reading.wrench.new_zeros(6, len(start), len(scene.time))
    if place.when is not None and all(own.trial != scene.trial for own in place.when):
        return found
    for k, scale in enumerate(effect.scale(place)):
        step = torch.zeros_like(start)
        step[k] = STEP * scale
        ahead = _total(effect, scene, reading, place, start + step)
        if theta is None and type(effect).read is Effect.read:
            # Absent, it loads nothing: half the work of central differences.
            found[:, k] = ahead / (STEP * scale)
        else:
            found[:, k] = (ahead - _total(effect, scene, reading, place, start - step)) / (2.0 * STEP * scale)
    return found


def _total(effect: Effect, scene: Scene, reading: Reading, place: Place, theta: Tensor) -> Tensor:
    """Only what the effect has a say in: most of a catalogue's cost are loads."""
    found = reading.wrench.new_zeros(6, len(scene.time))
    if type(effect).load is not Effect.load:
        found = found + effect.load(scene, place, theta)
    if effect.inverted:
        return found - effect.undone(reading, place, theta).total
    return found if type(effect).read is Effect.read else found + effect.read(reading, place, theta).total
