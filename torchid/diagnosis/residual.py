"""Forces that a model leaves, with everything that it knows taken off."""

from collections.abc import Sequence

from jaxtyping import Float
from torch import Tensor

from torchid.diagnosis.design import Columns, Design
from torchid.diagnosis.evidence import Fitted
from torchid.diagnosis.linearised import without_beyond
from torchid.diagnosis.sums import Prior
from torchid.diagnosis.watched import Watched
from torchid.regressor.rows import measured


def residuals(
    watched: Sequence[Watched], design: Design, prior: Prior, fitted: Fitted
) -> list[Float[Tensor, "frames 6"]]:
    """Of the trials a model was fitted to, about the root's origin."""
    both = enumerate(zip(watched, design.trials, strict=True))
    return [residual(own, columns, prior, fitted, k) for k, (own, columns) in both]


def residual(watched: Watched, columns: Columns, prior: Prior, fitted: Fitted, trial: int) -> Float[Tensor, "frames 6"]:
    """Of one trial about the root's origin, with everything that the model knows taken off."""
    theta, n = prior.theta(fitted.z(len(prior.mean), trial)), len(prior.inertia)
    late = any(one.effect.late for one in fitted.chosen)
    rows = without_beyond(watched.rows, columns) if late else watched.rows
    own = theta[columns.terms.live[n:]]
    known = watched.needed(theta[:n]) + columns.added(own)
    return measured(rows) - known
