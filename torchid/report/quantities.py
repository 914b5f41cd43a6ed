"""Sizes of named causes in words: as many digits as their standard deviations allow, directions by name."""

import torch
from torch import Tensor

from torchid.diagnosis.verdict.records import Cause
from torchid.report.text import decimals, listing, number, stated

BODY = (("forward", "back"), ("left", "right"), ("up", "down"))
ROOM = tuple((f"along {axis}", f"against {axis}") for axis in "xyz")
"""Directions along the axes of a segment and of the laboratory, and against them."""


def of(cause: Cause, key: str) -> tuple[Tensor, Tensor]:
    """A parameter's value and standard deviation, both flat."""
    entry = cause.parameters[key]
    value, sd = (torch.as_tensor(entry[k], dtype=torch.float64).reshape(-1) for k in ("value", "sd"))
    return value, sd.expand_as(value)


def size(cause: Cause, key: str, unit: str, factor: float = 1.0) -> str:
    """A scalar with its standard deviation."""
    value, sd = of(cause, key)
    return stated(value[0], sd[0], unit, factor)


def length(value: Tensor, sd: Tensor, unit: str, factor: float = 1.0) -> str:
    """Length of a vector; its standard deviation along the vector, components independent."""
    norm = value.norm()
    spread = (value / norm.clamp(min=1e-12) * sd).norm()
    return stated(norm, spread, unit, factor)


def vector(cause: Cause, key: str, unit: str, factor: float, words: tuple[tuple[str, str], ...]) -> str:
    """Length of a vector, then its components in words."""
    value, sd = of(cause, key)
    shown = parts(value, sd, unit, factor, words)
    return length(value, sd, unit, factor) + (f", that is {shown}" if shown else "")


def parts(value: Tensor, sd: Tensor, unit: str, factor: float, words: tuple[tuple[str, str], ...]) -> str:
    """Components in words; those that are not known from zero, or that nobody would see, are left out."""
    digits = decimals(factor * float(sd.max()), 1) if float(sd.max()) > 0.0 else decimals(factor * float(value.norm()))
    least = 0.05 * float(value.norm())
    said = [
        f"{number(abs(v), digits, factor)} {unit} {pair[v < 0.0]}"
        for v, s, pair in zip(value.tolist(), sd.tolist(), words, strict=True)
        if abs(v) > max(least, s)
    ]
    return listing(said) if said else ""


def much(cause: Cause, key: str, words: tuple[str, str] = ("much", "little")) -> str:
    """A factor's distance from one, in words for above and below it."""
    value, sd = of(cause, key)
    more = float(value[0]) - 1.0
    return f"{stated(abs(more), sd[0], '%', 100.0)} too {words[more < 0.0]}"
