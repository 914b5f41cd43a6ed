"""A stream from its source to pose, parameters and recording, and how fast that was."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchid.geometry.result import GeometryFit
from torchid.inertia.identify import Identified
from torchid.live.estimation.beside import Beside, LiveEstimate
from torchid.live.estimation.identifier import BLOCK_S, LAG_PERIODS, LiveSubject
from torchid.live.estimation.pose import PostureFollower, Postures
from torchid.live.estimation.refining import MessagePiece
from torchid.live.estimation.watch import Notice
from torchid.live.sources.intake import Intake, Stamps
from torchid.live.sources.recorder import Recorder
from torchid.live.sources.stream import Packet, Source
from torchid.model.model import InertialPrior
from torchid.recording import Markers

IDLE_S = 0.0005
"""Choice. Pause where nothing has come: a tenth of the latency that is asked for."""
KEPT = 1 << 20
"""Choice. Latencies that are kept, the newest ones: an hour and a half at 200 Hz."""


@dataclass(frozen=True)
class Moment:
    """What is known when a packet was worked off, for whoever shows it."""

    index: Int[Tensor, " frames"]
    """Numbers of the frames."""
    markers: Markers
    """As they came."""
    postures: Postures
    """At these frames."""
    fit: GeometryFit
    """By which they were found."""
    wrench: Float[Tensor, "plates 6"] | None
    """Newest reading of the plates [N, N m]."""
    found: LiveEstimate | None
    """What was identified last."""
    notices: tuple[Notice, ...] = ()
    """What is wrong with the stream."""


class Pipeline:
    """Takes packets, finds postures at once, and hands both on; the identifier works beside it."""

    def __init__(self, subject: LiveSubject, source: Source, recorder: Recorder | None = None) -> None:
        """Start the identifier; ``close`` or a ``with`` block ends it.

        Args:
            recorder: keeps what came; None keeps nothing.
        """
        self._source, self._recorder, self._cutoff_hz = source, recorder, subject.cutoff_hz
        self._intake = Intake(source.rate_hz, source.force_rate_hz, LAG_PERIODS / subject.cutoff_hz)
        self._stamps, self._misplaced = Stamps(source.rate_hz, source.force_rate_hz), tuple[Notice, ...]()
        self._follower, self._version = PostureFollower(subject.fit, source.labels), 0
        self._beside = Beside(subject, source.labels, source.rate_hz, source.plates, source.force_rate_hz)
        self._fit = subject.fit
        self._newest_s = 0.0
        self._latency_s: list[float] = []
        self._parameters_s: list[float] = []
        self._arrived: dict[int, float] = {}
        self._begun = time.monotonic()

    def __enter__(self) -> "Pipeline":
        return self

    def __exit__(self, *_: object) -> None:
        self._beside.close()

    def run(
        self, seconds: float = float("inf"), show: Callable[[Moment], None] = lambda moment: None,
        stop: Callable[[], bool] = lambda: False,
    ) -> None:  # fmt: skip
        """Work off the stream until it ends, the time is over, or somebody stops it.

        Args:
            seconds: longest duration on this machine's clock.
            show: called with everything that was found in a packet; must return at once.
            stop: asked before every packet.
        """
        end = time.monotonic() + seconds
        while time.monotonic() < end and not stop():
            packet = self._source.take()
            if packet is None:
                break
            if not self._take(packet, show):
                time.sleep(IDLE_S)

    def finish(self) -> Identified:
        """Identify from the whole stream.

        Raises:
            DataError: as ``Identifier.finish``.
        """
        return self._beside.finish()

    @property
    def geometry(self) -> tuple[GeometryFit, InertialPrior]:
        """Return the newest geometry, and the prior that goes with it."""
        return self._beside.fit, self._beside.prior

    def guidance(self) -> dict[str, Any] | None:
        """Return what each exercise has brought, once the stream is finished; None where nobody was advised."""
        return None if self._beside.account is None else self._beside.account.table

    def _take(self, packet: Packet, show: Callable[[Moment], None]) -> bool:
        """Work off a packet; False where nothing was new in it."""
        placed = self._intake.place(packet)
        if len(packet.markers.time):
            self._newest_s = float(placed.markers.time[-1]) if len(placed.index) else self._newest_s
            self._misplaced = self._stamps.after(self._intake.counts, self._newest_s)
        if self._recorder is not None:
            self._recorder.add(placed)
        if not len(placed.index) and not len(placed.sample):
            self._poll()
            return False
        if len(placed.index):
            postures = self._follower(placed.markers)
            self._latency_s.append(time.monotonic() - packet.arrived_s)
            del self._latency_s[:-KEPT]
            self._arrived[int(placed.index[-1])] = packet.arrived_s
            wrench = placed.wrench[-1] if len(placed.wrench) else None
            show(Moment(placed.index, placed.markers, postures, self._fit, wrench, self._beside.found, self._notices))
        else:
            postures = Postures(torch.zeros(0, 0), torch.zeros(0, 0))
        piece = MessagePiece(placed.index, placed.markers.position, postures, placed.sample, placed.wrench)
        self._beside.add(piece)
        self._poll()
        return True

    @property
    def _notices(self) -> tuple[Notice, ...]:
        fault = None if self._recorder is None else self._recorder.fault
        said = f"Nothing more is recorded: {fault}. The estimate goes on"
        found = (*self._misplaced, *self._beside.notices)
        return found if fault is None else (*found, Notice("recording", "", said))

    def _poll(self) -> None:
        """Note when parameters came that know of a frame."""
        self._beside.poll()
        if self._version != self._beside.version:
            self._version, self._fit = self._beside.version, self._beside.fit
            self._follower = self._follower.refined(self._fit, self._source.labels)
        found = self._beside.found
        if found is not None and found.newest in self._arrived:
            self._parameters_s.append(time.monotonic() - self._arrived[found.newest])
            self._arrived = {k: t for k, t in self._arrived.items() if k > found.newest}

    def performance(self) -> dict[str, Any]:
        """Return figures of speed and loss, by the keys of the line that ``torchid live`` prints."""
        self._poll()
        counts, elapsed = self._intake.counts, time.monotonic() - self._begun
        return {
            "frames": counts.frames, "lost": counts.lost, "again": counts.again, "late": counts.late,
            "restarts": counts.restarts,
            "fps": round(counts.frames / max(elapsed, 1e-9), 1),
            "latency_ms": {
                "pose": _quantiles(self._latency_s),
                "parameters": {"delay_ms": round(1e3 * (LAG_PERIODS / self._cutoff_hz + BLOCK_S), 1),
                               **_quantiles(self._parameters_s)},
            },
            "backlog": self._beside.sent - self._beside.done,
            "notices": [
                {"what": what, "where": where, "from_s": round(since, 2), "to_s": round(until, 2)}
                for (what, where), (since, until) in {**self._beside.noted, **self._stamps.noted}.items()
            ],
            **({} if self._recorder is None else {"recording": self._recorder.table}),
        }  # fmt: skip


def _quantiles(seconds: list[float]) -> dict[str, float | None]:
    """p50 and p99 [ms]."""
    if not seconds:
        return {"p50": None, "p99": None}
    p50, p99 = 1e3 * np.quantile(seconds, (0.5, 0.99))
    return {"p50": round(float(p50), 2), "p99": round(float(p99), 2)}
