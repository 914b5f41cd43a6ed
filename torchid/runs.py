"""Runs of frames: which last, and what lies beside them."""

import torch
from jaxtyping import Bool
from torch import Tensor


def runs(flag: Bool[Tensor, " frames"]) -> list[tuple[int, int]]:
    """Start and end (exclusive) of every run of True."""
    edges = torch.diff(torch.nn.functional.pad(flag.long(), (1, 1)))
    starts, stops = (edges == 1).nonzero()[:, 0], (edges == -1).nonzero()[:, 0]
    return list(zip(starts.tolist(), stops.tolist(), strict=True))


def lasting(flag: Bool[Tensor, "frames columns"], frames: int) -> Bool[Tensor, "frames columns"]:
    """Runs of True along the frames that last longer than ``frames``, or that an end of the trial cuts."""
    if frames < 1:
        return flag
    kept = flag.clone()
    for column in range(flag.shape[1]):
        for start, stop in runs(flag[:, column]):
            if stop - start <= frames and 0 < start and stop < len(flag):
                kept[start:stop, column] = False
    return kept


def dilate(flag: Bool[Tensor, " frames"], frames: int) -> Bool[Tensor, " frames"]:
    """Frames at most so many frames from one that is True."""
    if frames < 1 or not bool(flag.any()):
        return flag
    wide = torch.nn.functional.max_pool1d(flag.double()[None, None], 2 * frames + 1, stride=1, padding=frames)
    return wide[0, 0] > 0


def spread(core: Bool[Tensor, " frames"], edge: Bool[Tensor, " frames"]) -> Bool[Tensor, " frames"]:
    """Runs of ``edge`` that hold a frame of ``core``, and ``core``."""
    found = core.clone()
    for start, stop in runs(edge):
        if bool(core[start:stop].any()):
            found[start:stop] = True
    return found
