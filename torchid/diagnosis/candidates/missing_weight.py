"""Weight that is plainly borne where no plate is: a seat, a box, a rail that somebody leans on.

Such a force is many times what noise or any other effect makes. It would drown the search that looks for those, and be
taken for inertia; so it is recognised by its size alone, named, and its frames are set aside.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations_with_replacement

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchid.contact.contact import Contact
from torchid.diagnosis.candidates.touched_segment import BLOCK_S, centre_of, raised, touched
from torchid.diagnosis.options import MissingWeightOptions
from torchid.dynamics.equations_of_motion import wrench_about
from torchid.dynamics.rows import predict
from torchid.effects.catalogue import CATALOGUE
from torchid.effects.columns import columns
from torchid.effects.contact import MOST_KNOTS, CoursedForce
from torchid.effects.place import Interval, Place, inside_any
from torchid.observation.trial import TrialObservation
from torchid.recording import Forces
from torchid.runs import runs

EFFECT = next(one for one in CATALOGUE.values() if isinstance(one, CoursedForce))
"""The effect as which such weight is named."""
SPREAD_S = 0.1
"""Resolution. Time either side of an interval into which filters carry it [s]."""


@dataclass(frozen=True)
class MissingWeight:
    """A contact of one trial, in one or several intervals."""

    place: Place
    """Segment that is touched, the intervals, the point, and the number of knots of the force's course."""
    theta: Float[Tensor, " params"]
    """Internal parameters of ``EFFECT``: the force at its knots [N]."""
    sd: Float[Tensor, " params"]
    """Standard deviations of these."""
    odds: dict[str, float]
    """Posterior probabilities of the segments that may be touched."""
    gain: dict[str, float]
    """Held-out gain, as ``HeldOutFit.over`` has it: every second block of ``BLOCK_S`` is predicted by the others'
    course."""
    missing_part: float
    """Largest part of the weight that is missing."""

    @property
    def effect(self) -> CoursedForce:
        """Effect as which it is named."""
        return EFFECT

    @property
    def aside(self) -> tuple[Interval, ...]:
        """Intervals that no model should be fitted to."""
        assert self.place.when is not None
        return tuple(Interval(i.trial, i.t0 - SPREAD_S, i.t1 + SPREAD_S) for i in self.place.when)


def find_missing_weight(
    observed: TrialObservation,
    forces: Forces,
    contact: Contact,
    observable: Bool[Tensor, " frames"],
    options: MissingWeightOptions = MissingWeightOptions(),
) -> MissingWeight | None:
    """Return the contact of a trial in which plates miss a good part of the weight; None if there is none.

    A force that goes through feet on the floor is no such contact.

    Args:
        observed: the trial; its inertia tells what is missing.
        forces: readings of its plates, unfiltered, on the clock of the motion.
        contact: contact of its feet.
        observable: frames whose markers determine every coordinate: a bridged motion needs what nobody supplied.
        options: thresholds of what is plainly much.
    """
    rows, scene = observed.rows, observed.view.scene
    # Nor where another contact bears that no plate measures, as the user has said.
    known = torch.isfinite(forces.total).all(1) & observable & ~contact.unmeasured
    # Not the rows': those are bridged where a foot stands beside the plates.
    read = rows.motion.smoother(torch.nan_to_num(forces.total), known.to(torch.float64))
    missing = wrench_about(predict(rows, observed.phi), -rows.motion.q[:, :3]) - read
    weight = 9.81 * float(observed.phi[:, 0].sum())
    # Beside the plates the floor bears it; a plate that reads some of what stands on it reads too little.
    floor, read_some = (
        _underfoot(observed, contact, stands, missing, options)
        for stands in (contact.touching & ~contact.supported, contact.touching & ~contact.unread)
    )
    lack = torch.where(torch.isfinite(forces.total).all(1) & ~floor, missing[:, 2] / weight, 0.0)
    when = _lacking(lack, _clear(known, round(SPREAD_S * rows.rate)) & ~read_some, observed, options)
    if not when:
        return None
    inside = inside_any(when, rows.name, scene.time)
    odds, points = touched(observed, contact, missing, inside, options)
    best = max(odds, key=lambda name: odds[name])
    longest = max(own.t1 - own.t0 for own in when)
    knots = min(MOST_KNOTS, max(3, 1 + round(longest / BLOCK_S)))
    place = Place((best,), when, points[best], {"knots": float(knots)})
    return _coursed(observed, place, missing, inside, odds)


def set_aside(observed: TrialObservation, aside: Sequence[Interval]) -> TrialObservation:
    """Return the trial without the frames of intervals.

    Args:
        observed: the trial.
        aside: intervals, of any trials.
    """
    rows = observed.rows
    used = rows.used & ~inside_any(aside, rows.name, rows.motion.time)
    return replace(observed, rows=replace(rows, used=used))


