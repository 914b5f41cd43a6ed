"""Errors of the zeros of plates: offsets and drifts."""

from typing import final

from jaxtyping import Float
from torch import Tensor

from torchid.effects.parameter import Parameter
from torchid.effects.place import Place
from torchid.effects.plate_map import ZeroError
from torchid.effects.quantities import NamedEffect, length, of


@final
class PlateOffset(ZeroError):
    """A constant wrench on every sample of a plate, loaded or not, but those that a program wrote as zero: it was
    zeroed under load, or not at all."""

    name = "plate_offset"
    mistaken = 0.32
    usual = 0.1
    """0.5 N: a plate that was zeroed a while ago."""
    parameters = (
        Parameter("force_plate_N", 5.0, 3, source="a choice: the vertical force of a plate erred by 5.0 ± 2.5 N after "
                  "it was calibrated again by a linear map (Cappello et al., Gait & Posture 33 (2011))"),
        Parameter("moment_plate_Nm", 1.0, 3, source="a choice: a fifth of a metre times the prior of the force"),
    )  # fmt: skip
    noun = "a wrong zero"
    advice = "two seconds of every plate unloaded before and after each trial"

    def zero(self, time: Float[Tensor, " samples"], theta: Float[Tensor, " params"]) -> Float[Tensor, "samples 6"]:
        return theta.expand(len(time), 6)

    def sentence(self, finding: NamedEffect) -> str:
        force, moment = (
            length(*of(finding, key), unit) for key, unit in (("force_plate_N", "N"), ("moment_plate_Nm", "N m"))
        )
        return f"{self.located(finding.where)} reads {force} and {moment} when it bears nothing"


@final
class PlateDrift(ZeroError):
    """An offset that grows with time since the recording began: charge amplifiers and warming bridges do that."""

    name = "plate_drift"
    mistaken = 0.39
    usual = 0.02
    """0.01 N/s, which charge amplifiers are sold with."""
    parameters = (
        Parameter("rate_plate", 0.5, 6, source="a choice: fifty times the 0.01 N/s below which makers keep "
                  "piezoelectric plates (Kistler 9281C, 9286A); moments a fifth of a metre times forces"),
    )  # fmt: skip
    noun = "a drifting zero"
    advice = "a minute of every plate unloaded, without zeroing it"
    apart = {"plate_offset": "every plate unloaded for a minute"}

    def scale(self, place: Place) -> tuple[float, ...]:
        """Three forces [N/s], and moments [N m/s] a fifth of a metre times these."""
        return (0.5,) * 3 + (0.1,) * 3

    def zero(self, time: Float[Tensor, " samples"], theta: Float[Tensor, " params"]) -> Float[Tensor, "samples 6"]:
        return time[:, None] * theta

    def sentence(self, finding: NamedEffect) -> str:
        value, sd = of(finding, "rate_plate")
        return (
            f"the zero of {self.located(finding.where)} drifts by {length(value[:3], sd[:3], 'N/s')} and "
            f"{length(value[3:], sd[3:], 'N m/s')}"
        )
