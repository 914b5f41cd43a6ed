"""What a source of live measurements is, and what it hands over."""

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from torchid.recording import Forces, Markers, Plate


@dataclass(frozen=True)
class Packet:
    """Frames and samples that arrived since a source was last asked: in any order, some twice, some never."""

    markers: Markers
    """Frames of markers, by the clock of the source."""
    forces: Forces | None
    """Samples of the plates, by the same clock."""
    arrived_s: float
    """When the newest frame was there to be taken, by the monotonic clock of this machine [s]."""


@runtime_checkable
class Source(Protocol):
    """Where frames come from."""

    labels: tuple[str, ...]
    """Names of the markers, in the order of every packet."""
    rate_hz: float
    """Nominal frames per second."""
    plates: tuple[Plate, ...]
    """Force plates, in the order of every packet."""
    force_rate_hz: float
    """Nominal samples per second, zero without plates."""

    def take(self) -> Packet | None:
        """Return what arrived since the last call, perhaps nothing; None where nothing will come any more."""
        ...
