"""How late forces are, by the feet alone: a loaded foot stands still, and moves before and after."""

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.checks.clocks import BY_FEET, FEET_SD_S, Lateness
from torchid.checks.plates_against_feet.changes import Change
from torchid.checks.plates_against_feet.evidence import BELT_M_S, pressure_centre, slowest_point, weighted_quantile
from torchid.checks.plates_against_feet.feet import Feet, find_feet
from torchid.checks.plates_against_feet.finding import ForceFinding, without
from torchid.conventions import SAMPLE_LOADED_N
from torchid.io.mend import ForcesAs, PlateAs, number_of
from torchid.recording import Forces, Plate, Trial

LONGEST_S = 0.5
"""Lags are looked for up to this size."""
SHORTEST_CONTACT_S = 0.1
SEEN = 0.8
"""A lag counts where this share of the load meets a foot that was seen."""
CLEAR = 1.5
"""Calibrated. A lag is believed where undoing it makes the loaded foot this much slower (root mean square), by the 52
public recordings of ``BY_FEET``."""
MOVES_M_S = 0.05
"""And by this speed [m/s]: who stands has no clock in the feet."""
SAME_S = 0.05
"""Late plates whose lags lie this near their common one share a clock: feet tell each to 20 ms, twice over here."""
MOST_FRAMES = 20_000
"""Frames from the beginning of a recording that tell its clock."""
NEAR_M = 0.25
"""Distance of a centre of pressure from the middle of its foot's markers, averaged over a contact: 0.05 to 0.12 m."""
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

    def no_worse(self, seconds: float) -> bool:
        """Whether another lag suits this plate as well as none."""
        most = len(self.cost) // 2
        at = most + round(seconds * self.rate)
        return 0 <= at < len(self.cost) and float(self.cost[at]) <= float(self.cost[most])

    @property
    def late(self) -> bool:
        """Whether it is beyond doubt."""
        now, then = float(self.cost[len(self.cost) // 2]), float(self.cost.min())  # infinite: the foot is not there
        return now > CLEAR**2 * then and now - then > MOVES_M_S**2 and self.lateness.wrong(BY_FEET)

    @property
    def lateness(self) -> Lateness:
        """By how much its forces come late."""
        return Lateness(self.seconds, FEET_SD_S)


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
    known, centre = torch.isfinite(forces.wrench[:, k, 2]), pressure_centre(forces.wrench[:, k], height)
    load = forces.wrench[:, k, 2].nan_to_num()
    most, found = round(LONGEST_S * rate), []
    for start, stop in _contacts(load > SAMPLE_LOADED_N, round(SHORTEST_CONTACT_S * rate)):
        part = slice(start, stop)
        if not bool(known[start - 1 : stop + 1].all()):
            continue
        each = [_slips(feet, foot, load[part], centre[part], start, most, rate) for foot in range(feet.count)]
        own = min((lag for lag in each if lag is not None), key=lambda lag: float(lag.cost.min()), default=None)
        found += [] if own is None else [own]
    return sum(found[1:], found[0]) if found else None


def _slips(feet: Feet, foot: int, load: Tensor, centre: Tensor, start: int, most: int, rate: float) -> Lag | None:
    """How one foot slips under one contact's load under every lag, None where it is not its contact.

    The foot has to be where the pressure is, and to move before and after, as one foot's contact does and two feet's
    does not.
    """
    velocity = slowest_point(feet)[:, foot]
    square = _against_ground(velocity, load, start)
    place = feet.position[:, feet.foot == foot, :2].nanmean(dim=1)
    # One window a shift of what the foot does, the latest force first.
    slip, near = (_windows(x, len(load), start, most) for x in (square[:, None], place))
    away = (near - centre.T[None]).norm(dim=1).nan_to_num(torch.inf)
    there = (away * load).sum(dim=1) / load.sum() < NEAR_M
    slip = torch.where(there[:, None], slip[:, 0], torch.nan).flip(0)
    lag = Lag(slip.nan_to_num() @ load, torch.isfinite(slip).double() @ load, rate)
    known = bool((lag.load > SEEN * load.sum()).any())
    return lag if known and float(lag.cost.min()) < STILL * float(square.nanmean()) else None


def _windows(values: Tensor, length: int, start: int, most: int) -> Tensor:
    """(lags, columns, length): values (n, columns) from ``start`` on, earlier and later by up to ``most`` frames."""
    padded = torch.nn.functional.pad(values, (0, 0, most, most), value=torch.nan)
    return padded.unfold(0, length, 1)[start : start + 2 * most + 1]


def _against_ground(velocity: Tensor, load: Tensor, start: int) -> Tensor:
    """Squared speed (n) against the ground, which is a belt where the loaded foot moves as one."""
    during = velocity[start : start + len(load)]
    ground = torch.stack([weighted_quantile(during[None, :, i], load[None], 0.5)[0] for i in range(2)])
    return (velocity - (ground if float(ground.norm()) > BELT_M_S else 0.0)).square().sum(dim=-1)


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


def clock_findings(trial: Trial) -> tuple[ForceFinding, ...]:
    """Forces that are early or late by more than ``BY_FEET``, plate by plate or all alike."""
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
    late = [lag for lag in told.values() if lag.late]
    if late:
        shared = sum(late[1:], late[0])
        near = all(abs(lag.seconds - shared.seconds) < SAME_S for lag in late)
        if near and all(lag.late or lag.no_worse(shared.seconds) for lag in told.values()):
            change = Change(
                "their clock is off by that", ForcesAs(lag_ms=_rounded(shared)), size=shared.seconds, unit="s"
            )
            return (ForceFinding(f"all forces are {_in_words(shared)}", (change,)),)
    return tuple(_of_plate(forces.plates[k], k, lag) for k, lag in told.items() if lag.late)


def _of_plate(plate: Plate, k: int, lag: Lag) -> ForceFinding:
    n = number_of(plate, k)
    change = Change(
        "its clock is off by that",
        plates={n: PlateAs(lag_ms=_rounded(lag))},
        size=lag.seconds,
        sd=lag.lateness.sd,
        unit="s",
    )
    return ForceFinding(f"{plate.name} is {_in_words(lag)}", (change,), without(n))


def _rounded(lag: Lag) -> float:
    return float(round(1e3 * lag.seconds))


def _in_words(lag: Lag) -> str:
    now, then = (float(x) ** 0.5 for x in (lag.cost[len(lag.cost) // 2], lag.cost.min()))
    direction = "late" if lag.seconds > 0 else "early"
    seen = f"slips at {now:.2f} m/s as read" if math.isfinite(now) else "is elsewhere as read"
    return (
        f"{abs(1e3 * lag.seconds):.0f} ms {direction}: the loaded foot {seen}, and slips at {then:.2f} m/s "
        "with that undone"
    )
