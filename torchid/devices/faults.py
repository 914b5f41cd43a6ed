"""Errors of a device's sheet, and its numbers as values."""

from pathlib import Path
from typing import Any

from torchid.devices.sheet import VectorWithSd, WithSd
from torchid.devices.values import Number, SheetValue
from torchid.errors import ConfigError


def fault(code: str, message: str, source: str | Path, place: str = "", found: str = "", *, remedy: str) -> ConfigError:
    """Return the error ``device.<code>`` of a place of a sheet."""
    return ConfigError(f"device.{code}", message, source=source, place=place, found=found, remedy=remedy)


def number(text: Any) -> Number:
    """Return a number of a sheet; None where it is unknown."""
    if text == "unknown":
        return None
    return SheetValue(text.value, text.sd) if isinstance(text, WithSd) else SheetValue(float(text))


def vector(text: Any) -> tuple[SheetValue, SheetValue, SheetValue] | None:
    """Return a vector of a sheet; None where it is unknown."""
    if text == "unknown":
        return None
    values, sd = (text.value, text.sd) if isinstance(text, VectorWithSd) else (text, 0.0)
    spread = sd if isinstance(sd, tuple) else (sd, sd, sd)
    x, y, z = (SheetValue(float(v), float(s)) for v, s in zip(values, spread, strict=True))
    return x, y, z
