"""The verdict: causes with their parameters, rivals and confidence, and what they gain on motion that was not used."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.diagnosis.candidates import Candidate, Design, Watched, extra_columns
from torchid.diagnosis.evidence import Fitted, fit
from torchid.diagnosis.plates import SessionPlate
from torchid.diagnosis.search import ALIKE, Round, Search, estimate, search
from torchid.effects.catalogue import CATALOGUE, effect
from torchid.effects.effect import Effect, Interval
from torchid.model.model import InertialPrior
from torchid.regressor.rows import measured, predict
from torchid.regressor.whitening import Whitening, accumulate, spectra

TIMED = frozenset({"unmeasured_contact", "grasped_object"})
"""Effects that need intervals."""
RIVALS = 4
"""Alternatives that are listed at most."""


@dataclass(frozen=True)
class Alternative:
    """Another explanation."""

    effect: str
    where: tuple[str, ...]
    confidence: float


@dataclass(frozen=True)
class Cause:
    """An effect that the data support."""

    effect: str
    where: tuple[str, ...]
    when: tuple[Interval, ...] | None
    parameters: dict[str, dict[str, Tensor]]
    """``value`` and ``sd`` by key."""
    confidence: float
    """Probability that it, or one that cannot be told from it, is there."""
    alternatives: tuple[Alternative, ...]
    indistinguishable: tuple[Alternative, ...]
    gain: dict[str, float]
    """Held-out, of this cause on top of the others."""


@dataclass(frozen=True)
class Errors:
    """Held-out residual; RMS of 3-vectors over used frames, moments about the root's origin."""

    force_rmse_N: float
    moment_rmse_Nm: float


@dataclass(frozen=True)
class Diagnosis:
    """What the model gets wrong, and why."""

    plates: tuple[SessionPlate, ...]
    baseline: Errors
    extended: Errors
    causes: tuple[Cause, ...]
    not_testable: dict[str, str] = field(default_factory=dict)
    """Why, by effect."""


def wanted(include: Sequence[str], exclude: Sequence[str]) -> tuple[Effect, ...]:
    """The effects to try.

    Raises:
        ConfigError: one of the names is no effect.
    """
    out = {effect(name).name for name in exclude} | TIMED
    return tuple(effect(name) for name in (include or CATALOGUE) if name not in out)


def diagnose(
    watched: Sequence[Watched],
    heldout: Sequence[Watched],
    plates: tuple[SessionPlate, ...],
    effects: Sequence[Effect],
    inertia: InertialPrior,
    omega: float,
    whitening: Whitening,
    limit: int,
) -> Diagnosis:
    """Scan fit trials, then measure on held-out ones.

    Args:
        watched: fit trials.
        heldout: trials that nothing was fitted on.
        plates: of the session.
        effects: to try.
        inertia: prior of the inertial parameters.
        omega: weight of that prior in the inertial fit.
        whitening: of the inertial fit.
        limit: causes at most.
    """
    found = search(watched, effects, inertia, omega, whitening, limit)
    judge = _Judge(found, watched, heldout)
    everything = found.chosen
    causes = []
    for k, one in enumerate(everything):
        scan = next(r for r in found.rounds if r.rivals and _same(r.rivals[0].candidate, one))
        others = tuple(c for c in everything if c is not one)
        causes.append(_cause(found, k, scan, judge.gain(others, everything)))
    idle = _idle(found.design, watched, plates)
    return Diagnosis(plates, judge.errors(()), judge.errors(everything), tuple(causes), idle)


def _same(a: Candidate, b: Candidate) -> bool:
    return a.columns == b.columns


def _cause(found: Search, k: int, scan: Round, gain: dict[str, float]) -> Cause:
    one = found.chosen[k]
    weight = _weights(scan)
    best = next(r for r in scan.rivals if _same(r.candidate, one))
    grouped: dict[tuple[str, tuple[str, ...]], list[float]] = {}
    for rival, w in zip(scan.rivals, weight, strict=True):
        near = rival.score > best.score - ALIKE
        entry = grouped.setdefault((rival.candidate.effect.name, rival.candidate.place.where), [0.0, 0.0])
        entry[0] += w
        entry[1] = max(entry[1], float(near))
    own = grouped.pop((one.effect.name, one.place.where))
    rivals = sorted(((w, near, *key) for key, (w, near) in grouped.items()), reverse=True)
    twins = tuple(Alternative(name, where, w) for w, near, name, where in rivals if near)[:2]
    listed = tuple(Alternative(name, where, w) for w, near, name, where in rivals if w > 1e-3)[:RIVALS]
    values = {key: {"value": value, "sd": sd} for key, (value, sd) in estimate(found, k).items()}
    confidence = min(1.0, own[0] + sum(t.confidence for t in twins))
    return Cause(one.effect.name, one.place.where, one.place.when, values, confidence, listed, twins, gain)


