"""How late forces are, by the feet alone: a loaded foot stands still, and moves before and after."""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.agreement.changes import Change
from torchid.agreement.evidence import BELT_M_S, pressure_foot, slowest_point, weighted_quantile
from torchid.agreement.feet import Feet, find_feet
from torchid.agreement.finding import Finding
from torchid.conventions import SAMPLE_LOADED_N
from torchid.io.mend import ForcesAs, PlateAs, number_of
from torchid.recording import Forces, Plate, Trial

LONGEST_S = 0.5
"""Lags are looked for up to this size."""
SHORTEST_CONTACT_S = 0.1
SEEN = 0.8
"""A lag counts where this share of the load meets a foot that was seen."""
LEAST_S, CLEAR = 0.030, 1.5
"""A lag is believed from this size on, where undoing it makes the loaded foot this much slower (root mean square).
Feet tell clocks to 20 ms; of 52 public recordings the largest are 32 ms with a factor of 1.1 and 24 ms with 1.6."""
SAME_S = 0.025
"""Lags of plates this near their common one are one: feet tell each to 20 ms."""
MOST_FRAMES = 20_000
"""Frames from the beginning of a recording that tell its clock."""
STILL = 0.5
"""And where the foot then slips by less than this share of its speed over the whole recording: else it was not its
contact."""


@dataclass(frozen=True)
class Lag:
    """How late the forces of one plate are, by how its foot slips under each lag."""

    slip: Float[Tensor, " lags"]
    """Sum of force times the foot's squared speed, for lags from -n to n frames."""
    load: Float[Tensor, " lags"]
    """Sum of the force that met a foot that was seen."""
    rate: float

    def __add__(self, other: "Lag") -> "Lag":
        return Lag(self.slip + other.slip, self.load + other.load, self.rate)

    @property
    def cost(self) -> Float[Tensor, " lags"]:
        """Mean squared speed of the loaded foot [m^2/s^2]; infinite where too little of it was seen."""
        return torch.where(self.load > SEEN * self.load.max(), self.slip / self.load, torch.inf)

    @property
    def seconds(self) -> float:
        """The lag of least cost, between frames by a parabola."""
        cost, k, most = self.cost, int(self.cost.argmin()), len(self.cost) // 2
        place = float(k - most)
        if 0 < k < 2 * most and bool(torch.isfinite(cost[k - 1 : k + 2]).all()):
            a, b, c = cost[k - 1 : k + 2].tolist()
            place += 0.5 * (a - c) / max(a - 2 * b + c, 1e-12)
        return place / self.rate

    @property
    def late(self) -> bool:
        """Whether it is beyond doubt."""
        clear = float(self.cost[len(self.cost) // 2]) > CLEAR**2 * float(self.cost.min())
        return clear and abs(self.seconds) > LEAST_S


def contact_lag(feet: Feet, forces: Forces, k: int, height: float, rate: float) -> Lag | None:
    """Lag of plate k, None where no whole contact of one foot tells it.

    Only contacts whose beginning and end are recorded count: the end of a recording says nothing about a clock.

    Args:
        feet: at all frames.
        forces: at the same frames.
        k: which plate.
        height: of its surface in W [m].
        rate: frames per second.
    """
    fz, foot = forces.wrench[:, k, 2].nan_to_num(), pressure_foot(feet, forces.wrench[:, k], height)
    speed, most = slowest_point(feet), round(LONGEST_S * rate)
    cost, weight, used = torch.zeros(2 * most + 1), torch.zeros(2 * most + 1), 0
    for start, stop in _contacts(fz > SAMPLE_LOADED_N, round(SHORTEST_CONTACT_S * rate)):
        load, own = fz[start:stop], int(torch.mode(foot[start:stop]).values)
        square = _against_ground(speed[:, own], load, start)
        if _belongs(square, load, start):
            # One window of the foot's speed a shift, the latest force first.
            windows = torch.nn.functional.pad(square, (most, most), value=torch.nan).unfold(0, len(load), 1)
            windows = windows[start : start + 2 * most + 1]
            cost, weight = cost + windows.nan_to_num() @ load, weight + torch.isfinite(windows).double() @ load
            used += 1
    return Lag(cost.flip(0), weight.flip(0), rate) if used else None


def _against_ground(velocity: Tensor, load: Tensor, start: int) -> Tensor:
    """Squared speed (n) against the ground, which is a belt where the loaded foot moves as one."""
    during = velocity[start : start + len(load)]
    ground = torch.stack([weighted_quantile(during[None, :, i], load[None], 0.5)[0] for i in range(2)])
    return (velocity - (ground if float(ground.norm()) > BELT_M_S else 0.0)).square().sum(dim=-1)


def _belongs(square: Tensor, load: Tensor, start: int) -> bool:
    """The foot moves with the load's beginning and end, as one foot's contact does and two feet's does not."""
    during = square[start : start + len(load)]
    return float((load * during.nan_to_num()).sum() / load.sum()) < STILL * float(square.nanmean())


def _contacts(loaded: Tensor, least: int) -> list[tuple[int, int]]:
    """Start and end of every whole contact."""
    edges = torch.diff(loaded.long())
    starts, stops = (edges == 1).nonzero()[:, 0] + 1, (edges == -1).nonzero()[:, 0] + 1
    return [
        (a, b)
        for a in starts.tolist()
        for b in [next((s for s in stops.tolist() if s > a), None)]
        if b and b - a > least
    ]


def clock_findings(trial: Trial) -> tuple[Finding, ...]:
    """Forces that are late or early by more than ``LEAST_S``, plate by plate or all alike."""
    forces, rate = trial.forces, trial.markers.rate
    assert forces is not None
    feet = find_feet(trial.markers, torch.arange(min(len(trial.markers.time), MOST_FRAMES)))
    if feet is None:
        return ()
    part = Forces(forces.time[feet.frames], forces.wrench[feet.frames], forces.plates)
    heights = [0.0 if p.corners is None else float(p.corners[:, 2].mean()) for p in forces.plates]
    lags = {k: contact_lag(feet, part, k, height, rate) for k, height in enumerate(heights)}
    told = {k: lag for k, lag in lags.items() if lag is not None}
    if not told:
        return ()
    total = sum(list(told.values())[1:], next(iter(told.values())))
    if total.late and all(abs(lag.seconds - total.seconds) < SAME_S for lag in told.values()):
        change = Change("their clock is off by that", ForcesAs(lag_ms=_rounded(total)))
        return (Finding(f"all forces are {_in_words(total)}", (change,)),)
    return tuple(_of_plate(forces.plates[k], k, lag) for k, lag in told.items() if lag.late)


def _of_plate(plate: Plate, k: int, lag: Lag) -> Finding:
    n = number_of(plate, k)
    change = Change("its clock is off by that", plates={n: PlateAs(lag_ms=_rounded(lag))})
    return Finding(f"{plate.name} is {_in_words(lag)}", (change,), f"plates: {{{n}: {{use: false}}}}")


def _rounded(lag: Lag) -> float:
    return float(round(1e3 * lag.seconds))


def _in_words(lag: Lag) -> str:
    now, then = (float(x) ** 0.5 for x in (lag.cost[len(lag.cost) // 2], lag.cost.min()))
    direction = "late" if lag.seconds > 0 else "early"
    return (
        f"{abs(1e3 * lag.seconds):.0f} ms {direction}: the loaded foot slips at {now:.2f} m/s as read, "
        f"at {then:.2f} m/s with that undone"
    )
