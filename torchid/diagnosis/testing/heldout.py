"""Models that are fitted to the fit trials, on motion that they were not fitted to.

The density of held-out rows is p(held-out | fit trials) = p(both) / p(fit trials): the evidence of both less that of
the fit trials, parameters integrated out in each. What is a state of single recordings (``Effect.per_recording``), or
has parameters of its own in every trial, is asked of the held-out trials themselves.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.diagnosis.candidates.candidate import Candidate
from torchid.diagnosis.columns.assemble import trial_columns
from torchid.diagnosis.columns.design import Columns
from torchid.diagnosis.columns.relinearise import linearised
from torchid.diagnosis.evidence.model import LinearModel, spectra_of
from torchid.diagnosis.evidence.noise_estimation import unseen_noise
from torchid.diagnosis.evidence.per_trial import marginalise_per_trial
from torchid.diagnosis.evidence.posterior import Posterior, fit
from torchid.diagnosis.evidence.residuals import residual
from torchid.diagnosis.evidence.statistics import Statistics
from torchid.diagnosis.search.result import SearchResult
from torchid.effects.place import Interval
from torchid.observation.trial import TrialObservation


@dataclass(frozen=True)
class Errors:
    """Held-out residual: RMS of 3-vectors over used frames, moments about the root's origin."""

    force_rmse_N: float
    """RMS of the residual force [N]; NaN without held-out trials."""
    moment_rmse_Nm: float
    """RMS of the residual moment [N m]; NaN without held-out trials."""


@dataclass(frozen=True)
class HeldOutFit:
    """Errors and density of one model on the held-out trials."""

    errors: Errors
    """Residual of the held-out trials."""
    log_density: float
    """Log density of the held-out rows given the fit trials, up to what all models share [nat]."""

    def over(self, less: "HeldOutFit") -> dict[str, float]:
        """Return what it gains over a smaller model.

        Args:
            less: fit of the smaller model.

        Returns:
            ``heldout_log_likelihood`` [nat], and the parts by which errors fall, ``force_rmse_pct`` and
            ``moment_rmse_pct`` [%].
        """
        before, after = less.errors, self.errors
        return {
            "heldout_log_likelihood": self.log_density - less.log_density,
            "force_rmse_pct": 100.0 * (1.0 - after.force_rmse_N / before.force_rmse_N),
            "moment_rmse_pct": 100.0 * (1.0 - after.moment_rmse_Nm / before.moment_rmse_Nm),
        }


