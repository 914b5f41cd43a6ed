"""Maps of plate channels: what a plate makes of the wrench that it bears.

Sources: Cappello, Bagala, Cedraro & Chiari, Gait & Posture 33 (2011), on errors of plates before and after they are
calibrated again; Collins, Adamczyk, Ferris & Kuo, Gait & Posture 29 (2009), on calibration by linear maps.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import final

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.effects.kinds import ReadingEffect
from torchid.effects.marker_scene import View
from torchid.effects.parameter import Parameter, stacked
from torchid.effects.place import Place
from torchid.effects.plate_map import PlateMap, mapped, plate_names, to_plate, to_world
from torchid.effects.quantities import DEGREES, ROOM, NamedEffect, length, much, of, vector
from torchid.effects.scene import PlateFrame, Reading
from torchid.effects.traits import ColumnNoise, Site
from torchid.model.rotation import rotation_matrix
from torchid.wording import stated

CHANNELS = ("fx", "fy", "fz", "mx", "my", "mz")
CROSSTALK = [[i, j] for i in range(6) for j in range(6) if i != j]
"""Resolution. Rows and columns of the off-diagonals of a plate's 6 x 6 map."""


@final
class PlateGain(ReadingEffect):
    """All channels of a plate read too much by one factor: a wrong sensitivity or amplifier setting.

    All plates alike look like a wrong body mass; one plate alone shows wherever the weight moves between plates.
    """

    name = "plate_gain"
    mistaken = 0.06
    site = Site.PLATE
    link = "of"
    column_noise = ColumnNoise.CORRECTED
    parameters = (
        Parameter("gain", 0.03, source="a choice: a sensitivity that has aged is off by a few percent, and three times "
                  "as much shows at once where somebody stands still"),
    )  # fmt: skip
    noun = "a wrong gain"
    advice = "a known weight laid on each plate in turn"
    apart = {
        "plate_gain": "a known weight on each plate in turn",
        "body_mass": "the person on a second scale, or a known weight on each plate",
        "payload": "a known weight on each plate, and quiet standing with the load taken off",
        "body_weight_support": "a known weight on each plate, and quiet standing without the harness",
    }

    def places(self, views: Sequence[View]) -> tuple[Place, ...]:
        """Each plate, and all of them alike."""
        names = plate_names(views)
        each = tuple(Place((name,)) for name in names)
        return (*each, Place(tuple(names))) if len(names) > 1 else each

    def untested(self, views: Sequence[View], plates: Sequence[str]) -> str:
        readings = [view.reading for view in views]
        borne = {f.name for one in readings for k, f in enumerate(one.frames) if bool(one.wrench[:, k].any())}
        silent = [name for name in plates if name not in borne]
        return f"not of {', '.join(silent)}: no step there in a fit trial" if silent else ""

    def read(self, reading: Reading, place: Place, theta: Float[Tensor, " params"]) -> Reading:
        """The plates' wrenches times the gain.

        Where all plates are alike, so is what the body needs beyond what they bore: only another scale tells all gains
        from a body that weighs as much more, and their columns must not.
        """
        found = mapped(reading, place, lambda own, k: (1.0 + theta) * own.wrench[:, k])
        if found.unborne is None or not {frame.name for frame in reading.frames} <= set(place.where):
            return found
        return replace(found, unborne=(1.0 + theta) * found.unborne)

    def named(self, place: Place, theta: Float[Tensor, " params"]) -> dict[str, Tensor]:
        return {"gain": 1.0 + theta[0]}

    def internal(self, place: Place, values: dict[str, Tensor]) -> Float[Tensor, " params"]:
        return stacked(self.parameters, values, self.name) - 1.0

    def sentence(self, finding: NamedEffect) -> str:
        verb = "read" if len(finding.where) > 1 else "reads"
        return f"{self.located(finding.where)} {verb} {much(finding, 'gain')}"


