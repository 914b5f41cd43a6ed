"""Stretches that stand for a whole stream where errors of its motion are asked about: an hour is not kept.

They are to a stream what trials are to a run: the noise of the motion in the regressor, and what markers leave open of
the geometry, are found on them as there.
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from torchid.config import Config
from torchid.config.sections import TrialFile
from torchid.geometry.assign import Assignment
from torchid.geometry.result import GeometryFit
from torchid.live.estimation.window import Window
from torchid.model.model import InertialPrior
from torchid.recording import Trial
from torchid.session import Followed, Outcome, Session
from torchid.session.motion_noise import MotionNoise, motion_noise

STRETCH_S = 10.0
"""Choice. Duration of a stretch: several steps."""
FEWEST_S = 1.0
"""Choice. Of a stretch, what has to count: feet may be on plates only now and then."""
MOST = 6
"""Choice. Stretches that are kept: a minute tells the noise to some parts in a hundred, and takes some ten seconds."""


class Stretches:
    """Windows of one length that lie evenly over all that counts; the more that is, the farther apart."""

    def __init__(self) -> None:
        """Begin with none."""
        self.kept: list[Window] = []
        self._seen, self._apart = 0, 1

    def add(self, one: Window) -> None:
        """Take in the next window in which enough counts.

        Args:
            one: the window.
        """
        if self._seen % self._apart == 0:
            self.kept.append(one)
        self._seen += 1
        if len(self.kept) > MOST:
            self.kept, self._apart = self.kept[::2], 2 * self._apart


def outcome_of(
    config: Config, fit: GeometryFit, prior: InertialPrior, cutoff_hz: float, each: Sequence[tuple[Trial, Followed]]
) -> Outcome:
    """Return stretches as the trials of a run, up to the motion.

    Args:
        config: of the stream.
        fit: geometry by which they were followed.
        prior: of the segments' inertia.
        cutoff_hz: of the filter of motion and forces.
        each: with forces.
    """
    files = {trial.name: TrialFile(name=trial.name, file=Path(trial.name)) for trial, _ in each}
    trials, followed = {trial.name: trial for trial, _ in each}, {one.name: one for _, one in each}
    session = Session(trials, files, Assignment(fit.model, fit.attachment, ()), ())
    return Outcome(config, session, fit, fit, cutoff_hz, followed, followed, prior, prior)


def counted(stretches: Outcome, frames: int) -> float:
    """Return how often each row of stretches counts, that they stand for all of a stream; 0 where none has any.

    Args:
        stretches: as ``outcome_of`` returns them.
        frames: of the stream whose rows count.
    """
    rows = (one.wrench for one in stretches.followed.values())
    own = sum(block.stop - block.start for one in rows if one is not None for block in one.blocks())
    return frames / own if own else 0.0


def noise_of(stretches: Outcome, times: float) -> MotionNoise | None:
    """Return the noise in the regressors of all rows of a stream; None where no stretch has any.

    Args:
        stretches: as ``outcome_of`` returns them.
        times: that each of their rows counts.
    """
    found = motion_noise(stretches)
    return None if found is None else replace(found, share=times * found.share)
