"""Which effects the data support: add the best, estimate the noise again, scan again, try to remove each."""

import logging
import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

from torchid.diagnosis.anew import eliminated
from torchid.diagnosis.candidates import make_design
from torchid.diagnosis.design import Candidate, Design, narrower, only
from torchid.diagnosis.evidence import fit, gains
from torchid.diagnosis.found import Search, beside, pruned, reduced
from torchid.diagnosis.intervals import timed
from torchid.diagnosis.linearised import settled
from torchid.diagnosis.noise import Noise, estimate_noise, initial_noise, summed
from torchid.diagnosis.residual import residuals
from torchid.diagnosis.rivals import NAMED, Rival, Round
from torchid.diagnosis.scan import scan_all
from torchid.diagnosis.skin import with_slides
from torchid.diagnosis.spectral import Rows, narrowed, rows_of
from torchid.diagnosis.sums import Prior, Sums, make_prior
from torchid.diagnosis.unexplained import structure
from torchid.diagnosis.watched import Watched
from torchid.effects.effect import Effect
from torchid.geometry.fitted import GeometryFit
from torchid.model.model import InertialPrior
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
    watched: Sequence[Watched],
    effects: Sequence[Effect],
    inertia: InertialPrior,
    omega: float,
    whitening: Whitening,
    limit: int,
    geometry: GeometryFit | None = None,
) -> Search:
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
    log.info("scanning %d effects in %d trials", len(effects), len(watched))
    chosen: list[Candidate] = []
    rounds: list[Round] = []
    noise = initial_noise(whitening, len(watched))
    scan = _begun(watched, effects, inertia, omega, noise, limit, geometry)
    noise = scan.noise(chosen, noise)
    sums = scan.sums(noise)
    while True:
        some, looked, before = open_candidates(scan.design, chosen, limit), None, (noise, sums)
        scanned = scan_all(sums, some, chosen)
        log.info("scanned %d candidates", len(some))
        look, scan = scan.closer(noise, sums, chosen, scanned.rivals)
        if look is not None:
            noise, looked = look
            sums = scan.sums(noise)
            scanned = scan_all(sums, some, chosen)
        rounds.append(found := scanned.round)
        best = found.named
        if best is None:
            noise, sums = before
            break
        log.info("%s at %s gains %.1f nats", best.candidate.effect.name, best.candidate.place.where, best.score)
        chosen.append(best.candidate)
        scan, noise, sums = scan.took(noise, sums, chosen, looked)
        scan, sums, chosen = scan.opened(sums, chosen, beside(scan.design, chosen, rounds))
    return pruned(reduced(scan.design, scan.prior, noise, chosen, rounds, sums))


def _begun(
    watched: Sequence[Watched],
    effects: Sequence[Effect],
    inertia: InertialPrior,
    omega: float,
    noise: Noise,
    limit: int,
    geometry: GeometryFit | None,
) -> "_Scan":
    """Apart from the search, which would hold on to gigabytes of columns that it later does without."""
    design = make_design(watched, effects, geometry)
    prior, rows = make_prior(inertia, omega, design), _rows(watched, design)
    design = with_slides(rows, prior, design, noise)
    return _Scan(watched, rows, design, prior.widened(design), limit)


def _rows(watched: Sequence[Watched], design: Design) -> list[Rows]:
    return [rows_of(w, c, design.noisy) for w, c in zip(watched, design.trials, strict=True)]