def _weights(scan: Round) -> list[float]:
    """Posterior probabilities of all rivals and, implied, of none: families alike, places by their odds."""
    odds = {n: sum(r.candidate.place.odds for r in scan.rivals if r.candidate.effect.name == n) for n in scan.families}
    log = torch.tensor([r.weighed for r in scan.rivals], dtype=torch.float64)
    log -= torch.tensor([len(odds) * odds[r.candidate.effect.name] for r in scan.rivals], dtype=torch.float64).log()
    return torch.softmax(torch.cat([log, torch.zeros(1, dtype=torch.float64)]), 0)[:-1].tolist()


def _idle(design: Design, watched: Sequence[Watched], plates: Sequence[SessionPlate]) -> dict[str, str]:
    borne = {f.name for w in watched for k, f in enumerate(w.reading.frames) if bool(w.reading.wrench[:, k].any())}
    silent = [plate.frame.name for plate in plates if plate.frame.name not in borne]
    out = {name: "needs intervals, which are not searched yet" for name in sorted(TIMED)}
    if silent:
        out["plate_gain"] = f"not of {', '.join(silent)}: nobody steps there in a fit trial"
    return out


class _Judge:
    """Base and extended models, fitted to the fit trials, on the held-out ones."""

    def __init__(self, found: Search, watched: Sequence[Watched], heldout: Sequence[Watched]) -> None:
        self.found, self.heldout = found, heldout
        self.prior = found.prior
        own = zip(watched, found.design.extra, strict=True)
        self.sums = _summed(found, [spectra(w.rows, extra) for w, extra in own])
        self.extra = [extra_columns(w, found.design.all) for w in heldout]
        both = zip(heldout, self.extra, strict=True)
        self.more = _summed(found, [spectra(w.rows, extra) for w, extra in both]) if heldout else None

    def fitted(self, chosen: Sequence[Candidate]) -> Fitted:
        """To the fit trials."""
        return fit(self.sums, self.found.design.columns(chosen))

    def errors(self, chosen: Sequence[Candidate]) -> Errors:
        """Of the held-out trials."""
        theta, n = self._theta(chosen), self.found.design.inertia
        phi = theta[:n].reshape(-1, 10)
        left = [self._residual(w, extra, phi, theta[n:]) for w, extra in zip(self.heldout, self.extra, strict=True)]
        if not left:
            return Errors(float("nan"), float("nan"))
        both = torch.cat(left)
        return Errors(*(float(x.square().sum(1).mean().sqrt()) for x in (both[:, :3], both[:, 3:])))

    def gain(self, without: Sequence[Candidate], with_: Sequence[Candidate]) -> dict[str, float]:
        """Of the larger model over the smaller one."""
        before, after = self.errors(without), self.errors(with_)
        return {
            "heldout_log_likelihood": self._predictive(with_) - self._predictive(without),
            "force_rmse_pct": 100.0 * (1.0 - after.force_rmse_N / before.force_rmse_N),
            "moment_rmse_pct": 100.0 * (1.0 - after.moment_rmse_Nm / before.moment_rmse_Nm),
            "marker_rmse_pct": 0.0,
        }

    def _predictive(self, chosen: Sequence[Candidate]) -> float:
        """Log density of the held-out rows after the fit trials (chain rule), up to what all models share."""
        if self.more is None:
            return float("nan")
        columns = self.found.design.columns(chosen)
        both = self.sums[0] + self.more[0], self.sums[1] + self.more[1]
        return fit(both, columns).log_evidence - fit(self.sums, columns).log_evidence

    def _theta(self, chosen: Sequence[Candidate]) -> Float[Tensor, " all"]:
        found = self.fitted(chosen)
        z = torch.zeros_like(self.prior.mean)
        z[found.columns] = found.mean
        return self.prior.theta(z)

    def _residual(self, watched: Watched, extra: Tensor, phi: Tensor, theta: Tensor) -> Float[Tensor, "used 6"]:
        rows = watched.rows
        left = measured(rows) - predict(rows, phi) - torch.einsum("ipt,p->ti", extra, theta)
        return left[rows.used]


def _summed(found: Search, several: Sequence) -> tuple[Tensor, Tensor]:
    standard = [found.prior.standard(accumulate(own, found.whitening)) for own in several]
    gram, moment = standard[0]
    for g, m in standard[1:]:
        gram, moment = gram + g, moment + m
    return gram, moment


def verdict(diagnosis: Diagnosis) -> dict[str, object]:
    """Content of ``diagnosis.json``."""
    return {
        "baseline": {"heldout": diagnosis.baseline},
        "causes": [_listed(cause) for cause in diagnosis.causes],
        "extended": {"heldout": diagnosis.extended},
        "not_testable": [{"effect": name, "why": why} for name, why in diagnosis.not_testable.items()],
        "plates": {p.frame.name: {"channels": p.channels, "position_m": p.frame.p_WF} for p in diagnosis.plates},
    }


def _listed(cause: Cause) -> Mapping[str, object]:
    names = ("effect", "where", "when", "parameters", "confidence", "alternatives", "indistinguishable", "gain")
    return {name: getattr(cause, name) for name in names}
