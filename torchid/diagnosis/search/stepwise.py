"""Which effects the data support: add the best, estimate the noise again, scan again, try to remove each."""

import logging
import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

from torchid.diagnosis.candidates.candidate import Candidate
from torchid.diagnosis.columns.assemble import make_design
from torchid.diagnosis.columns.design import Design, narrower, only
from torchid.diagnosis.columns.relinearise import relinearised
from torchid.diagnosis.evidence.adequacy import assess_adequacy
from torchid.diagnosis.evidence.gains import gains
from torchid.diagnosis.evidence.noise import Noise, estimate_noise, initial_noise, summed
from torchid.diagnosis.evidence.per_trial import marginalise_per_trial
from torchid.diagnosis.evidence.posterior import fit
from torchid.diagnosis.evidence.prior import Prior, make_prior
from torchid.diagnosis.evidence.residuals import residuals
from torchid.diagnosis.evidence.skin_prior import with_slides
from torchid.diagnosis.evidence.spectra import TrialSpectra, narrowed, trial_spectra
from torchid.diagnosis.evidence.statistics import Statistics
from torchid.diagnosis.search.elimination import drop_unsupported
from torchid.diagnosis.search.interval_refinement import refine_interval
from torchid.diagnosis.search.result import SearchResult, asked_later, reduced
from torchid.diagnosis.search.rivals import NAMED, Rival, Round
from torchid.diagnosis.search.scan import scan_all
from torchid.effects.effect import Effect
from torchid.geometry.result import GeometryFit
from torchid.model.model import InertialPrior
from torchid.observation.trial import TrialObservation
from torchid.regressor.whitening import Whitening

log = logging.getLogger(__name__)
NEWTON = 2
"""Steps by which effects that are not linear in their parameters are found."""
SECOND = 4
"""Effects that are tried under the noise that they would leave, at most."""
GROWN = 1.5
"""Times what it would have explained then that such an effect must explain to be tried once more."""
LIKELY = 0.2
"""Part of what the likeliest explains that another must explain to be tried."""


def search(
    observed: Sequence[TrialObservation],
    effects: Sequence[Effect],
    inertia: InertialPrior,
    omega: float,
    whitening: Whitening,
    limit: int,
    geometry: GeometryFit | None = None,
) -> SearchResult:
    """Scan the catalogue until nothing more is supported.

    Args:
        watched: fit trials.
        effects: to try.
        inertia: prior of the inertial parameters.
        omega: weight of that prior.
        whitening: of the inertial fit, to begin with.
        limit: number of effects at most, of each kind (see ``_kind``).
        geometry: with which the trials were followed.
    """
    log.info("scanning %d effects in %d trials", len(effects), len(observed))
    chosen: list[Candidate] = []
    rounds: list[Round] = []
    noise = initial_noise(whitening, len(observed))
    scan = _begun(observed, effects, inertia, omega, noise, limit, geometry)
    noise = scan.noise(chosen, noise)
    statistics = scan.statistics(noise)
    while True:
        some, looked, before = open_candidates(scan.design, chosen, limit), None, (noise, statistics)
        scanned = scan_all(statistics, some, chosen)
        log.info("scanned %d candidates", len(some))
        look, scan = scan.closer(noise, statistics, chosen, scanned.rivals)
        if look is not None:
            noise, looked = look
            statistics = scan.statistics(noise)
            scanned = scan_all(statistics, some, chosen)
        rounds.append(found := scanned.round)
        best = found.named
        if best is None:
            noise, statistics = before
            break
        log.info("%s at %s gains %.1f nats", best.candidate.effect.name, best.candidate.place.where, best.score)
        chosen.append(best.candidate)
        scan, noise, statistics = scan.took(noise, statistics, chosen, looked)
        scan, statistics, chosen = scan.opened(statistics, chosen, asked_later(scan.design, chosen, rounds))
    return drop_unsupported(reduced(scan.design, scan.prior, noise, chosen, rounds, statistics))


