"""What force plates carried during a trial, and whether their readings can be."""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchid.checks.plates_against_feet.beside import beside_plates
from torchid.conventions import GRAVITY, SAMPLE_LOADED_N
from torchid.io.plates import baseline
from torchid.io.resample import to_clock
from torchid.recording import Forces, Trial

MARGIN = 0.02
"""How far [m] beside the plate still counts as on it."""
FALLING = 0.5
"""Choice. Downward acceleration, part of g, beyond which a body without load on plates flies: halfway from one that
stands beside them."""
FEWEST = 5
"""Choice. Frames of load below which nothing is weighed."""
WEIGHED_S = 0.4
"""Estimator. Time with both feet on plates that weighs better than all the time with one beside them [s]: from 0.4 s of
five children's walks the mass comes to 1 to 4 %, from 0.2 s to 9 to 13 %."""
RAIL_SAMPLES = 3
RAIL_SECONDS = 0.01
"""A plateau at the peak is suspect from so many samples on, where channels are coarsely quantised from so long on."""


@dataclass(frozen=True)
class PlateCheck:
    """One plate during a trial."""

    name: str
    kind: str
    """Type in the C3D file, empty where the file has none."""
    mean: float
    """Mean vertical force [N] over the whole trial."""
    peak: float
    """Largest vertical force [N] by size."""
    baseline: float | None
    """Median vertical force [N] while unloaded, None where it always carries somebody."""
    outside: float
    """Share of the loaded time that the centre of pressure lies beside the plate; NaN without corners or load."""
    saturated: int
    """Samples on a plateau at the peak."""
    loaded: float | None = None
    """Mean vertical force [N] while somebody is on it, None where nobody is."""


def check_plate(forces: Forces, k: int, kind: str) -> PlateCheck:
    """Facts about plate k; ``kind`` is its type in the file."""
    vertical = forces.wrench[:, k, 2].nan_to_num()
    peak = float(vertical[vertical.abs().argmax()]) if len(vertical) else 0.0
    return PlateCheck(
        forces.plates[k].name, kind, float(vertical.mean()) if len(vertical) else 0.0, peak,
        baseline(forces.wrench[:, k, 2].numpy()), _outside(forces, k), _saturated(forces, k), _mean_loaded(vertical),
    )  # fmt: skip


def _mean_loaded(vertical: torch.Tensor) -> float | None:
    """Mean of the samples (samples) above half of the median of those that bear load."""
    vertical = vertical[vertical > SAMPLE_LOADED_N]
    return float(vertical[vertical > 0.5 * vertical.median()].mean()) if len(vertical) else None


def _outside(forces: Forces, k: int) -> float:
    """Share of the loaded time that the centre of pressure of plate k lies beside it."""
    corners = forces.plates[k].corners
    point = forces.centre_of_pressure(SAMPLE_LOADED_N)[:, k]
    point = point[point.isfinite().all(dim=1)]
    if corners is None or not len(point):
        return float("nan")
    edges = torch.stack([corners[1] - corners[0], corners[3] - corners[0]])
    lengths = edges.norm(dim=1)
    along = (point - corners[0]) @ (edges / lengths[:, None]).T
    beside = ((along < -MARGIN) | (along > lengths + MARGIN)).any(dim=1)
    return float(beside.double().mean())


def _saturated(forces: Forces, k: int) -> int:
    """Samples of plate k on a plateau at the largest value of a force component."""
    if len(forces.time) < RAIL_SAMPLES:
        return 0
    worst = 0
    for column in forces.wrench[:, k, :3].numpy().T:
        size = np.abs(column)
        if not size.max() > SAMPLE_LOADED_N:
            continue
        inner = column[(size < size.max()) & (column != 0.0)]
        coarse = len(np.unique(inner)) < len(inner) / 2
        least = max(RAIL_SAMPLES, int(np.ceil(RAIL_SECONDS * forces.rate)) + 1) if coarse else RAIL_SAMPLES
        worst = max(worst, _longest(size == size.max()) if _longest(size == size.max()) >= least else 0)
    return worst


def _longest(mask: np.ndarray) -> int:
    """Length of the longest run of true entries."""
    ends = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(int)))
    return int((ends[1::2] - ends[::2]).max()) if len(ends) else 0


