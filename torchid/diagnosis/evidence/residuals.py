"""Forces that a model leaves, with everything that it knows taken off."""

from collections.abc import Sequence

from jaxtyping import Float
from torch import Tensor

from torchid.diagnosis.columns.design import Columns
from torchid.diagnosis.columns.relinearise import without_beyond
from torchid.diagnosis.evidence.model import LinearModel
from torchid.diagnosis.evidence.posterior import Posterior
from torchid.diagnosis.evidence.prior import Prior
from torchid.dynamics.rows import measured
from torchid.observation.trial import TrialObservation


def residuals(
    observed: Sequence[TrialObservation], model: LinearModel, posterior: Posterior
) -> list[Float[Tensor, "frames 6"]]:
    """Return what a posterior leaves of the wrenches of all trials of a model, about the root's origin [N, N m].

    Args:
        observed: trials of the model.
        model: the model.
        posterior: posterior of the model with some effects.
    """
    both = enumerate(zip(observed, model.design.trials, strict=True))
    return [residual(own, columns, model.prior, posterior, k) for k, (own, columns) in both]


def residual(
    observed: TrialObservation, columns: Columns, prior: Prior, posterior: Posterior, trial: int
) -> Float[Tensor, "frames 6"]:
    """Return what a posterior leaves of the wrench of one trial, about the root's origin [N, N m].

    Args:
        observed: the trial.
        columns: columns of the trial.
        prior: prior of all columns of the design.
        posterior: posterior of a model on any trials.
        trial: index of it among the posterior's trials, or one behind them.
    """
    theta, n = prior.theta(posterior.z(len(prior.mean), trial)), len(prior.inertia)
    late = any(one.effect.shifts_time for one in posterior.chosen)
    rows = without_beyond(observed.rows, columns) if late else observed.rows
    own = theta[columns.terms.live[n:]]
    known = observed.needed(theta[:n]) + columns.added(own)
    return measured(rows) - known
