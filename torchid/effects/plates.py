"""Maps of plate channels: what a plate makes of the wrench that it bears.

Sources: Cappozzo, Della Croce, Leardini & Chiari, Gait & Posture 21 (2005), on errors of plates and their spot checks;
Collins, Adamczyk, Ferris & Kuo, Gait & Posture 29 (2009), on calibration by linear maps.
"""

from collections.abc import Sequence
from dataclasses import replace

import roma
import torch
from jaxtyping import Float
from torch import Tensor

from torchid.effects.effect import Effect, Parameter
from torchid.effects.marker_scene import View
from torchid.effects.place import Place
from torchid.effects.scene import PlateFrame, Reading

CROSSTALK = [[i, j] for i in range(6) for j in range(6) if i != j]
"""Rows and columns of the off-diagonals of a plate's 6 x 6 map."""


def to_plate(frame: PlateFrame, wrench: Float[Tensor, "samples 6"]) -> Float[Tensor, "samples 6"]:
    """A wrench about the origin of W, taken about the plate's and in its axes."""
    force, moment = wrench[:, :3], wrench[:, 3:]
    moment = moment - torch.linalg.cross(frame.p_WF.expand_as(force), force)
    return torch.cat([force @ frame.R_WF, moment @ frame.R_WF], 1)


def to_world(frame: PlateFrame, wrench: Float[Tensor, "samples 6"]) -> Float[Tensor, "samples 6"]:
    """The inverse of ``to_plate``."""
    force, moment = wrench[:, :3] @ frame.R_WF.T, wrench[:, 3:] @ frame.R_WF.T
    return torch.cat([force, moment + torch.linalg.cross(frame.p_WF.expand_as(force), force)], 1)


class PlateMap(Effect):
    """An effect on what single plates read, each alike."""

    follows_acceleration = True
    together = False
    """Could also sit on all plates alike."""

    def places(self, views: Sequence[View]) -> tuple[Place, ...]:
        names = sorted({frame.name for v in views for frame in v.reading.frames})
        each = tuple(Place((name,)) for name in names)
        return (*each, Place(tuple(names))) if self.together and len(names) > 1 else each

    def weighs(self, place: Place) -> bool:
        return self.together and len(place.where) > 1

    def read(self, reading: Reading, place: Place, theta: Float[Tensor, " params"]) -> Reading:
        for name in place.where:
            k = reading.index(name)
            if k is not None:
                mapped = self.map(reading.frames[k], reading.time, reading.wrench[:, k], theta)
                reading = reading.with_plate(k, mapped)
        return reading

    def map(self, frame: PlateFrame, time: Tensor, wrench: Tensor, theta: Tensor) -> Float[Tensor, "samples 6"]:
        """What the plate reads of a wrench, both about the origin of W."""
        raise NotImplementedError


class PlateGain(PlateMap):
    """All channels of a plate read too much by one factor: a wrong sensitivity or amplifier setting.

    All plates alike look like a wrong body mass; one plate alone shows wherever the weight moves between plates.
    """

    name = "plate_gain"
    parameters = (Parameter("gain", 0.03),)
    together = True

    def read(self, reading: Reading, place: Place, theta: Float[Tensor, " params"]) -> Reading:
        """All alike are a body that weighs as much more: only another scale tells which, and their columns must not.

        By what the plates bore, which nothing is in the air and has the mass spread as it was identified, a runner
        written down 6 kg too light was likelier by 10 nats to have run on plates that gain 8 %.
        """
        found = super().read(reading, place, theta)
        if found.unborne is None or not {frame.name for frame in reading.frames} <= set(place.where):
            return found
        return replace(found, unborne=(1.0 + theta) * found.unborne)

    def map(self, frame: PlateFrame, time: Tensor, wrench: Tensor, theta: Tensor) -> Float[Tensor, "samples 6"]:
        return (1.0 + theta) * wrench

    def named(self, place: Place, theta: Float[Tensor, " params"]) -> dict[str, Tensor]:
        return {"gain": 1.0 + theta[0]}

    def internal(self, place: Place, values: dict[str, Tensor]) -> Float[Tensor, " params"]:
        return super().internal(place, values) - 1.0


class PlateOffset(PlateMap):
    """A constant wrench on every sample of a plate, loaded or not: it was zeroed under load, or not at all."""

    name = "plate_offset"
    follows_acceleration = False
    parameters = (Parameter("force_plate_N", 5.0, 3), Parameter("moment_plate_Nm", 1.0, 3))

    def map(self, frame: PlateFrame, time: Tensor, wrench: Tensor, theta: Tensor) -> Float[Tensor, "samples 6"]:
        return wrench + to_world(frame, theta.expand(len(time), 6))


