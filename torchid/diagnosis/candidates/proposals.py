"""Places of an effect that are worth columns, by what the trials show."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.diagnosis.candidates.free_courses import evidence_of_courses
from torchid.dynamics.rows import measured
from torchid.effects.effect import Effect
from torchid.effects.marker_scene import Sway, View
from torchid.effects.place import Place
from torchid.observation.marker_response import MarkerResponse
from torchid.observation.trial import TrialObservation


def propose(effect: Effect, observed: Sequence[TrialObservation]) -> tuple[Place, ...]:
    """Return the places of an effect, each with its odds among all that could have been proposed.

    Args:
        effect: the effect.
        observed: trials.
    """
    return effect.propose([ObservedEvidence(one) for one in observed])


@dataclass(frozen=True)
class ObservedEvidence:
    """A trial as an effect that proposes places may see it (``effects.evidence.TrialEvidence``)."""

    observed: TrialObservation
    """The trial."""

    @property
    def view(self) -> View:
        """Motion, plates and markers of the trial."""
        return self.observed.view

    @property
    def rate_hz(self) -> float:
        """Frames per second."""
        return self.observed.rows.rate

    @property
    def markers(self) -> MarkerResponse | None:
        """Markers of the trial, None if no camera is at hand."""
        return self.observed.response

    def residual(self) -> Float[Tensor, "frames 6"]:
        """Return the residual of the identified model about the root's origin [N, N m], zero where frames are not
        used."""
        rows, known = self.observed.rows, self.observed.needed(self.observed.phi.reshape(-1))
        return torch.where(rows.used[:, None], measured(rows) - known, 0.0)

    def evidence_of_courses(self, sways: Sequence[Sway], scales: Sequence[float]) -> list[float]:
        """Return log evidences [nat] as ``free_courses`` does.

        Args:
            sways: displacements in fixed ways.
            scales: prior standard deviation of the coefficients, one for each displacement.
        """
        assert self.observed.response is not None, "only markers tell"
        found = evidence_of_courses(self.observed.response, sways, scales)
        self.observed.response.forget()
        return found
