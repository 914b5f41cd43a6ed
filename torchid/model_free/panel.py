"""All statements of a session side by side, what a cause would have them say, and how likely they are with causes.

With causes of parameters theta_k ~ N(0, P_k) the statements are r ~ N(0, S + sum_k J_k P_k J_k'), where J_k is what a
unit of each parameter makes them say: each cause is put into the recordings and the witnesses are asked again. Causes
that look alike to one witness are told apart by the others, and what looks alike to all is said to.

One trial may be bad, by markers that were lost or a foot beside a plate: then its statements scatter ``BAD`` times as
much. Whether one is, and which, is averaged over (a mixture, as for outliers: Box & Tiao, Biometrika 55:119 (1968)).
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.effects.effect import Effect
from torchid.effects.place import Place
from torchid.model_free.balance import balance
from torchid.model_free.options import WitnessOptions
from torchid.model_free.pressure import pressures
from torchid.model_free.scatter import RECORD_PART, SCATTER
from torchid.model_free.statements import CheckSubject, Witness
from torchid.model_free.unloaded import zeros
from torchid.model_free.watched import Watched
from torchid.observation.options import ObservationOptions

BAD = 5.0
"""Estimator. Times as much that statements of a bad trial scatter, a choice: half of the statements of the one turning
walk whose head markers are exchanged are three standard deviations off."""
BAD_ODDS = 0.1
"""Estimator. Probability that one trial of a session is bad, a choice."""
STEP = 0.1
"""Resolution. Step of the differences, in prior standard deviations: small beside all that bends, large beside the
thresholds of what counts as unloaded."""


@dataclass(frozen=True)
class Panel:
    """Statements of a session, with all that they scatter by."""

    trials: tuple[Watched, ...]
    """Trials that are asked."""
    witnesses: tuple[tuple[Witness, ...], ...]
    """Witnesses of each."""
    value: Float[Tensor, " some"]
    """What they say, beyond what they say of any body."""
    covariances: Float[Tensor, "ways some some"]
    """Of the statements where nothing is wrong: within trials, between sessions and between laboratories; and where one
    trial is bad."""
    log_odds: Float[Tensor, " ways"]
    """Log probabilities of these."""
    options: WitnessOptions
    spread: Float[Tensor, "ways some some"] | None = None

    @property
    def about(self) -> list[CheckSubject]:
        """What each statement is about."""
        return [subject for some in self.witnesses for one in some for subject in one.about]

    def log_density(
        self, mean: Float[Tensor, " some"] | float = 0.0, more: Float[Tensor, "some some"] | float = 0.0
    ) -> float:
        """Return the log density of the statements, up to the constant of their number [nat].

        Args:
            mean: what they should be.
            more: covariance of what they could be besides.
        """
        return float(torch.logsumexp(self._by_way(mean, more), 0))

    def likeliest(self, more: Float[Tensor, "some some"] | float = 0.0, spread: bool = False) -> Float[Tensor, "some some"]:
        """Return the covariance of the likeliest way in which nothing, or one trial, is bad.

        Args:
            more: covariance of what statements could be besides.
        """
        return (self.spread if spread else self.covariances)[int(self._by_way(0.0, more).argmax())]

    def _by_way(
        self, mean: Float[Tensor, " some"] | float, more: Float[Tensor, "some some"] | float
    ) -> Float[Tensor, " ways"]:
        """Return the log density of the statements and each way."""
        L = torch.linalg.cholesky(self.covariances + more)
        off = (self.value - mean)[:, None].expand(len(L), -1, 1)
        white = torch.linalg.solve_triangular(L, off, upper=False)[..., 0]
        return self.log_odds - 0.5 * white.square().sum(1) - L.diagonal(dim1=1, dim2=2).log().sum(1)

    def signature(self, effect: Effect, place: Place) -> Float[Tensor, "some params"]:
        """Return what a unit of each parameter makes the witnesses say.

        Args:
            effect: one that acts on loads or readings.
            place: where it sits.
        """
        found = []
        for k, scale in enumerate(effect.scale(place)):
            theta = self.value.new_zeros(effect.size(place))
            theta[k] = STEP * scale
            found.append(self.change([one.under(effect, place, theta) for one in self.trials]) / theta[k])
        return torch.stack(found, 1)

    def change(self, trials: Sequence[Watched]) -> Float[Tensor, " some"]:
        """Return what other readings of the same trials change in what witnesses say; what they cannot say of these is
        not changed.

        Args:
            trials: the same trials, those that are as they were the very same.
        """
        first, found = 0, torch.zeros_like(self.value)
        for own, one, some in zip(self.trials, trials, self.witnesses, strict=True):
            stop = first + sum(len(witness.about) for witness in some)
            if one is not own:
                found[first:stop] = (self.of(one, some) - self.value[first:stop]).nan_to_num()
            first = stop
        return found

    @staticmethod
    def of(trial: Watched, some: Sequence[Witness]) -> Float[Tensor, " some"]:
        """Return what witnesses of a trial say, beyond what they say of any body.

        Args:
            trial: the trial.
            some: its witnesses.
        """
        said = torch.cat([one.value(trial) for one in some])
        return said - said.new_tensor([SCATTER[about.kind].usual for one in some for about in one.about])


def make_panel(
    trials: Sequence[Watched],
    record_part: float,
    options: WitnessOptions,
    observation: ObservationOptions = ObservationOptions(),
) -> Panel | None:
    """Return the statements of a session; None where no witness has any.

    Args:
        trials: trials that are asked.
        record_part: relative standard deviation of the recorded mass.
        options: thresholds.
        observation: thresholds by which a plate bears nothing.
    """
    some = [tuple(witnesses_of(one, options, observation)) for one in trials]
    asked = [(trial, own) for trial, own in zip(trials, some, strict=True) if own]
    if not asked:
        return None
    value = torch.cat([Panel.of(*both) for both in asked])
    each = [one for _, own in asked for one in own]
    about = [subject for one in each for subject in one.about]
    own, alike = _scatter(about, torch.block_diag(*(one.covariance for one in each)), record_part)
    ways, log_odds = [own + alike], [math.log1p(-BAD_ODDS)]
    spread = [own + len(asked) * alike]
    for trial, _ in asked:
        bad = own.new_tensor([BAD if one.trial == trial.name else 1.0 for one in about])
        ways.append(own * bad[:, None] * bad + alike)
        spread.append(own * bad[:, None] * bad + len(asked) * alike)
        log_odds.append(math.log(BAD_ODDS / len(asked)))
    heard = tuple(trial for trial, _ in asked), tuple(own for _, own in asked)
    return Panel(*heard, value, torch.stack(ways), own.new_tensor(log_odds), options, torch.stack(spread))


def witnesses_of(trial: Watched, options: WitnessOptions, observation: ObservationOptions) -> Iterator[Witness]:
    """Yield all that can be asked about a trial.

    Args:
        trial: the trial.
        options: thresholds.
        observation: thresholds by which a plate bears nothing.
    """
    for one in (balance(trial, options), zeros(trial, observation), pressures(trial, options)):
        if one is not None:
            yield one


def _scatter(
    about: Sequence[CheckSubject], within: Float[Tensor, "some some"], record_part: float
) -> tuple[Float[Tensor, "some some"], Float[Tensor, "some some"]]:
    """Return the covariance of statements by themselves, and of what all of a kind share, by their kinds."""
    scatter = SCATTER | {"mass": SCATTER["mass"]._replace(alike=max(record_part, RECORD_PART))}
    own = within.new_tensor([scatter[one.kind].own for one in about])
    alike = within.new_tensor([scatter[one.kind].alike for one in about])
    same = torch.tensor([[a.kind == b.kind for b in about] for a in about], device=within.device)
    return within + own.square().diag(), torch.where(same, alike[:, None] * alike, 0.0)
