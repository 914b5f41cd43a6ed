"""Strides of a run's trials: angles, moments and powers of the legs' joints over each, and how it was walked."""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.config.conditions import EvaluateOptions
from torchid.config.sections import BUILTIN_MODELS
from torchid.cycles.conventions import chosen, side_of, spellings
from torchid.cycles.cycles import Course, Cycle, find_cycles, normalise
from torchid.cycles.measures import STRIDE, stride_values
from torchid.session.following import soles
from torchid.session.outcome import Outcome

JOINTS = ("hip_flexion", "hip_adduction", "hip_rotation", "knee_flexion", "ankle_flexion")
"""Choice. What gait laboratories print of each leg, in the built-in model's names without the side."""
WALKED_M = 0.2
"""Choice. A foot that comes down nearer than this to where it stood steps on the spot [m]."""


@dataclass(frozen=True)
class JointCycles:
    """All strides of a run, each with the leg whose stride it is."""

    cycles: tuple[Cycle, ...]
    joints: tuple[str, ...]
    """Coordinates without their side, signs as ISB has them."""
    values: Float[Tensor, "cycles values"]
    """By ``STRIDE``."""
    start_s: Float[Tensor, " cycles"]
    angle_deg: Float[Tensor, "cycles points joints"]
    moment_Nm: Float[Tensor, "cycles points joints"]
    """Net moment; NaN where a wrench under the leg is not known."""
    power_W: Float[Tensor, "cycles points joints"]
    mass_kg: float
    """Of the model, identified or of tables, by which moments and powers are divided where they are compared."""

    def of(self, side: str) -> list[int]:
        """Strides of one foot.

        Args:
            side: l or r.
        """
        return [k for k, cycle in enumerate(self.cycles) if cycle.side == side]


def joint_cycles(outcome: Outcome) -> JointCycles | None:
    """Return the strides of all trials of motion; None where nobody walks, or the model lacks a leg.

    Args:
        outcome: the run.
    """
    rows = _rows(outcome)
    found = [] if not rows else [one for name in outcome.session.trials for one in _strides(outcome, name, rows)]
    if not found:
        return None
    cycles, *courses = zip(*found, strict=True)
    values, start, angle, moment, power = map(torch.stack, courses)
    mass = float(outcome.phi[:, 0].sum())
    return JointCycles(cycles, tuple(rows), values, start, angle, moment, power, mass)


def _rows(outcome: Outcome) -> dict[str, dict[str, tuple[int, float]]]:
    """Row in q and sign of every joint by side; joints that both legs have."""
    model = outcome.fit.model
    spelling = spellings(model, "isb", outcome.config.model not in BUILTIN_MODELS)
    found = {}
    for joint in JOINTS:
        dofs, _ = chosen((joint,), model.tree.dof_names[6:])
        own = {side_of(dof): (model.tree.dof_names.index(dof), spelling[dof].sign) for dof in dofs}
        if set(own) == {"l", "r"}:
            found[joint] = own
    return found


def _strides(outcome: Outcome, name: str, rows: dict[str, dict[str, tuple[int, float]]]) -> Iterator[tuple]:
    """Strides of one trial with what is measured in each."""
    followed, trial = outcome.followed[name], outcome.session.trials[name]
    motion, contact = followed.motion, followed.contact
    if trial.role == "static" or contact is None or len(motion.time) < 2:
        return
    dofs, options = outcome.fit.model.tree.dof_names, EvaluateOptions()
    course = Course(name, motion.time, motion.q, dofs, contact, trial.events)
    heels = {foot: points[:, 0] for foot, points in soles(outcome.fit, followed.tracked).items()}
    step = float(motion.time[1] - motion.time[0])
    for cycle in find_cycles(course, options):
        if any(cycle.side not in own for own in rows.values()):
            continue  # a foot of a model file whose name ends otherwise
        values = stride_values(cycle, contact, heels, step)
        if float(values[STRIDE.index("stride_length_m")]) < WALKED_M:
            continue
        places, signs = zip(*(own[cycle.side] for own in rows.values()), strict=True)
        sign = motion.q.new_tensor(signs)
        q, v, tau = (x[:, list(places)] * sign for x in (motion.q, motion.v, outcome.torque[name]))
        cut = (normalise(x, cycle, options.points) for x in (q * math.degrees(1.0), tau, tau * v))
        yield (cycle, values, motion.time[cycle.start], *cut)
