"""What plates read while they bear nothing: their zeros."""

import torch

from torchid.observation.unloaded_plates import find_unloaded
from torchid.witnesses.statements import Statements, Subject
from torchid.witnesses.watched import Watched

CHANNELS = ("fx", "fy", "fz", "mx", "my", "mz")


def zeros(watched: Watched) -> Statements | None:
    """Return the zeros of a trial's plates [N, N m], in their own axes; None where no plate is unloaded.

    Args:
        watched: the trial.
    """
    found = find_unloaded(watched.reading, watched.rate).runs
    if not found:
        return None
    about = tuple(
        Subject(f"zero_{channel}", watched.name, watched.reading.frames[k].name)
        for k, *_ in found
        for channel in CHANNELS
    )
    value, error = torch.cat([mean for *_, mean, _ in found]), torch.cat([sd for *_, sd in found])
    return Statements(about, value, error.square().diag())
