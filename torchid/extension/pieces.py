"""A recording looked at in overlapping pieces, so that memory does not grow with its length."""

from collections.abc import Iterator
from dataclasses import dataclass

from jaxtyping import Float
from torch import Tensor

from torchid.motion import Motion
from torchid.storage.snapshot import release

PIECE_S = 40.0
"""Length of a piece [s], that of what a diagnosis searches of a trial: a piece takes less memory than that."""
BESIDE_S = 20.0
"""Time on either side that is looked at with a piece [s], in which all forget where they began: a mass on the softest
spring of the catalogue, with the least damping, rings down to exp(-31), and filters forget sooner."""


@dataclass(frozen=True)
class TrialPiece:
    """Some frames of a recording, and those beside them that are looked at as well."""

    own: slice
    """The frames, of those of the recording."""
    around: slice
    """These and those beside them."""

    @property
    def inner(self) -> slice:
        """The frames, of those around."""
        return slice(self.own.start - self.around.start, self.own.stop - self.around.start)


def pieces(time: Float[Tensor, " frames"]) -> Iterator[TrialPiece]:
    """Cut a recording; one that is no longer than a piece stays whole.

    Behind each piece, what it touched of mapped files leaves the memory.

    Args:
        time: uniform clock of the recording [s].
    """
    frames, lasts = len(time), float(time[-1] - time[0])
    length, beside = (max(1, round(part / lasts * (frames - 1))) if lasts else frames for part in (PIECE_S, BESIDE_S))
    for start in range(0, frames, length):
        stop = min(frames, start + length)
        yield TrialPiece(slice(start, stop), slice(max(0, start - beside), min(frames, stop + beside)))
        release()


def ends(motion: Motion, span: slice, part: slice) -> Motion | None:
    """The first and the last frame of a span of a motion, as ``Scene.span`` wants them; None where a part is all of it.

    Args:
        motion: of a trial.
        span: frames in which parameters were found.
        part: frames that are looked at.
    """
    step = max(1, span.stop - span.start - 1)
    return None if part == span else motion.frames(slice(span.start, span.stop, step))