@dataclass(frozen=True)
class _Scan:
    """Of the catalogue, under one noise or another."""

    watched: Sequence[Watched]
    rows: Sequence[Rows]
    design: Design
    prior: Prior
    limit: int
    silent: dict[tuple[str, int], float] = field(default_factory=dict)
    """What effects would explain at places at which the noise that they leave did not support them [nat]; places by
    identity, which rounds keep alive."""

    def noise(self, chosen: Sequence[Candidate], start: Noise, sums: Sums | None = None) -> Noise:
        """That of what is left by the chosen effects; ``sums`` are those under ``start``, if at hand."""
        rows, prior, design, own = narrowed(self.rows, self.prior, self.design, chosen)
        return estimate_noise(rows, prior, design, own, start, sums and sums.only(self.design, chosen))

    def sums(self, noise: Noise) -> Sums:
        """Of everything under a noise."""
        return summed(self.rows, self.prior, self.design, noise)

    def took(
        self, noise: Noise, sums: Sums, chosen: list[Candidate], looked: Candidate | None
    ) -> tuple["_Scan", Noise, Sums]:
        """After the last effect was chosen; the noise may be that which one effect leaves already."""
        effect = chosen[-1].effect
        if effect.late or effect.curved:
            noise, scan = self.settled(noise, chosen)
        elif effect.timed and not effect.kinematic:
            scan, chosen[-1] = self.timed(noise, sums, chosen)
        elif chosen[-1] is looked:
            return self, noise, sums
        else:
            noise = self.noise(chosen, noise, sums)
            return self, noise, self.sums(noise)
        noise = scan.noise(chosen, noise)
        return scan, noise, scan.sums(noise)

    def opened(
        self, sums: Sums, chosen: Sequence[Candidate], kept: Sequence[Candidate]
    ) -> tuple["_Scan", Sums, list[Candidate]]:
        """Without the columns of effects of which as many are named as may be, but for those asked about at the end."""
        some = [*chosen, *open_candidates(self.design, chosen, self.limit)]
        some += [c for c in kept if c not in some]
        if narrower(self.design, some)[0].width == self.design.width:
            return self, sums, list(chosen)
        rows, prior, _, _ = narrowed(self.rows, self.prior, self.design, some)
        less = sums.only(self.design, some)
        design, own, _ = only(self.design, some)
        return replace(self, rows=rows, prior=prior, design=design), less, list(own[: len(chosen)])

    def settled(self, noise: Noise, chosen: Sequence[Candidate]) -> tuple[Noise, "_Scan"]:
        """Late and curved effects linearised where they are."""
        design, theta, n = self.design, [self.prior.mean.clone() for _ in self.rows], self.design.inertia
        for step in range(NEWTON):
            if step:
                # All columns at once: taken of the chosen effects alone, they were taken again behind this.
                design = settled(self.watched, design, [x[n:] for x in theta])
            small, own, which = only(design, chosen)
            rows, prior = _rows(self.watched, small), self.prior.widened(small)
            noise = estimate_noise(rows, prior, small, own, noise)
            fitted = fit(summed(rows, prior, small, noise), own)
            for k, x in enumerate(theta):
                x[which] = prior.theta(fitted.z(len(prior.mean), k))
        design = settled(self.watched, design, [x[n:] for x in theta])
        return noise, replace(self, rows=_rows(self.watched, design), design=design)

    def timed(self, noise: Noise, sums: Sums, chosen: Sequence[Candidate]) -> tuple["_Scan", Candidate]:
        """The last effect with its interval and course as they are best."""
        noise = self.noise(chosen, noise, sums)
        own = self.sums(noise)
        rows, design, prior, best = timed(self.watched, self.rows, self.design, self.prior, noise, own, chosen)
        return replace(self, rows=rows, design=design, prior=prior), best

    def closer(
        self, noise: Noise, sums: Sums, chosen: Sequence[Candidate], rivals: Sequence[Rival]
    ) -> tuple[tuple[Noise, Candidate] | None, "_Scan"]:
        """Where the residual is more than noise, likely candidates compete under the noise that each would leave.

        Whatever is not yet named is in the noise that was estimated without it: ground that shook at 37 times the noise
        had no evidence, and two plates that were swapped had less than a tenth of the energy that they explain. Beside
        the noise comes the candidate whose it is, and the scan that remembers which had no support.
        """
        rest = structure(self.watched, residuals(self.watched, self.design, self.prior, fit(sums, chosen)))
        looks, silent = [], dict(self.silent)
        for one in _likely(rivals) if rest.significant else ():
            key = one.candidate.effect.name, id(one.candidate.place)
            if one.explained > GROWN * silent.get(key, 0.0):
                look = self._look(noise, sums, one, chosen)
                if look is None:
                    silent[key] = one.explained
                else:
                    looks.append((*look, one.candidate))
        best = max(looks, key=lambda look: look[0])[1:] if looks else None
        return best, replace(self, silent=silent)

    def _look(self, noise: Noise, sums: Sums, rival: Rival, chosen: Sequence[Candidate]) -> tuple[float, Noise] | None:
        """Log evidence with one more effect under the noise that it leaves; None where this place of it has no support
        there."""
        some = [*chosen, rival.candidate]
        rows, prior, design, own = narrowed(self.rows, self.prior, self.design, some)
        other = estimate_noise(rows, prior, design, own, noise, sums.only(self.design, some))
        sums, base = eliminated(summed(rows, prior, design, other), own[:-1])
        fitted = fit(sums, base)
        gain = float(gains(sums, fitted, own[-1:])[0]) + math.log(rival.candidate.odds) - rival.ordinary
        return None if gain < NAMED else (fitted.log_evidence + gain + sums.constant, other)


def open_candidates(design: Design, chosen: Sequence[Candidate], limit: int) -> list[Candidate]:
    """Those that may still be chosen: no plate's error is left out because bodies are as bodies are, or for markers.

    A wrong record is counted apart as well: a body 6 kg heavier than written down went unnamed beside three errors of
    plates and time that explained more.
    """
    kinds = [_kind(c.effect) for c in chosen]
    return [c for c in design.candidates if c not in chosen and kinds.count(_kind(c.effect)) < limit]


def _kind(effect: Effect) -> tuple[bool, ...]:
    return effect.bodily, effect.kinematic, effect.recorded, effect.overall


def _likely(rivals: Sequence[Rival]) -> list[Rival]:
    """Of the effects that would explain most, the places that do."""
    best: dict[str, Rival] = {}
    for one in rivals:
        name = one.candidate.effect.name
        if name not in best or one.explained > best[name].explained:
            best[name] = one
    order = sorted(best.values(), key=lambda one: -one.explained)[:SECOND]
    return [one for one in order if one.explained > LIKELY * order[0].explained]
