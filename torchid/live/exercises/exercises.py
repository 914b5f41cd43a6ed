"""Exercises that a subject may be asked for, and how they are likely to look when this subject does them."""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from torchid.errors import ConfigError
from torchid.filters import Smoother
from torchid.geometry.result import GeometryFit
from torchid.model.landmarks import ANKLE_FROM_HEEL
from torchid.model.proportions import proportions
from torchid.model.skeleton import SIDES
from torchid.model.tree import Tree
from torchid.motion import Motion, smooth_motion
from torchid.simulate.balance import balance
from torchid.simulate.legs import LEG
from torchid.simulate.motions import ARMS, QUIET, TRUNK, Range, make_script
from torchid.simulate.script import Script, wander
from torchid.simulate.subject import SimulatedSubject, Sole

Need = Literal["standing", "sitting", "arms"]
SEATED = "seated"
"""Motion of one who sits with thighs level; all else is in an exercise's own ranges."""
RATE_HZ = 50.0
"""Choice. Frames a second of a motion that is made up: four times what the filter of a stream usually lets through."""
MARGIN_S = 0.8
"""Choice. Made up before and after an exercise and cut away, as for simulated trials: the search for balance and the
filter know one side only there."""
ASTRAY_M = 0.02
"""Choice. Largest miss of the centre of pressure of a motion that counts as possible: a fifth of a foot's width, of
which the information of a second knows nothing."""
ATTEMPTS = 4
"""Choice. Motions tried, each somewhat easier, until one is possible for the subject."""
POSTURES = 3
"""Choice. Postures in which an exercise is drawn."""
SEAT_M = 0.25
"""Choice. Height of the pelvis over the floor, part of stature, of one who sits."""
SIT: Mapping[str, Range] = {"hip_flexion": (82, 86), "hip_adduction": (-10, -8), "knee_flexion": (84, 90)}
"""Choice. Legs of one who sits [deg]."""
HANGING: Mapping[str, Range] = {
    name: QUIET.get(name, (0, 0)) for name in ARMS if name.startswith(("shoulder", "elbow", "wrist"))
}
"""Arms at ease [deg]."""


@dataclass(frozen=True)
class Exercise:
    """Something a subject can be asked to do."""

    name: str
    text: str
    """What the subject is told."""
    seconds: float
    """For how long it is asked for at a time [s]."""
    motion: str
    """How the body moves besides: a motion of ``simulate.motions``, or ``SEATED``."""
    needs: tuple[Need, ...] = ()
    ranges: Mapping[str, Range] = field(default_factory=dict)
    """Angles that go their own way between two values [deg]; sided names hold for both sides."""
    band_hz: tuple[float, float] = (0.2, 1.0)
    """Frequencies of these."""
    joints: tuple[str, ...] = ()
    """Joints it is for, besides those of the legs, which every body has that is advised; sided names hold for both."""

    def lacking(self, tree: Tree) -> tuple[str, ...]:
        """Return the joints it is for that do not move in a body, such as those that no marker tells of."""
        moving = {re.sub("_[lr]_", "_", name) for name in tree.dof_names}
        return tuple(joint for joint in self.joints if not any(name.startswith(f"{joint}_") for name in moving))


@dataclass(frozen=True)
class Possibilities:
    """What a subject can be asked for."""

    seated: bool = False
    """The subject sits, on a chair whose feet stand on the plates as well."""
    arms: bool = True
    """The arms may be moved."""

    def allow(self, exercise: Exercise) -> bool:
        """Return whether the subject can do an exercise.

        Args:
            exercise: what it needs counts.
        """
        lacking = {"standing": self.seated, "arms": not self.arms, "sitting": not self.seated}
        return not any(lacking[need] for need in exercise.needs)


