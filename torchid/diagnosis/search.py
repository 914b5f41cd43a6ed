"""Which effects the data support: add the best, estimate the noise again, scan again, try to remove each."""

import logging
import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.diagnosis.anew import eliminated
from torchid.diagnosis.candidates import make_design
from torchid.diagnosis.design import Candidate, Columns, Design, narrower, only
from torchid.diagnosis.evidence import Fitted, Prior, Sums, fit, gains, make_prior
from torchid.diagnosis.found import NAMED, Rival, Round, Search, reduced, support
from torchid.diagnosis.intervals import timed
from torchid.diagnosis.late import linearised, without_beyond
from torchid.diagnosis.noise import Noise, Rows, estimate_noise, initial_noise, narrowed, rows_of, summed
from torchid.diagnosis.unexplained import structure
from torchid.diagnosis.watched import Watched
from torchid.effects.effect import Effect
from torchid.geometry.fitted import GeometryFit
from torchid.model.model import InertialPrior
from torchid.regressor.rows import measured
from torchid.regressor.whitening import Whitening

log = logging.getLogger(__name__)
NEWTON = 2
"""Steps by which effects that no column is linear in are found."""
SECOND = 4
"""Effects that are tried under the noise that they would leave, at most."""
OUT_OF_SIGHT = 10.0
"""Nats behind the best at which nothing matters to it."""
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
        limit: number of effects at most, of bodies, of markers and of forces each.
        geometry: with which the trials were followed.
    """
    design = make_design(watched, effects, geometry)
    prior = make_prior(inertia, omega, design)
    noise = initial_noise(whitening, len(watched))
    chosen: list[Candidate] = []
    rounds: list[Round] = []
    scan = _Scan(watched, _rows(watched, design), design, prior, limit)
    noise, sums = scan.noise(chosen, noise)
    while True:
        noise, sums, seen = scan.closer(noise, sums, chosen)
        rounds.append(found := _scan(sums, open_candidates(scan.design, chosen, limit), chosen))
        best = found.named
        if best is None:
            break
        log.info("%s at %s gains %.1f nats", best.candidate.effect.name, best.candidate.place.where, best.score)
        chosen.append(best.candidate)
        if best.candidate.effect.late:
            noise, scan = scan.settled(noise, chosen)
        if best.candidate.effect.timed and not best.candidate.effect.kinematic:
            scan, chosen[-1] = scan.timed(noise, chosen)
        if chosen[-1] is not seen or best.candidate.effect.late:
            noise, sums = scan.noise(chosen, noise)
        scan, sums, chosen = scan.opened(sums, chosen)
    return _pruned(reduced(scan.design, scan.prior, noise, chosen, rounds, sums))


def _rows(watched: Sequence[Watched], design: Design) -> list[Rows]:
    return [rows_of(w, c, design.late) for w, c in zip(watched, design.trials, strict=True)]


def _linearised(watched: Sequence[Watched], design: Design, theta: Sequence[Tensor]) -> Design:
    trials = zip(watched, design.trials, theta, strict=True)
    return replace(design, trials=tuple(linearised(w, c, design.sources, x[design.inertia :]) for w, c, x in trials))


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

    def noise(self, chosen: Sequence[Candidate], start: Noise) -> tuple[Noise, Sums]:
        """That of what is left by the chosen effects, and the sums under it."""
        noise = estimate_noise(self.rows, self.prior, self.design, chosen, start)
        return noise, self.sums(noise)

    def sums(self, noise: Noise) -> Sums:
        """Of everything under a noise."""
        return summed(self.rows, self.prior, self.design, noise)

    def opened(self, sums: Sums, chosen: Sequence[Candidate]) -> tuple["_Scan", Sums, list[Candidate]]:
        """Without the columns of effects of which as many are named as may be."""
        some = [*chosen, *open_candidates(self.design, chosen, self.limit)]
        if narrower(self.design, some)[0].width == self.design.width:
            return self, sums, list(chosen)
        rows, prior, _, _ = narrowed(self.rows, self.prior, self.design, some)
        design, own, which = only(self.design, some)
        less = replace(sums, shared=design.shared, trials=tuple(raw.only(which) for raw in sums.trials))
        return replace(self, rows=rows, prior=prior, design=design), less, list(own[: len(chosen)])

    def settled(self, noise: Noise, chosen: Sequence[Candidate]) -> tuple[Noise, "_Scan"]:
        """Late effects linearised where they are."""
        small, own, which = only(self.design, chosen)
        prior, theta = self.prior.widened(small), [self.prior.mean.clone() for _ in self.rows]
        for _ in range(NEWTON):
            rows = _rows(self.watched, small)
            noise = estimate_noise(rows, prior, small, own, noise)
            fitted = fit(summed(rows, prior, small, noise), own)
            for k, x in enumerate(theta):
                x[which] = prior.theta(fitted.z(len(prior.mean), k))
            small = _linearised(self.watched, small, [x[which] for x in theta])
        design = _linearised(self.watched, self.design, theta)
        return noise, replace(self, rows=_rows(self.watched, design), design=design)

    def timed(self, noise: Noise, chosen: Sequence[Candidate]) -> tuple["_Scan", Candidate]:
        """The last effect with its interval and course as they are best."""
        noise, sums = self.noise(chosen, noise)
        rows, design, prior, best = timed(self.watched, self.rows, self.design, self.prior, noise, sums, chosen)
        return replace(self, rows=rows, design=design, prior=prior), best

    def closer(self, noise: Noise, sums: Sums, chosen: Sequence[Candidate]) -> tuple[Noise, Sums, Candidate | None]:
        """Where the residual is more than noise, likely candidates compete under the noise that each would leave.

        Whatever is not yet named is in the noise that was estimated without it: ground that shook at 37 times the noise
        had no evidence, and two plates that were swapped had less than a tenth of the energy that they explain. Third
        is the candidate whose noise it is.
        """
        rest = structure(self.watched, residuals(self.watched, self.design, self.prior, fit(sums, chosen)))
        if not rest.significant:
            return noise, sums, None
        looks = []
        for energy, one in _likely(sums, open_candidates(self.design, chosen, self.limit), chosen):
            if energy > GROWN * self.silent.get((one.effect.name, id(one.place)), 0.0):
                look = self._look(noise, one, chosen)
                if look is None:
                    self.silent[one.effect.name, id(one.place)] = energy
                else:
                    looks.append((*look, one))
        if not looks:
            return noise, sums, None
        _, noise, best = max(looks, key=lambda look: look[0])
        return noise, self.sums(noise), best

    def _look(self, noise: Noise, one: Candidate, chosen: Sequence[Candidate]) -> tuple[float, Noise] | None:
        """Log evidence with one more effect under the noise that it leaves; None where this place of it has no support
        there."""
        rows, prior, design, own = narrowed(self.rows, self.prior, self.design, [*chosen, one])
        other = estimate_noise(rows, prior, design, own, noise)
        sums, base = eliminated(summed(rows, prior, design, other), own[:-1])
        fitted = fit(sums, base)
        gain = float(gains(sums, fitted, own[-1:])[0]) + math.log(one.odds)
        return None if gain < NAMED else (fitted.log_evidence + gain + sums.constant, other)


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
    known = watched.needed(theta[:n]) + torch.einsum("ipt,p->ti", columns.extra, own)
    return measured(rows) - known


def open_candidates(design: Design, chosen: Sequence[Candidate], limit: int) -> list[Candidate]:
    """Those that may still be chosen: no plate's error is left out because bodies are as bodies are, or for markers."""
    kinds = [_kind(c.effect) for c in chosen]
    return [c for c in design.candidates if c not in chosen and kinds.count(_kind(c.effect)) < limit]


