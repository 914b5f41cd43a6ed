"""Where and when the data suggest that something comes and goes: what is worth columns.

A proposal is no verdict. Each one stands among the others that could have been made (``odds``), so that looking for it
is paid for.
"""

import math
from collections.abc import Sequence
from dataclasses import replace

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchid.diagnosis.cameras import Cameras
from torchid.diagnosis.fixed import Fixed
from torchid.diagnosis.watched import Watched
from torchid.effects.effect import Effect
from torchid.effects.joints import MissingDof
from torchid.effects.place import Interval, Place
from torchid.effects.session import MovingGround
from torchid.regressor.rows import measured, runs

WINDOWS = 2
"""Intervals proposed for each trial."""
CLOCK_HZ = 20.0
"""At which ends of intervals are looked for."""
SHORTEST_S = 0.2
LONGEST = 0.7
"""Part of a trial; what lasts longer is not an interval."""
JOINTS = 2
"""Joints proposed for each kind of missing motion."""
PEAKS = 3
"""Frequencies proposed for ground that moves."""
AROUND, NEAR = 40, 5
"""Steps of the grid of frequencies to compare with, and that count as the same peak."""
SWAPPED = 5
"""Frames that a swap lasts at least."""
EVERY, AT_ONCE = 5, 1024
"""Frames of which one is looked at for pairs of markers that come near each other, and that many together."""
CLOSER = 0.5
"""Part of the squared distances that must be left after a swap is undone."""


def suggested(effect: Effect, watched: Sequence[Watched]) -> tuple[Place, ...]:
    """Places of an effect: all it names, those of its intervals, or those worth a closer look."""
    views = [w.view for w in watched]
    if effect.name == "marker_swap":
        return tuple(place for w in watched if w.cameras is not None for place in swaps(w.cameras))
    if isinstance(effect, MissingDof):
        return _loosest(effect, watched)
    if isinstance(effect, MovingGround):
        return _shakes(effect, watched)
    if not effect.timed:
        return effect.places(views)
    found, places = [window for w in watched for window in windows(w)], effect.places(views)
    share = 1.0 / (len(places) * len(watched))
    return tuple(replace(place, when=(own,), odds=share * odds) for place in places for own, odds in found)


def unexplained(watched: Watched) -> Float[Tensor, "frames 6"]:
    """Residual of the identified model, zero where frames are not used."""
    rows = watched.rows
    return torch.where(rows.used[:, None], measured(rows) - watched.needed(watched.phi.reshape(-1)), 0.0)


def _shakes(effect: MovingGround, watched: Sequence[Watched]) -> tuple[Place, ...]:
    """Frequencies at which the residual forces of all trials stand out of their neighbours."""
    places = effect.places([w.view for w in watched])
    frequency = torch.tensor([place.grid["frequency_hz"] for place in places], dtype=torch.float64)
    power = torch.zeros_like(frequency)
    for w in watched:
        phase = 2.0 * torch.pi * frequency[:, None] * w.rows.motion.time
        force = unexplained(w)[:, :3]
        force = force - force.mean(0)
        power += (torch.cos(phase) @ force).square().sum(1) + (torch.sin(phase) @ force).square().sum(1)
    around = torch.nn.functional.pad(power[None], (AROUND, AROUND), mode="reflect")[0].unfold(0, 2 * AROUND + 1, 1)
    height = power / around.median(1).values.clamp(min=1e-12)
    best = []
    for _ in range(PEAKS):
        best.append(int(height.argmax()))
        height[max(0, best[-1] - NEAR) : best[-1] + NEAR + 1] = 0.0
    return tuple(replace(places[k], odds=1.0 / len(places)) for k in best)


def windows(watched: Watched) -> list[tuple[Interval, float]]:
    """Intervals in which the residual's mean stands out most, with the odds of each among all there are.

    The scan statistic |sum of residuals|^2 / length over all pairs of ends, forces and moments each on the scale of
    their own scatter.
    """
    rows = watched.rows
    left = unexplained(watched)
    group = max(1, round(rows.rate / CLOCK_HZ))
    bins = len(left) // group
    coarse = left[: bins * group].unflatten(0, (bins, group)).mean(1)
    scale = coarse.abs().median(0).values.clamp(min=1e-9)
    coarse = (coarse - coarse.median(0).values) / scale
    found, clock = [], group / rows.rate
    for _ in range(WINDOWS):
        a, b = _strongest(coarse, round(SHORTEST_S / clock), int(LONGEST * bins))
        if b <= a:
            break
        t0 = float(rows.motion.time[0])
        found.append((Interval(rows.name, t0 + a * clock, t0 + b * clock), 2.0 / bins**2))
        coarse[a:b] = 0.0
    return found


def _strongest(x: Float[Tensor, "bins 6"], shortest: int, longest: int) -> tuple[int, int]:
    sums = torch.cat([x.new_zeros(1, 6), x.cumsum(0)])
    length = torch.arange(len(sums))[None] - torch.arange(len(sums))[:, None]
    power = (sums[None] - sums[:, None]).square().sum(2) / length.clamp(min=1)
    power[(length < shortest) | (length > longest)] = 0.0
    return divmod(int(power.argmax()), len(sums)) if float(power.max()) > 0.0 else (0, 0)


