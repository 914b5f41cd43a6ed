"""One trial as witnesses see it: plates as they were read, and where the centre of mass went."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from torchid.contact.contact import Contact
from torchid.conventions import LOADED_N
from torchid.effects.effect import Effect
from torchid.effects.marker_scene import View
from torchid.effects.place import Place
from torchid.effects.scene import Reading, Scene

STRETCH_M = 0.05
"""Estimator. How far a pressure moves under a sole as easily as its force changes by all that it bears [m]: a quarter
of a sole's length, a choice."""


@dataclass(frozen=True)
class Watched:
    """One trial with forces, on the clock of the markers."""

    scene: Scene
    """Motion of the body, with the inertia of tables."""
    reading: Reading
    """Plates as they were read, unfiltered."""
    measured: Bool[Tensor, " frames"]
    """Frames whose whole wrench is on plates and whose motion is known."""
    centre: Float[Tensor, "frames 3"]
    """Centre of mass in W, by the inertia of tables [m]."""
    feet: tuple[str, ...] = ()
    """Names of the feet."""
    soles: Float[Tensor, "feet frames 2 3"] | None = None
    """Heel and tip of each sole in W [m]."""
    foot_on: Int[Tensor, "frames plates"] | None = None
    """Number of the contact that each plate bears, those of ``feet`` first and others behind them; negative: none, or
    none alone."""

    @property
    def name(self) -> str:
        """Name of the trial."""
        return self.scene.trial

    @property
    def view(self) -> View:
        """The trial as effects see it."""
        return View(self.scene, self.reading, self.reading)

    @property
    def rate(self) -> float:
        """Frames per second."""
        return self.scene.rate

    def under(self, effect: Effect, place: Place, theta: Float[Tensor, " params"]) -> "Watched":
        """Return the trial as its plates would have read it, had an effect been there too.

        What the ground must supply besides is read by the plates in proportion to what they bear.

        Args:
            effect: one that acts on loads or readings.
            place: where it sits.
            theta: internal parameters.
        """
        read = effect.read(self._loaded(effect.load(self.scene, place, theta)), place, theta)
        return self if read is self.reading else replace(self, reading=read)

    def without(self, effect: Effect, place: Place, theta: Float[Tensor, " params"]) -> "Watched":
        """Return the trial as its plates would have read it, had an effect not been there.

        Args:
            effect: one that acts on loads or readings.
            place: where it sits.
            theta: internal parameters.
        """
        right = replace(self, reading=effect.undone(self.reading, place, theta))
        return replace(right, reading=right._loaded(-effect.load(self.scene, place, theta)))

    def _loaded(self, load: Float[Tensor, "6 frames"]) -> Reading:
        """Return the reading with a further load shared by the plates."""
        if not bool(load.any()):
            return self.reading
        share = torch.einsum("fpij,jf->fpi", self._shares, load)
        return replace(self.reading, wrench=self.reading.wrench + share)

    @cached_property
    def _shares(self) -> Float[Tensor, "frames plates 6 6"]:
        """What each plate bears of a further load, see ``shares``."""
        return shares(self.reading)


def shares(reading: Reading) -> Float[Tensor, "frames plates 6 6"]:
    """Return what each plate bears of a further load of all, force [N] and moment about the origin [N m] in W.

    How legs share it cannot be known; it is shared as springs would that yield in proportion to what each plate bears:
    two feet answer a moment that tips the body by their vertical forces, not by rolling over their edges.

    Args:
        reading: of the plates as it was.
    """
    wrench = reading.wrench
    borne = wrench[..., 2] * (wrench[..., 2] > LOADED_N)
    force = borne.clamp(min=LOADED_N)
    px, py = -wrench[..., 4] / force, wrench[..., 3] / force
    zero = torch.zeros_like(px)
    arm = torch.stack([zero, zero, py, zero, zero, -px, -py, px, zero], -1).unflatten(-1, (3, 3))
    eye = torch.eye(3, dtype=wrench.dtype, device=wrench.device).expand_as(arm)
    moment = arm @ arm.mT + STRETCH_M**2 * eye
    yields = torch.cat([torch.cat([eye, arm.mT], -1), torch.cat([arm, moment], -1)], -2) * borne[..., None, None]
    whole = yields.sum(1) + torch.diag_embed((borne.sum(1, keepdim=True) == 0.0).to(wrench).expand(-1, 6))
    return yields @ torch.linalg.inv(whole)[:, None]


def watch(
    scene: Scene,
    reading: Reading,
    measured: Bool[Tensor, " frames"],
    soles: Mapping[str, Float[Tensor, "frames points 3"]],
    contact: Contact,
) -> Watched:
    """Return a trial as witnesses see it.

    Args:
        scene: its motion, with the inertia of tables.
        reading: of its plates, unfiltered, on the clock of the motion.
        measured: frames whose whole wrench is on plates and whose motion is known.
        soles: points of each foot's sole in W, the heel first and the tip last.
        contact: of these feet.
    """
    centre = scene.centre_of_mass.T.contiguous()
    if not contact.feet:
        return Watched(scene, reading, measured, centre)
    ends = torch.stack([soles[foot][:, [0, -1]] for foot in contact.feet])
    # A foot that stands where no plate reads it may be on this one, too: then it bears none alone.
    astray = contact.beside.any(1) | contact.unread.any(1)
    alone = torch.where(astray[:, None], -2, contact.plate)
    return Watched(scene, reading, measured, centre, contact.feet, ends, alone)


def longest_stretch(measured: Bool[Tensor, " frames"], frames: int) -> slice:
    """Return the stretch of a trial in which most frames are measured; all of it where it is no longer.

    Args:
        measured: frames whose whole wrench is known.
        frames: its length.
    """
    if len(measured) <= frames:
        return slice(0, len(measured))
    before = torch.nn.functional.pad(measured.long().cumsum(0), (1, 0))
    first = int((before[frames:] - before[:-frames]).argmax())
    return slice(first, first + frames)
