"""Effects on the whole session: where gravity points, ground that moves, clocks that disagree."""

import math
from collections.abc import Sequence

import numpy as np
import scipy.interpolate
import torch
from jaxtyping import Float
from torch import Tensor

from torchid.conventions import GRAVITY
from torchid.effects.effect import Effect, Parameter, Place, covers
from torchid.effects.scene import Reading, Scene, at_origin

SESSION = Place(("session",))
SHAKES = (0.5, 0.8, 1.2, 1.8, 2.7, 4.0, 6.0)
"""Frequencies at which ground that moves is looked for [Hz]."""


class GravityTilt(Effect):
    """The axes of the cameras do not stand upright: a horizontal force in proportion to the weight.

    The true vertical is the z axis of W pitched about y, then rolled about x.
    """

    name = "gravity_tilt"
    parameters = (Parameter("roll_rad", 0.02), Parameter("pitch_rad", 0.02))
    alike = ("plate_pose", "tether")

    def places(self, scenes: Sequence[Scene], readings: Sequence[Reading]) -> tuple[Place, ...]:
        return (SESSION,)

    def load(self, scene: Scene, place: Place, theta: Float[Tensor, " params"]) -> Float[Tensor, "6 frames"]:
        roll, pitch = theta
        up = torch.stack([torch.sin(pitch), -torch.sin(roll) * torch.cos(pitch), torch.cos(roll) * torch.cos(pitch)])
        change = GRAVITY * (up - theta.new_tensor([0.0, 0.0, 1.0]))
        return at_origin(scene.centre_of_mass, (scene.mass * change)[:, None].expand(3, len(scene.time)))


class MovingGround(Effect):
    """Laboratory and cameras shake together (a ship, a platform): an inertial force on all mass.

    Internal are the amplitudes of sine and cosine along x, y, z at the frequency of the place's grid.
    """

    name = "moving_ground"
    parameters = (Parameter("sine_m_s2", 0.3, 3), Parameter("cosine_m_s2", 0.3, 3))
    alike = ("unmeasured_contact",)

    def places(self, scenes: Sequence[Scene], readings: Sequence[Reading]) -> tuple[Place, ...]:
        return tuple(Place(("session",), grid={"frequency_hz": f}) for f in SHAKES)

    def load(self, scene: Scene, place: Place, theta: Float[Tensor, " params"]) -> Float[Tensor, "6 frames"]:
        sine, cosine = self.split(theta)
        phase = 2.0 * math.pi * place.grid["frequency_hz"] * scene.time
        shake = sine[:, None] * torch.sin(phase) + cosine[:, None] * torch.cos(phase)
        return at_origin(scene.centre_of_mass, scene.mass * shake)

    def named(self, place: Place, theta: Float[Tensor, " params"]) -> dict[str, Tensor]:
        return {
            "rms_m_s2": (0.5 * theta.square().sum()).sqrt(),
            "frequency_hz": theta.new_tensor(place.grid["frequency_hz"]),
        }

    def internal(self, place: Place, values: dict[str, Tensor]) -> Float[Tensor, " params"]:
        """An upward shake without a stated direction."""
        if "rms_m_s2" not in values:
            return super().internal(place, values)
        theta = torch.zeros(self.size, dtype=torch.float64)
        theta[2] = math.sqrt(2.0) * torch.as_tensor(values["rms_m_s2"])
        return theta


class TimeOffset(Effect):
    """Cameras and plates disagree about when: forces come late by a lag, in all trials or in one."""

    name = "time_offset"
    parameters = (Parameter("lag_s", 0.01),)
    alike = ("filter_lag", "drag")

    def places(self, scenes: Sequence[Scene], readings: Sequence[Reading]) -> tuple[Place, ...]:
        """Cables and triggers seldom change within a session: all single trials together are a fifth as likely."""
        single = tuple(Place((scene.trial,), odds=0.2 / len(scenes)) for scene in scenes)
        return (SESSION, *single) if len(scenes) > 1 else (SESSION,)

    def read(self, reading: Reading, place: Place, theta: Float[Tensor, " params"]) -> Reading:
        if not covers(place, reading.trial):
            return reading
        time, lag = reading.time.cpu().numpy(), float(theta[0])
        flat = reading.wrench.flatten(1).cpu().numpy()
        late = scipy.interpolate.make_interp_spline(time, flat, k=3)(np.clip(time - lag, time[0], time[-1]))
        wrench = torch.as_tensor(late, dtype=reading.wrench.dtype, device=reading.wrench.device)
        return Reading(reading.trial, reading.time, wrench.reshape(reading.wrench.shape), reading.frames)