class PlateDrift(PlateMap):
    """An offset that grows with time since the recording began: charge amplifiers and warming bridges do."""

    name = "plate_drift"
    follows_acceleration = False
    parameters = (Parameter("rate_plate", 0.5, 6),)

    def scale(self, place: Place) -> tuple[float, ...]:
        """Moments a fifth of a metre times forces."""
        return (0.5,) * 3 + (0.1,) * 3

    def map(self, frame: PlateFrame, time: Tensor, wrench: Tensor, theta: Tensor) -> Float[Tensor, "samples 6"]:
        return wrench + to_world(frame, (time - time[0])[:, None] * theta)


class PlatePose(PlateMap):
    """The plate lies elsewhere than the file says: moments err by shift x force, and a tilt leans the force.

    ``shift_m`` and ``rotation_rad`` (in W, about the plate's centre) lead from where the file has it to where it is.
    """

    name = "plate_pose"
    parameters = (Parameter("shift_m", 0.02, 3), Parameter("rotation_rad", 0.02, 3))

    def map(self, frame: PlateFrame, time: Tensor, wrench: Tensor, theta: Tensor) -> Float[Tensor, "samples 6"]:
        shift, turn = self.split(theta)
        true = PlateFrame(frame.name, frame.p_WF + shift, roma.rotvec_to_rotmat(turn) @ frame.R_WF)
        return to_world(frame, to_plate(true, wrench))


class PlateCrosstalk(PlateMap):
    """One channel of a plate leaks into another: bent sensors, a wrong or missing calibration matrix."""

    name = "plate_crosstalk"
    parameters = (Parameter("matrix_plate", 0.01, 30),)

    def scale(self, place: Place) -> tuple[float, ...]:
        """One part of what a channel may bear: moments a fifth of a metre times forces.

        A leak of 0.01 m from the vertical force into moments would be a plate that lies 10 mm elsewhere.
        """
        bears = (1.0,) * 3 + (0.2,) * 3
        return tuple(0.01 * bears[i] / bears[j] for i, j in CROSSTALK)

    def map(self, frame: PlateFrame, time: Tensor, wrench: Tensor, theta: Tensor) -> Float[Tensor, "samples 6"]:
        own = to_plate(frame, wrench)
        return wrench + to_world(frame, own @ self.matrix(theta).T)

    @staticmethod
    def matrix(theta: Float[Tensor, " 30"]) -> Float[Tensor, "6 6"]:
        """The off-diagonals in their places."""
        row, column = torch.tensor(CROSSTALK, device=theta.device).T
        return theta.new_zeros(6, 6).index_put((row, column), theta)

    def named(self, place: Place, theta: Float[Tensor, " params"]) -> dict[str, Tensor]:
        return {"matrix_plate": self.matrix(theta)}

    def internal(self, place: Place, values: dict[str, Tensor]) -> Float[Tensor, " params"]:
        full = torch.as_tensor(values.get("matrix_plate", []), dtype=torch.float64)
        if tuple(full.shape) != (6, 6):
            return super().internal(place, values)
        return torch.stack([full[i, j] for i, j in CROSSTALK])


BEARING = 20.0
"""Upward force from which a plate bears something [N]."""


class PlateAssignment(PlateMap):
    """Two plates' cables are swapped: the channels of each are read with the other's geometry.

    The parameter is how much of the swap is there: one, or nothing.
    """

    name = "plate_assignment"
    follows_acceleration = False
    parameters = (Parameter("share", 1.0, positive=True),)
    reads_measured = all_or_nothing = True

    def places(self, views: Sequence[View]) -> tuple[Place, ...]:
        names = sorted({frame.name for v in views for frame in v.reading.frames})
        return tuple(Place((a, b)) for k, a in enumerate(names) for b in names[k + 1 :])

    def read(self, reading: Reading, place: Place, theta: Float[Tensor, " params"]) -> Reading:
        a, b = (reading.index(name) for name in place.where)
        if a is None or b is None:
            return reading
        # Where a plate bears nothing, its noise would be swapped, and the noise in what is read explained by itself.
        true = [reading.wrench[:, k] * (reading.wrench[:, k, 2:3] > BEARING) for k in (a, b)]
        first, second = reading.frames[a], reading.frames[b]
        there = to_world(first, to_plate(second, true[1])), to_world(second, to_plate(first, true[0]))
        reading = reading.with_plate(a, reading.wrench[:, a] + theta * (there[0] - true[0]))
        return reading.with_plate(b, reading.wrench[:, b] + theta * (there[1] - true[1]))

    def undone(self, reading: Reading, place: Place, theta: Float[Tensor, " params"]) -> Reading:
        return self.read(reading, place, theta)

    def named(self, place: Place, theta: Float[Tensor, " params"]) -> dict[str, Tensor]:
        return {}

    def internal(self, place: Place, values: dict[str, Tensor]) -> Float[Tensor, " params"]:
        return torch.ones(1, dtype=torch.float64)
