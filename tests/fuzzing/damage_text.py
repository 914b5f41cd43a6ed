"""Damage to TRC, MOT and STO: to digits, cells, rows, columns, the header, the bytes."""

import re

import numpy as np

from fuzzing.damage_bytes import Damaged, Random, repeated

CELLS = ("", " ", "nan", "NaN", "inf", "-inf", "1e400", "1e30", "-1e5", "1e-320", "0", "x", "1,5", "0x10", "1_000",
         "--1", "9999999", "999999", "1.#QNAN")  # fmt: skip
NUMBER = re.compile(r"[-+]?\d+\.?\d*(?:[eE][-+]?\d+)?")


def damage_text(content: bytes, random: Random) -> Damaged:
    """One damage in three quarters of all files, else a few."""
    ways = (_digit, _digit, _cell, _cell, _row, _column, _header, _raw)
    return repeated(content, random, lambda data: ways[random.integers(len(ways))](data, random))


def changed_number(text: str, random: Random) -> tuple[str, str]:
    """The number with another digit, sign, exponent, point or size; and which of them."""
    digits = [k for k, letter in enumerate(text) if letter.isdigit()]
    way = ("digit", "sign", "exponent", "point", "digit lost", "digit doubled")[random.integers(6)]
    k = digits[random.integers(len(digits))] if digits else 0
    new = {
        "digit": lambda: f"{text[:k]}{random.integers(10)}{text[k + 1 :]}",
        "sign": lambda: text[1:] if text[:1] in ("-", "+") else "-" + text,
        "exponent": lambda: f"{text}e{random.integers(-9, 10)}",
        "point": lambda: text.replace(".", "", 1) if "." in text else f"{text[:k]}.{text[k:]}",
        "digit lost": lambda: text[:k] + text[k + 1 :],
        "digit doubled": lambda: text[: k + 1] + text[k:],
    }[way]()
    return new, way


def _lines(data: bytes) -> tuple[list[str], int]:
    """Lines, and the number of the first row of numbers."""
    lines = data.decode("latin-1").split("\n")
    first = next((k for k, line in enumerate(lines) if k > 3 and re.match(r"\s*[-\d]", line)), len(lines) - 1)
    return lines, first


def _joined(lines: list[str]) -> bytes:
    return "\n".join(lines).encode("latin-1")


def _pick(lines: list[str], first: int, random: Random) -> int:
    return int(random.integers(first, max(first + 1, len(lines) - 1)))


def _spot(k: int, column: int, first: int, lines: list[str]) -> str:
    """Column's part of a place: the clock's columns, or the data's."""
    row = "first row" if k == first else "last row" if k >= len(lines) - 2 else "row"
    return f"{row}, {('column 1', 'column 2')[column] if column < 2 else 'column'}"


def _digit(data: bytes, random: Random) -> Damaged:
    lines, first = _lines(data)
    k = _pick(lines, first, random)
    found = list(NUMBER.finditer(lines[k]))
    if not found:
        return _raw(data, random)
    column = int(random.integers(len(found)))
    new, way = changed_number(found[column][0], random)
    place = _spot(k, column, first, lines)
    lines[k] = lines[k][: found[column].start()] + new + lines[k][found[column].end() :]
    return Damaged(_joined(lines), f"number's {way}", place)


def _cell(data: bytes, random: Random) -> Damaged:
    """A cell replaced, deleted, doubled, or exchanged with the next."""
    lines, first = _lines(data)
    k = _pick(lines, first, random)
    cells = lines[k].split("\t")
    at = int(random.integers(len(cells)))
    place = _spot(k, at, first, lines)
    way = ("replace", "replace", "delete", "double", "exchange")[random.integers(5)]
    one, two = cells[at : at + 1], cells[at + 1 : at + 2]
    cells[at : at + 2] = {
        "replace": [str(random.choice(CELLS)), *two], "delete": two, "double": one + one + two, "exchange": two + one,
    }[way]  # fmt: skip
    lines[k] = "\t".join(cells)
    return Damaged(_joined(lines), f"cell {way}", place)


