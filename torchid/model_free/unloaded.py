"""What plates read while they bear nothing: their zeros."""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.effects.plate_map import to_plate
from torchid.model_free.statements import CheckSubject
from torchid.model_free.watched import Watched
from torchid.observation.options import ObservationOptions
from torchid.observation.unloaded_plates import find_unloaded

CHANNELS = ("fx", "fy", "fz", "mx", "my", "mz")


@dataclass(frozen=True)
class Zeros:
    """The zeros of a trial's plates [N, N m], in their own axes; a ``Witness``."""

    about: tuple[CheckSubject, ...]
    covariance: Float[Tensor, "some some"]
    runs: tuple[tuple[int, slice], ...]
    """Plates, and the frames in which each bears nothing."""

    def value(self, watched: Watched) -> Float[Tensor, " some"]:
        """Return mean readings of the unloaded plates.

        Args:
            watched: the trial.
        """
        reading = watched.reading
        return torch.cat([to_plate(reading.frames[k], reading.wrench[part, k]).mean(0) for k, part in self.runs])


def zeros(watched: Watched, observation: ObservationOptions) -> Zeros | None:
    """Return the witness of a trial's zeros; None where no plate is unloaded.

    Args:
        watched: the trial.
        observation: thresholds by which a plate bears nothing.
    """
    found = find_unloaded(watched.reading, watched.rate, observation).runs
    if not found:
        return None
    names = [watched.reading.frames[k].name for k, *_ in found]
    about = tuple(CheckSubject(f"zero_{channel}", watched.name, name) for name in names for channel in CHANNELS)
    error = torch.cat([sd for *_, sd in found])
    return Zeros(about, error.square().diag(), tuple((k, part) for k, part, *_ in found))
