"""What standing on plates tells: the weight, which frames of other trials miss a part of it, and the mass."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchid.contact.options import ContactOptions
from torchid.conventions import GRAVITY, SAMPLE_LOADED_N
from torchid.dynamics.rows import WrenchTrial, predict
from torchid.geometry.result import GeometryFit
from torchid.geometry.tracking import Tracked
from torchid.model.model import InertialPrior
from torchid.motion import Motion
from torchid.recording import Trial
from torchid.runs import spread
from torchid.session import Followed, Session
from torchid.session.following import Following, follow, put_aside
from torchid.storage.results import OutputFolder

ALWAYS = 0.98
"""Share of the loaded frames from which on a lack is that of the whole trial."""
KNOWN = 0.95
"""Level of what plates seem to bear too much that stands for the error of the balance."""


@dataclass(frozen=True)
class Weight:
    """What a subject weighs, from standing on plates."""

    mass: float
    """[kg]"""
    sd: float
    """Of the mass [kg]: of the plates' gains, which standing does not show."""
    trials: tuple[str, ...]
    """That it was read in."""


def falls_short(
    vertical: Float[Tensor, " frames"],
    needed: Float[Tensor, " frames"],
    weight: Weight,
    rate_hz: float,
    options: ContactOptions,
) -> Bool[Tensor, " frames"]:
    """Frames of a run in which a share of the weight is missing.

    Args:
        vertical: force of all plates [N], smoothed as the motion is.
        needed: mass times gravity and the vertical acceleration of the centre of mass [N].
        weight: from standing.
        options: how much may be missing, and for how long.
    """
    missing = (needed - vertical) / (GRAVITY * weight.mass) - weight.sd / weight.mass
    bearing = vertical > 0.5 * GRAVITY * weight.mass
    if not bool(bearing.any()):
        return missing > options.missing_share
    # No plate bears more than there is: what it seems to bear too much tells how well the acceleration is known.
    share = max(options.missing_share, float((-missing[bearing]).quantile(KNOWN)))
    width = max(1, round(options.shortest_s * rate_hz)) | 1
    padded = torch.nn.functional.pad(missing[None, None], (width // 2, width // 2), mode="replicate")
    lasting = torch.nn.functional.avg_pool1d(padded, width, stride=1)[0, 0]
    short = spread(lasting > share, missing > 0.5 * share)
    # Where a share is missing throughout, no contact comes or goes: that is for the diagnosis.
    loaded = vertical > options.loaded_n
    return short if float((missing > share)[loaded].double().mean()) < ALWAYS else torch.zeros_like(short)


STANDS = 0.9
"""Who stands keeps the median of the force at this share of its largest value."""
NEAR_RECORD = 0.75, 1.33
"""Standing masses over the recorded one that are believed: a foot beside the plate halves it."""
PLATE_GAIN = 0.005
"""Relative scatter of masses that one laboratory's plates read in standing and in walking: 0.4 % in eight public
sessions."""


def follow_each(
    fit: GeometryFit, session: Session, tracked: Callable[[str], Tracked], way: Following, prior: InertialPrior
) -> Iterator[Followed]:
    """All trials followed by one model, static ones first: what they weigh tells which frames of the others count.

    Args:
        tracked: coordinates of a trial by its name.
        prior: inertia of the model, whose shares of mass tell what the plates should bear.
    """
    levels: dict[str, float] = {}
    for name in sorted(session.trials, key=lambda n: session.trials[n].role != "static"):
        trial, weight = session.trials[name], _weight(levels)
        short = weight and short_of(fit, trial, weight, prior.mean, way.contact)
        one = follow(fit, trial, tracked(name), way, short)
        level = _level(one, session, way.recorded_kg)
        if level is not None:
            levels[name] = level
        yield one


def follow_session(
    fit: GeometryFit,
    session: Session,
    tracked: Callable[[str], Tracked],
    way: Following,
    prior: InertialPrior,
    folder: OutputFolder,
) -> dict[str, Followed]:
    """Return all trials followed by one model, in the order of the session, what is as long as they are in files.

    Args:
        tracked: coordinates of a trial by its name.
    """
    found = {one.name: put_aside(one, folder) for one in follow_each(fit, session, tracked, way, prior)}
    return {name: found[name] for name in session.trials}


def standing_weight(followed: Iterable[Followed], session: Session, recorded_kg: float | None) -> Weight | None:
    """What the subject weighs, from the static trials that stand on plates; None where none does."""
    levels = {one.name: _level(one, session, recorded_kg) for one in followed}
    return _weight({name: level for name, level in levels.items() if level is not None})


def carried(trial: WrenchTrial | None, phi: Float[Tensor, "bodies 10"]) -> float | None:
    """Mass [kg] that the plates bear in the used frames of a trial, None where there are none.

    Args:
        trial: its motion and what the plates read.
        phi: how the mass is shared out, of which the total does not matter.
    """
    if trial is None or not bool(trial.used.any()):
        return None
    one = predict(trial, phi)[trial.used, 2] / phi[:, 0].sum()
    return float(trial.wrench[trial.used, 2] @ one / (one @ one))


def _weight(levels: dict[str, float]) -> Weight | None:
    mass = sum(levels.values()) / max(len(levels), 1)
    return Weight(mass, PLATE_GAIN * mass, tuple(levels)) if levels else None


def _level(one: Followed, session: Session, recorded_kg: float | None) -> float | None:
    """Mass [kg] that a static trial reads, None where it does not stand on plates that can be believed."""
    if session.trials[one.name].role != "static" or not session.files[one.name].inertia or one.wrench is None:
        return None
    if one.contact is None or not one.contact.feet:
        return None
    # Not the recording's: an extended model stands on plates that are put right.
    vertical = one.wrench.wrench[one.contact.measured, 2]
    if not (len(vertical) and float(vertical.median()) > STANDS * float(vertical.max()) > SAMPLE_LOADED_N):
        return None
    mass = float(vertical.mean()) / GRAVITY
    return mass if not recorded_kg or NEAR_RECORD[0] < mass / recorded_kg < NEAR_RECORD[1] else None


def short_of(
    fit: GeometryFit, trial: Trial, weight: Weight, phi: Float[Tensor, "bodies 10"], contact: ContactOptions
) -> Callable[[Motion], Bool[Tensor, " frames"]] | None:
    """From a motion to the frames in which the plates miss a part of the weight, with the shares of mass of ``phi``."""
    if trial.forces is None:
        return None
    vertical = trial.forces.total
    known = torch.isfinite(vertical[:, 2])

    def short(motion: Motion) -> Bool[Tensor, " frames"]:
        total = motion.smoother(torch.nan_to_num(vertical), known.to(vertical))
        every = WrenchTrial(trial.name, fit.model.tree, fit.geometry, motion, total, known)
        needed = predict(every, phi)[:, 2] * (weight.mass / phi[:, 0].sum())
        return known & falls_short(total[:, 2], needed, weight, trial.markers.rate, contact)

    return short
