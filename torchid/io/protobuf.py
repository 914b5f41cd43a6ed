"""Protocol Buffers' wire format (https://protobuf.dev/programming-guides/encoding): a message's fields by number."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from torchid.errors import InputError

VARINT, FIXED64, BYTES, FIXED32 = 0, 1, 2, 5
FIXED = {FIXED64: 8, FIXED32: 4}
"""Bytes of values of a fixed size."""
WIDEST = 10
"""Bytes of the longest whole number, of 64 bits."""


@dataclass(frozen=True)
class WireField:
    """One field as it stands in a message."""

    number: int
    wire: int
    """How it is stored: a varint, a value of fixed size, or bytes."""
    start: int
    stop: int
    """Where its value stands in the message."""


def walk(data: bytes, source: str) -> Iterator[WireField]:
    """The fields of a message, in their order.

    Raises:
        InputError: ``protobuf.damaged`` where the bytes are no message.
    """
    at = 0
    while at < len(data):
        key, start = varint(data, at, source)
        number, wire = key >> 3, key & 7
        if wire == VARINT:
            _, stop = varint(data, start, source)
        elif wire == BYTES:
            size, start = varint(data, start, source)
            stop = start + size
        else:
            stop = start + FIXED.get(wire, len(data) + 1)
        if not number or stop > len(data):
            raise _damaged(at, source)
        yield WireField(number, wire, start, stop)
        at = stop


def varint(data: bytes, at: int, source: str) -> tuple[int, int]:
    """A whole number of seven bits in each byte, and where the next value stands; errors as ``walk``."""
    value = 0
    for k, byte in enumerate(data[at : at + WIDEST]):
        value |= (byte & 0x7F) << (7 * k)
        if byte < 0x80:
            return value, at + k + 1
    raise _damaged(at, source)


def _damaged(at: int, source: str) -> InputError:
    return InputError(
        "protobuf.damaged", "the file is damaged: its bytes are no message", source=source, place=f"byte {at} of it",
        remedy="Download or export the file again",
    )  # fmt: skip


class Message:
    """A message's values by the numbers of its fields; those that are absent are zero or empty, as of proto3."""

    def __init__(self, data: bytes, source: str) -> None:
        """Errors as ``walk``."""
        self._data, self._source = data, source
        self._fields: dict[int, list[WireField]] = {}
        for field in walk(data, source):
            self._fields.setdefault(field.number, []).append(field)

    def _stored(self, number: int, *wires: int) -> list[bytes]:
        """The values of a field that are stored in one of these ways."""
        return [self._data[one.start : one.stop] for one in self._fields.get(number, []) if one.wire in wires]

    def whole(self, number: int) -> int:
        """A whole number of 32 bits, with its sign."""
        stored = self._stored(number, VARINT)
        value = varint(stored[-1], 0, self._source)[0] & 0xFFFFFFFF if stored else 0
        return value - (value >> 31 << 32)

    def wholes(self, number: int) -> list[int]:
        """Whole numbers of a list, packed or one by one."""
        values = []
        for part in self._stored(number, BYTES, VARINT):
            at = 0
            while at < len(part):
                value, at = varint(part, at, self._source)
                values.append(value)
        return values

    def doubles(self, number: int) -> Float[np.ndarray, " values"]:
        """Numbers of a list, packed or one by one; one number alone is a list, too."""
        stored = b"".join(self._stored(number, BYTES, FIXED64))
        return np.frombuffer(bytearray(stored[: len(stored) // 8 * 8]), "<f8")

    def texts(self, number: int) -> list[str]:
        """Texts of a list."""
        return [part.decode("utf-8", "replace") for part in self._stored(number, BYTES)]

    def text(self, number: int) -> str:
        """A text."""
        return next(reversed(self.texts(number)), "")

    def messages(self, number: int) -> list["Message"]:
        """Messages of a list; errors as ``walk``."""
        return [Message(part, self._source) for part in self._stored(number, BYTES)]
