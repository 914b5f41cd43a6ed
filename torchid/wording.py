"""Numbers and names as a reader wants them: sensible digits, no control characters, lists that end."""

import math
import re
from collections.abc import Sequence
from typing import Any

ABSENT = "–"
"""Stands for what is not known."""
_CONTROL = re.compile(r"[\x00-\x1f\x7f-\x9f\u200e\u200f\u2028-\u202e\u2066-\u2069\ud800-\udfff\ufffe\uffff]")
_SHOWN = "\N{REPLACEMENT CHARACTER}"
_UNIT = re.compile(r"(?<=\d) (?=(?:N|mm|kg|m|Hz|s|%|°)(?![\w]))|(?<=\bN) (?=m\b)")
_NUMBER = re.compile(r"(?<![\w.])-?\d+(?:\.\d+)?(?![\w.]*\w)")


def clean(text: str, most: int = 120) -> str:
    """A name from a file without control characters and bidirectional marks, shortened in the middle."""
    text = _CONTROL.sub(_SHOWN, str(text))
    return text if len(text) <= most else f"{text[: most - 12]}…{text[-11:]}"


def visible(text: str) -> str:
    """Lines for a terminal, with what it would obey instead of show as U+FFFD: escapes, bells, marks of direction."""
    return "\n".join(_CONTROL.sub(_SHOWN, line) for line in text.split("\n"))


def number(value: Any, digits: int = 1, factor: float = 1.0) -> str:
    """``factor * value`` with fixed decimals and a true minus sign; an en dash where there is no number."""
    if value is None or not math.isfinite(float(value)):
        return ABSENT
    text = f"{factor * float(value):.{digits}f}"
    if float(text) == 0.0:
        text = text.lstrip("-")
    return text.replace("-", "\N{MINUS SIGN}")


def spread(value: Any, sd: Any, digits: int = 1, factor: float = 1.0) -> str:
    """``value ± sd``."""
    if number(value, digits, factor) == ABSENT:
        return ABSENT
    return f"{number(value, digits, factor)} ± {number(sd, digits, factor)}"


def stated(value: Any, sd: Any, unit: str, factor: float = 1.0) -> str:
    """``5.3 ms (sd 0.3 ms)`` with as many digits as the standard deviation allows; without one, three."""
    value, sd = factor * float(value), abs(factor * float(sd))
    unit = unit if unit == "°" else f" {unit}"
    if not (math.isfinite(sd) and sd > 0.0):
        return f"{number(value, decimals(abs(value), 3))}{unit}"
    digits = decimals(sd, 2 if f"{sd:e}"[0] in "12" else 1)
    return f"{number(value, digits)}{unit} (sd {number(sd, digits)}{unit})"


def decimals(value: float, significant: int = 2) -> int:
    """Decimals that show so many significant digits of a positive number, four at most."""
    return 1 if value <= 0.0 else min(4, max(0, significant - 1 - math.floor(math.log10(value))))


def scientific(value: Any) -> str:
    """Two significant digits, with an exponent where that is shorter."""
    if value is None or not math.isfinite(float(value)):
        return ABSENT
    return f"{float(value):.2g}".replace("-", "\N{MINUS SIGN}")


def percent(value: Any, digits: int = 0) -> str:
    """A share in percent."""
    text = number(value, digits, 100.0)
    return text if text == ABSENT else f"{text} %"


def change(before: float, after: float) -> str:
    """``after`` against ``before``, in percent with its sign."""
    if not (math.isfinite(before) and math.isfinite(after)) or before == 0.0:
        return ABSENT
    share = number(after / before - 1.0, 0, 100.0)
    return f"{share if share.startswith(chr(0x2212)) or share == '0' else '+' + share} %"


def bind(text: str) -> str:
    """Text whose numbers do not part from their units at the end of a line."""
    return _UNIT.sub("\N{NO-BREAK SPACE}", text)


def listing(names: Sequence[str], most: int = 8) -> str:
    """``a, b and c``; of a long list the first ones and how many more there are."""
    names = [clean(name) for name in names]
    if len(names) > most:
        return f"{', '.join(names[: most - 1])} and {len(names) - most + 1} more"
    return " and ".join(filter(None, (", ".join(names[:-1]), names[-1]))) if names else "none"


def plural(count: int, noun: str) -> str:
    """``1 trial``, ``2 trials``."""
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"


def segment(name: str) -> str:
    """``thigh_l`` as ``left thigh``."""
    part, _, side = name.rpartition("_")
    names = {"l": "left", "r": "right"}
    return f"{names[side]} {part.replace('_', ' ')}" if part and side in names else clean(name.replace("_", " "))


def merge(messages: Sequence[str]) -> str:
    """Messages that differ only in their numbers as one, with the range of each number."""
    parts = _NUMBER.split(messages[0])
    columns = list(zip(*(_NUMBER.findall(message) for message in messages), strict=True))
    said = parts[0]
    for column, rest in zip(columns, parts[1:], strict=True):
        ordered = sorted(set(column), key=float)
        said += (ordered[0] if len(ordered) == 1 else f"{ordered[0]} to {ordered[-1]}") + rest
    return said


def pattern(message: str) -> str:
    """The message with its numbers taken out: equal for messages that ``merge`` joins."""
    return _NUMBER.sub("\x00", message)