def plate_weight(trial: Trial) -> float | None:
    """Mean total vertical force while loaded, as a mass [kg]; None where nobody stands on the plates.

    Loaded are the frames above half of the median of those above ``SAMPLE_LOADED_N``, without those in which a foot
    stands beside the plates: steps onto and off them would otherwise lower the mean. Who runs or hops is weighed over
    whole cycles, flights included, whose momentum comes back.
    """
    if trial.forces is None:
        return None
    course = _course(trial)
    if course is None or course.throughout:
        loaded = _mean_loaded(trial.forces.total[:, 2])  # samples tell the edges of a contact best
        return None if loaded is None else loaded / GRAVITY
    return float(course.vertical[course.weighed].mean()) / GRAVITY


def moved_mass(trial: Trial) -> float | None:
    """Mass [kg] that the vertical force moves: its mean over the mean of g + a in the frames of ``plate_weight``.

    a is the vertical acceleration of the markers' mean, so that a flight phase or a push-off does not pass for a wrong
    weight. None without enough markers or loaded frames.
    """
    course = _course(trial)
    if course is None or int(course.weighed.sum()) < FEWEST:
        return None
    counted = course.weighed
    return float(course.vertical[counted].mean() / (GRAVITY + course.acceleration[counted].mean()))


def flight_cycles(
    vertical: Float[Tensor, " frames"], acceleration: Float[Tensor, " frames"]
) -> Bool[Tensor, " frames"] | None:
    """Frames from the first take-off to the last, where all between them is contact and flight; None where it is not.

    Args:
        vertical: force of all plates together [N].
        acceleration: of the body, upwards [m/s2].
    """
    loaded = vertical > SAMPLE_LOADED_N
    edges = torch.nonzero(loaded[1:] != loaded[:-1])[:, 0] + 1
    off = edges[~loaded[edges]]  # first frame of each time without load
    if len(off) < 2:
        return None
    cycles = torch.zeros_like(loaded)
    cycles[int(off[0]) : int(off[-1])] = True
    falling = acceleration[cycles & ~loaded]
    return cycles if float(falling.mean()) < -FALLING * GRAVITY else None


@dataclass(frozen=True)
class _Course:
    """What plates carry and how the body moves on them, frame by frame."""

    vertical: Float[Tensor, " frames"]
    """Force of all plates together [N]."""
    acceleration: Float[Tensor, " frames"]
    """Vertical one of the markers' mean [m/s2]."""
    beside: Bool[Tensor, " frames"]
    """Whether a foot stands beside the plates."""
    rate: float
    """Frames per second."""

    @property
    def carried(self) -> Bool[Tensor, " frames"]:
        """Frames in which the plates carry somebody: above half of what they carry in the median."""
        loaded = self.vertical > SAMPLE_LOADED_N
        return self.vertical > 0.5 * self.vertical[loaded].median() if bool(loaded.any()) else loaded

    @property
    def weighed(self) -> Bool[Tensor, " frames"]:
        """Frames in which they carry all of the body, or whole cycles of a runner."""
        cycles = flight_cycles(self.vertical, self.acceleration)
        if cycles is not None:
            return cycles
        # Who has a foot beside them nearly throughout is weighed all the same.
        whole = self.carried & ~self.beside
        return whole if int(whole.sum()) >= WEIGHED_S * self.rate else self.carried

    @property
    def throughout(self) -> bool:
        """Whether all frames in which they carry somebody tell the weight."""
        return bool((self.weighed == self.carried).all())


def _course(trial: Trial) -> _Course | None:
    """The course of a trial; None without forces, or with too few markers seen throughout."""
    if trial.forces is None or len(trial.forces.time) < 2 or len(trial.markers.time) < 5:
        return None
    height = trial.markers.position[..., 2]
    height = height[:, height.isfinite().all(dim=0)]
    if height.shape[1] < 3:
        return None
    mean = height.mean(dim=1)
    acceleration = (mean[4:] - 2 * mean[2:-2] + mean[:-4]) * (trial.markers.rate / 2) ** 2
    forces = to_clock(trial.forces, trial.markers.time)
    vertical, beside = forces.total[:, 2].nan_to_num(), beside_plates(trial.markers, forces)
    return _Course(vertical[2:-2], acceleration, beside[2:-2], trial.markers.rate)
