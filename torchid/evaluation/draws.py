"""How far torques move with what is not known of the body: one set of bodies for all trials.

What all trials have in common, such as a thigh that is too heavy, moves the torques of both conditions alike and leaves
their difference. The only place that draws.
"""

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.dynamics import body_rows, body_wrenches, dynamic_state, generalised_forces
from torchid.evaluation.trials import ConditionTrial
from torchid.outcome import Outcome

CHUNK = 1024
"""Choice. Frames whose equations of motion are held at a time, for memory."""
SAID = "the inertia of the body, within what its fit leaves open"
"""What is drawn, in words."""


def torque_deviations(
    outcome: Outcome, trials: Sequence[ConditionTrial], draws: int, seed: int
) -> dict[str, Float[Tensor, "draws frames dofs"]] | None:
    """Torques with other bodies minus those with the body that was identified, by trial; None without a covariance.

    Args:
        outcome: of the body's run.
        trials: of all conditions.
        draws: bodies.
        seed: of chance.
    """
    if outcome.identified is None:
        return None
    bodies = _bodies(outcome, draws, seed)
    return {trial.name: _deviations(outcome, trial, bodies) for trial in trials}


def _bodies(outcome: Outcome, draws: int, seed: int) -> Float[Tensor, "draws bodies 10"]:
    """Deviations of the inertial parameters from the identified ones."""
    assert outcome.identified is not None
    values, vectors = torch.linalg.eigh(outcome.identified.fit.covariance)
    generator = torch.Generator().manual_seed(seed)
    unit = torch.randn(draws, len(values), generator=generator, dtype=torch.float64).to(values)
    return (unit @ (vectors * values.clamp(min=0.0).sqrt()).mT).view(draws, -1, 10)


def _deviations(outcome: Outcome, trial: ConditionTrial, bodies: Tensor) -> Float[Tensor, "draws frames dofs"]:
    fit, motion = outcome.fit, trial.followed.motion
    out = motion.q.new_empty(len(bodies), *motion.q.shape)
    for start in range(0, len(motion.q), CHUNK):
        part = slice(start, start + CHUNK)
        parts = (x[part].T.contiguous() for x in (motion.q, motion.v, motion.a))
        state = dynamic_state(fit.model.tree, fit.geometry, *parts)
        rows = body_rows(state)
        for k, phi in enumerate(bodies):
            out[k, part] = generalised_forces(state, body_wrenches(state.plan, rows, phi)).T
    return out