@final
class PlatePose(PlateMap):
    """The plate lies elsewhere than the file says: moments err by shift x force, and a tilt leans the force.

    ``shift_m`` and ``rotation_rad`` (in W, about the plate's centre) lead from where the file has it to where it is.
    """

    name = "plate_pose"
    parameters = (
        Parameter("shift_m", 0.02, 3, source="a choice: four plates had centres of pressure 2 to 14 mm off before they "
                  "were calibrated again (Cappello et al., Gait & Posture 33 (2011)); more for corners that are "
                  "measured by hand"),
        Parameter("rotation_rad", 0.02, 3, source="a choice: 10 mm between the ends of a plate of half a metre"),
    )  # fmt: skip
    noun = "a wrong place"
    advice = "a pole with markers pressed on known points of the plate"
    apart = {
        "plate_crosstalk": "a pole pressed, upright and slantwise, on known points of the plate",
        "plate_assignment": "a step on one plate at a time, called out",
    }

    def map(self, bears: Reading, k: int, theta: Float[Tensor, " params"]) -> Float[Tensor, "samples 6"]:
        (shift, turn), frame = self.split(theta), bears.frames[k]
        true = PlateFrame(frame.name, frame.p_WF + shift, rotation_matrix(turn) @ frame.R_WF)
        return to_world(frame, to_plate(true, bears.wrench[:, k]))

    def sentence(self, finding: NamedEffect) -> str:
        (turn, turn_sd) = of(finding, "rotation_rad")
        return (
            f"{self.located(finding.where)} lies elsewhere than the file has it: by "
            f"{vector(finding, 'shift_m', 'mm', 1e3, ROOM)}, and turned by {length(turn, turn_sd, '°', DEGREES)}"
        )


@final
class PlateCrosstalk(PlateMap):
    """One channel of a plate leaks into another: bent sensors, a wrong or missing calibration matrix."""

    name = "plate_crosstalk"
    mistaken = 0.1
    parameters = (
        Parameter("matrix_plate", 0.02, 30, source="two parts in a hundred, the most that makers of plates state of "
                  "any pair of channels; times the lever of a fifth of a metre, see ``scale``"),
    )  # fmt: skip
    noun = "channels that leak"
    advice = "a known weight at the centre and at the corners of the plate, and a pole pressed slantwise"

    def scale(self, place: Place) -> tuple[float, ...]:
        """Two parts in a hundred of what a channel may bear: moments a fifth of a metre times forces."""
        bears, part = (1.0,) * 3 + (0.2,) * 3, self.parameters[0].scale
        return tuple(part * bears[i] / bears[j] for i, j in CROSSTALK)

    def map(self, bears: Reading, k: int, theta: Float[Tensor, " params"]) -> Float[Tensor, "samples 6"]:
        frame, wrench = bears.frames[k], bears.wrench[:, k]
        return wrench + to_world(frame, to_plate(frame, wrench) @ _matrix(theta).T)

    def named(self, place: Place, theta: Float[Tensor, " params"]) -> dict[str, Tensor]:
        return {"matrix_plate": _matrix(theta)}

    def internal(self, place: Place, values: dict[str, Tensor]) -> Float[Tensor, " params"]:
        full = torch.as_tensor(values.get("matrix_plate", []), dtype=torch.float64)
        if tuple(full.shape) != (6, 6):
            return stacked(self.parameters, values, self.name)
        return torch.stack([full[i, j] for i, j in CROSSTALK])

    def sentence(self, finding: NamedEffect) -> str:
        value, sd = of(finding, "matrix_plate")
        k = int(value.abs().argmax())
        row, column = divmod(k, 6)
        unit = f"{'N' if row < 3 else 'N m'} per {'N' if column < 3 else 'N m'}"
        return (
            f"channels of {self.located(finding.where)} leak into each other, most of all {CHANNELS[column]} into "
            f"{CHANNELS[row]}: {stated(value[k], sd[k], unit)}"
        )


def _matrix(theta: Float[Tensor, " 30"]) -> Float[Tensor, "6 6"]:
    """The off-diagonals in their places, zeros between."""
    row, column = torch.tensor(CROSSTALK, device=theta.device).T
    return theta.new_zeros(6, 6).index_put((row, column), theta)
