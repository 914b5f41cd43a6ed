"""Damage to C3D files: to header words, to parameter records, to the numbers, to the bytes."""

import struct
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

BLOCK = 512
WORDS = ("signature", "points", "analog per frame", "first frame", "last frame", "gap", "scale", "scale", "data block",
         "ratio", "rate", "rate")  # fmt: skip
COUNTS = (0, 1, 2, 7, 255, 256, 32767, 32768, 65535)
REALS = (0.0, -1.0, 1.0, 1e-3, 1e3, 1e30, -1e30, 1e-30, np.nan, np.inf, -np.inf)
FACTORS = (-1.0, 0.1, 10.0, 1e-3, 1e3, 1.01, 0.5, 2.0)

LAST = 300
"""Bytes at the end of a file that hold its last numbers."""

Random = np.random.Generator


@dataclass(frozen=True)
class Damaged:
    """A damaged file and what was done to it."""

    content: bytes
    how: str
    place: str


@dataclass(frozen=True)
class Record:
    """Where one record of the parameter section lies."""

    name: str
    start: int
    end: int
    kind: int
    value: int
    """Where its value begins; its end for a group."""


def damage_c3d(content: bytes, random: Random) -> Damaged:
    """One damage in three quarters of all files, else a few."""
    ways = (_header, _parameter, _parameter, _record, _number, _bytes, _frames)
    return repeated(content, random, lambda data: ways[random.integers(len(ways))](data, random))


def repeated(content: bytes, random: Random, once: Callable[[bytes], Damaged]) -> Damaged:
    """``once`` a few times."""
    count = 1 if random.random() < 0.75 else int(random.integers(2, 5))
    done = [Damaged(content, "", "")]
    for _ in range(count):
        done.append(once(done[-1].content))
    kinds, places = (sorted({getattr(one, name) for one in done[1:]}) for name in ("how", "place"))
    return Damaged(done[-1].content, " + ".join(kinds), " + ".join(places))


def cut(content: bytes, random: Random) -> Damaged:
    """The file's beginning; a third of the cuts lie in its last row or block."""
    at = int(random.integers(max(0, len(content) - LAST) if random.random() < 1 / 3 else 0, len(content)))
    return Damaged(content[:at], "cut", f"{10 * at // max(1, len(content))}0 %")


def records(data: bytes) -> tuple[str, list[Record]]:
    """Byte order and the records of the parameter section, as far as they can be followed."""
    begin = max(0, data[0] - 1) * BLOCK if data else 0
    order = ">" if data[begin + 3 : begin + 4] == b"\x56" else "<"
    found, groups, at = [], {}, begin + 4
    while at + 4 < len(data) and len(found) < 400:
        length, group = struct.unpack("bb", data[at : at + 2])
        after = at + 2 + abs(length)
        if length == 0 or after + 4 > len(data):
            break
        name = data[at + 2 : after].decode("ascii", "replace")
        step = struct.unpack(order + "H", data[after : after + 2])[0]
        end = after + step
        if step == 0 or end > len(data):
            break
        if group < 0:
            groups[-group] = name
            found.append(Record(name, at, end, 0, end))
        else:
            kind, dims = struct.unpack("bB", data[after + 2 : after + 4])
            found.append(Record(f"{groups.get(group, group)}:{name}", at, end, kind, after + 4 + dims))
        at = end
    return order, found


def _header(data: bytes, random: Random) -> Damaged:
    order, _ = records(data)
    word = int(random.choice([0, 1, 2, 3, 4, 6, 8, 9, 10]))
    at = 2 * word
    if WORDS[word] in ("scale", "rate"):
        return Damaged(_real(data, at, order, random), "real", f"header {WORDS[word]}")
    return Damaged(_integer(data, at, 2, order, random), "integer", f"header {WORDS[word]}")