def _begun(
    observed: Sequence[TrialObservation],
    effects: Sequence[Effect],
    inertia: InertialPrior,
    omega: float,
    noise: Noise,
    limit: int,
    geometry: GeometryFit | None,
) -> "_Scan":
    """Apart from the search, which would hold on to gigabytes of columns that it later does without."""
    design = make_design(observed, effects, geometry)
    prior, rows = make_prior(inertia, omega, design), _rows(observed, design)
    design = with_slides(rows, prior, design, noise)
    return _Scan(observed, rows, design, prior.widened(design), limit)


def _rows(observed: Sequence[TrialObservation], design: Design) -> list[TrialSpectra]:
    return [trial_spectra(w, c, design.noisy) for w, c in zip(observed, design.trials, strict=True)]


@dataclass(frozen=True)
class _Scan:
    """Of the catalogue, under one noise or another."""

    observed: Sequence[TrialObservation]
    rows: Sequence[TrialSpectra]
    design: Design
    prior: Prior
    limit: int
    silent: dict[tuple[str, int], float] = field(default_factory=dict)
    """What effects would explain at places at which the noise that they leave did not support them [nat]; places by
    identity, which rounds keep alive."""

    def noise(self, chosen: Sequence[Candidate], start: Noise, statistics: Statistics | None = None) -> Noise:
        """That of what is left by the chosen effects; ``sums`` are those under ``start``, if at hand."""
        rows, prior, design, own = narrowed(self.rows, self.prior, self.design, chosen)
        return estimate_noise(rows, prior, design, own, start, statistics and statistics.only(self.design, chosen))

    def statistics(self, noise: Noise) -> Statistics:
        """Of everything under a noise."""
        return summed(self.rows, self.prior, self.design, noise)

    def took(
        self, noise: Noise, statistics: Statistics, chosen: list[Candidate], looked: Candidate | None
    ) -> tuple["_Scan", Noise, Statistics]:
        """After the last effect was chosen; the noise may be that which one effect leaves already."""
        effect = chosen[-1].effect
        if effect.shifts_time or effect.nonlinear:
            noise, scan = self.relinearised(noise, chosen)
        elif effect.intermittent and not effect.moves_markers:
            scan, chosen[-1] = self.refined(noise, statistics, chosen)
        elif chosen[-1] is looked:
            return self, noise, statistics
        else:
            noise = self.noise(chosen, noise, statistics)
            return self, noise, self.statistics(noise)
        noise = scan.noise(chosen, noise)
        return scan, noise, scan.statistics(noise)

    def opened(
        self, statistics: Statistics, chosen: Sequence[Candidate], kept: Sequence[Candidate]
    ) -> tuple["_Scan", Statistics, list[Candidate]]:
        """Without the columns of effects of which as many are named as may be, but for those asked about at the end."""
        some = [*chosen, *open_candidates(self.design, chosen, self.limit)]
        some += [c for c in kept if c not in some]
        if narrower(self.design, some)[0].width == self.design.width:
            return self, statistics, list(chosen)
        rows, prior, _, _ = narrowed(self.rows, self.prior, self.design, some)
        less = statistics.only(self.design, some)
        design, own, _ = only(self.design, some)
        return replace(self, rows=rows, prior=prior, design=design), less, list(own[: len(chosen)])

    def relinearised(self, noise: Noise, chosen: Sequence[Candidate]) -> tuple[Noise, "_Scan"]:
        """Late and curved effects linearised where they are."""
        design, theta, n = self.design, [self.prior.mean.clone() for _ in self.rows], self.design.inertia
        for step in range(NEWTON):
            if step:
                # All columns at once: taken of the chosen effects alone, they were taken again behind this.
                design = relinearised(self.observed, design, [x[n:] for x in theta])
            small, own, which = only(design, chosen)
            rows, prior = _rows(self.observed, small), self.prior.widened(small)
            noise = estimate_noise(rows, prior, small, own, noise)
            posterior = fit(summed(rows, prior, small, noise), own)
            for k, x in enumerate(theta):
                x[which] = prior.theta(posterior.z(len(prior.mean), k))
        design = relinearised(self.observed, design, [x[n:] for x in theta])
        return noise, replace(self, rows=_rows(self.observed, design), design=design)

    def refined(self, noise: Noise, statistics: Statistics, chosen: Sequence[Candidate]) -> tuple["_Scan", Candidate]:
        """The last effect with its interval and course as they are best."""
        noise = self.noise(chosen, noise, statistics)
        own = self.statistics(noise)
        rows, design, prior, best = refine_interval(
            self.observed, self.rows, self.design, self.prior, noise, own, chosen
        )
        return replace(self, rows=rows, design=design, prior=prior), best

    def closer(
        self, noise: Noise, statistics: Statistics, chosen: Sequence[Candidate], rivals: Sequence[Rival]
    ) -> tuple[tuple[Noise, Candidate] | None, "_Scan"]:
        """Where the residual is more than noise, likely candidates compete under the noise that each would leave.

        Whatever is not yet named is in the noise that was estimated without it: ground that shook at 37 times the noise
        had no evidence, and two plates that were swapped had less than a tenth of the energy that they explain. Beside
        the noise comes the candidate whose it is, and the scan that remembers which had no support.
        """
        rest = assess_adequacy(
            self.observed, residuals(self.observed, self.design, self.prior, fit(statistics, chosen))
        )
        looks, silent = [], dict(self.silent)
        for one in _likely(rivals) if rest.significant else ():
            key = one.candidate.effect.name, id(one.candidate.place)
            if one.explained > GROWN * silent.get(key, 0.0):
                look = self._look(noise, statistics, one, chosen)
                if look is None:
                    silent[key] = one.explained
                else:
                    looks.append((*look, one.candidate))
        best = max(looks, key=lambda look: look[0])[1:] if looks else None
        return best, replace(self, silent=silent)

    def _look(
        self, noise: Noise, statistics: Statistics, rival: Rival, chosen: Sequence[Candidate]
    ) -> tuple[float, Noise] | None:
        """Log evidence with one more effect under the noise that it leaves; None where this place of it has no support
        there."""
        some = [*chosen, rival.candidate]
        rows, prior, design, own = narrowed(self.rows, self.prior, self.design, some)
        other = estimate_noise(rows, prior, design, own, noise, statistics.only(self.design, some))
        statistics, base = marginalise_per_trial(summed(rows, prior, design, other), own[:-1])
        posterior = fit(statistics, base)
        gain = float(gains(statistics, posterior, own[-1:])[0]) + math.log(rival.candidate.odds) - rival.ordinary
        return None if gain < NAMED else (posterior.log_evidence + gain + statistics.constant, other)


def open_candidates(design: Design, chosen: Sequence[Candidate], limit: int) -> list[Candidate]:
    """Those that may still be chosen: no plate's error is left out because bodies are as bodies are, or for markers.

    A wrong record is counted apart as well: a body 6 kg heavier than written down went unnamed beside three errors of
    plates and time that explained more.
    """
    kinds = [_kind(c.effect) for c in chosen]
    return [c for c in design.candidates if c not in chosen and kinds.count(_kind(c.effect)) < limit]


def _kind(effect: Effect) -> tuple[bool, ...]:
    return effect.bodily, effect.moves_markers, effect.on_record, effect.whole_body


def _likely(rivals: Sequence[Rival]) -> list[Rival]:
    """Of the effects that would explain most, the places that do."""
    best: dict[str, Rival] = {}
    for one in rivals:
        name = one.candidate.effect.name
        if name not in best or one.explained > best[name].explained:
            best[name] = one
    order = sorted(best.values(), key=lambda one: -one.explained)[:SECOND]
    return [one for one in order if one.explained > LIKELY * order[0].explained]
