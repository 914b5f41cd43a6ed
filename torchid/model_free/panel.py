"""All statements of a session side by side, what a cause would have them say, and what they scatter by without any.

Each cause is put into the recordings and the checks are asked again: what then changes is its signature. Causes that
look alike to one check are told apart by the others.

One trial may be bad, by markers that were lost or a foot beside a plate: then its statements scatter ``BAD`` times as
much. The likeliest of none and each is taken (Box & Tiao, Biometrika 55:119 (1968), average over them).
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

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
    own: Float[Tensor, "some some"]
    """Covariance of each by itself where nothing is wrong: within its trial and between sessions."""
    alike: Float[Tensor, "some some"]
    """Covariance of what all of a kind share in a session, by bodies and tables of inertia."""

    @property
    def about(self) -> list[CheckSubject]:
        """What each statement is about."""
        return [subject for some in self.witnesses for one in some for subject in one.about]

    @property
    def sd(self) -> Float[Tensor, " some"]:
        """Standard deviation of each where nothing is wrong."""
        return (self.own + self.alike).diagonal().sqrt()

    def covariance_beside(self, more: Float[Tensor, "some some"]) -> Float[Tensor, "some some"]:
        """Return the covariance with which the statements of one trial count beside those of the others.

        What all of a kind share counts in each of T trials with T times its variance, so that all together know no more
        of it than one could: exact where trials are alike, and cautious where they are not.

        Args:
            more: covariance of what faults of unknown sizes could make them say besides.
        """
        return self._with_bad_trial(more) + len(self.trials) * self.alike

    def _with_bad_trial(self, more: Float[Tensor, "some some"]) -> Float[Tensor, "some some"]:
        """Return the covariance of statements by themselves, larger for a trial that is likelier bad than not, whatever
        faults there are."""
        trials = [one.trial for one in self.about]
        each, log_odds = [self.own], [math.log1p(-BAD_ODDS)]
        for name in dict.fromkeys(trials):
            bad = self.own.new_tensor([BAD if one == name else 1.0 for one in trials])
            each.append(self.own * bad[:, None] * bad)
            log_odds.append(math.log(BAD_ODDS / len(set(trials))))
        L = torch.linalg.cholesky(torch.stack(each) + self.alike + more)
        white = torch.linalg.solve_triangular(L, self.value[:, None].expand(len(L), -1, 1), upper=False)[..., 0]
        density = self.own.new_tensor(log_odds) - 0.5 * white.square().sum(1) - L.diagonal(dim1=1, dim2=2).log().sum(1)
        return each[int(density.argmax())]

    def signature(self, effect: Effect, place: Place) -> Float[Tensor, "some params"]:
        """Return what a unit of each parameter makes the witnesses say.

        Args:
            effect: one that acts on loads or readings.
            place: where it sits.
        """
        if effect.all_or_nothing:
            whole = self.value.new_ones(1)
            return -self.change([one.without(effect, place, whole) for one in self.trials])[:, None]
        found = []
        for k, scale in enumerate(effect.scale(place)):
            theta = self.value.new_zeros(effect.size(place))
            theta[k] = STEP * scale
            each = [_read_besides(one, one.under(effect, place, theta)) / theta[k] for one in self.trials]
            found.append(torch.cat([s @ more.flatten() for s, more in zip(self._slopes, each, strict=True)]))
        return torch.stack(found, 1)

    @cached_property
    def _slopes(self) -> tuple[Float[Tensor, "some readings"], ...]:
        """What a unit of each reading of a trial's plates changes in what its witnesses say."""
        return tuple(_slopes(one, some) for one, some in zip(self.trials, self.witnesses, strict=True))

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
    heard = tuple(trial for trial, _ in asked), tuple(own for _, own in asked)
    return Panel(*heard, value, own, alike)


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


def _read_besides(before: Watched, after: Watched) -> Float[Tensor, "frames plates 6"]:
    """Return what plates read more under an effect; zero where they read nothing."""
    return (after.reading.wrench - before.reading.wrench).nan_to_num()


def _slopes(trial: Watched, some: Sequence[Witness]) -> Float[Tensor, "some readings"]:
    """Return the derivatives of what witnesses of a trial say by each of its plates' readings."""
    with torch.enable_grad():
        wrench = trial.reading.wrench.detach().clone().requires_grad_()
        said = Panel.of(replace(trial, reading=replace(trial.reading, wrench=wrench)), some)
        rows = [torch.autograd.grad(one, wrench, retain_graph=True)[0].flatten() for one in said]
    return torch.stack(rows).nan_to_num()


def _scatter(
    about: Sequence[CheckSubject], within: Float[Tensor, "some some"], record_part: float
) -> tuple[Float[Tensor, "some some"], Float[Tensor, "some some"]]:
    """Return the covariance of statements by themselves, and of what all of a kind share, by their kinds."""
    scatter = SCATTER | {"mass": SCATTER["mass"]._replace(alike=max(record_part, RECORD_PART))}
    own = within.new_tensor([scatter[one.kind].own for one in about])
    alike = within.new_tensor([scatter[one.kind].alike for one in about])
    same = torch.tensor([[a.kind == b.kind for b in about] for a in about], device=within.device)
    return within + own.square().diag(), torch.where(same, alike[:, None] * alike, 0.0)
