"""Effects on the whole session: where gravity points, ground that moves, clocks that disagree."""

import math
from collections.abc import Sequence

import numpy as np
import scipy.interpolate
import scipy.linalg
import torch
from jaxtyping import Float
from torch import Tensor

from torchid.conventions import GRAVITY
from torchid.effects.effect import Effect, Parameter, value_of
from torchid.effects.marker_scene import Sight, Slid, View
from torchid.effects.place import Place, covers
from torchid.effects.scene import Reading, Scene, at_origin
from torchid.filters import Smoother

SESSION = Place(("session",))
SHAKES = tuple(0.3 + 0.02 * k for k in range(286))
"""Frequencies at which ground that moves is looked for [Hz]."""


class GravityTilt(Effect):
    """The axes of the cameras do not stand upright: a horizontal force in proportion to the weight.

    The true vertical is the z axis of W pitched about y, then rolled about x.
    """

    name = "gravity_tilt"
    parameters = (Parameter("roll_rad", 0.02), Parameter("pitch_rad", 0.02))

    def places(self, views: Sequence[View]) -> tuple[Place, ...]:
        return (SESSION,)

    def load(self, scene: Scene, place: Place, theta: Float[Tensor, " params"]) -> Float[Tensor, "6 frames"]:
        roll, pitch = theta
        up = torch.stack([torch.sin(pitch), -torch.sin(roll) * torch.cos(pitch), torch.cos(roll) * torch.cos(pitch)])
        change = GRAVITY * (up - theta.new_tensor([0.0, 0.0, 1.0]))
        return at_origin(scene.centre_of_mass, (scene.mass * change)[:, None].expand(3, len(scene.time)))


class MovingGround(Effect):
    """Laboratory and cameras shake together (a ship, a platform): an inertial force on all mass.

    Internal are the amplitudes of sine and cosine along x, y, z at the frequency of the place's grid, in every trial
    anew: nobody knows the phase at which a recording begins.
    """

    name = "moving_ground"
    parameters = (Parameter("sine_m_s2", 0.3, 3), Parameter("cosine_m_s2", 0.3, 3))
    per_trial = True

    def places(self, views: Sequence[View]) -> tuple[Place, ...]:
        return tuple(Place(("session",), grid={"frequency_hz": f}) for f in SHAKES)

    def period_s(self, place: Place) -> float:
        return 1.0 / place.grid["frequency_hz"]

    def load(self, scene: Scene, place: Place, theta: Float[Tensor, " params"]) -> Float[Tensor, "6 frames"]:
        sine, cosine = self.split(theta)
        phase = 2.0 * math.pi * place.grid["frequency_hz"] * scene.time
        course = scene.passed(place.grid["frequency_hz"], lambda: torch.stack([torch.sin(phase), torch.cos(phase)]))
        shake = torch.stack([sine, cosine], 1) @ course
        return at_origin(scene.centre_of_mass, scene.mass * shake)

    def named(self, place: Place, theta: Float[Tensor, " params"]) -> dict[str, Tensor]:
        return {
            "rms_m_s2": (0.5 * theta.view(-1, 6).square().sum(1).mean()).sqrt(),
            "frequency_hz": theta.new_tensor(place.grid["frequency_hz"]),
        }

    def internal(self, place: Place, values: dict[str, Tensor]) -> Float[Tensor, " params"]:
        """An upward shake without a stated direction."""
        if "rms_m_s2" not in values:
            return super().internal(place, values)
        theta = torch.zeros(self.size(SESSION), dtype=torch.float64)
        theta[2] = math.sqrt(2.0) * torch.as_tensor(values["rms_m_s2"])
        return theta


class FilterLag(Effect):
    """The markers were low-passed before anybody saw them: accelerations come out too small, the more the faster.

    A second-order Butterworth filter run both ways. Internal is its cut-off to the power of -4: what it took away of
    the markers as they are read is that times the fourth derivative, exactly. Read markers it is the columns' task to
    explain; true ones are filtered.
    """

    name = "filter_lag"
    parameters = (Parameter("slowness", 5e-4, positive=True),)
    moves_markers = True

    def places(self, views: Sequence[View]) -> tuple[Place, ...]:
        return (SESSION,)

    def slide(self, sight: Sight, place: Place, theta: Float[Tensor, " params"]) -> Slid:
        """The filter as (1 + theta D^4)^-1 with D^4 a stencil of five frames, places and slopes at the ends held.

        Local, so that ends matter near the ends only: as a series of sines, a trial that ends in motion had columns
        of thousands of newtons there, and of 20 N half a second before.
        """
        p = sight.p
        flat, n = p.flatten(0, 1).T.cpu().numpy(), p.shape[2]
        weight = float(theta[0]) * (sight.scene.rate / (2.0 * math.pi)) ** 4
        band = weight * np.repeat(np.array([1.0, -4.0, 6.0, -4.0, 1.0])[:, None], n, 1)
        # Column j of a row is the matrix' entry (j + row - 2, j): the two rows at either end are those of the identity.
        for row in range(5):
            at = np.arange(n) + row - 2
            band[row, (at < 2) | (at > n - 3)] = 0.0
        band[2] += 1.0
        slid = torch.as_tensor(scipy.linalg.solve_banded((2, 2), band, flat) - flat).to(p)
        return Slid(tuple(range(len(p))), slid.T.reshape(p.shape))

    def named(self, place: Place, theta: Float[Tensor, " params"]) -> dict[str, Tensor]:
        return {"cutoff_hz": theta[0].clamp(min=1e-12) ** -0.25}

    def internal(self, place: Place, values: dict[str, Tensor]) -> Float[Tensor, " params"]:
        return value_of(values, self.name, "cutoff_hz", 1) ** -4

    def trusted(
        self, added: Float[Tensor, "frames 6"], rate_hz: float, place: Place, theta: Float[Tensor, " params"]
    ) -> Float[Tensor, "frames 6"]:
        return Smoother(TRUSTED * float(self.named(place, theta)["cutoff_hz"]), rate_hz)(added)


TRUSTED = 0.6
"""Part of the cut-off up to which motion is restored: there, 0.9 of an amplitude came through. Markers that slide on
the skin show harmonics of fast motion that no force has; all frequencies restored, a held-out error of 4 N became 10 N.
"""


class TimeOffset(Effect):
    """Cameras and plates disagree about when: forces come late by a lag, in all trials or in one."""

    name = "time_offset"
    shifts_time = reads_measured = True
    parameters = (Parameter("lag_s", 0.01),)

    def places(self, views: Sequence[View]) -> tuple[Place, ...]:
        """Cables and triggers seldom change within a session: all single trials together are a fifth as likely."""
        single = tuple(Place((view.scene.trial,), odds=0.2 / len(views)) for view in views)
        return (SESSION, *single) if len(views) > 1 else (SESSION,)

    def source(self, place: Place) -> tuple[Place, tuple[str, ...] | None]:
        return SESSION, None if place.where == SESSION.where else place.where

    def read(self, reading: Reading, place: Place, theta: Float[Tensor, " params"]) -> Reading:
        if not covers(place, reading.trial):
            return reading
        time, lag = reading.time.cpu().numpy(), float(theta[0])
        flat = reading.wrench.flatten(1).cpu().numpy()
        late = scipy.interpolate.make_interp_spline(time, flat, k=3)(np.clip(time - lag, time[0], time[-1]))
        wrench = torch.as_tensor(late, dtype=reading.wrench.dtype, device=reading.wrench.device)
        return Reading(reading.trial, reading.time, wrench.reshape(reading.wrench.shape), reading.frames)
