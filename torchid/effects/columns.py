"""Columns of what plates read, by central differences of the effects themselves."""

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.effects.effect import Effect
from torchid.effects.place import Place
from torchid.effects.scene import Reading, Scene

STEP = 1e-3
"""Of the central differences, in prior standard deviations: exact for parameters that act linearly."""

MANY = 8
"""Ways to read a plate from which on they are read together: a few take longer so."""


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
    if place.when is not None and all(own.trial != scene.trial for own in place.when):
        return reading.wrench.new_zeros(6, len(start), len(reading.wrench))
    step = STEP * start.new_tensor(effect.scale(place))
    ahead = start + step.diag()
    if theta is None and type(effect).read is Effect.read:
        # Absent, it loads nothing: half the work of central differences.
        change = _totals(effect, scene, reading, place, ahead)
    else:
        behind = start - step.diag()
        change = 0.5 * torch.sub(*_totals(effect, scene, reading, place, torch.cat([ahead, behind])).split(len(step)))
    return (change / step[:, None, None]).transpose(0, 1)


def _totals(
    effect: Effect, scene: Scene, reading: Reading, place: Place, thetas: Float[Tensor, "ways params"]
) -> Float[Tensor, "ways 6 frames"]:
    """All at once where there are many: one by one, the 30 leaks of a plate took five times as long."""
    if len(thetas) < MANY:
        return torch.stack([_total(effect, scene, reading, place, theta) for theta in thetas])
    return torch.vmap(lambda theta: _total(effect, scene, reading, place, theta))(thetas)


def _total(effect: Effect, scene: Scene, reading: Reading, place: Place, theta: Tensor) -> Tensor:
    """Only what the effect has a say in: most of a catalogue's cost are loads."""
    found = reading.wrench.new_zeros(6, len(reading.wrench))
    if type(effect).load is not Effect.load:
        found = found + effect.load(scene, place, theta)
    if effect.reads_measured:
        return found - effect.undone(reading, place, theta).total
    return found if type(effect).read is Effect.read else found + effect.read(reading, place, theta).total
