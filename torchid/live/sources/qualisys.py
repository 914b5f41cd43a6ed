"""Qualisys Track Manager (QTM) as a source: markers and plates of its real-time protocol, whatever becomes of it."""

import asyncio
import logging
import threading
import time
from collections import deque
from collections.abc import Awaitable
from concurrent.futures import Future
from contextlib import suppress
from types import TracebackType
from typing import Any

import torch
from qtm_rt.packet import QRTEvent, QRTPacket
from qtm_rt.protocol import QRTCommandException
from qtm_rt.qrt import QRTConnection

from torchid.errors import InputError
from torchid.live.sources.qtm_link import QtmLink, address_of
from torchid.live.sources.qtm_run import Arrival, Run
from torchid.live.sources.qtm_settings import Settings, fault, read_settings
from torchid.live.sources.stream import Packet
from torchid.recording import Forces, Markers

VERSION = "1.20"
"""Cited. The version that docs.qualisys.com/qtm-rt-protocol describes; every later QTM speaks it too."""
REPLY_S = 5.0
"""Choice. How long an answer may take, as for streams of LSL."""
SILENT_S = 1.0
"""Choice. After so long without a packet the server is asked whether it is there, and has as long to answer."""
RETRY_S = 0.5
"""Choice. Pause before it is tried to connect anew: back within a second, and no burden to who is not there."""
ANEW = {QRTEvent.EventConnected, QRTEvent.EventCaptureStarted, QRTEvent.EventRTfromFileStarted,
        QRTEvent.EventCameraSettingsChanged}  # fmt: skip
"""Cited. Events after which parameters are read again: so does QTM-Connect-For-Unity (``RTStreamThread.cs``)."""

log = logging.getLogger(__name__)


