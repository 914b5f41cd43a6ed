"""Forces that a model leaves, with everything that it knows taken off."""

from collections.abc import Sequence

from jaxtyping import Float
from torch import Tensor

from torchid.diagnosis.columns.design import Columns, Design
from torchid.diagnosis.columns.relinearise import without_beyond
from torchid.diagnosis.evidence.posterior import Posterior
from torchid.diagnosis.evidence.prior import Prior
from torchid.observation.trial import TrialObservation
from torchid.regressor.rows import measured


def residuals(
    observed: Sequence[TrialObservation], design: Design, prior: Prior, posterior: Posterior
) -> list[Float[Tensor, "frames 6"]]:
    """Of the trials a model was fitted to, about the root's origin."""
    both = enumerate(zip(observed, design.trials, strict=True))
    return [residual(own, columns, prior, posterior, k) for k, (own, columns) in both]


def residual(
    observed: TrialObservation, columns: Columns, prior: Prior, posterior: Posterior, trial: int
) -> Float[Tensor, "frames 6"]:
    """Of one trial about the root's origin, with everything that the model knows taken off."""
    theta, n = prior.theta(posterior.z(len(prior.mean), trial)), len(prior.inertia)
    late = any(one.effect.shifts_time for one in posterior.chosen)
    rows = without_beyond(observed.rows, columns) if late else observed.rows
    own = theta[columns.terms.live[n:]]
    known = observed.needed(theta[:n]) + columns.added(own)
    return measured(rows) - known
