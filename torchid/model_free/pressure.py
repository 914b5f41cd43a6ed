"""Where under a sole the pressure is: beside its axis, and along it."""

import math
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchid.conventions import LOADED_N
from torchid.model_free.options import WitnessOptions
from torchid.model_free.statements import CheckSubject
from torchid.model_free.watched import Watched

KINDS = ("pressure_lateral", "pressure_along")


@dataclass(frozen=True)
class _Stand:
    """A foot on a plate."""

    plate: int
    on: Bool[Tensor, " frames"]
    """Frames in which the plate bears it alone."""
    sole: Float[Tensor, "stood 2 3"]
    """Heel and tip in these frames [m]."""
    left: bool


@dataclass(frozen=True)
class Pressures:
    """How far the mean pressure of each foot on each plate is from the middle of its sole [m]; a ``Witness``."""

    about: tuple[CheckSubject, ...]
    stands: tuple[_Stand, ...]

    @property
    def covariance(self) -> Float[Tensor, "some some"]:
        """Nothing: what it scatters by within a trial is the gait, which is alike in all."""
        n = len(self.about)
        return self.stands[0].sole.new_zeros(n, n)

    def value(self, watched: Watched) -> Float[Tensor, " some"]:
        """Return the distances, to the outside and to the front.

        Args:
            watched: the trial.
        """
        return torch.cat([_off(one, watched.reading.wrench[one.on, one.plate]) for one in self.stands])


def pressures(watched: Watched, options: WitnessOptions) -> Pressures | None:
    """Return the witness of a trial's pressures; None where no foot stands on a plate alone for long.

    Args:
        watched: the trial.
        options: least time that a foot must bear a plate.
    """
    if watched.soles is None or watched.foot_on is None:
        return None
    stands, about = [], []
    for k, frame in enumerate(watched.reading.frames):
        for j, foot in enumerate(watched.feet):
            on = (watched.foot_on[:, k] == j) & (watched.reading.wrench[:, k, 2] > LOADED_N)
            if int(on.sum()) >= options.shortest_contact_s * watched.rate:
                stands.append(_Stand(k, on, watched.soles[j][on], foot.endswith("_l")))
                about += [CheckSubject(kind, watched.name, f"{frame.name} {foot}") for kind in KINDS]
    return Pressures(tuple(about), tuple(stands)) if stands else None


def _off(stand: _Stand, wrench: Float[Tensor, "stood 6"]) -> Float[Tensor, " 2"]:
    """Mean distance of the pressure to the outside of a sole's axis and to the front of its middle, by load [m].

    NaN where the plate bears nothing, as another reading may have it."""
    if float(wrench[:, 2].detach().mean()) <= LOADED_N:
        return wrench.new_full((2,), math.nan)
    heel, toe, force, moment = stand.sole[:, 0], stand.sole[:, 1], wrench[:, :3], wrench[:, 3:]
    height = stand.sole[..., 2].min()
    centre = torch.stack([height * force[:, 0] - moment[:, 1], height * force[:, 1] + moment[:, 0]], 1) / force[:, 2:]
    along = torch.nn.functional.normalize((toe - heel)[:, :2], dim=1)
    outside = torch.stack([along[:, 1], -along[:, 0]], 1) * (-1.0 if stand.left else 1.0)
    off = centre - 0.5 * (heel + toe)[:, :2]
    load = force[:, 2] / force[:, 2].sum()
    return torch.stack([((off * outside).sum(1) * load).sum(), ((off * along).sum(1) * load).sum()])
