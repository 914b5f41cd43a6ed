"""Lab Streaming Layer as a source: markers of one stream, plates of another, both by this machine's clock."""

import time
from types import TracebackType

import pylsl

from torchid.live.sources.description import FORCE_PLATE, MOCAP, fault, marker_layout, plate_layout
from torchid.live.sources.feed import LOOK_S, Feed
from torchid.live.sources.stream import Packet
from torchid.recording import Forces, Markers

WAIT_S = 5.0
"""Choice. How long streams are looked for: five looks, for senders on a busy network."""


class LslSource:
    """Frames of a stream of type ``MoCap`` and samples of one of type ``ForcePlate``.

    Time stamps are left as they came but for the offset between the clocks, so that a sample that comes twice is known
    again. The source has no end of its own: where senders stop, packets are empty.
    """

    def __init__(self, name: str = "", wait_s: float = WAIT_S) -> None:
        """Find both streams and read what they say of themselves; frames are kept from the first ``take`` on.

        Args:
            name: of the stream of markers; empty: the only one.
            wait_s: how long streams are looked for [s].

        Raises:
            InputError: ``live.lsl`` where there is no such stream, more than one, or one that does not say what is
                needed.
        """
        markers, plates = _found(name, wait_s)
        self._markers = Feed(markers, marker_layout)
        try:
            self._plates = Feed(plates, plate_layout)
        except BaseException:
            self._markers.close()
            raise
        self.labels, self.rate_hz = self._markers.layout.names, self._markers.rate_hz
        self.plates, self.force_rate_hz = self._plates.layout.plates, self._plates.rate_hz

    def take(self) -> Packet:
        """Return what arrived since the last call, perhaps nothing; never waits."""
        time_s, position = self._markers.pull()
        sample_s, wrench = self._plates.pull()
        return Packet(Markers(self.labels, time_s, position), Forces(sample_s, wrench, self.plates), time.monotonic())

    def close(self) -> None:
        """Look for restarted senders no more."""
        self._markers.close()
        self._plates.close()

    def __enter__(self) -> "LslSource":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def _found(name: str, wait_s: float) -> tuple[pylsl.StreamInfo, pylsl.StreamInfo]:
    """The one stream of either type, as soon as both are there."""
    end = time.monotonic() + wait_s
    while True:
        seen = pylsl.resolve_streams(LOOK_S)
        markers = [one for one in seen if _is(one, MOCAP) and name in ("", one.name())]
        plates = [one for one in seen if _is(one, FORCE_PLATE)]
        if (markers and plates) or time.monotonic() >= end:
            return _only(markers, MOCAP, name, seen), _only(plates, FORCE_PLATE, "", seen)


def _is(stream: pylsl.StreamInfo, kind: str) -> bool:
    return stream.type().lower() == kind.lower()


def _only(some: list[pylsl.StreamInfo], kind: str, name: str, seen: list[pylsl.StreamInfo]) -> pylsl.StreamInfo:
    if len(some) == 1:
        return some[0]
    listed = ", ".join(f"{one.name()} ({one.type()}, {one.hostname()})" for one in some or seen) or "no stream at all"
    if some:
        remedy = "Give --source lsl:NAME" if kind == MOCAP else "Send all plates in one stream, and stop the others"
        raise fault(f"LSL type {kind}", "has several streams", listed, remedy)
    called = f" called {name}" if name else ""
    remedy = "Start the sender; where it runs, look at lsl_api.cfg on both machines and at firewalls (docs/live.md)"
    raise fault(f"LSL type {kind}", f"has no stream{called}", listed, remedy)
