"""Base and extended models, fitted to the fit trials, on motion that they were not fitted to."""

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
from torchid.diagnosis.evidence.noise import summed, unforced, unseen_noise
from torchid.diagnosis.evidence.per_trial import marginalise_per_trial
from torchid.diagnosis.evidence.posterior import Posterior, fit
from torchid.diagnosis.evidence.residuals import residual
from torchid.diagnosis.evidence.spectra import trial_spectra
from torchid.diagnosis.evidence.statistics import Statistics
from torchid.diagnosis.search.elimination import PLAIN, sizes
from torchid.diagnosis.search.result import SearchResult, support, without
from torchid.diagnosis.search.rivals import NAMED, PART
from torchid.effects.place import Interval
from torchid.observation.trial import TrialObservation

REFUTED = 3.0
"""Nats by which held-out motion must speak against a cause, beyond its leeway. A log likelihood ratio that should be m
has a standard deviation of (2 m)^0.5: that of a true cause in a true model falls below -3 once in 140 at most, whatever
m. Models of bodies are not true, and a scale of the cameras told to a tenth of itself lost 5 where 12 were promised."""


@dataclass(frozen=True)
class Errors:
    """Held-out residual; RMS of 3-vectors over used frames, moments about the root's origin."""

    force_rmse_N: float
    moment_rmse_Nm: float


@dataclass(frozen=True)
class HeldOutFit:
    """A model on the held-out trials."""

    errors: Errors
    log_density: float
    """Of the held-out rows after the fit trials, up to what all models share."""

    def over(self, less: "Judged") -> dict[str, float]:
        """What it gains over a smaller model."""
        before, after = less.errors, self.errors
        return {
            "heldout_log_likelihood": self.log_density - less.log_density,
            "force_rmse_pct": 100.0 * (1.0 - after.force_rmse_N / before.force_rmse_N),
            "moment_rmse_pct": 100.0 * (1.0 - after.moment_rmse_Nm / before.moment_rmse_Nm),
        }