class QualisysSource:
    """Frames and force samples of one server.

    A thread of its own connects, reads the parameters, hands over what comes, and connects anew where the connection is
    lost, the server counts its frames anew, or what it sends no longer fits its parameters; they are then read again.
    Every further run goes on behind a pause, and one that does not fit the first is refused, with a warning.
    """

    def __init__(self, address: str = "") -> None:
        """Connect, and keep what comes from now on.

        Args:
            address: HOST or HOST:PORT; empty: this machine.

        Raises:
            ConfigError: ``live.source`` where that is no address.
            InputError: ``live.qualisys`` where nobody answers there, or the parameters do not tell what is needed.
        """
        self._host, self._port = address_of(address)
        self.name = f"QTM at {self._host}:{self._port}"
        self._arrivals, self._newest_s, self._said = deque[Arrival](), None, ""
        self._known, self._loop = Future[Settings](), asyncio.new_event_loop()
        self._task = self._loop.create_task(self._keep())
        self._thread = threading.Thread(target=self._work, name=self.name, daemon=True)
        self._thread.start()
        try:
            first = self._known.result()
        except BaseException:
            self.close()
            raise
        self.labels, self.rate_hz = first.labels, first.rate_hz
        self.plates, self.force_rate_hz = first.plates, first.force_rate_hz

    def take(self) -> Packet:
        """Return what arrived since the last call, perhaps nothing; never waits."""
        here = [self._arrivals.popleft() for _ in range(len(self._arrivals))]
        arrived_s = next((one.arrived_s for one in reversed(here) if len(one.time_s)), time.monotonic())
        none = torch.zeros(0, dtype=torch.float64)
        markers = Markers(
            self.labels, torch.cat([none, *(one.time_s for one in here)]),
            torch.cat([none.reshape(0, len(self.labels), 3), *(one.position for one in here)]),
        )  # fmt: skip
        forces = Forces(
            torch.cat([none, *(one.sample_s for one in here)]),
            torch.cat([none.reshape(0, len(self.plates), 6), *(one.wrench for one in here)]), self.plates,
        )  # fmt: skip
        return Packet(markers, forces, arrived_s)

    def close(self) -> None:
        """Leave the server."""
        with suppress(RuntimeError):  # it has ended by itself
            self._loop.call_soon_threadsafe(self._task.cancel)
        self._thread.join()

    def __enter__(self) -> "QualisysSource":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _work(self) -> None:
        with suppress(asyncio.CancelledError):
            self._loop.run_until_complete(self._task)
        self._loop.run_until_complete(self._loop.shutdown_default_executor())
        self._loop.close()

    async def _keep(self) -> None:
        """Run after run; a first one that fails is the caller's to hear of."""
        while True:
            try:
                await self._run()
            except Exception as error:
                if not self._known.done():
                    self._known.set_exception(error)
                    return
                if str(error) != self._said:
                    log.warning("not connected: %s", error)
                self._said = str(error)
            await asyncio.sleep(RETRY_S)

    async def _run(self) -> None:
        """One connection, until it is lost.

        Raises:
            InputError: ``live.qualisys``, with the reason.
        """
        link = await self._link()
        try:
            server = QRTConnection(link, REPLY_S)
            await self._answer(link.set_version(VERSION))
            settings = read_settings(await self._answer(server.get_parameters(["general", "3d", "force"])), self.name)
            first = self._known.result() if self._known.done() else settings
            run, streams = Run(settings.fitting(first), first.labels, self._newest_s), True
            link.on_event = lambda event: self._event(link, run, event)
            try:
                await server.stream_frames("allframes", ["3d", "force"], lambda packet: self._take(run, packet))
            except TimeoutError:
                streams = False  # as long as nothing is measured
            except QRTCommandException as error:
                raise self._refused(error) from error
            if self._known.done():
                log.warning("%s is back", self.name)
            else:
                self._known.set_result(settings)
            self._said = ""
            await self._listen(link, server if streams else None)
        finally:
            link.end(fault(self.name, "is left", "by torchid", "Nothing needs to be done"))
            await asyncio.sleep(0)  # in which the socket is closed

    async def _link(self) -> QtmLink:
        try:
            connected = self._loop.create_connection(lambda: QtmLink(self._loop, self.name), self._host, self._port)
            return (await asyncio.wait_for(connected, REPLY_S))[1]
        except OSError as error:
            raise fault(
                self.name, "no answer", str(error),
                "Start QTM, see which port it streams from (Project options, Real-time output: base port + 1) and "
                "whether a firewall is between, and give --source qualisys:HOST:PORT",
            ) from error  # fmt: skip

    async def _answer(self, asked: Awaitable[Any], seconds: float = REPLY_S) -> bytes:
        try:
            answer = await asyncio.wait_for(asked, seconds)
        except QRTCommandException as error:
            raise self._refused(error) from error
        except TimeoutError as error:
            raise fault(self.name, "does not answer", f"nothing for {seconds:g} s",
                        "Look whether it is QTM that listens there") from error  # fmt: skip
        return answer if isinstance(answer, bytes) else b""

    def _refused(self, error: QRTCommandException) -> InputError:
        return fault(self.name, "refuses", str(error), "Start a preview or a measurement in QTM, or play a file with "
                     "real-time output; see how many clients it admits")  # fmt: skip

    def _take(self, run: Run, packet: QRTPacket) -> None:
        self._arrivals.append(run.take(packet))
        self._newest_s = run.newest_s

    def _event(self, link: QtmLink, run: Run, event: QRTEvent) -> None:
        if event in ANEW and run.begun:
            link.end(fault(self.name, "begins anew", event.name, "Nothing needs to be done"))

    async def _listen(self, link: QtmLink, server: QRTConnection | None) -> None:
        """Wait until the connection is lost; where it is silent, ask whether the server is there."""
        while not (await asyncio.wait({link.lost}, timeout=SILENT_S))[0]:
            if server is not None and time.monotonic() - link.heard_s > SILENT_S:
                await self._answer(server.qtm_version(), SILENT_S)
        raise link.lost.result()
