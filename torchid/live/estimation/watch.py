"""What is wrong with a stream, said within seconds: while it can be mended, before the subject has gone."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchid.checks.clocks import BY_BODY
from torchid.checks.finding import Finding, InstrumentFault, Severity
from torchid.checks.instruments import late_forces, unlike_gains, unloaded_reading
from torchid.contact.contact import Contact
from torchid.conventions import ZERO_WRONG_N
from torchid.live.estimation.instruments import Instruments

SHARE = 0.5
"""Choice. Part of a block for which something must last before it is said: a stance, and no foot that grazes."""
GAIN_SD = 6.0
"""Choice. Standard deviations by which plates must disagree: motion that is modelled wrongly is no noise."""
GAIN = 0.05
"""Choice. By how much two plates may disagree about one weight: two groups of plates of a real laboratory do by as much
(60.1 and 63.5 kg, `configs/opencap_subject4_all.yaml`)."""


@dataclass(frozen=True)
class Notice:
    """Something that a laboratory should look at."""

    what: str
    """Stable name: ``posture``, ``marker``, ``unread``, ``beside``, ``offset``, ``clock``, ``gain``, ``recording``,
    ``stamps``."""
    where: str
    """Marker, foot or plate; empty where it is the whole stream."""
    text: str
    """For whoever stands beside the subject."""

    @classmethod
    def of(cls, found: Finding) -> "Notice":
        """Return a finding about an instrument as the page of a stream has it.

        Args:
            found: its code is the name behind ``live.``.
        """
        return cls(found.code.removeprefix("live."), ", ".join(found.place), found.message)


UNKNOWN = Notice.of(
    Finding(
        InstrumentFault.EXCHANGE, "live.posture", "No posture fits the markers",
        advice="look whether labels are exchanged, or markers hidden",
    )
)  # fmt: skip
"""Nothing else can be said then."""


@dataclass(frozen=True)
class WatchedBlock:
    """What is known of the frames of a block."""

    error: Float[Tensor, "frames markers"]
    """Distance between measured and modelled marker, NaN where missing and where no posture is known [m]."""
    contact: Contact | None
    """Of feet and plates; None without postures or forces."""
    vertical: Float[Tensor, "frames plates"]
    """What each plate reads vertically [N]."""
    instruments: Instruments | None
    """What the newest rows say of clock and gains; None before any."""


class Watch:
    """Looks at every block, and remembers which markers it has seen."""

    def __init__(self, labels: Sequence[str], plates: Sequence[str]) -> None:
        """Begin with nothing.

        Args:
            labels: of the markers, in the order of ``WatchedBlock.error``.
            plates: their names.
        """
        self._labels, self._plates = tuple(labels), tuple(plates)
        # Many are taken off when the subject has stood: only one that was there is missed.
        self._seen = torch.zeros(len(self._labels), dtype=torch.bool)

    def after(self, block: WatchedBlock) -> tuple[Notice, ...]:
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
            label = self._labels[k]
            seen = f"Marker {label} is not seen"
            yield Notice.of(
                Finding(InstrumentFault.HIDDEN, "live.marker", seen, "", (label,), severity=Severity.WARNING)
            )

    def _feet(self, block: WatchedBlock, known: Bool[Tensor, " frames"]) -> Iterator[Notice]:
        contact = block.contact
        if contact is None:
            return
        for k, foot in enumerate(contact.feet):
            name = foot.replace("_", " ")
            if _lasts(contact.unread[:, k] & known):
                yield Notice("unread", foot, f"The {name} stands on a plate that does not read it")
            elif _lasts(contact.touching[:, k] & ~contact.supported[:, k] & known):
                yield Notice("beside", foot, f"The {name} stands beside the plates: these seconds do not count")

    def _offsets(self, block: WatchedBlock) -> Iterator[Notice]:
        if block.contact is None:
            return
        for k, plate in enumerate(self._plates):
            free = block.contact.plate[:, k] == -1
            if _lasts(free) and abs(mean := float(block.vertical[free, k].mean())) > ZERO_WRONG_N:
                yield Notice.of(unloaded_reading(plate, mean, "live.offset", severity=Severity.WARNING))

    def _late(self, block: WatchedBlock) -> Iterator[Notice]:
        if (found := block.instruments) is None:
            return
        if found.late.wrong(BY_BODY):
            yield Notice.of(late_forces(found.late, "live.clock"))

    def _gains(self, block: WatchedBlock) -> Iterator[Notice]:
        if block.instruments is None or len(self._plates) < 2:
            return
        high, low, off, sd = block.instruments.most_apart()
        if off > max(GAIN, GAIN_SD * sd):
            yield Notice.of(unlike_gains(self._plates[low], self._plates[high], off, sd, "live.gain"))


def _lasts(flag: Bool[Tensor, " frames"]) -> bool:
    return len(flag) > 0 and float(flag.to(torch.float64).mean()) > SHARE
