"""What the page of one subject and that of a study have in common: conditions, comparisons, courses and gaps."""

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from torchid.evaluation.statistics.comparing import Comparison
from torchid.evaluation.statistics.effects import Estimate


@dataclass(frozen=True)
class Gap:
    """Something that cannot be determined, and why."""

    what: str
    why: str


@runtime_checkable
class Compared(Protocol):
    """An evaluation of one subject, or a study of several."""

    @property
    def name(self) -> str:
        """Of the subject or the study."""
        ...

    @property
    def reference(self) -> str:
        """Condition that the others are compared with."""
        ...

    @property
    def names(self) -> tuple[str, ...]:
        """All conditions."""
        ...

    @property
    def comparisons(self) -> tuple[Comparison, ...]:
        """With the identified bodies."""
        ...

    @property
    def level(self) -> float:
        """Family-wise rate of false findings."""
        ...

    @property
    def per_mass(self) -> bool:
        """Whether torques are divided by mass."""
        ...

    @property
    def usual(self) -> str:
        """What the identified body is held against."""
        ...

    @property
    def signs(self) -> str:
        """Whose names and signs coordinates have."""
        ...

    @property
    def gaps(self) -> tuple[Gap, ...]:
        """What cannot be said."""
        ...

    def devices(self, condition: str) -> tuple[str, ...]:
        """Names of what was worn; none where nothing was."""
        ...

    def course(self, one: Comparison, condition: str, share: str) -> Estimate:
        """Mean courses of a condition with their band, points times ``one.courses``.

        Args:
            condition: its own or the reference.
            share: human, demand, device, or template.
        """
        ...
