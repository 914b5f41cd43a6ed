"""One trial as cameras see it: markers on bodies."""

import math
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass
from functools import cached_property

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchid.conventions import GRAVITY
from torchid.effects.scene import Reading, Scene
from torchid.kinematics.recursion import cross


@dataclass(frozen=True)
class Sight:
    """Markers of one trial where the bodies carry them."""

    scene: Scene
    labels: tuple[str, ...]
    body: Int[Tensor, " markers"]
    """Plan position of the body that carries each."""
    p_BM_B: Float[Tensor, "markers 3"]
    soft: Float[Tensor, " markers"] | None = None
    """Softness of the flesh that the motion was seen through: the way of the markers under 1 g [m]; None: the motion
    is that of bones."""

    @cached_property
    def p(self) -> Float[Tensor, "markers 3 frames"]:
        """p_WM_W [m]."""
        return self.scene.state.at.p[self.body] + self.turned(self.p_BM_B[:, :, None])

    @cached_property
    def a(self) -> Float[Tensor, "markers 3 frames"]:
        """Accelerations in W of the bones under them [m/s^2]."""
        motion, arm = self.scene.state.motion, self.p - self.scene.state.at.p[self.body]
        w, alpha = motion.w[self.body], motion.alpha[self.body]
        a = motion.a[self.body] + cross(alpha, arm) + cross(w, cross(w, arm))
        return a if self.soft is None else _beneath(a, self.soft, self.scene.rate)

    def turned(
        self, b: Float[Tensor, "some 3 #frames"], which: Sequence[int] | None = None
    ) -> Float[Tensor, "some 3 frames"]:
        """Vectors b in the axes of the bodies that carry some markers, or all, turned to W: R_WB b."""
        R = self.scene.state.at.R[self.body if which is None else self.body[list(which)]]
        return (R * b[:, :, None]).sum(1)

    def on(self, segment: str) -> tuple[int, ...]:
        """Numbers of the markers that a segment carries."""
        return tuple((self.body == self.scene.at(segment)).nonzero()[:, 0].tolist())

    def carried(self, bodies: Float[Tensor, "*columns bodies 6 frames"]) -> Float[Tensor, "*columns markers 3 frames"]:
        """Return the way on which bodies that are displaced [m] and turned [rad] in W take their markers [m]."""
        own = bodies.index_select(-3, self.body)
        arm = (self.p - self.scene.state.at.p[self.body]).expand_as(own[..., :3, :])
        return own[..., :3, :] + cross(own[..., 3:, :], arm)


def _beneath(
    a: Float[Tensor, "markers 3 frames"], soft: Float[Tensor, " markers"], rate_hz: float
) -> Float[Tensor, "markers 3 frames"]:
    """Accelerations [m/s^2] of bones that carry markers on springs.

    Args:
        a: of the markers.
        soft: how far 1 g stretches the spring of each [m].
        rate_hz: frames per second.
    """
    spectrum = torch.fft.rfft(torch.cat([a, a.flip(2)], 2))
    w = 2.0 * math.pi * torch.fft.rfftfreq(2 * a.shape[2], 1.0 / rate_hz).to(a)
    return torch.fft.irfft(spectrum / (1.0 + soft[:, None, None] / GRAVITY * w.square()))[..., : a.shape[2]]


@dataclass(frozen=True)
class Slid:
    """Markers that cameras see elsewhere than the bodies carry them."""

    which: tuple[int, ...]
    by: Float[Tensor, "some 3 frames"]
    """Displacement in W [m]."""


@dataclass(frozen=True)
class Along:
    """Markers displaced by units along the axes of their segments, in some ways."""

    which: tuple[int, ...]
    ways: Float[Tensor, "ways some 3"] | None = None
    """Displacements of the markers in each way; None: each marker along each axis."""


@dataclass(frozen=True)
class CarriedMarkers:
    """Bodies displaced with their markers by units, in some ways."""

    key: Hashable
    """Equal for equal ways, whatever their courses."""
    bodies: Callable[[], Float[Tensor, "ways bodies 6 frames"]]


@dataclass(frozen=True)
class Sway:
    """A displacement in fixed ways that comes and goes."""

    ways: Along | CarriedMarkers
    courses: Float[Tensor, "courses frames"]
    pairs: tuple[tuple[int, int], ...]
    """Way and course of which each parameter is the coefficient."""


@dataclass(frozen=True)
class View:
    """All that effects can change in one trial."""

    scene: Scene
    reading: Reading
    """Wrenches that the plates bore by the model: the readings' noise in columns would explain that of the total."""
    measured: Reading
    """Wrenches that they read, through the same filter."""
    sight: Sight | None = None
    """None where no markers are at hand."""

    def read(self, as_measured: bool) -> Reading:
        """The reading that columns are made of: what was measured, for effects with ``reads_measured``."""
        return self.measured if as_measured else self.reading
