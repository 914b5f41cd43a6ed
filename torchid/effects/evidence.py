"""Data that an effect may look at to propose where and when it could sit."""

from collections.abc import Sequence
from typing import Protocol, runtime_checkable

from jaxtyping import Float
from torch import Tensor

from torchid.effects.marker_scene import Sight, Sway, View


@runtime_checkable
class MarkerErrors(Protocol):
    """Markers of one trial, as they were seen against the model that was fitted to them."""

    @property
    def sight(self) -> Sight:
        """Markers where the model has them."""
        ...

    @property
    def weight(self) -> Float[Tensor, "markers frames"]:
        """1 / sigma^2 [1/m^2], zero where a marker was not seen."""
        ...

    @property
    def error(self) -> Float[Tensor, "markers 3 frames"]:
        """Measured minus modelled [m], zero where a marker was not seen."""
        ...


@runtime_checkable
class TrialEvidence(Protocol):
    """One trial, as a proposer may see it."""

    @property
    def view(self) -> View:
        """Motion, plates and markers of the trial."""
        ...

    @property
    def rate_hz(self) -> float:
        """Frames per second."""
        ...

    @property
    def markers(self) -> MarkerErrors | None:
        """Markers of the trial, None if no camera is at hand."""
        ...

    def residual(self) -> Float[Tensor, "frames 6"]:
        """Return the wrench that plates measured beyond what the identified model needs, about the root's origin
        [N, N m]; it is zero where frames are not used."""
        ...

    def evidence_of_courses(self, sways: Sequence[Sway], scales: Sequence[float]) -> list[float]:
        """Log evidence that markers give for displacements in fixed ways with free courses, geometry held [nat].

        Args:
            sways: each with its ways, and the courses that may be combined.
            scales: prior standard deviation of the coefficient of every course, for each.
        """
        ...
