"""Which effects the data support: add the best, estimate the noise again, scan again, try to remove each."""

import logging
import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.diagnosis.candidates import Candidate, Design, Watched, make_design
from torchid.diagnosis.evidence import Fitted, Prior, fit, gains, make_prior
from torchid.effects.effect import Effect
from torchid.model.model import InertialPrior
from torchid.regressor.whitening import Spectrum, Whitening, accumulate, estimate_whitening, spectra

log = logging.getLogger(__name__)
NAMED = 5.0
"""Nats that name an effect: odds of 150 to one."""
ALIKE = 3.0
"""Nats within which a rival cannot be told apart."""
ROUNDS = 2
"""Estimates of the noise for each set of effects."""


@dataclass(frozen=True)
class Rival:
    """A candidate and what the data say for it."""

    candidate: Candidate
    evidence: float
    """Log evidence gained over the model without it [nat]."""
    crossed: float
    """The same, each trial predicted from the others."""

    @property
    def score(self) -> float:
        """What counts: an effect that does not carry over to other trials is none.

        Not the lesser of both: what only the prior contradicts, such as a wrong recorded mass, each trial predicts from
        the others without the effect as well.
        """
        return self.evidence if self.crossed > 0.0 else min(self.evidence, self.crossed)

    @property
    def weighed(self) -> float:
        """The score with the odds of the place."""
        return self.score + math.log(self.candidate.place.odds)


@dataclass(frozen=True)
class Round:
    """One scan of the catalogue, best first."""

    rivals: tuple[Rival, ...]
    families: dict[str, float]
    """Score of each effect, averaged over its places: what was searched is paid for."""


@dataclass(frozen=True)
class Search:
    """What was found."""

    design: Design
    prior: Prior
    whitening: Whitening
    chosen: tuple[Candidate, ...]
    rounds: tuple[Round, ...]
    base: Fitted
    """Without any effect, under the same noise."""
    fitted: Fitted


def search(
    watched: Sequence[Watched],
    effects: Sequence[Effect],
    inertia: InertialPrior,
    omega: float,
    whitening: Whitening,
    limit: int,
) -> Search:
    """Scan the catalogue until nothing more is supported.

    Args:
        watched: fit trials.
        effects: to try.
        inertia: prior of the inertial parameters.
        omega: weight of that prior.
        whitening: of the inertial fit, to begin with.
        limit: number of effects at most.
    """
    design = make_design(watched, effects)
    prior = make_prior(inertia, omega, design)
    blocks = [list(spectra(w.rows, extra)) for w, extra in zip(watched, design.extra, strict=True)]
    chosen: list[Candidate] = []
    rounds: list[Round] = []
    while True:
        whitening = _noise(blocks, prior, design, chosen, whitening)
        by_trial = [prior.standard(accumulate(own, whitening)) for own in blocks]
        found = _scan(by_trial, design, chosen)
        rounds.append(found)
        best = found.rivals[0] if found.rivals else None
        if best is None or len(chosen) >= limit or found.families[best.candidate.effect.name] < NAMED:
            break
        log.info("%s at %s gains %.1f nats", best.candidate.effect.name, best.candidate.place.where, best.score)
        chosen.append(best.candidate)
    chosen = _pruned(by_trial, design, chosen)
    whole = _total(by_trial)
    return Search(
        design, prior, whitening, tuple(chosen), tuple(rounds),
        fit(whole, design.columns(())), fit(whole, design.columns(chosen)),
    )  # fmt: skip


def _total(by_trial: Sequence[tuple[Tensor, Tensor]]) -> tuple[Tensor, Tensor]:
    return sum(g for g, _ in by_trial), sum(m for _, m in by_trial)  # type: ignore[return-value]


def _noise(
    blocks: Sequence[Sequence[Spectrum]], prior: Prior, design: Design, chosen: Sequence[Candidate], start: Whitening
) -> Whitening:
    """Covariance of what the model with the chosen effects leaves: noise estimated without them would hold them."""
    whitening, flat = start, [block for own in blocks for block in own]
    columns = design.columns(chosen)
    for _ in range(ROUNDS):
        found = fit(_total([prior.standard(accumulate(own, whitening)) for own in blocks]), columns)
        z = torch.zeros_like(prior.mean)
        z[columns] = found.mean
        lost = float(len(columns) - torch.trace(found.covariance))
        whitening = estimate_whitening(flat, prior.theta(z), lost)
    return whitening


def _scan(by_trial: Sequence[tuple[Tensor, Tensor]], design: Design, chosen: Sequence[Candidate]) -> Round:
    left = [c for c in design.candidates if c not in chosen]
    if not left:
        return Round((), {})
    columns, whole = design.columns(chosen), _total(by_trial)
    gain = gains(whole, fit(whole, columns), left)
    crossed = torch.zeros_like(gain)
    for own in by_trial:
        # The chain rule: what a trial says after the others is the evidence of all less that of the others.
        others = whole[0] - own[0], whole[1] - own[1]
        crossed += gain - gains(others, fit(others, columns), left)
    if len(by_trial) == 1:
        crossed = gain
    rivals = [Rival(c, float(g), float(x)) for c, g, x in zip(left, gain, crossed, strict=True)]
    rivals.sort(key=lambda rival: -rival.weighed)
    names = dict.fromkeys(c.effect.name for c in left)
    families = {n: _mean([r for r in rivals if r.candidate.effect.name == n]) for n in names}
    return Round(tuple(rivals), families)


def _mean(rivals: Sequence[Rival]) -> float:
    """Log of the mean of exponentials, places weighed by their odds."""
    odds = torch.tensor([r.candidate.place.odds for r in rivals], dtype=torch.float64)
    return float(torch.logsumexp(torch.tensor([r.weighed for r in rivals], dtype=torch.float64), 0) - odds.sum().log())


def _pruned(by_trial: Sequence[tuple[Tensor, Tensor]], design: Design, chosen: Sequence[Candidate]) -> list[Candidate]:
    """Without those that the others have made superfluous."""
    kept = list(chosen)
    whole = _total(by_trial)
    for one in chosen:
        rest = [c for c in kept if c is not one]
        if float(gains(whole, fit(whole, design.columns(rest)), [one])) < NAMED:
            kept = rest
    return kept


def estimate(found: Search, k: int) -> dict[str, tuple[Float[Tensor, "*size"], Float[Tensor, "*size"]]]:
    """Named parameters of the k-th chosen effect: values and standard deviations."""
    one, at = found.chosen[k], found.design.base + sum(c.effect.size for c in found.chosen[:k])
    part = slice(at, at + one.effect.size)
    scale = found.prior.scale[one.columns.start - found.design.inertia : one.columns.stop - found.design.inertia]
    theta = scale * found.fitted.mean[part]
    covariance = scale[:, None] * found.fitted.covariance[part, part] * scale
    values = one.effect.named(one.place, theta)
    out = {}
    for key in values:
        slope = torch.func.jacrev(lambda x, key=key: one.effect.named(one.place, x)[key])(theta)
        flat = slope.reshape(-1, len(theta))
        out[key] = values[key], (flat @ covariance * flat).sum(1).sqrt().reshape(values[key].shape)
    return out
