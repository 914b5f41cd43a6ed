"""Errors a user can act on: each says what, where, what was found and what to do."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any


@dataclass(frozen=True)
class Note:
    """Something a stage noticed or changed that the user must hear of; collected in ``warnings[]`` of the results."""

    code: str
    message: str
    source: str = ""
    """File, trial or marker it concerns."""

    def __str__(self) -> str:
        return f"{self.source}: {self.message} [{self.code}]" if self.source else f"{self.message} [{self.code}]"


class TorchidError(Exception):
    """Base of every error that torchid raises on purpose.

    Args:
        code: short dotted name, stable across versions, such as ``c3d.truncated``.
        message: what is wrong.
        source: the file or config key at fault.
        place: where inside it (parameter, byte, line, column).
        found: what was found there.
        remedy: what the user can do.
    """

    exit_code = 2

    def __init__(
        self, code: str, message: str, *, source: str | Path = "", place: str = "", found: str = "", remedy: str
    ) -> None:
        self.code, self.message = code, message
        self.source, self.place, self.found, self.remedy = str(source), place, found, remedy
        super().__init__(str(self))

    def __reduce__(self) -> tuple[Any, ...]:
        # An exception is made again from what str() says of it, which is none of the arguments of these.
        return _restored, (type(self), self.args), self.__dict__

    def __str__(self) -> str:
        where = ", ".join(part for part in (self.source, self.place) if part)
        text = f"{where}: {self.message}" if where else self.message
        if self.found:
            text += f" (found: {self.found})"
        if self.remedy:
            text += f". {self.remedy}"
        return f"{text} [{self.code}]"


def _restored(kind: type[TorchidError], said: tuple[str, ...]) -> TorchidError:
    """Make an error of another process, which gets its attributes then."""
    return kind.__new__(kind, *said)


class InputError(TorchidError):
    """A file cannot be read or contradicts itself."""


class ConfigError(TorchidError):
    """The config asks for something that does not exist or cannot be."""


class OptionError(ConfigError, ValueError):
    """An option of a stage cannot be; a ValueError, so that the config lists it among its other faults."""


class DataError(TorchidError):
    """The files are sound, but they do not support a result."""

    exit_code = 3


def said_of_defect(error: Exception) -> str:
    """Return the kind and the words of an error that is none of torchid's own, in one line of at most 400 characters.

    Args:
        error: any but a ``TorchidError``.
    """
    return " ".join(f"{type(error).__name__}: {error}".split())[:400]
