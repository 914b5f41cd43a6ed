"""How far torques move with what is not known of the body, of markers and of plates: one set of draws for all trials.

What all trials have in common, such as a thigh that is too heavy, moves the torques of both conditions alike and leaves
their difference. The only place that draws.
"""

from collections.abc import Sequence
from dataclasses import replace

from jaxtyping import Float
from torch import Tensor

from torchid.evaluation.trials import ConditionTrial
from torchid.experiment.torque_bands import outcome_draws
from torchid.outcome import Outcome

SAID = "geometry and inertia of the body, what markers do on the skin, and gains and places of the plates"
"""What is drawn, in words."""


def torque_deviations(
    outcome: Outcome, trials: Sequence[ConditionTrial], draws: int, seed: int
) -> dict[str, Float[Tensor, "draws frames dofs"]] | None:
    """Torques with other bodies and readings minus those that are published, by trial.

    Args:
        outcome: of the body's run.
        trials: of all conditions.
        draws: number of draws.
        seed: of chance.

    Returns:
        None where no inertia was identified. What a device's parts weigh is not drawn.
    """
    if outcome.identified is None:
        return None
    every = with_trials(outcome, trials)
    found = outcome_draws(every, [trial.name for trial in trials], draws, seed)
    return {name: drawn - found.value[name] for name, drawn in found.draws.items()}


def with_trials(outcome: Outcome, trials: Sequence[ConditionTrial]) -> Outcome:
    """The outcome of the body's run with the trials that it has left out, as held-out ones.

    Args:
        outcome: of the body's run.
        trials: of all conditions.
    """
    new = [trial for trial in trials if trial.name not in outcome.session.trials]
    recordings = outcome.session.trials | {trial.name: trial.recording for trial in new}
    files = outcome.session.files | {trial.name: trial.file for trial in new}
    session = replace(outcome.session, trials=recordings, files=files)
    return replace(outcome, session=session, followed=outcome.followed | {t.name: t.followed for t in new})
