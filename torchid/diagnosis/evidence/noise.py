"""Noise of forces and markers, by which their rows are weighed."""

from dataclasses import dataclass, replace

from jaxtyping import Float
from torch import Tensor

from torchid.dynamics.whitening import Whitening
from torchid.observation.marker_bands import BANDS


@dataclass(frozen=True)
class Noise:
    """A covariance of forces in each band, and a factor on the variance of markers in each of theirs."""

    forces: Whitening
    """Covariance of the six channels of a typical trial in each band [N, N m], as ``Whitening`` has it."""
    markers: Float[Tensor, " bands"]
    """Variance of the markers in each of their bands over the one that weighs them."""
    trials: Float[Tensor, " trials"]
    """Variance of each trial's forces over that of a typical one: what a landing leaves must not hide what squats
    show."""

    def of(self, trial: int) -> Whitening:
        """Return the noise of the forces of one trial.

        Args:
            trial: index of the trial.
        """
        return Whitening(self.trials[trial] * self.forces.covariance)

    def typical(self, trials: int) -> "Noise":
        """Return the noise of trials that nobody has seen yet.

        Args:
            trials: their number.
        """
        return replace(self, trials=self.trials.new_ones(trials))


def initial_noise(whitening: Whitening, trials: int) -> Noise:
    """Return the noise of the inertial fit, the same in all trials, with markers as they scatter.

    Args:
        whitening: noise of the forces.
        trials: number of trials.
    """
    one = whitening.covariance.new_ones(())
    return Noise(whitening, one.expand(BANDS), one.expand(trials))