def _lacking(
    lack: Float[Tensor, " frames"],
    plain: Bool[Tensor, " frames"],
    observed: TrialObservation,
    options: MissingWeightOptions,
) -> tuple[Interval, ...]:
    """Return intervals in which more than a little is missing, and for a while plainly much."""
    time, name, much = observed.view.scene.time, observed.rows.name, (lack > options.missing_part) & plain
    parts = [part for part in runs(lack > options.gone_part)]
    parts = [part for part in parts if _lasts(much[slice(*part)], options.shortest_s * observed.rows.rate)]
    if sum(b - a for a, b in parts) > options.longest_part * len(lack):
        return ()
    return tuple(Interval(name, float(time[a]), float(time[b - 1])) for a, b in parts)


def _lasts(much: Bool[Tensor, " frames"], frames: float) -> bool:
    """Return whether a run of True has at least so many frames."""
    return any(stop - start >= frames for start, stop in runs(much))


def _clear(flag: Bool[Tensor, " frames"], frames: int) -> Bool[Tensor, " frames"]:
    """Return where every False is so far that no filter carries it there."""
    n = 2 * frames + 1
    wide = torch.nn.functional.max_pool1d((~flag).double()[None, None], n, stride=1, padding=frames)
    return wide[0, 0] == 0.0


def _underfoot(
    observed: TrialObservation, contact: Contact, stands: Bool[Tensor, "frames feet"],
    missing: Float[Tensor, "frames 6"], options: MissingWeightOptions,
) -> Bool[Tensor, " frames"]:  # fmt: skip
    """Return frames in which the missing force goes through feet that stand on the floor, or between them."""
    centre = torch.stack([-missing[:, 4], missing[:, 3]], 1) / missing[:, 2:3]
    at = torch.stack([centre_of(observed, foot) for foot in contact.feet])
    stands = stands.T & ~torch.stack([raised(one, options) for one in at])
    found = torch.zeros_like(stands[0])
    for a, b in combinations_with_replacement(range(len(at)), 2):
        start, along = at[a, :2].T, (at[b, :2] - at[a, :2]).T
        share = ((centre - start) * along).sum(1) / along.square().sum(1).clamp(min=1e-9)
        away = (centre - start - share.clamp(0.0, 1.0)[:, None] * along).norm(dim=1)
        found |= stands[a] & stands[b] & (away < options.reach_m)
    return found


def _coursed(
    observed: TrialObservation, place: Place, missing: Float[Tensor, "frames 6"], inside: Bool[Tensor, " frames"],
    odds: dict[str, float],
) -> MissingWeight:  # fmt: skip
    """Return the contact with its force from knot to knot, and the gain of that at frames which it was not fitted
    to."""
    root = observed.rows.motion.q[inside, :3]
    load = -columns(EFFECT, observed.view.scene, observed.view.reading, place)[..., inside].permute(1, 2, 0)
    Y = wrench_about(load, root.expand(len(load), -1, -1)).permute(1, 2, 0)
    wrench = wrench_about(missing[inside], root)
    tenth = max(1, round(BLOCK_S * observed.rows.rate))
    seen = (torch.arange(len(wrench)) // tenth) % 2 == 0
    left = wrench[~seen] - Y[~seen] @ _solved(Y[seen], wrench[seen])
    before, after = (torch.stack([_rms(x[:, :3]), _rms(x[:, 3:])]) for x in (wrench[~seen], left))
    theta = _solved(Y, wrench)
    sd = ((wrench - Y @ theta)[:, :3].square().mean() * tenth * _inverse(Y).diagonal()).sqrt()
    part = (100.0 * (1.0 - after / before)).tolist()
    nats = 3.0 * float((~seen).sum()) / tenth * math.log(float(before[0] / after[0]))
    gain = {"heldout_log_likelihood": nats, "force_rmse_pct": part[0], "moment_rmse_pct": part[1]}
    weight = 9.81 * float(observed.phi[:, 0].sum())
    return MissingWeight(place, theta, sd, odds, gain, float(missing[inside, 2].max()) / weight)


def _rms(x: Float[Tensor, "frames 3"]) -> Float[Tensor, ""]:
    """Return the root mean square of the norm of vectors."""
    return x.square().sum(1).mean().sqrt()


def _solved(Y: Float[Tensor, "frames 6 params"], wrench: Float[Tensor, "frames 6"]) -> Float[Tensor, " params"]:
    """Return the solution by the forces alone: a moment also depends on the place."""
    return _inverse(Y) @ (Y[:, :3].flatten(0, 1).T @ wrench[:, :3].flatten())


def _inverse(Y: Float[Tensor, "frames 6 params"]) -> Float[Tensor, "params params"]:
    """Return the inverse of the columns' Gram matrix, made regular by a thousandth of its diagonal."""
    flat = Y[:, :3].flatten(0, 1)
    gram = flat.T @ flat
    return torch.linalg.inv(gram + 1e-3 * gram.diagonal().mean() * torch.eye(len(gram)).to(gram))