def swaps(cameras: Cameras) -> list[Place]:
    """Pairs of markers and when they are closer to each other's places than to their own.

    Where one of them is lost the other tells, and where both are, the frames about: without them half of a swap was
    named, and the other half as a marker that was moved.
    """
    sight, seen = cameras.sight, cameras.weight > 0.0
    found: dict[tuple[int, int], list[Interval]] = {}
    trial, time = sight.scene.trial, sight.scene.time
    odds = 1.0 / (math.comb(len(sight.labels), 2) * len(time))
    for a, b in _near(cameras):
        exchanged = _exchanged(cameras, a, b)
        if int(exchanged.sum()) < SWAPPED:
            continue
        for start, stop in runs(exchanged | ~(seen[a] | seen[b])):
            inside = start + exchanged[start:stop].nonzero()[:, 0]
            if int((seen[a] & seen[b])[inside].sum()) >= SWAPPED:
                t0, t1 = float(time[inside[0]]), float(time[inside[-1]])
                found.setdefault((a, b), []).append(Interval(trial, t0, t1))
    return [Place((sight.labels[a], sight.labels[b]), tuple(own), odds=odds) for (a, b), own in found.items()]


def _near(cameras: Cameras) -> list[tuple[int, int]]:
    """Pairs of which one may be where the other is: all others are farther apart than errors reach.

    With e the errors of a pair and D what exchanging adds to them, |e + D|^2 < c |e|^2 wants |D| < (1 + c^0.5) |e|,
    and |D| is the distance at least.
    """
    p, seen = cameras.sight.p.permute(2, 0, 1), cameras.weight > 0.0
    error = (seen * torch.linalg.vector_norm(cameras.error, dim=1)).amax(1)
    # Between the frames that are looked at, a distance shrinks by what both markers stray at most.
    looked = p[::EVERY]
    strays = (p - looked.repeat_interleave(EVERY, 0)[: len(p)]).norm(dim=2).amax(0)
    least = torch.stack([torch.cdist(some, some).amin(0) for some in looked.split(AT_ONCE)]).amin(0)
    reach = (1.0 + math.sqrt(CLOSER)) * torch.hypot(error[:, None], error)
    return [(a, b) for a, b in (least - strays[:, None] - strays < reach).nonzero().tolist() if a < b]


def _exchanged(cameras: Cameras, a: int, b: int) -> Bool[Tensor, " frames"]:
    """Frames in which what is seen of two markers fits better the other way round."""
    apart, both = cameras.sight.p[b] - cameras.sight.p[a], [a, b]
    seen, error = cameras.weight[both] > 0.0, cameras.error[both]
    now = (seen * error.square().sum(1)).sum(0)
    undone = (seen * (error + torch.stack([-apart, apart])).square().sum(1)).sum(0)
    return undone < CLOSER * now


def _loosest(effect: MissingDof, watched: Sequence[Watched]) -> tuple[Place, ...]:
    """Joints whose markers follow motion of their own, by the evidence of markers alone."""
    if watched[0].cameras is None:
        return ()
    places = effect.places([w.view for w in watched])
    score = torch.tensor([_loose(effect, places, w) for w in watched], dtype=torch.float64).sum(0)
    best = []
    for turning in (0.0, 1.0):
        own = [k for k, place in enumerate(places) if place.grid["turning"] == turning]
        best += sorted(own, key=lambda k: -float(score[k]))[:JOINTS]
    return tuple(replace(places[k], odds=1.0 / len(places)) for k in best)


def _loose(effect: MissingDof, places: Sequence[Place], watched: Watched) -> list[float]:
    """Evidence of free courses of each joint in one trial, geometry held, residuals' scatter as it is."""
    cameras = watched.cameras
    assert cameras is not None
    coarse, fixed = cameras.coarse, Fixed(cameras)
    shifts, courses = [], []
    for place in places:
        sway = effect.sway(cameras.sight, place)
        shifts.append(fixed.shown(sway.ways))
        # Geometry that errs is a constant.
        courses.append(sway.courses[1:, coarse.middle])
    left = coarse.left(torch.cat([*shifts, coarse.error[None]]))
    *ways, residual = left.split([*(len(s) for s in shifts), 1])
    each = zip(places, ways, courses, strict=True)
    return [_free(own, residual[0], modes, effect.scale(p)[0], coarse.free) for p, own, modes in each]


def _free(
    left: Float[Tensor, "ways bins rows"],
    residual: Float[Tensor, "bins rows"],
    modes: Float[Tensor, "modes bins"],
    scale: float,
    free: float,
) -> float:
    """Evidence of courses along some ways that are combinations of modes with coefficients of this scale; ``free`` as
    in ``Coarse``."""
    spread = residual.square().sum() / (free * residual.numel())
    A = torch.einsum("itr,jtr->tij", left, left) / spread
    b = torch.einsum("itr,tr->ti", left, residual) / spread
    gram = scale**2 * torch.einsum("tij,kt,lt->ikjl", A, modes, modes).flatten(2).flatten(0, 1)
    moment = scale * torch.einsum("ti,kt->ik", b, modes).flatten()
    L = torch.linalg.cholesky(gram + torch.eye(len(gram)).to(gram))
    u = torch.linalg.solve_triangular(L, moment[:, None], upper=False)
    return float(0.5 * u.square().sum() - L.diagonal().log().sum())
