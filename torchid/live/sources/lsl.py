"""Lab Streaming Layer as a source: markers of one stream, plates of another, both by this machine's clock."""

import logging
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from types import TracebackType

import numpy as np
import pylsl
import torch
from jaxtyping import Float
from torch import Tensor

from torchid.errors import InputError
from torchid.live.sources.description import (
    FORCE_PLATE,
    MOCAP,
    ChannelLayout,
    Tree,
    fault,
    marker_layout,
    plate_layout,
    rate_of,
    tree,
)
from torchid.live.sources.stream import Packet
from torchid.recording import Forces, Markers

LOOK_S = 1.0
"""Cited. Duration of one look for streams; below half a second some are missed (pylsl, ``resolve_streams``)."""
REPLY_S = 5.0
"""Choice. How long a stream that was found may take to describe itself and to compare clocks."""
SILENT_S = 1.0
"""Choice. Without a sample for so long, a sender may have been replaced by another run of it, which is looked for."""
POLL_S = 0.05
"""Choice. How often that is asked: a twentieth of the time that looking takes."""
MEASURED_S = 2.0
"""Choice. How long a stream that states no rate is watched: 5 ms of jitter are a quarter of a frame/s at 100 Hz."""
CHUNK = 512
"""Choice. Samples that are pulled at once, again until fewer come: half a second of a quick plate."""

log = logging.getLogger(__name__)
Samples = tuple[Float[Tensor, " samples"], Float[Tensor, "samples items parts"]]


@dataclass(frozen=True)
class FeedLink:
    """A connection to one run of a sender, with what that run says of its channels; never changed, only replaced."""

    inlet: pylsl.StreamInlet
    uid: str
    layout: ChannelLayout

    def pull(self) -> Samples:
        """Return times by this machine's clock [s], and samples in W and SI units, at once.

        Raises:
            RuntimeError: where the sender is gone, as ``pylsl`` has it.
        """
        # Asked here, not left to the inlet (``proc_clocksync``), which waits wherever it knows no offset.
        late_s = self.layout.late_s - self.inlet.time_correction(0.0)
        times, values = [], []
        while not times or len(times[-1]) == CHUNK:
            samples, stamps = self.inlet.pull_chunk(0.0, CHUNK, as_numpy=True)
            times.append(stamps)
            values.append(np.asarray(samples, dtype=np.float64))
        time_s = torch.from_numpy(np.concatenate(times) - late_s)
        return time_s, self.layout.read(torch.from_numpy(np.concatenate(values)))


class Feed:
    """Samples of one stream, run after run of its sender.

    Inlets do not recover by themselves: one that did would go on with the channels of the old description, whatever the
    sender says after a restart. A thread connects anew and reads the new description, in which everything is found by
    its name; it does all that waits, so that pulling never does. A run that does not fit is refused, with a warning.
    """

    def __init__(self, found: pylsl.StreamInfo, read: Callable[[Tree, str], ChannelLayout]) -> None:
        """Connect; samples are kept from the first pull on.

        Raises:
            InputError: ``live.lsl`` where it does not answer, or its description does not tell all that is needed.
        """
        self._read, self.name = read, f"LSL stream {found.name()}"
        stated = (("name", found.name()), ("type", found.type()), ("source_id", found.source_id()))
        self._query = " and ".join(f"{key}='{value}'" for key, value in stated if value and "'" not in value)
        try:
            self._link = self._connected(found)
            self.layout = self._link.layout
            self.rate_hz = rate_of(self.layout, self._watched(), self.name)
        except RuntimeError as error:
            remedy = "Start its sender again, or look whether a firewall is between"
            raise fault(self.name, "was found, but does not answer", str(error), remedy) from error
        self._refused, self._heard_s = set[str](), time.monotonic()
        self._lost, self._closed = threading.Event(), threading.Event()
        self._thread = threading.Thread(target=self._keep, name=self.name, daemon=True)
        self._thread.start()

    def pull(self) -> Samples:
        """Return what arrived since the last call, perhaps nothing, as ``FeedLink.pull``."""
        try:
            time_s, values = self._link.pull()
        except RuntimeError:
            self._lost.set()
            return torch.zeros(0, dtype=torch.float64), torch.zeros(0, *self.layout.columns.shape, dtype=torch.float64)
        if len(time_s):
            self._heard_s = time.monotonic()
        return time_s, values

    def close(self) -> None:
        """End the thread."""
        self._closed.set()
        self._thread.join()

    def _connected(self, found: pylsl.StreamInfo) -> FeedLink:
        inlet = pylsl.StreamInlet(found, recover=False)
        xml = inlet.info(REPLY_S).as_xml()
        inlet.time_correction(REPLY_S)
        return FeedLink(inlet, found.uid(), self._read(tree(xml), self.name))

    def _watched(self) -> Float[Tensor, " samples"]:
        """Times of the samples of a while, none where the rate is known."""
        if self.layout.rate_hz > 0.0:
            return torch.zeros(0, dtype=torch.float64)
        self._link.inlet.open_stream(REPLY_S)
        time.sleep(MEASURED_S)
        return self._link.pull()[0].sort().values

    def _keep(self) -> None:
        while not self._closed.wait(POLL_S):
            if self._lost.is_set() or time.monotonic() - self._heard_s > SILENT_S:
                self._look()

    def _look(self) -> None:
        """Connect to the newest run of the sender, if there is one that has not been refused."""
        lost = self._lost.is_set()
        known = self._refused if lost else {*self._refused, self._link.uid}
        seen = pylsl.resolve_bypred(self._query, 1 if lost else 2, LOOK_S)
        newest = max((one for one in seen if one.uid() not in known), key=lambda one: one.created_at(), default=None)
        if newest is None:
            return
        try:
            link = self._connected(newest)
            layout = self._fitting(link.layout)
            link.inlet.open_stream(REPLY_S)
        except RuntimeError:
            return  # gone again
        except InputError as error:
            self._refused.add(newest.uid())
            log.warning("a restart is not taken up: %s", error)
            return
        old, self._link = self._link, FeedLink(link.inlet, link.uid, layout)
        self._lost.clear()
        self._heard_s = time.monotonic()
        log.warning("%s is back", self.name)
        self._closed.wait(POLL_S)  # The last pull of the old inlet is over then: to end an inlet takes a while.
        del old

    def _fitting(self, layout: ChannelLayout) -> ChannelLayout:
        """Layout of another run, by the names of the first.

        Raises:
            InputError: ``live.lsl`` where it has another rate, none of the names, or plates elsewhere.
        """
        first, remedy = self.layout, "Start torchid live anew, or the sender as it was"
        if layout.rate_hz != first.rate_hz:
            raise fault(self.name, "has another rate", f"{layout.rate_hz:g} Hz, was {first.rate_hz:g} Hz", remedy)
        moved = [name for name in first.corners if name in layout.corners
                 and not torch.equal(layout.corners[name], first.corners[name])]  # fmt: skip
        if moved:
            raise fault(self.name, "has plates in other places", ", ".join(moved), remedy)
        lacking = [name for name in first.names if name not in layout.names]
        if len(lacking) == len(first.names):
            raise fault(self.name, "has none of the names it had", ", ".join(layout.names), remedy)
        if lacking:
            log.warning("%s came back without %s", self.name, ", ".join(lacking))
        return layout.having(first.names)


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
