"""Laboratory and cameras that shake together."""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import final

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.effects.evidence import TrialEvidence
from torchid.effects.kinds import LoadEffect
from torchid.effects.marker_scene import View
from torchid.effects.parameter import Parameter, stacked
from torchid.effects.place import Place
from torchid.effects.quantities import NamedEffect, of, size
from torchid.effects.scene import Scene, at_origin
from torchid.effects.traits import Occurrence
from torchid.wording import number

SHAKES = tuple(0.3 + 0.02 * k for k in range(286))
"""Resolution. Frequencies at which ground that moves is looked for [Hz]."""
PEAKS = 3
"""Proposal. Frequencies that are proposed."""
AROUND, NEAR = 40, 5
"""Proposal. Steps of ``SHAKES`` to either side that a frequency is compared with, and that count as the same peak."""
SHAKEN = "a choice: a platform or a ship in moderate sea; the floor of a building moves a hundred times less"


@final
class MovingGround(LoadEffect):
    """Laboratory and cameras shake together (a ship, a platform): an inertial force on all mass.

    Internal are the amplitudes of sine and cosine along x, y, z at the frequency of the place's grid, in every trial
    anew: nobody knows the phase at which a recording begins.
    """

    name = "moving_ground"
    occurrence = Occurrence.ANEW_PER_TRIAL
    grid_keys = ("frequency_hz",)
    parameters = (Parameter("sine_m_s2", 0.3, 3, source=SHAKEN), Parameter("cosine_m_s2", 0.3, 3, source=SHAKEN))
    noun = "ground that shakes"
    advice = "a dead weight resting on a plate in an empty laboratory"
    apart = {"unmeasured_contact": "a dead weight resting on a plate with no person near"}

    def places(self, views: Sequence[View]) -> tuple[Place, ...]:
        return tuple(Place(("session",), grid={"frequency_hz": f}) for f in SHAKES)

    def propose(self, observed: Sequence[TrialEvidence]) -> tuple[Place, ...]:
        """Frequencies at which the residual forces of all trials stand out of their neighbours."""
        places = self.places([one.view for one in observed])
        frequency = torch.tensor([place.grid["frequency_hz"] for place in places], dtype=torch.float64)
        power = torch.zeros_like(frequency)
        for one in observed:
            phase = 2.0 * torch.pi * frequency[:, None] * one.view.scene.time
            force = one.residual()[:, :3]
            force = force - force.mean(0)
            power += (torch.cos(phase) @ force).square().sum(1) + (torch.sin(phase) @ force).square().sum(1)
        return tuple(replace(places[k], odds=1.0 / len(places)) for k in _peaks(power))

    def period_s(self, place: Place) -> float:
        return 1.0 / place.grid["frequency_hz"]

    def load(self, scene: Scene, place: Place, theta: Float[Tensor, " params"]) -> Float[Tensor, "6 frames"]:
        sine, cosine = self.split(theta)
        phase = 2.0 * math.pi * place.grid["frequency_hz"] * scene.time
        course = scene.passed(place.grid["frequency_hz"], lambda: torch.stack([torch.sin(phase), torch.cos(phase)]))
        shake = torch.stack([sine, cosine], 1) @ course
        return at_origin(scene.centre_of_mass, scene.mass * shake)

    def named(self, place: Place, theta: Float[Tensor, " params"]) -> dict[str, Tensor]:
        return {
            "rms_m_s2": (0.5 * theta.view(-1, 6).square().sum(1).mean()).sqrt(),
            "frequency_hz": theta.new_tensor(place.grid["frequency_hz"]),
        }

    def internal(self, place: Place, values: dict[str, Tensor]) -> Float[Tensor, " params"]:
        """The amplitudes, or an upward shake of the given size where no direction is stated."""
        if "rms_m_s2" not in values:
            return stacked(self.parameters, values, self.name)
        theta = torch.zeros(self.size(place), dtype=torch.float64)
        theta[2] = math.sqrt(2.0) * torch.as_tensor(values["rms_m_s2"])
        return theta

    def sentence(self, finding: NamedEffect) -> str:
        frequency = number(of(finding, "frequency_hz")[0][0], 2)
        return f"the laboratory shakes at {frequency} Hz with {size(finding, 'rms_m_s2', 'm/s²')} RMS"


def _peaks(power: Float[Tensor, " frequencies"]) -> list[int]:
    """The frequencies whose power stands out most of the median around them, one for each peak."""
    around = torch.nn.functional.pad(power[None], (AROUND, AROUND), mode="reflect")[0].unfold(0, 2 * AROUND + 1, 1)
    height = power / around.median(1).values.clamp(min=1e-12)
    best = []
    for _ in range(PEAKS):
        best.append(int(height.argmax()))
        height[max(0, best[-1] - NEAR) : best[-1] + NEAR + 1] = 0.0
    return best