class HeldOut:
    """The held-out trials of a search."""

    def __init__(self, found: SearchResult, heldout: Sequence[TrialObservation]) -> None:
        """Make columns and statistics of the held-out trials beside those of the fit trials.

        Args:
            found: result of the search in the fit trials.
            heldout: the trials to ask; may be none.
        """
        self.found, self.trials, self.first = found, heldout, len(found.model.statistics.trials)
        self.columns = self._columns()
        model = self._model()
        self.both = self._beside(model.statistics)
        self.unforced = self._beside(model.marker_statistics)
        self._known: dict[tuple[int, ...], tuple[Statistics, ...]] = {}

    def fit(self, chosen: Sequence[Candidate]) -> HeldOutFit:
        """Return held-out residual and density under a model with these effects.

        Args:
            chosen: effects of the model.
        """
        if not self.trials:
            return HeldOutFit(Errors(math.nan, math.nan), math.nan)
        (statistics, _, _), some = self._marginalised(chosen)
        return HeldOutFit(self._errors(fit(statistics, some)), self.density(chosen))

    def density(self, chosen: Sequence[Candidate]) -> float:
        """Return the log density of the held-out rows given the fit trials [nat].

        Args:
            chosen: effects of the model.
        """
        (statistics, whole, _), some = self._marginalised(chosen)
        return _over(whole, statistics, some) - self._asked(chosen) * math.log(2.0)

    def density_of_forces(self, chosen: Sequence[Candidate]) -> float:
        """Return the log density of the held-out forces given the fit trials and all that cameras saw in the held-out
        ones [nat].

        Args:
            chosen: effects of the model.
        """
        (_, whole, markers), some = self._marginalised(chosen)
        return _over(whole, markers, some)

    def acting(self) -> tuple[Candidate, ...]:
        """Return the chosen effects; a state of single recordings also acts in those held-out ones that show it.

        Where a marker sat in a recording only that recording tells: one bit, and a yes has its price.
        """
        found = list(self.found.chosen)
        asked = [k for k, one in enumerate(found) if one.effect.per_recording and not self.everywhere(one)]
        best = self.density(found) if asked and self.trials else 0.0
        for k, j in product(asked, range(len(self.trials))):
            more = [*found[:k], self._also(found[k], j), *found[k + 1 :]]
            if (density := self.density(more)) > best:
                found, best = more, density
        return tuple(found)

    def everywhere(self, one: Candidate) -> bool:
        """Return whether an effect acts in all fit trials, and therefore in held-out ones too.

        Args:
            one: the effect.
        """
        return one.trials == self.found.model.statistics.all

    def _columns(self) -> list[Columns]:
        """Return columns of the held-out trials, nonlinear effects and shifts in time taken where the fit trials found
        them."""
        model = self.found.model
        columns = [trial_columns(w, model.design.sources) for w in self.trials]
        if not any(one.effect.shifts_time or one.effect.nonlinear for one in self.found.chosen):
            return columns
        posterior, n = model.fit(self._extended(self.found.chosen)), model.design.inertia
        found = []
        for k, (own, before) in enumerate(zip(self.trials, columns, strict=True), self.first):
            theta = model.prior.theta(posterior.z(len(model.prior.mean), k))[n:]
            found.append(linearised(own, before, model.design.sources, theta))
        return found

    def _model(self) -> LinearModel:
        """Return the model of the held-out trials, each as loud as the fit trials' model leaves it."""
        of, design = self.found.model, replace(self.found.model.design, trials=tuple(self.columns))
        model = LinearModel(spectra_of(self.trials, design), of.prior, design, of.noise.typical(len(self.trials)))
        if not self.trials:
            return model
        chosen = self._extended(self.found.chosen)
        return model.with_noise(unseen_noise(model, chosen, self._beside(model.statistics)))

    def _beside(self, more: Statistics) -> Statistics:
        """Return statistics of the fit trials with those of further trials behind them."""
        own = self.found.model.statistics
        return replace(own, trials=(*own.trials, *more.trials))

    def _marginalised(self, chosen: Sequence[Candidate]) -> tuple[tuple[Statistics, ...], list[Candidate]]:
        """Return statistics of fit trials, of all trials, and of all without held-out forces; and the effects that they
        have.

        Effects with parameters of their own in every trial are integrated out of the statistics; the others are
        returned.
        """
        extended = self._extended(chosen)
        each = [k for k, one in enumerate(extended) if one.effect.per_trial]
        key = tuple(id(chosen[k]) for k in each)
        if key not in self._known:
            some, sources = [extended[k] for k in each], (self.found.model.statistics, self.both, self.unforced)
            self._known[key] = tuple(marginalise_per_trial(x, some)[0] for x in sources)
        return self._known[key], [one for one in extended if not one.effect.per_trial]

    def _extended(self, chosen: Sequence[Candidate]) -> list[Candidate]:
        """Return the effects; what acts in all fit trials acts in the held-out ones too."""
        every = frozenset(range(self.first + len(self.trials)))
        return [replace(c, trials=every) if self.everywhere(c) else c for c in chosen]

    def _errors(self, posterior: Posterior) -> Errors:
        """Return the held-out residual of a posterior."""
        left = [x[w.rows.used] for w, x in zip(self.trials, self._left(posterior), strict=True)]
        both = torch.cat(left)
        return Errors(*(float(x.square().sum(1).mean().sqrt()) for x in (both[:, :3], both[:, 3:])))

    def _left(self, posterior: Posterior) -> list[Float[Tensor, "frames 6"]]:
        """Return residuals of the held-out trials under a model that the fit trials have [N, N m]."""
        prior, trials = self.found.model.prior, enumerate(zip(self.trials, self.columns, strict=True), self.first)
        return [residual(w, c, prior, posterior, k) + self._untrusted(w, c, posterior, k) for k, (w, c) in trials]

    def _untrusted(
        self, observed: TrialObservation, columns: Columns, posterior: Posterior, trial: int
    ) -> Float[Tensor, "frames 6"]:
        """Return the wrench that chosen effects explain and that is not believed of other motion (``Effect.trusted``)
        [N, N m]."""
        model = self.found.model
        found, n = torch.zeros_like(observed.rows.wrench), model.design.inertia
        for one, share in zip(posterior.chosen, posterior.shares(len(model.prior.mean), trial), strict=True):
            theta = model.prior.scale * share[n:]
            added = columns.added(theta[columns.terms.live[n:] - n])
            found += added - one.effect.trusted(added, observed.rows.rate, one.place, theta[one.columns - n])
        return found

    def _asked(self, chosen: Sequence[Candidate]) -> int:
        """Return the number of held-out trials that said themselves that an effect is there."""
        return sum(len(one.trials - self.found.model.statistics.all) for one in chosen if one.effect.per_recording)

    def _also(self, one: Candidate, trial: int) -> Candidate:
        """Return the effect acting in one of the held-out trials too."""
        name, time = self.trials[trial].rows.name, self.trials[trial].rows.motion.time
        own = Interval(name, float(time[0]), float(time[-1]))
        place = replace(one.place, when=(*(one.place.when or ()), own))
        trials = one.trials | {self.first + trial}
        return replace(one, place=place, trials=trials, proposed=one.proposed or one.place)


def _over(more: Statistics, less: Statistics, chosen: Sequence[Candidate]) -> float:
    """Return the log density of what some statistics have beyond others [nat]."""
    return fit(more, chosen).log_evidence + more.constant - fit(less, chosen).log_evidence - less.constant
