"""The place of a plate that puts its pressures under the feet, where the place in the file does not.

The place is found and not picked from a list: by how much the plate has to be moved, and how well that is known. Of 26
plates of 15 public recordings that lie where their files say, it is found within 40 mm of there along either axis, with
standard deviations of 26 to 65 mm.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.checks.plates_against_feet.changes import Change
from torchid.checks.plates_against_feet.evidence import (
    AIM_M,
    PRESSURE_M,
    PRESSURE_MOST_M,
    Evidence,
    agrees,
    by_frame,
    gather,
    pressure_centre,
    weighted_quantile,
)
from torchid.checks.plates_against_feet.feet import Feet
from torchid.checks.plates_against_feet.readings import ALIKE, MENDS, FeetScene, Tried
from torchid.conventions import SAMPLE_LOADED_N
from torchid.io.mend import ForcesAs, PlateAs, number_of

VOTES = 100
"""Resolution. Moves that are tried first: in each, one foot in one frame stands with its middle on the pressure."""
STEP_M, STEPS = 0.025, 4
"""Resolution. The best of them is refined over so many steps of this size to either side, along X and Y."""
PASSES = 2
"""Resolution. Times that it is refined, each about the place found before."""
FAR = 3.0
"""Estimator. A witness further off than so many times its usual value tells a place no more."""
NEARLY_ALL = 0.9
"""Choice. Of the load, so much has its pressure under the feet in the right place. A median would not do: two free
numbers put the pressures of another trial under some foot for half of the time."""
SAME_SD = 3.0
"""Choice. Plates whose moves differ by less than so many standard deviations have moved together: their origin is
wrong."""
TOGETHER = 8
"""Resolution. Readings that are worked on at a time: their distances to all lines of a foot have to find room."""


@dataclass(frozen=True)
class FoundPlace:
    """By how much a plate has to be moved."""

    plate: int
    """Its place among the plates of the scene."""
    shift: Float[Tensor, " 2"]
    """Along X and Y of W [m]."""
    sd: float
    """Standard deviation along each of them [m]: markers of a foot tell its sole to a centimetre or two."""
    gain: float
    """How much better the plate agrees there than as read (``Evidence.gain``)."""

    @property
    def words(self) -> str:
        """By how much, in words."""
        return f"{1e3 * float(self.shift.norm()):.0f} mm (sd {1e3 * self.sd:.0f} mm)"


def find_place(scene: FeetScene, k: int, read: Tried) -> FoundPlace | None:
    """The place of plate k under which it agrees with the feet, and better than under a reading on the list.

    Args:
        scene: feet and forces.
        k: the plate.
        read: the plate under the readings on the list.

    Returns:
        The move; None where there is none, or where a reading on the list explains as much.
    """
    wrench, height = scene.forces.wrench[:, k], scene.heights[k]
    others = scene.forces.wrench[..., 2].abs().sum(dim=1) - wrench[:, 2].abs()
    votes = _votes(scene.feet, wrench, height)
    if not len(votes):
        return None
    moved = [_gathered(scene.feet, wrench, height, others, some).gain[1:] for some in _parts(votes)]
    centre, sd = votes[int(torch.cat(moved).argmax())], torch.full((2,), torch.inf)
    for _ in range(PASSES):
        centre, sd = _refined(scene.feet, wrench, height, others, centre)
    found = _gathered(scene.feet, wrench, height, others, centre[None])
    gain = float(found.gain[1])
    if not bool(agrees(found)[1]) or gain < max(MENDS, read.best + ALIKE):
        return None
    if not _stays_under(scene.feet, moved_by(wrench, centre[None]), height):
        return None
    return FoundPlace(k, centre, float(sd.square().mean().sqrt()), gain)


def moved_by(wrench: Float[Tensor, "n 6"], shifts: Float[Tensor, "some 2"]) -> Float[Tensor, "some n 6"]:
    """The wrench of a plate about the origin of W, moved by each of some shifts [m]."""
    arm = torch.cat([shifts, torch.zeros_like(shifts[:, :1])], dim=1)[:, None]
    force = wrench[None, :, :3].expand(len(shifts), -1, -1)
    return torch.cat([force, wrench[None, :, 3:] + torch.linalg.cross(arm.expand_as(force), force)], dim=-1)


def place_changes(scene: FeetScene, one: FoundPlace) -> tuple[Change, ...]:
    """The config lines that move a plate: with its corners, or what it reads alone, or both where nothing tells.

    Where the pressures as read lie beside the plate, what leads from its corners to its transducer is wrong; where they
    lie on it, and would lie beside it if they alone were moved, its corners are.
    """
    plate, name = scene.forces.plates[one.plate], scene.forces.plates[one.plate].name
    number, by = number_of(plate, one.plate), _in_config(one.shift)
    size = float(one.shift.norm()), one.sd, "m"
    said = f"{name} lies {one.words} from where the file has it"
    whole = Change(said, ForcesAs(), {number: PlateAs(shift_m=by)}, None, *size)
    if plate.corners is None:
        return (whole,)
    said = f"ORIGIN of {name} is off by {one.words}"
    alone = Change(said, ForcesAs(), {number: PlateAs(origin_shift_m=by)}, None, *size)
    wrench, height = scene.forces.wrench[:, one.plate], scene.heights[one.plate]
    before, after = (_on(plate.corners, each, height) for each in (wrench, moved_by(wrench, one.shift[None])[0]))
    if before == after:
        return whole, alone
    return (whole,) if before else (alone,)


def shared_place(scene: FeetScene, found: Sequence[FoundPlace]) -> tuple[Change, ...]:
    """The line that moves all plates together, where all that bear load are off by the same; else none."""
    loaded = int((scene.forces.wrench[..., 2].amax(dim=0) > SAMPLE_LOADED_N).sum())
    if len(found) < 2 or len(found) < loaded:
        return ()
    weight = torch.tensor([one.sd**-2 for one in found], dtype=torch.float64)
    mean = torch.stack([one.shift for one in found]).T @ weight / weight.sum()
    if any(float((one.shift - mean).abs().max()) > SAME_SD * one.sd for one in found):
        return ()
    shared = FoundPlace(-1, mean, float(weight.sum()) ** -0.5, 0.0)
    said = f"all plates lie {shared.words} from where the file has them"
    moved = ForcesAs(shift_m=_in_config(mean))
    return (Change(said, moved, size=float(shared.shift.norm()), sd=shared.sd, unit="m"),)


def _in_config(shift: Tensor) -> tuple[float, float]:
    """A shift as a config has it, to a millimetre."""
    x, y = (round(float(v), 3) for v in shift)
    return x, y


def _votes(feet: Feet, wrench: Tensor, height: float) -> Float[Tensor, "votes 2"]:
    """Moves (votes, 2) that put the pressure of a frame under the middle of a foot [m]."""
    loaded = ((wrench[:, 2] > SAMPLE_LOADED_N) & feet.seen).nonzero()[:, 0]
    if not len(loaded):
        return wrench.new_zeros(0, 2)
    loaded = loaded[torch.linspace(0, len(loaded) - 1, min(len(loaded), max(1, VOTES // feet.count))).round().long()]
    middle = [feet.position[loaded][:, feet.foot == f, :2].nanmean(dim=1) for f in range(feet.count)]
    if feet.count > 1:  # who stands on both feet presses between them
        middle.append(torch.stack(middle).mean(dim=0))
    return (torch.stack(middle, dim=1) - pressure_centre(wrench[loaded], height)[:, None]).flatten(0, 1)


def _parts(shifts: Tensor) -> Iterator[Tensor]:
    """The shifts, a few at a time."""
    yield from shifts.split(TOGETHER)


def _gathered(feet: Feet, wrench: Tensor, height: float, others: Tensor, shifts: Tensor) -> Evidence:
    """Witnesses of the plate as read and moved by each shift."""
    return gather(feet, torch.cat([wrench[None], moved_by(wrench, shifts)]), height, others)


def _refined(feet: Feet, wrench: Tensor, height: float, others: Tensor, centre: Tensor) -> tuple[Tensor, Tensor]:
    """Mean (2) and standard deviation (2) of the move about ``centre``, by squares of pressure and aim over the load.

    All frames together count as one reading of either witness: what a foot's markers get wrong about its sole they get
    wrong in every frame.
    """
    steps = STEP_M * torch.arange(-STEPS, STEPS + 1).to(centre)
    shifts = centre + torch.cartesian_prod(steps, steps)
    cost = torch.cat([_squares(feet, moved_by(wrench, some), height, others) for some in _parts(shifts)])
    share = torch.softmax(-0.5 * cost, dim=0)
    mean = share @ shifts
    return mean, (share @ (shifts - mean).square() + STEP_M**2 / 12.0).sqrt()


def _squares(feet: Feet, wrench: Tensor, height: float, others: Tensor) -> Float[Tensor, " readings"]:
    """Mean squares of pressure and aim over the load, in their usual values, each within ``FAR``."""
    one = by_frame(feet, wrench, height, others)
    found = one.pressure.new_zeros(len(wrench))
    for part in (one.pressure / PRESSURE_M, one.aim / AIM_M):
        weight = torch.where(torch.isnan(part), 0.0, one.weight)
        square = part.nan_to_num(0.0, posinf=FAR).clamp_max(FAR).square()
        found = found + (weight * square).sum(dim=1) / weight.sum(dim=1).clamp_min(1e-9)
    return found


def _stays_under(feet: Feet, wrench: Float[Tensor, "1 n 6"], height: float) -> bool:
    """Whether nearly all of the load has its pressure under a foot."""
    one = by_frame(feet, wrench, height)
    return bool((weighted_quantile(one.pressure, one.weight, NEARLY_ALL) < PRESSURE_MOST_M)[0])


def _on(corners: Tensor, wrench: Tensor, height: float) -> bool:
    """Whether the pressures of a plate lie on it for most of the load."""
    force = wrench[:, 2].nan_to_num()
    centre = pressure_centre(wrench, height)
    edges = torch.stack([corners[1] - corners[0], corners[3] - corners[0]])[:, :2]
    lengths = edges.norm(dim=1)
    along = (centre - corners[0, :2]) @ (edges / lengths[:, None]).T
    inside = ((along > 0.0) & (along < lengths)).all(dim=1) & (force > SAMPLE_LOADED_N)
    return float((force * inside).sum()) > 0.5 * float((force * (force > SAMPLE_LOADED_N)).sum())