class HeldOut:
    """The held-out trials of a search."""

    def __init__(
        self, found: SearchResult, observed: Sequence[TrialObservation], heldout: Sequence[TrialObservation]
    ) -> None:
        self.found, self.trials, self.first = found, heldout, len(found.statistics.trials)
        self.share = _used(heldout) / max(_used(observed), 1)
        self.columns = [trial_columns(w, found.design.sources) for w in heldout]
        if any(one.effect.shifts_time or one.effect.nonlinear for one in found.chosen):
            self.columns = self._settled()
        rows = [trial_spectra(w, c, found.design.noisy) for w, c in zip(heldout, self.columns, strict=True)]
        noise = found.noise.typical(len(heldout))
        if heldout:
            typical = self._beside(summed(rows, found.prior, found.design, noise))
            everywhere = self._everywhere(found.chosen)
            noise = unseen_noise(rows, found.prior, found.design, everywhere, noise, typical)
        self.both = self._beside(summed(rows, found.prior, found.design, noise))
        self.unforced = self._beside(unforced(rows, found.prior, found.design, noise))
        self._known: dict[tuple[int, ...], tuple[Statistics, ...]] = {}

    def _beside(self, more: Statistics) -> Statistics:
        return replace(self.found.statistics, trials=(*self.found.statistics.trials, *more.trials))

    def judged(self, chosen: Sequence[Candidate]) -> HeldOutFit:
        """Held-out residual and density under a model with these effects."""
        if not self.trials:
            return HeldOutFit(Errors(math.nan, math.nan), math.nan)
        (statistics, _, _), some = self._without_anew(chosen)
        return HeldOutFit(self._errors(fit(statistics, some)), self.density(chosen))

    def density(self, chosen: Sequence[Candidate]) -> float:
        """Log density of the held-out rows after the fit trials, see ``Judged``."""
        (statistics, whole, _), some = self._without_anew(chosen)
        return _over(whole, statistics, some) - self._asked(chosen) * math.log(2.0)

    def of_forces(self, chosen: Sequence[Candidate]) -> float:
        """Log density of the held-out forces after all that cameras saw there, and the fit trials."""
        (_, whole, response), some = self._without_anew(chosen)
        return _over(whole, response, some)

    def _without_anew(self, chosen: Sequence[Candidate]) -> tuple[tuple[Statistics, ...], list[Candidate]]:
        """Sums of fit and of all trials, and of these without held-out forces, effects that are anew in every trial
        integrated out; and the other effects."""
        everywhere = self._everywhere(chosen)
        anew = [k for k, one in enumerate(everywhere) if one.effect.per_trial]
        key = tuple(id(chosen[k]) for k in anew)
        if key not in self._known:
            some = [everywhere[k] for k in anew]
            self._known[key] = tuple(
                marginalise_per_trial(x, some)[0] for x in (self.found.statistics, self.both, self.unforced)
            )
        return self._known[key], [one for one in everywhere if not one.effect.per_trial]

    def acting(self) -> tuple[Candidate, ...]:
        """The chosen effects; what is a state of single recordings also in those of the held-out ones that show it.

        Where a marker sat in a recording only that recording tells: one bit, and a yes has its price.
        """
        found = list(self.found.chosen)
        asked = [k for k, one in enumerate(found) if one.effect.per_recording and not self._whole(one)]
        best = self.density(found) if asked and self.trials else 0.0
        for k, j in product(asked, range(len(self.trials))):
            more = [*found[:k], self._also(found[k], j), *found[k + 1 :]]
            if (density := self.density(more)) > best:
                found, best = more, density
        return tuple(found)

    def upheld(self, chosen: Sequence[Candidate]) -> tuple[tuple[Candidate, ...], tuple[tuple[Candidate, float], ...]]:
        """The effects that held-out motion does not refute, and the others with what it says for them [nat].

        One that it refutes may sit elsewhere: at the next place that fit trials support and for which it speaks.
        """
        kept, refuted = list(chosen), []
        while kept and self.trials:
            says, worse = self._says(kept), self._worse(kept)
            margin = [x + self._leeway(kept, one) for x, one in zip(says, kept, strict=True)]
            worst = min(range(len(kept)), key=lambda k: (not worse[k], margin[k]))
            if margin[worst] > -REFUTED and not worse[worst]:
                break
            refuted.append((kept.pop(worst), says[worst]))
            kept += self._elsewhere(kept, [one for one, _ in refuted])
        return tuple(kept), tuple(refuted)

    def _elsewhere(self, kept: Sequence[Candidate], refuted: Sequence[Candidate]) -> list[Candidate]:
        """What may stand for the cause that was refuted last, if anything.

        Held-out motion must speak for it as it would have to against it, and pay for each place it is asked about.
        """
        gone = refuted[-1]
        taken = [one.place.where for one in (*kept, *refuted) if one.effect.name == gone.effect.name]
        others = [
            other for one, other in self.found.alternative_places if one is gone and other.place.where not in taken
        ]
        for asked, other in enumerate(others, 1):
            some = [*kept, other]
            if support(self.found.statistics, some, other) < NAMED or self._worse(some)[-1]:
                continue
            if self.of_forces(some) - self.of_forces(kept) > REFUTED + math.log(asked):
                return [other]
        return []

    def _worse(self, chosen: Sequence[Candidate]) -> list[bool]:
        """Whether forces and moments both err plainly more because of each of them, of what acts on forces alone.

        The density knows how little fit trials tell of a limb's inertia, which then makes up for much: most of an upper
        arm on a spring, where there was none, was likelier by 6.6 nats, and forces erred by half as much again. What
        inertia takes on of a wrong record is spared, as in ``relevant``.
        """
        whole, found = self._sizes(chosen), []
        for one in chosen:
            spared = one.effect.moves_markers or one.effect.per_trial or one.effect.on_record or not self._whole(one)
            more = whole - (whole if spared else self._sizes(without(chosen, one)))
            found.append(float(more.min()) > math.log1p(PLAIN))
        return found

    def _sizes(self, chosen: Sequence[Candidate]) -> Float[Tensor, " 2"]:
        """Of the held-out residual, see ``sizes``."""
        (statistics, _, _), some = self._without_anew(chosen)
        return sizes(self.trials, self._left(fit(statistics, some)))

    def _says(self, chosen: Sequence[Candidate]) -> list[float]:
        """What held-out motion says for each of them: of what acts on forces alone, its forces do.

        Geometry that a force had bent in the fit trials came back and was 31 nats better for held-out markers, while
        the force itself made held-out forces 32 nats worse.
        """
        whole = {density: density(chosen) for density in (self.density, self.of_forces)}
        own = [self.density if one.effect.moves_markers else self.of_forces for one in chosen]
        return [whole[density] - density(without(chosen, one)) for density, one in zip(own, chosen, strict=True)]

    def _leeway(self, chosen: Sequence[Candidate], one: Candidate) -> float:
        """By how much held-out motion may speak against what cameras saw, or what is anew in every trial [nat].

        Where it acts, by the standard deviation of what fit trials promise. What cameras saw in some trials alone, by a
        part of what those say for it: two toe markers that were swapped for half a second, at 1800 nats, went for the
        16 nats by which the geometry that they had bent was the better one for other trials. What acts on forces
        alone has no such excuse: in the table of sessions, 4 of 648 such causes that were right lost more than 3 nats,
        and 14 of 154 that were wrong.
        """
        if not (one.effect.moves_markers or one.effect.per_trial):
            return 0.0
        told = max(support(self.found.statistics, chosen, one), 0.0)
        acts = self._whole(one) or bool(one.trials - self.found.statistics.all)
        promised = math.sqrt(2.0 * self.share * told) if acts else 0.0
        return max(promised, PART * told) if one.effect.moves_markers and not self._whole(one) else promised

    def _errors(self, posterior: Posterior) -> Errors:
        left = [x[w.rows.used] for w, x in zip(self.trials, self._left(posterior), strict=True)]
        both = torch.cat(left)
        return Errors(*(float(x.square().sum(1).mean().sqrt()) for x in (both[:, :3], both[:, 3:])))

    def _left(self, posterior: Posterior) -> list[Float[Tensor, "frames 6"]]:
        """Residuals of the held-out trials under a model that the fit trials have."""
        trials = enumerate(zip(self.trials, self.columns, strict=True), self.first)
        return [
            residual(w, c, self.found.prior, posterior, k) + self._untrusted(w, c, posterior, k) for k, (w, c) in trials
        ]

    def _untrusted(
        self, observed: TrialObservation, columns: Columns, posterior: Posterior, trial: int
    ) -> Float[Tensor, "frames 6"]:
        """What chosen effects take off and nobody believes (``Effect.trusted``)."""
        found, n = torch.zeros_like(observed.rows.wrench), self.found.design.inertia
        for one, share in zip(posterior.chosen, posterior.shares(len(self.found.prior.mean), trial), strict=True):
            theta = self.found.prior.scale * share[n:]
            added = columns.added(theta[columns.terms.live[n:] - n])
            found += added - one.effect.trusted(added, observed.rows.rate, one.place, theta[one.columns - n])
        return found

    def _settled(self) -> list[Columns]:
        """Columns with those of late and curved effects where the fit trials found them."""
        found = self.found
        posterior, n = fit(found.statistics, self._everywhere(found.chosen)), found.design.inertia
        theta = [
            found.prior.theta(posterior.z(len(found.prior.mean), self.first + k))[n:] for k in range(len(self.trials))
        ]
        trials = zip(self.trials, self.columns, theta, strict=True)
        return [linearised(w, c, found.design.sources, x) for w, c, x in trials]

    def _whole(self, one: Candidate) -> bool:
        return one.trials == self.found.statistics.all

    def _everywhere(self, chosen: Sequence[Candidate]) -> list[Candidate]:
        """What acts in all fit trials acts in the held-out ones too."""
        every = frozenset(range(self.first + len(self.trials)))
        return [replace(c, trials=every) if self._whole(c) else c for c in chosen]

    def _asked(self, chosen: Sequence[Candidate]) -> int:
        """Held-out trials that said themselves that an effect is there."""
        return sum(len(one.trials - self.found.statistics.all) for one in chosen if one.effect.per_recording)

    def _also(self, one: Candidate, trial: int) -> Candidate:
        """The same acting in one of the held-out trials too."""
        name, time = self.trials[trial].rows.name, self.trials[trial].rows.motion.time
        own = Interval(name, float(time[0]), float(time[-1]))
        place = replace(one.place, when=(*(one.place.when or ()), own))
        trials = one.trials | {self.first + trial}
        return replace(one, place=place, trials=trials, proposed=one.proposed or one.place)


def _over(more: Statistics, less: Statistics, chosen: Sequence[Candidate]) -> float:
    """Log density of what some sums have beyond others."""
    return fit(more, chosen).log_evidence + more.constant - fit(less, chosen).log_evidence - less.constant


def _used(trials: Sequence[TrialObservation]) -> int:
    return sum(int(w.rows.used.sum()) for w in trials)