LIBRARY: tuple[Exercise, ...] = (
    Exercise(
        "arm_circles", "Swing both arms in wide circles", 10.0, "arms", ("arms",),
        {"shoulder_flexion": (-40, 150), "shoulder_adduction": (-100, -5), "shoulder_rotation": (-50, 50),
         "elbow_flexion": (5, 40)},
        (0.3, 1.0), ("shoulder", "elbow"),
    ),
    Exercise(
        "forearms", "Bend, stretch and turn your elbows and wrists, quickly", 10.0, "arms", ("arms",),
        {"shoulder_flexion": (10, 80), "shoulder_adduction": (-60, -10), "elbow_flexion": (10, 130),
         "elbow_pronation": (-75, 75), "wrist_flexion": (-60, 60), "wrist_deviation": (-25, 35)},
        (0.5, 1.6), ("elbow", "wrist"),
    ),
    Exercise(
        "head", "Nod, tilt and turn your head", 10.0, "arms", (),
        {**QUIET, **HANGING, "neck_flexion": (-35, 40), "neck_bending": (-30, 30), "neck_rotation": (-60, 60)},
        (0.4, 1.2), ("neck",),
    ),
    Exercise(
        "trunk", "Bend, twist and circle your upper body", 10.0, "trunk", (), TRUNK, (0.2, 0.8),
        ("lower_spine", "upper_spine"),
    ),
    Exercise("squats", "Bend your knees deeply and stand up again", 10.0, "squats", ("standing",)),
    Exercise(
        "leg_circles", "Stand on one leg, circle the other one; then change legs", 10.0, "hip_rom", ("standing",),
    ),
    Exercise(
        "leg_kicks", "Stand on one leg, kick with the other one; then change legs", 10.0, "hip_rom", ("standing",),
        {"hip_flexion": (5, 75), "knee_flexion": (42, 110), "ankle_flexion": (-35, 25), "ankle_inversion": (-20, 20)},
        (0.5, 1.4),
    ),
    Exercise("steps", "Step on the spot, and sway from foot to foot", 10.0, "sway_steps", ("standing",)),
    Exercise(
        "knee_swings", "Sit, and swing both lower legs to and fro", 10.0, SEATED, ("sitting",),
        {"hip_flexion": (75, 95), "knee_flexion": (15, 100), "ankle_flexion": (-35, 25), "ankle_inversion": (-20, 20)},
        (0.4, 1.3),
    ),
)  # fmt: skip
"""Choice. Every segment is moved by one of them at least, against its neighbours and about all axes of its joint; no
room beyond two plates is needed."""


def allowed(possibilities: Possibilities) -> tuple[Exercise, ...]:
    """Return the exercises of the library that a subject can do; one that sits does them all on the chair."""
    found = [one for one in LIBRARY if possibilities.allow(one)]
    return tuple(replace(one, motion=SEATED) if possibilities.seated else one for one in found)


def stand_in(fit: GeometryFit, phi: Float[Tensor, "bodies 10"], sex: str) -> SimulatedSubject:
    """Return one who moves in the subject's place: identified geometry, and the inertia that is expected.

    Args:
        sex: as in the config; the sole's outline is that of the proportions.

    Raises:
        ConfigError: ``guidance.model``, the model lacks a joint of the built-in template's legs.
    """
    names, model = fit.model.tree.dof_names, fit.model
    lacking = [leg for leg in LEG for side in SIDES if leg.replace("_", f"_{side}_", 1) not in names]
    if lacking:
        raise ConfigError(
            "guidance.model", "no exercise is known for a body without these joints", place="model",
            found=", ".join(sorted(set(lacking))), remedy="Go on without advice, or take model: whole_body",
        )  # fmt: skip
    shape, mass, none = proportions(sex), float(phi[:, 0].sum()), phi.new_zeros(0, 3)
    foot = shape.foot_length * model.height
    sole = Sole(-ANKLE_FROM_HEEL * foot, 0.5 * foot, 0.17 * foot, shape.ankle_height * model.height)
    return SimulatedSubject(
        0, sex, model.height, mass, model.height, mass, model, fit.xi, fit.geometry, phi, (), (), none,
        none[:, :, None], sole,
    )  # fmt: skip


