"""Where the forces of the feet come from, condition by condition: a plate of their own, a shared one, or none."""

from collections.abc import Sequence

import torch

from torchid.evaluation.evaluation import ContactCount
from torchid.evaluation.trials import ConditionTrial

SHARED = -2
"""Mark of ``Contact.plate`` for a plate that carries more than one foot."""


def count_contacts(trials: Sequence[ConditionTrial]) -> tuple[ContactCount, ...]:
    """Shares of every foot's contact in every condition.

    Args:
        trials: of all conditions; those without forces have none of their contact measured.
    """
    found = []
    for condition in dict.fromkeys(trial.condition for trial in trials):
        own = [t.followed.contact for t in trials if t.condition == condition and t.followed.contact is not None]
        for k, foot in enumerate(own[0].feet if own else ()):
            down = torch.cat([c.touching[:, k] for c in own])
            beside = torch.cat([~c.supported[:, k] for c in own])[down]
            shared = torch.cat([(c.plate == SHARED).any(1) for c in own])[down] & ~beside
            frames = int(down.sum())
            parts = [float(x.double().mean()) if frames else 0.0 for x in (~beside & ~shared, shared, beside)]
            found.append(ContactCount(condition, foot, frames, parts[0], parts[1], parts[2]))
    return tuple(found)