def _row(data: bytes, random: Random) -> Damaged:
    lines, first = _lines(data)
    k = _pick(lines, first, random)
    way = ("delete", "double", "exchange", "split", "blank")[random.integers(5)]
    one, two = lines[k], lines[k + 1 : k + 2]
    half = len(one) // 2
    place = _spot(k, 9, first, lines)
    lines[k : k + 2] = {
        "delete": two, "double": [one, one, *two], "exchange": [*two, one], "split": [one[:half], one[half:], *two],
        "blank": ["\t" * one.count("\t"), *two],
    }[way]  # fmt: skip
    return Damaged(_joined(lines), f"row {way}", place)


def _column(data: bytes, random: Random) -> Damaged:
    """A column deleted, doubled or exchanged with the next in all rows, with its name or without."""
    lines, first = _lines(data)
    at = int(random.integers(max(1, lines[first].count("\t"))))
    way = ("delete", "double", "exchange")[random.integers(3)]
    named = bool(random.random() < 0.5)
    for k in range(first - (1 if named else 0), len(lines)):
        cells = lines[k].split("\t")
        one, two = cells[at : at + 1], cells[at + 1 : at + 2]
        cells[at : at + 2] = {"delete": two, "double": one + one + two, "exchange": two + one}[way]
        lines[k] = "\t".join(cells)
    return Damaged(_joined(lines), f"column {way}{' with its name' if named else ''}", "all rows")


def _header(data: bytes, random: Random) -> Damaged:
    """A word or line of the header: lost, doubled, exchanged, or with another number."""
    lines, first = _lines(data)
    k = int(random.integers(max(1, first)))
    words = re.split(r"([\t =]+)", lines[k])
    at = 2 * int(random.integers((len(words) + 1) // 2))
    way = ("lost", "doubled", "number", "letter", "line lost", "line doubled")[random.integers(6)]
    place = f"header line {k + 1}"
    if way.startswith("line"):
        lines[k : k + 1] = [] if way == "line lost" else [lines[k], lines[k]]
        return Damaged(_joined(lines), f"header {way}", place)
    word = words[at]
    match = NUMBER.search(word)
    if way == "number" and match:
        word = word[: match.start()] + changed_number(match[0], random)[0] + word[match.end() :]
    elif way == "letter" and word:
        j = int(random.integers(len(word)))
        word = word[:j] + str(random.choice([*"aXz_ :#1"])) + word[j + 1 :]
    else:
        word = {"lost": "", "doubled": word + word}.get(way, word + "x")
    words[at] = word
    lines[k] = "".join(words)
    return Damaged(_joined(lines), f"header word {way}", place)


def _raw(data: bytes, random: Random) -> Damaged:
    """Some bytes: other ones, lost, doubled or exchanged; an encoding; other line ends."""
    if not data:
        return Damaged(b"\n", "made", "nothing left")
    at, size = int(random.integers(len(data))), int(random.choice([1, 1, 2, 8, 60, 400]))
    one, two, head, tail = data[at : at + size], data[at + size : at + 2 * size], data[:at], data[at + 2 * size :]
    way = ("bytes", "delete", "double", "exchange", "marked", "UTF-16", "line ends", "NUL")[random.integers(8)]
    letters = np.frombuffer(b"0123456789.-e\t\n x,\xff\x00", np.uint8)
    new = {
        "bytes": lambda: head + random.choice(letters, len(one)).tobytes() + two + tail,
        "delete": lambda: head + two + tail,
        "double": lambda: head + one + one + two + tail,
        "exchange": lambda: head + two + one + tail,
        "marked": lambda: b"\xef\xbb\xbf" + data,
        "UTF-16": lambda: data.decode("latin-1").encode("utf-16"),
        "line ends": lambda: data.replace(b"\n", b"\r"),
        "NUL": lambda: head + b"\0" * size + one + two + tail,
    }[way]()
    return Damaged(new, f"raw {way}", "anywhere")
