"""What is wrong with a stream, said within seconds: while it can be mended, before the subject has gone."""

import math
from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchid.contact.contact import Contact

SHARE = 0.5
"""Choice. Part of a block for which something must last before it is said: a stance, and no foot that grazes."""
OFFSET_N = 4.0
"""Choice. Mean vertical reading of a plate that nobody is on: less is what drift and cables do."""
CLOCK_S = 0.02
"""Choice. How late forces may come: those of living bodies come up to 15 ms late by themselves (``body_lag``)."""
CLOCK_SD = 3.0
"""Choice. Standard deviations by which a clock must be off."""
GAIN_SD = 6.0
"""Choice. Standard deviations by which plates must disagree: motion that is modelled wrongly is no noise."""
GAIN = 0.05
"""Choice. By how much two plates may disagree about one weight: two groups of plates of a real laboratory do by as much
(60.1 and 63.5 kg, `configs/opencap_subject4_all.yaml`)."""
REMEMBERED = 10
"""Choice. Blocks over which clocks and gains are judged: a step or two of every kind of motion."""


@dataclass(frozen=True)
class Notice:
    """Something that a laboratory should look at."""

    what: str
    """Stable name: ``posture``, ``marker``, ``unread``, ``beside``, ``offset``, ``clock``, ``gain``, ``recording``."""
    where: str
    """Marker, foot or plate; empty where it is the whole stream."""
    text: str
    """For whoever stands beside the subject."""


UNKNOWN = Notice("posture", "", "No posture fits the markers: look whether labels are exchanged, or markers hidden")
"""Nothing else can be said then."""


@dataclass(frozen=True)
class Block:
    """What is known of the frames of a block."""

    error: Float[Tensor, "frames markers"]
    """Distance between measured and modelled marker, NaN where missing and where no posture is known [m]."""
    contact: Contact | None
    """Of feet and plates; None without postures or forces."""
    vertical: Float[Tensor, "frames plates"]
    """What each plate reads vertically [N]."""
    used: Bool[Tensor, " frames"]
    """Frames whose contacts are all on plates, once there is an estimate."""
    measured: Float[Tensor, "used 3"]
    """Total force of frames that are used [N], ..."""
    predicted: Float[Tensor, "used 3"]
    """... and as the identified dynamics have it."""
    rate_hz: float
    cutoff_hz: float


class Watch:
    """Looks at every block, and remembers what clocks need longer for."""

    def __init__(self, labels: Sequence[str], plates: Sequence[str]) -> None:
        """Begin with nothing.

        Args:
            labels: of the markers, in the order of ``Block.error``.
            plates: their names.
        """
        self._labels, self._plates = tuple(labels), tuple(plates)
        # Many are taken off when the subject has stood: only one that was there is missed.
        self._seen = torch.zeros(len(self._labels), dtype=torch.bool)
        self._clock: deque[tuple[float, float, float, int]] = deque(maxlen=REMEMBERED)
        self._weighed: deque[tuple[Tensor, Tensor]] = deque(maxlen=REMEMBERED)

    def after(self, block: Block) -> tuple[Notice, ...]:
        """Return what is wrong now.

        Args:
            block: the newest frames.
        """
        known = torch.isfinite(block.error).any(1)
        if float((~known).to(block.error).mean()) > SHARE:
            return (UNKNOWN,)
        return (
            *self._markers(block.error[known]), *self._feet(block, known), *self._offsets(block), *self._late(block),
            *self._gains(block),
        )  # fmt: skip

    def _markers(self, error: Float[Tensor, "frames markers"]) -> Iterator[Notice]:
        here = torch.isfinite(error).any(0)
        missing, self._seen = self._seen & ~here, self._seen | here
        for k in missing.nonzero()[:, 0].tolist():
            yield Notice("marker", self._labels[k], f"Marker {self._labels[k]} is not seen")

    def _feet(self, block: Block, known: Bool[Tensor, " frames"]) -> Iterator[Notice]:
        contact = block.contact
        if contact is None:
            return
        for k, foot in enumerate(contact.feet):
            name = foot.replace("_", " ")
            if _lasts(contact.unread[:, k] & known):
                yield Notice("unread", foot, f"The {name} stands on a plate that does not read it")
            elif _lasts(contact.touching[:, k] & ~contact.supported[:, k] & known):
                yield Notice("beside", foot, f"The {name} stands beside the plates: these seconds do not count")

    def _offsets(self, block: Block) -> Iterator[Notice]:
        if block.contact is None:
            return
        for k, plate in enumerate(self._plates):
            free = block.contact.plate[:, k] == -1
            if _lasts(free) and abs(mean := float(block.vertical[free, k].mean())) > OFFSET_N:
                yield Notice("offset", plate, f"{plate} reads {mean:.0f} N while nobody is on it: set it to zero")

    def _late(self, block: Block) -> Iterator[Notice]:
        """By how much the force lags behind that of the model: least squares of the residual on the force's rate."""
        if len(block.measured) > 2:
            rate = torch.gradient(block.predicted, dim=0)[0] * block.rate_hz
            rest = block.measured - block.predicted
            rest = rest - rest.mean(0)
            self._clock.append((-float((rest * rate).sum()), float(rate.square().sum()), float(rest.square().sum()),
                                rest.numel()))  # fmt: skip
        if not self._clock:
            return
        cross, power, square, count = (sum(column) for column in zip(*self._clock, strict=True))
        late_s, independent = cross / max(power, 1e-12), 2.0 * block.cutoff_hz / block.rate_hz
        left = max(square - late_s**2 * power, 0.0) / count
        sd_s = math.sqrt(left / max(power * independent, 1e-12))
        if abs(late_s) > CLOCK_S and abs(late_s) > CLOCK_SD * sd_s:
            yield Notice("clock", "", f"Forces come {1e3 * abs(late_s):.0f} ms {'late' if late_s > 0.0 else 'early'}")

    def _gains(self, block: Block) -> Iterator[Notice]:
        """Two plates that weigh differently: least squares of the model's vertical force on that of every plate.

        What is wrong with all of them alike goes into the mass.
        """
        if len(block.predicted):
            self._weighed.append((block.vertical[block.used], block.predicted[:, 2]))
        if not self._weighed or len(self._plates) < 2:
            return
        read, needed = (torch.cat(parts) for parts in zip(*self._weighed, strict=True))
        on = read.abs().mean(0) > OFFSET_N
        index = on.nonzero()[:, 0].tolist()
        if len(index) < 2 or len(needed) < 2 * len(index):
            return
        inverse = torch.linalg.pinv(read[:, on].T @ read[:, on], hermitian=True)
        share = inverse @ read[:, on].T @ needed
        rest = float((needed - read[:, on] @ share).square().mean())
        independent = 2.0 * block.cutoff_hz / block.rate_hz
        low, high = int(share.argmax()), int(share.argmin())  # what reads too little counts too much
        apart = torch.zeros_like(share)
        apart[low], apart[high] = 1.0, -1.0
        sd = math.sqrt(rest * float(apart @ inverse @ apart) / independent)
        off = float(share[low] - share[high])
        if off > GAIN and off > GAIN_SD * sd:
            names = [self._plates[index[k]] for k in (low, high)]
            text = f"{names[0]} reads {100.0 * off:.0f} % less than {names[1]} for the same weight: look at their gains"
            yield Notice("gain", ", ".join(names), text)


def _lasts(flag: Bool[Tensor, " frames"]) -> bool:
    return len(flag) > 0 and float(flag.to(torch.float64).mean()) > SHARE