def _kind(effect: Effect) -> tuple[bool, bool]:
    return effect.bodily, effect.kinematic


def _likely(sums: Sums, left: Sequence[Candidate], chosen: Sequence[Candidate]) -> list[tuple[float, Candidate]]:
    """Of the effects that would explain most, the places that do, and how much [nat]."""
    sums, chosen = eliminated(sums, chosen)
    explained = gains(sums, fit(sums, chosen), left)[1] - 0.5 * torch.tensor([c.size for c in left])
    best: dict[str, tuple[float, Candidate]] = {}
    for one, energy in zip(left, explained.tolist(), strict=True):
        if one.effect.name not in best or energy > best[one.effect.name][0]:
            best[one.effect.name] = energy, one
    order = sorted(best.values(), key=lambda both: -both[0])[:SECOND]
    return [(energy, one) for energy, one in order if energy > LIKELY * order[0][0]]


def _scan(sums: Sums, left: Sequence[Candidate], chosen: Sequence[Candidate]) -> Round:
    if not left:
        return Round((), {})
    sums, chosen = eliminated(sums, chosen)
    gain, energy = (x.tolist() for x in gains(sums, fit(sums, chosen), left))
    rivals = [Rival(c, g, g, e - 0.5 * c.size) for c, g, e in zip(left, gain, energy, strict=True)]
    rivals = _consented(sums, chosen, rivals) if len(sums.all) > 1 else rivals
    rivals.sort(key=lambda rival: -rival.weighed)
    names = dict.fromkeys(c.effect.name for c in left)
    families = {n: _mean([r for r in rivals if r.candidate.effect.name == n]) for n in names}
    return Round(tuple(rivals), families)


def _consented(sums: Sums, chosen: Sequence[Candidate], rivals: Sequence[Rival]) -> list[Rival]:
    """With the consent of each trial to those that may come out best, or near."""
    base = [fit(sums, chosen, sums.all - {k}) for k in sums.all]
    asked, best = [], -math.inf
    # What all trials together do not support needs no consent of each.
    silent, waiting = [r for r in rivals if r.evidence <= 0.0], [r for r in rivals if r.evidence > 0.0]
    while waiting and (top := max(r.weighed for r in waiting)) > best - OUT_OF_SIGHT:
        fresh = [r for r in waiting if r.weighed >= top - OUT_OF_SIGHT]
        waiting = [r for r in waiting if r.weighed < top - OUT_OF_SIGHT]
        crossed = _crossed(sums, base, fresh).tolist()
        asked += [replace(r, crossed=x) for r, x in zip(fresh, crossed, strict=True)]
        best = max(r.weighed for r in asked)
    return asked + waiting + silent


def _crossed(sums: Sums, base: Sequence[Fitted], some: Sequence[Rival]) -> Float[Tensor, " some"]:
    """Log evidence that candidates add to what each trial says after the others, summed over the trials.

    By the chain rule, that of a trial is the evidence of all less that of the others, to which ``base`` was fitted.
    """
    candidates = [r.candidate for r in some]
    whole = torch.tensor([r.evidence for r in some]).to(sums.trials[0].moment)
    return sum((whole - gains(sums, without, candidates)[0] for without in base), start=torch.zeros_like(whole))


def _mean(rivals: Sequence[Rival]) -> float:
    """Log of the mean of exponentials, places weighed by their odds."""
    return float(torch.logsumexp(torch.tensor([r.weighed for r in rivals], dtype=torch.float64), 0))


def _pruned(found: Search) -> Search:
    """Without those that the others have made superfluous."""
    kept = list(found.chosen)
    for one in reversed(found.chosen):
        if support(found.sums, kept, one) < NAMED:
            kept.remove(one)
    return replace(found, chosen=tuple(kept), fitted=fit(found.sums, kept))
