"""Sizes of findings in words: as many digits as their standard deviations allow, directions by name."""

import math
from collections.abc import Mapping
from typing import Protocol, runtime_checkable

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.effects.place import Place
from torchid.wording import decimals, listing, number, stated

BODY = (("forward", "back"), ("left", "right"), ("up", "down"))
ROOM = tuple((f"along {axis}", f"against {axis}") for axis in "xyz")
"""Directions along the axes of a segment and of the laboratory, and against them."""
DEGREES = 180.0 / math.pi
"""Wording. Degrees of a radian."""
UNITS = (
    ("gain", "1", "%", 1e2), ("excess", "1", "%", 1e2), ("matrix_plate", "1", "%", 1e2),
    ("rate_plate", "N/s", "N/s", 1.0), ("_Nms", "N m s", "N m s", 1.0), ("_Ns_m", "N s/m", "N s/m", 1.0),
    ("_N_m", "N/m", "N/m", 1.0), ("_Nm", "N m", "N m", 1.0), ("_N", "N", "N", 1.0), ("_kg", "kg", "kg", 1.0),
    ("_rad", "rad", "°", DEGREES), ("_s", "s", "ms", 1e3), ("_m", "m", "mm", 1e3),
)  # fmt: skip
"""Wording. Units of parameters by the ends of their keys, units that people read, and factors from one to the other."""


def units_of(key: str) -> tuple[str, str, float]:
    """Return the unit of a parameter, the unit that people read, and the factor between; an unknown one as the key has
    it.

    Args:
        key: key of the parameter, which ends in its unit.
    """
    last = key.rpartition("_")[2]
    known = ((unit, read, factor) for end, unit, read, factor in UNITS if key.endswith(end))
    return next(known, (last, last, 1.0))


@runtime_checkable
class NamedEffect(Protocol):
    """An effect as it was found: what its sentence may say."""

    @property
    def where(self) -> tuple[str, ...]:
        """Names of the place."""
        ...

    @property
    def place(self) -> Place:
        """The place with all that belongs to it."""
        ...

    @property
    def parameters(self) -> Mapping[str, Mapping[str, Tensor]]:
        """``value`` and ``sd`` of reported parameters, by key."""
        ...


def of(finding: NamedEffect, key: str) -> tuple[Float[Tensor, " size"], Float[Tensor, " size"]]:
    """A parameter's value and standard deviation, both flat."""
    entry = finding.parameters[key]
    value, sd = (torch.as_tensor(entry[k], dtype=torch.float64).reshape(-1) for k in ("value", "sd"))
    return value, sd.expand_as(value)


def size(finding: NamedEffect, key: str, unit: str, factor: float = 1.0) -> str:
    """A scalar with its standard deviation, both times ``factor``."""
    value, sd = of(finding, key)
    return stated(value[0], sd[0], unit, factor)


def length(value: Float[Tensor, " n"], sd: Float[Tensor, " n"], unit: str, factor: float = 1.0) -> str:
    """Length of a vector with its standard deviation along the vector, components taken as independent."""
    norm = value.norm()
    spread = (value / norm.clamp(min=1e-12) * sd).norm()
    return stated(norm, spread, unit, factor)


def vector(finding: NamedEffect, key: str, unit: str, factor: float, words: tuple[tuple[str, str], ...]) -> str:
    """Length of a vector, then its components in words.

    Args:
        finding: that has the parameter.
        key: of the parameter.
        unit: after ``factor``.
        factor: from the parameter's unit.
        words: for each component, what it is called where positive and where negative.
    """
    value, sd = of(finding, key)
    shown = parts(value, sd, unit, factor, words)
    return length(value, sd, unit, factor) + (f", that is {shown}" if shown else "")


def parts(
    value: Float[Tensor, " n"], sd: Float[Tensor, " n"], unit: str, factor: float, words: tuple[tuple[str, str], ...]
) -> str:
    """Components in words; those that are not known from zero, or that nobody would see, are left out."""
    digits = decimals(factor * float(sd.max()), 1) if float(sd.max()) > 0.0 else decimals(factor * float(value.norm()))
    least = 0.05 * float(value.norm())
    said = [
        f"{number(abs(v), digits, factor)} {unit} {pair[v < 0.0]}"
        for v, s, pair in zip(value.tolist(), sd.tolist(), words, strict=True)
        if abs(v) > max(least, s)
    ]
    return listing(said) if said else ""


def much(finding: NamedEffect, key: str, words: tuple[str, str] = ("much", "little")) -> str:
    """A factor's distance from one, in words for above and below it."""
    value, sd = of(finding, key)
    more = float(value[0]) - 1.0
    return f"{stated(abs(more), sd[0], '%', 100.0)} too {words[more < 0.0]}"


def main_axis(value: Float[Tensor, " 3"]) -> str:
    """The axis of a segment along which most of a vector is: ``forward``, ``left`` or ``upward``."""
    return ("forward", "left", "upward")[int(value.abs().argmax())]
