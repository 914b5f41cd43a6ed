"""Where under a sole the pressure is: beside its axis, and along it."""

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.conventions import LOADED_N
from torchid.witnesses.options import WitnessOptions
from torchid.witnesses.statements import Statements, Subject
from torchid.witnesses.watched import Watched


def pressures(watched: Watched, options: WitnessOptions) -> Statements | None:
    """Return how far the mean pressure of each foot on each plate is from the middle of its sole [m].

    Args:
        watched: the trial.
        options: least time that a foot must bear a plate.
    """
    found: list[tuple[Subject, Tensor]] = []
    if watched.soles is None or watched.foot_on is None:
        return None
    for k, frame in enumerate(watched.reading.frames):
        for j, foot in enumerate(watched.feet):
            on = (watched.foot_on[:, k] == j) & (watched.reading.wrench[:, k, 2] > LOADED_N)
            if int(on.sum()) >= options.shortest_contact_s * watched.rate:
                both = _off(watched.soles[j][on], watched.reading.wrench[on, k], foot.endswith("_l"))
                where = f"{frame.name} {foot}"
                found += [(Subject(kind, watched.name, where), x) for kind, x in zip(KINDS, both, strict=True)]
    if not found:
        return None
    value = torch.stack([x for _, x in found])
    return Statements(tuple(one for one, _ in found), value, torch.zeros(len(value), len(value)).to(value))


KINDS = ("pressure_lateral", "pressure_along")


def _off(sole: Float[Tensor, "frames 2 3"], wrench: Float[Tensor, "frames 6"], left: bool) -> tuple[Tensor, Tensor]:
    """Mean distance of the pressure to the outside of a sole's axis and to the front of its middle, by load [m]."""
    heel, toe = sole[:, 0], sole[:, 1]
    force, moment = wrench[:, :3], wrench[:, 3:]
    height = sole[..., 2].min()
    centre = torch.stack([height * force[:, 0] - moment[:, 1], height * force[:, 1] + moment[:, 0]], 1) / force[:, 2:]
    along = torch.nn.functional.normalize((toe - heel)[:, :2], dim=1)
    outside = torch.stack([along[:, 1], -along[:, 0]], 1) * (-1.0 if left else 1.0)
    off = centre - 0.5 * (heel + toe)[:, :2]
    load = force[:, 2] / force[:, 2].sum()
    return ((off * outside).sum(1) * load).sum(), ((off * along).sum(1) * load).sum()