def perform(
    exercise: Exercise, who: SimulatedSubject, possibilities: Possibilities, seed: int, rate_hz: float = RATE_HZ
) -> Motion | None:
    """Return a motion that the exercise may turn out to be, or None where none was found that the subject can do.

    Args:
        exercise: one of ``allowed``.
        who: moves; from ``stand_in`` or simulated.
        possibilities: arms that may not be moved hang still.
    """
    margin = round(MARGIN_S * rate_hz)
    frames = round(exercise.seconds * rate_hz)
    time = torch.arange(-margin, frames + margin, dtype=torch.float64) / rate_hz
    still = {} if possibilities.arms else {name: _middle(reach) for name, reach in HANGING.items()}
    for attempt in range(ATTEMPTS):
        rng = np.random.default_rng((seed, attempt))
        if exercise.motion == SEATED:
            motion = _sitting(exercise, who, still, rng, time, rate_hz)
        else:
            motion = _standing(exercise, who, still, rng, time, rate_hz, 1.0 - 0.1 * attempt)
        if motion is not None:
            return motion.frames(slice(margin, margin + frames))
    return None


def extremes(motion: Motion) -> Float[Tensor, "postures dofs"]:
    """Return the postures of a motion that differ most, for a drawing; each is farthest from those before it.

    Args:
        motion: some frames.
    """
    turning = motion.q[:, 6:]
    away = (turning - turning.mean(0)).square().sum(1)
    chosen = [int(away.argmax())]
    while len(chosen) < POSTURES:
        away = torch.stack([(turning - turning[k]).square().sum(1) for k in chosen]).amin(0)
        chosen.append(int(away.argmax()))
    return motion.q[chosen]


def intended(
    exercise: Exercise, who: SimulatedSubject, rng: np.random.Generator, time: Float[Tensor, " frames"],
    seconds: float, effort: float,
) -> Script:  # fmt: skip
    """Return what one who stands intends to do in an exercise; arguments are those of ``make_script``.

    Args:
        who: moves.
        time: of the frames [s].
        seconds: duration, from time zero on.
        effort: below one it is somewhat easier.
    """
    script = make_script(exercise.motion, rng, who, time, seconds, effort)
    _wander(script.angles, who, exercise.ranges, rng, time, exercise.band_hz)
    return script


def _standing(
    exercise: Exercise, who: SimulatedSubject, still: Mapping[str, Range], rng: np.random.Generator, time: Tensor,
    rate_hz: float, effort: float,
) -> Motion | None:  # fmt: skip
    script = intended(exercise, who, rng, time, exercise.seconds, effort)
    _wander(script.angles, who, still, rng, time, exercise.band_hz)
    moving = balance(who, script, rate_hz)
    return moving.motion if moving.miss <= ASTRAY_M else None


def _sitting(
    exercise: Exercise, who: SimulatedSubject, still: Mapping[str, Range], rng: np.random.Generator, time: Tensor,
    rate_hz: float,
) -> Motion:  # fmt: skip
    q = time.new_zeros(len(time), len(who.model.tree.dofs))
    q[:, 2] = SEAT_M * who.height
    _wander(q, who, {**QUIET, **SIT, **exercise.ranges, **still}, rng, time, exercise.band_hz)
    return smooth_motion(who.model.tree, time, q, Smoother(rate_hz, rate_hz))


def _wander(
    angles: Float[Tensor, "frames dofs"], who: SimulatedSubject, ranges: Mapping[str, Range],
    rng: np.random.Generator, time: Tensor, band_hz: tuple[float, float],
) -> None:  # fmt: skip
    """Let angles wander in their ranges, in place, and within the joints' limits."""
    for row, dof in enumerate(who.model.tree.dofs):
        stem = dof.name.replace("_l_", "_").replace("_r_", "_")
        if stem in ranges:
            low, high = (float(np.clip(np.deg2rad(x), dof.lower, dof.upper)) for x in ranges[stem])
            angles[:, row] = wander(rng, time, low, high, band_hz)


def _middle(reach: Range) -> Range:
    return (0.5 * (reach[0] + reach[1]), 0.5 * (reach[0] + reach[1]))
