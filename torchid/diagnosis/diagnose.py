"""From a search to a verdict: what is kept of it, how sure, and what it gains on motion that was not used."""

import math
from collections.abc import Sequence
from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.diagnosis.anew import eliminated
from torchid.diagnosis.candidates import trial_columns
from torchid.diagnosis.design import Candidate, Columns
from torchid.diagnosis.doubtful import relevant, without_opposed
from torchid.diagnosis.evidence import Fitted, fit
from torchid.diagnosis.found import ALIKE, Round, Search, estimate, internal
from torchid.diagnosis.late import linearised
from torchid.diagnosis.noise import rows_of, summed
from torchid.diagnosis.plates import SessionPlate
from torchid.diagnosis.search import residual, residuals, search
from torchid.diagnosis.unexplained import structure
from torchid.diagnosis.verdict import RIVALS, Alternative, Cause, Diagnosis, Errors, Near
from torchid.diagnosis.watched import Watched
from torchid.effects.catalogue import CATALOGUE, effect
from torchid.effects.effect import Effect
from torchid.geometry.fitted import GeometryFit
from torchid.model.model import InertialPrior
from torchid.regressor.whitening import Whitening


def wanted(include: Sequence[str], exclude: Sequence[str]) -> tuple[Effect, ...]:
    """The effects to try.

    Raises:
        ConfigError: one of the names is no effect.
    """
    out = {effect(name).name for name in exclude}
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
    geometry: GeometryFit | None = None,
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
        geometry: with which the trials were followed.
    """
    found = search(watched, effects, inertia, omega, whitening, limit, geometry)
    rest = structure(watched, residuals(watched, found.design, found.prior, found.fitted))
    if rest.significant:
        found = relevant(without_opposed(found), watched)
    judge, everything, causes = _Judge(found, heldout), found.chosen, []
    extended = judge(everything)
    for k, one in enumerate(everything):
        scan = next(r for r in found.rounds if r.rivals and _same(r.rivals[0].candidate, one))
        others = tuple(c for c in everything if c is not one)
        names = [w.rows.name for w in watched]
        causes.append(_cause(found, k, scan, _gain(judge(others), extended), names))
    if rest.significant:
        # A model that the data visibly contradict is sure of nothing that the contradicted forces told.
        trust = 1.0 - 0.5 * rest.share_of_residual
        causes = [c if _seen(c) else replace(c, confidence=trust * c.confidence) for c in causes]
    # What a laboratory did to forces is read first, and what markers and bodies are like after it.
    causes.sort(key=lambda c: effect(c.effect).kinematic or effect(c.effect).bodily)
    idle, near = _idle(watched, plates), _nearest(found.rounds[-1])
    return Diagnosis(plates, judge(())[0], extended[0], tuple(causes), rest, idle, near)


def _nearest(scan: Round) -> tuple[Near, ...]:
    """Of the last scan, which named nothing."""
    best = sorted(scan.families.items(), key=lambda both: -both[1])[:RIVALS]
    first = {name: next(r.candidate for r in scan.rivals if r.candidate.effect.name == name) for name, _ in best}
    return tuple(Near(name, first[name].place.where, score) for name, score in best)


def _seen(cause: Cause) -> bool:
    """What bodies do and cameras see: no contradicted force had to tell it."""
    own = effect(cause.effect)
    return own.bodily and own.kinematic


def _same(scanned: Candidate, one: Candidate) -> bool:
    return scanned.place is (one.proposed or one.place)


def _cause(found: Search, k: int, scan: Round, gain: dict[str, float], names: Sequence[str]) -> Cause:
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
    acting = tuple(names[j] for j in sorted(one.trials))
    return Cause(
        one.effect.name, one.place.where, one.place.when, values, confidence, listed, twins, gain,
        one.place, internal(found, k).view(len(one.blocks), -1), acting, len(acting) == len(names),
    )  # fmt: skip


def _weights(scan: Round) -> list[float]:
    """Posterior probabilities of all rivals and, implied, of none: families alike, places by their odds."""
    log = torch.tensor([r.weighed for r in scan.rivals], dtype=torch.float64) - math.log(len(scan.families))
    return torch.softmax(torch.cat([log, torch.zeros(1, dtype=torch.float64)]), 0)[:-1].tolist()


def _idle(watched: Sequence[Watched], plates: Sequence[SessionPlate]) -> dict[str, str]:
    borne = {
        f.name for w in watched for k, f in enumerate(w.view.reading.frames) if bool(w.view.reading.wrench[:, k].any())
    }
    silent = [plate.frame.name for plate in plates if plate.frame.name not in borne]
    out = {}
    if silent:
        out["plate_gain"] = f"not of {', '.join(silent)}: nobody steps there in a fit trial"
    return out


class _Judge:
    """Base and extended models, fitted to the fit trials, on the held-out ones."""

    def __init__(self, found: Search, heldout: Sequence[Watched]) -> None:
        self.found, self.heldout = found, heldout
        self.columns = [trial_columns(w, found.design.sources) for w in heldout]
        if any(one.effect.late for one in found.chosen):
            self.columns = self._settled()
        rows = [rows_of(w, c, found.design.late) for w, c in zip(heldout, self.columns, strict=True)]
        more = summed(rows, found.prior, found.design, found.noise.typical(len(heldout)))
        self.both = replace(found.sums, trials=(*found.sums.trials, *more.trials))

    def __call__(self, chosen: Sequence[Candidate]) -> tuple[Errors, float]:
        """Held-out residual, and log density of the held-out rows after the fit trials but for what models share."""
        chosen, first = self._everywhere(chosen), len(self.found.sums.trials)
        (sums, some), (whole, _) = (eliminated(x, chosen) for x in (self.found.sums, self.both))
        fitted = fit(sums, some)
        both = enumerate(zip(self.heldout, self.columns, strict=True), first)
        left = [(residual(w, c, self.found.prior, fitted, k) + self._untrusted(w, c, fitted, k))[w.rows.used]
                for k, (w, c) in both]  # fmt: skip
        if not left:
            return Errors(float("nan"), float("nan")), float("nan")
        both = torch.cat(left)
        errors = Errors(*(float(x.square().sum(1).mean().sqrt()) for x in (both[:, :3], both[:, 3:])))
        return errors, fit(whole, some).log_evidence + whole.constant - fitted.log_evidence - sums.constant

    def _untrusted(self, watched: Watched, columns: Columns, fitted: Fitted, trial: int) -> Float[Tensor, "frames 6"]:
        """What chosen effects take off and nobody believes (``Effect.trusted``)."""
        found, n = torch.zeros_like(watched.rows.wrench), self.found.design.inertia
        for one, share in zip(fitted.chosen, fitted.shares(len(self.found.prior.mean), trial), strict=True):
            theta = self.found.prior.scale * share[n:]
            added = torch.einsum("ipt,p->ti", columns.extra, theta[columns.terms.live[n:] - n])
            found += added - one.effect.trusted(added, watched.rows.rate, one.place, theta[one.columns - n])
        return found

    def _settled(self) -> list[Columns]:
        """Columns with those of late effects where the fit trials found them."""
        found, first = self.found, len(self.found.sums.trials)
        fitted, n = fit(found.sums, self._everywhere(found.chosen)), found.design.inertia
        theta = [found.prior.theta(fitted.z(len(found.prior.mean), first + k))[n:] for k in range(len(self.heldout))]
        trials = zip(self.heldout, self.columns, theta, strict=True)
        return [linearised(w, c, found.design.sources, x) for w, c, x in trials]

    def _everywhere(self, chosen: Sequence[Candidate]) -> list[Candidate]:
        """What acts in all fit trials acts in the held-out ones too."""
        whole = frozenset(range(len(self.found.sums.trials) + len(self.heldout)))
        return [replace(c, trials=whole) if c.trials == self.found.sums.all else c for c in chosen]


def _gain(before: tuple[Errors, float], after: tuple[Errors, float]) -> dict[str, float]:
    """Of the larger model over the smaller one."""
    (less, low), (more, high) = before, after
    return {
        "heldout_log_likelihood": high - low,
        "force_rmse_pct": 100.0 * (1.0 - more.force_rmse_N / less.force_rmse_N),
        "moment_rmse_pct": 100.0 * (1.0 - more.moment_rmse_Nm / less.moment_rmse_Nm),
    }