def _parameter(data: bytes, random: Random) -> Damaged:
    """Another value in a parameter."""
    order, found = records(data)
    found = [one for one in found if one.kind in (-1, 1, 2, 4) and one.value < one.end - 1]
    if not found:
        return _bytes(data, random)
    one = found[random.integers(len(found))]
    size = abs(one.kind)
    at = one.value + size * int(random.integers(max(1, (one.end - 1 - one.value) // size)))
    if one.kind == 4:
        return Damaged(_real(data, at, order, random), "real", one.name)
    if one.kind == 2:
        return Damaged(_integer(data, at, 2, order, random), "integer", one.name)
    letter = bytes([int(random.choice([*b" AXLR0159#*:._\0\xff"]))])
    return Damaged(data[:at] + letter + data[at + 1 :], "letter", one.name)


def _record(data: bytes, random: Random) -> Damaged:
    """A record deleted, doubled, exchanged with the next, or with another head."""
    _, found = records(data)
    if len(found) < 2:
        return _bytes(data, random)
    k = int(random.integers(len(found) - 1))
    one, after = found[k], found[k + 1]
    body, behind = data[one.start : one.end], data[after.start : after.end]
    way = ("delete", "double", "exchange", "head")[random.integers(4)]
    if way == "head":
        at = int(random.integers(one.start, max(one.start + 1, min(one.value, one.end))))
        return Damaged(_integer(data, at, 1, "<", random), "record head", one.name)
    new = {"delete": behind, "double": body + body + behind, "exchange": behind + body}[way]
    return Damaged(_same_size(data, one.start, after.end, new), f"record {way}", one.name)


def _same_size(data: bytes, start: int, end: int, new: bytes) -> bytes:
    """``new`` in place of data[start:end]; the parameter section keeps its length, as its writer would see to."""
    stop = _section_end(data)
    if stop < end:
        return data[:start] + new + data[end:]
    section = (data[:start] + new + data[end:stop])[:stop].ljust(stop, b"\0")
    return section + data[stop:]


def _section_end(data: bytes) -> int:
    begin = max(0, data[0] - 1) * BLOCK
    return begin + data[begin + 2] * BLOCK if begin + 2 < len(data) else len(data)


def _number(data: bytes, random: Random) -> Damaged:
    """One stored number of the data section."""
    order, _ = records(data)
    begin = min(_section_end(data), len(data))
    real = data[12 + (order == "<") : 14 + (order == "<")] and data[13 if order == "<" else 12] & 0x80
    size = 4 if real else 2
    count = (len(data) - begin) // size
    if count < 1:
        return _bytes(data, random)
    at = begin + size * int(random.integers(count))
    return Damaged(_real(data, at, order, random) if real else _integer(data, at, 2, order, random), "number", "data")


def _frames(data: bytes, random: Random) -> Damaged:
    """A piece of the data section deleted, doubled or exchanged with the next, of a whole frame's size if that fits."""
    begin = min(_section_end(data), len(data))
    order, _ = records(data)
    words = struct.unpack(order + "10H", data[:20].ljust(20, b"\0"))
    size = max(1, (4 * words[1] + words[2]) * (4 if data[13 if order == "<" else 12] & 0x80 else 2))
    count = (len(data) - begin) // size
    if count < 3:
        return _bytes(data, random)
    at = begin + size * int(random.integers(count - 2))
    return _piece(data, at, size, random, "frame", "data")


def _bytes(data: bytes, random: Random) -> Damaged:
    """Some bytes: another value, deleted, doubled, exchanged with the next; half of them in the first blocks."""
    if not data:
        return Damaged(b"\x02\x50", "made", "nothing left")
    end = len(data) if random.random() < 0.5 else min(len(data), 4 * BLOCK)
    at, size = int(random.integers(end)), int(random.choice([1, 1, 1, 2, 4, 16, 64, 512]))
    place = "header" if at < BLOCK else "parameters" if at < _section_end(data) else "data"
    if random.random() < 0.6:
        new = random.integers(0, 256, len(data[at : at + size]), np.uint8).tobytes()
        return Damaged(data[:at] + new + data[at + size :], "bytes", place)
    return _piece(data, at, size, random, "bytes", place)


def _piece(data: bytes, at: int, size: int, random: Random, what: str, place: str) -> Damaged:
    one, two = data[at : at + size], data[at + size : at + 2 * size]
    way = ("delete", "double", "exchange")[random.integers(3)]
    new = {"delete": two, "double": one + one + two, "exchange": two + one}[way]
    return Damaged(data[:at] + new + data[at + 2 * size :], f"{what} {way}", place)


def _integer(data: bytes, at: int, size: int, order: str, random: Random) -> bytes:
    code = order + ("H" if size == 2 else "B")
    old = struct.unpack(code, data[at : at + size].ljust(size, b"\0"))[0]
    near = (old + 1, old - 1, 2 * old, old // 2, -old, old ^ (1 << int(random.integers(8 * size))))
    new = int(random.choice([*near, *COUNTS])) % (1 << (8 * size))
    return data[:at] + struct.pack(code, new) + data[at + size :]


def _real(data: bytes, at: int, order: str, random: Random) -> bytes:
    """Another real; DEC's words are left as they are, so that its values are just others."""
    old = struct.unpack(order + "f", data[at : at + 4].ljust(4, b"\0"))[0]
    factor = float(random.choice(FACTORS))
    with np.errstate(over="ignore", invalid="ignore"):
        new = np.float32(old * factor if random.random() < 0.7 else random.choice(REALS))
    return data[:at] + struct.pack(order + "f", new) + data[at + 4 :]
