"""What witnesses are asked, and what they are about."""

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from jaxtyping import Float
from torch import Tensor

from torchid.model_free.watched import Watched


@dataclass(frozen=True)
class CheckSubject:
    """What a number is about."""

    kind: str
    """Name of the witness, of ``scatter.SCATTER``."""
    trial: str
    """Trial that it was taken from."""
    plate: str = ""
    """Plate that it is about; empty: all of them."""


@runtime_checkable
class Witness(Protocol):
    """Numbers about one trial, zero where nothing is wrong, that can be taken again of other readings of its plates."""

    @property
    def about(self) -> tuple[CheckSubject, ...]:
        """What each number is about."""
        ...

    @property
    def covariance(self) -> Float[Tensor, "some some"]:
        """Of the scatter within the trial that they were taken from."""
        ...

    def value(self, watched: Watched) -> Float[Tensor, " some"]:
        """Return the numbers.

        Args:
            watched: the trial, perhaps as its plates would have read it with an effect.
        """
        ...
