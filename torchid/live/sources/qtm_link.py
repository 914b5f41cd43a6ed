"""A connection to Qualisys Track Manager (QTM): its address, and packets that are whole and can be packets."""

import asyncio
import struct
import time
from typing import Any
from urllib.parse import urlsplit

from qtm_rt.protocol import QTMProtocol

from torchid.errors import ConfigError, InputError
from torchid.live.sources.qtm_settings import fault

HOST, PORT = "127.0.0.1", 22223
"""Cited. Where QTM listens for little-endian clients: RT protocol, "IP port numbers" (base port + 1)."""
LARGEST = 1 << 24
"""Choice. Bytes of a packet: the parameters of a large laboratory have a hundredth, and text that is read as a size has
more."""
HEADER, DATA, DATA_HEADER = struct.Struct("<II"), 3, struct.Struct("<IIqII")
"""Cited. Size and type of a packet; the type of data; then stamp, frame and number of components (RT protocol)."""


class QtmLink(QTMProtocol):
    """A connection that a packet which cannot be one ends, instead of being waited for or read for ever."""

    def __init__(self, loop: asyncio.AbstractEventLoop, source: str) -> None:
        """Wait to be connected.

        Args:
            loop: in which it lives.
        """
        super().__init__(loop=loop)
        self.lost: asyncio.Future[InputError] = loop.create_future()
        self.heard_s = time.monotonic()
        self._source, self._rest, self._why = source, b"", None

    def send_command(self, *words: Any, **options: Any) -> asyncio.Future[Any]:
        """Return the answer to a command, when it comes.

        Args:
            words: the command, and what ``QTMProtocol`` takes with it.
            options: the same.

        Raises:
            InputError: ``live.qualisys`` where the connection is lost.
        """
        if self.lost.done():
            raise self.lost.result()
        return super().send_command(*words, **options)

    def data_received(self, data: bytes) -> None:
        """Read every packet that is whole."""
        self.heard_s, self._rest = time.monotonic(), self._rest + data
        try:
            while self._why is None and (packet := self._packet()):
                super().data_received(packet)
        except InputError as error:
            self.end(error)
        except Exception as error:  # whatever a packet that is none does to qtm_rt
            self.end(self._nonsense(f"{type(error).__name__}: {error}"))

    def connection_lost(self, exc: Exception | None) -> None:
        """Tell all who wait for an answer.

        Args:
            exc: what happened; None where the server has left.
        """
        super().connection_lost(exc)
        why = self._why or fault(self._source, "is lost", str(exc or "closed by the server"), "Look whether QTM runs")
        for waiting in self.request_queue:
            if not waiting.done():
                waiting.set_exception(why)
        self.lost.set_result(why)

    def end(self, why: InputError) -> None:
        """Leave the server.

        Args:
            why: told to all who wait for an answer.
        """
        self._why = why
        if isinstance(self.transport, asyncio.Transport):
            self.transport.abort()

    def _packet(self) -> bytes:
        """The next packet, nothing where it is not whole yet."""
        if len(self._rest) < HEADER.size:
            return b""
        size, kind = HEADER.unpack_from(self._rest)
        if not HEADER.size <= size <= LARGEST:
            raise self._nonsense(f"a packet of {size} bytes")
        packet = self._rest[:size]
        if len(packet) < size:
            return b""
        if kind == DATA and size < DATA_HEADER.size + HEADER.size * DATA_HEADER.unpack_from(packet)[-1]:
            raise self._nonsense("more components than a packet holds")
        self._rest = self._rest[size:]
        return packet

    def _nonsense(self, found: str) -> InputError:
        return fault(self._source, "does not speak QTM's protocol", found,
                     "Give the port for little-endian clients, 22223 unless QTM's base port was changed")  # fmt: skip


def address_of(text: str) -> tuple[str, int]:
    """Return host and port.

    Args:
        text: HOST or HOST:PORT, an IPv6 address in brackets; empty: this machine.

    Raises:
        ConfigError: ``live.source`` where it is neither.
    """
    try:
        parts = urlsplit(f"//{text}")
        if parts.netloc != text:
            raise ValueError(f"no address, but {text}")
        return parts.hostname or HOST, parts.port or PORT
    except ValueError as error:
        raise ConfigError(
            "live.source", "is no address", place="--source", found=f"{text[:80]} ({error})",
            remedy="Give qualisys, qualisys:HOST or qualisys:HOST:PORT, an IPv6 address in brackets",
        ) from error  # fmt: skip
