"""What a run is worth: good, usable with care or not to be used, with the number that decides."""

from dataclasses import dataclass
from enum import StrEnum


class QualityLevel(StrEnum):
    """What a reader may do with a result."""

    GOOD = "good"
    CARE = "usable with care"
    UNUSABLE = "do not use"


ORDER = (QualityLevel.GOOD, QualityLevel.CARE, QualityLevel.UNUSABLE)
"""From the best to the worst."""


@dataclass(frozen=True)
class Criterion:
    """One figure of a run beside its norm."""

    name: str
    """Key of files, such as ``force``."""
    level: QualityLevel
    value: float
    norm: float
    """Up to which the figure is good; NaN where there is no figure."""
    shown: str
    """The figure in words, such as ``held-out force residual 11 % of peak``."""
    bound: str
    """The norm in words, such as ``norm 5 %``; empty where there is none."""
    source: str
    """Where the norm comes from."""

    @property
    def words(self) -> str:
        """The figure and its norm."""
        return f"{self.shown} ({self.bound})" if self.bound else self.shown


@dataclass(frozen=True)
class Quality:
    """All figures of a run beside their norms, those that weigh most first."""

    criteria: tuple[Criterion, ...]

    @property
    def level(self) -> QualityLevel:
        """The worst of all."""
        return max((one.level for one in self.criteria), key=ORDER.index, default=QualityLevel.CARE)

    @property
    def deciding(self) -> Criterion | None:
        """The first figure of the worst level; None of a run without any."""
        return next((one for one in self.criteria if one.level is self.level), None)

    @property
    def usable(self) -> bool:
        """False where the result is not to be used."""
        return self.level is not QualityLevel.UNUSABLE

    @property
    def line(self) -> str:
        """The verdict and the number that decides, as one line."""
        return self.level.value if self.deciding is None else f"{self.level.value}: {self.deciding.words}"


def graded(value: float, norm: float, limit: float = float("inf")) -> QualityLevel:
    """The level of a figure that should be small; a figure that is not known cannot be good.

    Args:
        norm: good up to here.
        limit: not to be used beyond.
    """
    if value <= norm:
        return QualityLevel.GOOD
    return QualityLevel.UNUSABLE if value > limit else QualityLevel.CARE
