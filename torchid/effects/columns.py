"""Columns of what plates read, by central differences of the effects themselves."""

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.effects.effect import Effect
from torchid.effects.kinds import LoadEffect, ReadingEffect
from torchid.effects.place import Place
from torchid.effects.scene import Reading, Scene
from torchid.kinematics.recursion import SMALL

STEP = 1e-3
"""Resolution. Step of the central differences, in prior standard deviations: exact for parameters that act linearly."""

MANY = 8
"""Resolution. Number of parameters from which on plates are read with all of them at once, which takes longer for
a few."""


def columns(
    effect: Effect, scene: Scene, reading: Reading, place: Place, theta: Float[Tensor, " params"] | None = None
) -> Float[Tensor, "6 params frames"]:
    """Change of the plates' total wrench about the origin of W per unit of each internal parameter.

    Args:
        effect: one that acts on loads or readings.
        scene: motion and inertia as estimated.
        reading: what the plates bore, or, if the effect ``reads_measured``, what they read; on the scene's clock.
        place: where the effect sits.
        theta: parameters at which to linearise; None: where the effect is absent.
    """
    start = reading.wrench.new_zeros(effect.size(place)) if theta is None else theta
    if place.when is not None and all(own.trial != scene.trial for own in place.when):
        return reading.wrench.new_zeros(6, len(start), len(reading.wrench))
    step = STEP * start.new_tensor(effect.scale(place))
    ahead = start + step.diag()
    if theta is None and not isinstance(effect, ReadingEffect):
        # An absent load is zero: half the work of central differences.
        change = _totals(effect, scene, reading, place, ahead)
    else:
        behind = start - step.diag()
        change = 0.5 * torch.sub(*_totals(effect, scene, reading, place, torch.cat([ahead, behind])).split(len(step)))
    return (change / step[:, None, None]).transpose(0, 1)


def _totals(
    effect: Effect, scene: Scene, reading: Reading, place: Place, thetas: Float[Tensor, "ways params"]
) -> Float[Tensor, "ways 6 frames"]:
    """The plates' total for each row of parameters, all at once where there are many and the trial is short.

    Of a long one each alone is as quick, and its cross products are made in place, which ``vmap`` cannot.
    """
    if len(thetas) < MANY or 3 * len(reading.wrench) >= SMALL:
        return torch.stack([_total(effect, scene, reading, place, theta) for theta in thetas])
    return torch.vmap(lambda theta: _total(effect, scene, reading, place, theta))(thetas)


def _total(effect: Effect, scene: Scene, reading: Reading, place: Place, theta: Tensor) -> Tensor:
    """The part of the plates' total that the effect has a say in, for one vector of parameters."""
    found = reading.wrench.new_zeros(6, len(reading.wrench))
    if isinstance(effect, LoadEffect):
        found = found + effect.load(scene, place, theta)
    if effect.reads_measured:
        return found - effect.undone(reading, place, theta).total
    return found + effect.read(reading, place, theta).total if isinstance(effect, ReadingEffect) else found
