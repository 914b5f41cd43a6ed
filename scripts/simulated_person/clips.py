"""Exercises of a simulated subject that begin and end in the same stance, so that one can follow another."""

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from torchid.errors import ConfigError
from torchid.filters import Smoother
from torchid.live.exercises.exercises import Exercise, intended
from torchid.motion import smooth_motion
from torchid.simulate.balance import Moving, balance, centre_of_pressure, needed_wrench, wanted_pressure
from torchid.simulate.motions import make_script
from torchid.simulate.options import SimulateOptions
from torchid.simulate.script import FootPath, Script, random_stance, smooth_step
from torchid.simulate.subject import SimulatedSubject
from torchid.simulate.trial import ATTEMPTS, SimulatedTrial, impossible, record, with_margins

STANDING = "standing"
"""Name of the recording of one who stands."""
EASE_S = 1.0
"""Choice. In which a subject passes from its stance to an exercise, and back: joints turn no faster then than in the
exercises themselves."""
SETTLE_S = 0.4
"""Derived. Between the last step of an exercise and the passage to the stance: the weight is back
``simulate.script.TRANSFER`` after a step, and the last one ends a tenth of a second before the exercise."""
LEAD_S = 0.5
"""Choice. Before a passage begins and after the last one: balance shifts the pelvis ahead of what comes, less and less
the longer before, with a time constant of a third of a second (``simulate.balance``)."""
ARRIVE_S = 0.8
"""Choice. In which what is left of that shift at the ends of an exercise comes and goes."""
EASIER = 0.07
"""Choice. By how much every further attempt is easier, as for simulated trials."""


class Standing(NamedTuple):
    """A subject as it stands between exercises."""

    who: SimulatedSubject
    """With the stance that all exercises keep."""
    script: Script
    """One frame of what it intends."""
    q: Float[Tensor, " dofs"]
    """Its coordinates."""


def make_standing(who: SimulatedSubject, seed: int, rate_hz: float) -> Standing:
    """Return how a subject stands between exercises: at ease, and still.

    Args:
        who: the subject.
        seed: of the stance.
        rate_hz: frames per second.
    """
    rng = np.random.default_rng((seed, 3))
    who, time = replace(who, stance=random_stance(rng, who)), with_margins(1.0, rate_hz)
    # Stretched no further than in exercises: knees as straight as in a static trial would have to give way first.
    drawn = replace(make_script("static", rng, who, time, 1.0), reach=Script.reach)
    one = _each(drawn, lambda x: x[:1])
    moving = balance(who, _held(one, time), rate_hz)
    return Standing(who, one, moving.motion.q[len(time) // 2])


def stand_still(standing: Standing, seconds: float, options: SimulateOptions) -> SimulatedTrial:
    """Return a recording without noise of a subject that stands still.

    Args:
        standing: the subject.
        seconds: duration.
        options: rates and plates.
    """
    time = with_margins(seconds, options.rate_hz)
    script = _held(standing.script, time)
    who = replace(standing.who, trial=STANDING)
    return record(who, script, _moving(standing, script, torch.zeros_like(script.angles)), options)


def make_clip(exercise: Exercise, standing: Standing, options: SimulateOptions, seed: int) -> SimulatedTrial:
    """Return a recording without noise of an exercise, from standing to standing.

    Args:
        exercise: what is done; its duration holds the passages as well.
        standing: the subject.
        options: rates and plates.
        seed: of the motion.

    Raises:
        ConfigError: ``simulate.balance``, the subject cannot do the exercise in balance.
    """
    who, time, found = standing.who, with_margins(exercise.seconds, options.rate_hz), ""
    start, inner = LEAD_S + EASE_S, exercise.seconds - 2.0 * (LEAD_S + EASE_S) - SETTLE_S
    part = _passing(time - LEAD_S, exercise.seconds - 2.0 * LEAD_S, EASE_S)
    for attempt in range(ATTEMPTS):
        rng = np.random.default_rng((seed, 4, attempt))
        script = intended(exercise, who, rng, time - start, inner, 1.0 - EASIER * attempt)
        script = _eased(replace(script, time=time), standing, part)
        q = balance(who, script, options.rate_hz).motion.q
        away = _passing(time, exercise.seconds, ARRIVE_S)[:, None] * (q - standing.q)
        moving = _moving(standing, script, away)
        found = impossible(who, moving)
        if not found:
            return record(replace(who, trial=exercise.name), script, moving, options)
    raise ConfigError(
        "simulate.balance", "the subject cannot do this exercise in balance", place=exercise.name, found=found,
        remedy="Take another seed",
    )  # fmt: skip


def _moving(standing: Standing, script: Script, away: Float[Tensor, "frames dofs"]) -> Moving:
    """The motion whose coordinates are so far from standing, with the wrench that it needs."""
    who, rate = standing.who, round(1.0 / float(script.time[1] - script.time[0]), 6)
    motion = smooth_motion(who.model.tree, script.time, standing.q + away, Smoother(rate, rate))
    wrench = needed_wrench(who, motion)
    missed = centre_of_pressure(wrench) - wanted_pressure(who, script)
    return Moving(motion, wrench, float(missed.norm(dim=1).max()))


def _passing(time: Float[Tensor, " frames"], seconds: float, ease_s: float) -> Float[Tensor, " frames"]:
    """From 0 at time zero to 1, and back to 0 at the end."""
    return smooth_step(time / ease_s) * smooth_step((seconds - time) / ease_s)


def _eased(script: Script, standing: Standing, part: Float[Tensor, " frames"]) -> Script:
    """Only a part of what the script intends beyond standing; feet that step are where it wants them."""
    one = standing.script
    feet = [
        replace(path, bearing=_between(own.bearing, path.bearing, part))
        for own, path in zip(one.feet, script.feet, strict=True)
    ]
    names = ("angles", "pelvis_turn", "drop", "share", "squeeze")
    mixed = {name: _between(getattr(one, name), getattr(script, name), part) for name in names}
    return replace(script, feet=(feet[0], feet[1]), **mixed)


def _between(one: Tensor, other: Tensor, part: Float[Tensor, " frames"]) -> Tensor:
    return one + part.reshape(-1, *[1] * (other.ndim - 1)) * (other - one)


def _held(one: Script, time: Float[Tensor, " frames"]) -> Script:
    """One frame of a script, all the time."""
    return replace(_each(one, lambda x: x.expand(len(time), *x.shape[1:]).clone()), time=time)


def _each(script: Script, change: Callable[[Tensor], Tensor]) -> Script:
    """The script with all that has frames changed; it stays on the floor."""
    names = ("angles", "pelvis_turn", "drop", "share", "squeeze")
    paths = ("base", "pitch", "roll", "bearing", "free", "airborne")
    feet: list[FootPath] = [
        replace(path, **{name: change(getattr(path, name)) for name in paths}) for path in script.feet
    ]
    changed = {name: change(getattr(script, name)) for name in names}
    return replace(script, time=change(script.time), feet=(feet[0], feet[1]), **changed)
