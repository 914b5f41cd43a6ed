"""Every number of an evaluation under one key, and how the report writes it: what the report says stands in the CSV.

The report gets its numbers from the ledger alone, so that none can be in it that the CSV does not have.
"""

import csv
import math
from collections.abc import Iterable
from io import StringIO
from typing import NamedTuple

from torchid.wording import number

BODIES = ("identified", "template")
"""What a number may be of: the identified body, or the scaled template with tabulated inertia."""


class Key(NamedTuple):
    """What a number is of."""

    section: str
    """measure, difference, course, cycle, contact, device, test or method."""
    statistic: str
    """mean, low, high, p, p_adjusted, ..."""
    condition: str = ""
    where: str = ""
    measure: str = ""
    body: str = "identified"
    """identified or template."""
    item: str = ""
    """Trial and number of a cycle, percent of a course, foot of a contact."""


class Ledger:
    """Numbers by key, with the texts by which they have been shown."""

    def __init__(self, numbers: Iterable[tuple[Key, float, str]]) -> None:
        """Take all numbers.

        Args:
            numbers: key, value and unit; no key twice.
        """
        self._value: dict[Key, float] = {}
        self._unit: dict[Key, str] = {}
        self._shown: dict[Key, list[str]] = {}
        for key, value, unit in numbers:
            assert key not in self._value, f"{key} is told twice"
            self._value[key], self._unit[key] = float(value), unit

    def has(self, key: Key) -> bool:
        """Whether there is a number under a key."""
        return key in self._value

    def value(self, key: Key) -> float:
        """The number under a key."""
        return self._value[key]

    def show(self, key: Key, digits: int = 1, factor: float = 1.0) -> str:
        """Text of a number, remembered for the CSV.

        Args:
            factor: by which the value is multiplied, 100 for percent.
        """
        text = number(self._value[key], digits, factor)
        texts = self._shown.setdefault(key, [])
        if text not in texts:
            texts.append(text)
        return text

    def size(self, key: Key, digits: int = 1, factor: float = 1.0) -> str:
        """Text of a number without its sign, remembered for the CSV; arguments as of ``show``."""
        sign = -1.0 if self._value[key] < 0.0 else 1.0
        return self.show(key, digits, factor * sign)

    def say(self, section: str, text: str) -> str:
        """Text that has numbers of its own, remembered for the CSV as it is."""
        key = Key(section, "text", item=str(len(self._value)))
        self._value[key], self._unit[key], self._shown[key] = math.nan, "", [text]
        return text

    def csv(self) -> str:
        """All numbers as a table: the key's columns, value, unit, and the texts of the report."""
        file = StringIO(newline="")
        write = csv.writer(file, lineterminator="\n")
        write.writerow((*Key._fields, "value", "unit", "shown"))
        for key, value in self._value.items():
            text = "" if math.isnan(value) else repr(value)
            write.writerow((*key, text, self._unit[key], "; ".join(self._shown.get(key, ()))))
        return file.getvalue()
