"""Content of ``geometry.json`` and ``inertia.json``: the figures that files and report share."""

import math
from collections.abc import Iterable, Iterator
from typing import Any

import torch
from torch import Tensor

from torchid.conventions import INERTIAL_NAMES
from torchid.diagnosis.verdict.table import verdict_table
from torchid.dynamics.rows import residual_rms
from torchid.effects.catalogue import effect
from torchid.effects.kinds import AttachedLoad
from torchid.geometry.result import GeometryFit
from torchid.inertia.fit import InertiaFit
from torchid.model.model import InertialPrior
from torchid.session.outcome import Outcome, Quality

PIECE = 1 << 15
"""Frames whose errors are looked at together."""


def diagnosis_table(outcome: Outcome) -> dict[str, Any]:
    """Content of ``diagnosis.json``: the verdict, which model the other files hold, and held-out errors of both."""
    assert outcome.diagnosis is not None
    found = verdict_table(outcome.diagnosis)
    found["published"] = "base" if outcome.base is None else "extended"
    found["baseline"]["heldout"] = heldout_errors(outcome.base or outcome)
    found["extended"]["heldout"] = heldout_errors(outcome)
    before, after = (found[k]["heldout"]["marker_rmse_mm"] for k in ("baseline", "extended"))
    for cause in found["causes"]:
        seen = before > 0.0 and cause["applied"] and effect(cause["effect"]).moves_markers
        cause["gain"]["marker_rmse_pct"] = 100.0 * (1.0 - after / before) if seen else 0.0
    return found


def heldout_errors(outcome: Outcome) -> dict[str, float]:
    """Of forces and markers in the held-out trials; NaN where there are none."""
    names = outcome.session.part("heldout", "inertia")
    wrenches = [w for name in names if (w := outcome.followed[name].wrench) is not None]
    force, moment = residual_rms(wrenches, outcome.phi)
    errors = [outcome.followed[name].tracked.error for name in outcome.session.role("heldout")]
    return {"force_rmse_N": force, "moment_rmse_Nm": moment, "marker_rmse_mm": 1e3 * rms(*errors)}


def geometry_table(outcome: Outcome) -> dict[str, Any]:
    """Content of ``geometry.json``."""
    base = outcome.base
    return _geometry(outcome) | ({} if base is None or base.fit is outcome.fit else {"base": _geometry(base)})


def _geometry(outcome: Outcome) -> dict[str, Any]:
    fit, named = outcome.fit, len(outcome.fit.prior.mean)
    sd = torch.zeros_like(fit.xi) if fit.uncertainty is None else fit.uncertainty.sd
    directions = () if fit.uncertainty is None else fit.uncertainty.undetermined
    return {
        "xi": {
            name: {
                "value": fit.xi[k],
                "sd": sd[k],
                "unit": unit,
                "prior": fit.prior.mean[k],
                "prior_sd": fit.prior.sd[k],
            }
            for k, (name, unit) in enumerate(zip(fit.prior.names, fit.prior.units, strict=True))
        },
        "segments": segment_lengths(fit),
        "markers": {
            label: {
                "segment": fit.model.tree.names[int(fit.attachment.body[k])],
                "landmark": fit.attachment.landmark[k],
                "p_BM_B": fit.place[k],
                "sd": sd[named + 3 * k : named + 3 * k + 3],
                "sigma_mm": 1e3 * fit.sigma[k],
            }
            for k, label in enumerate(fit.attachment.labels)
        },
        "undetermined": directions,
        "skin_mm_per_rad": None if fit.uncertainty is None else 1e3 * fit.uncertainty.skin_m_rad,
        "marker_rmse_mm": {name: marker_errors(outcome, name) for name in outcome.session.trials},
        "solver": fit.options.solver,
        "converged": None if fit.solution is None else fit.solution.converged,
        "iterations": None if fit.solution is None else fit.solution.iterations,
        "warnings": [{"code": n.code, "message": n.message, "source": n.source} for n in outcome.notes],
    }


def segment_lengths(fit: GeometryFit) -> dict[str, dict[str, float]]:
    """Distance from each body's origin to the joint of its (first) child, with its standard deviation [m]."""
    tree, found = fit.model.tree, {}
    named = len(fit.prior.mean)
    for k, body in enumerate(tree.bodies):
        children = [j for j, b in enumerate(tree.bodies) if b.parent == k]
        if not children or k == 0:
            continue
        p = fit.geometry.offset[children[0]]
        length = p.norm()
        row = (p / length) @ fit.prior.map[3 * children[0] : 3 * children[0] + 3]
        covariance = torch.zeros(named, named, dtype=p.dtype)
        if fit.uncertainty is not None:
            covariance = fit.uncertainty.covariance[:named, :named]
        found[body.name] = {"length_m": float(length), "sd": math.sqrt(max(0.0, float(row @ covariance @ row)))}
    return found


def marker_errors(outcome: Outcome, name: str) -> dict[str, Any]:
    """RMS distances of a trial's physical markers before filtering [mm]."""
    error, scaled = outcome.followed[name].tracked.error, outcome.followed_scaled[name].tracked.error
    return {
        "role": outcome.session.trials[name].role,
        "identified": 1e3 * rms(error),
        "scaled": 1e3 * rms(scaled),
        "max": 1e3 * largest(error),
        "markers": {label: 1e3 * rms(error[:, k]) for k, label in enumerate(outcome.fit.attachment.labels)},
    }


def rms(*parts: Tensor) -> float:
    """Root mean square of what is finite in all parts, NaN where nothing is."""
    total, count = 0.0, 0
    for piece in _pieces(parts):
        known = piece[torch.isfinite(piece)]
        total, count = total + float(known.square().sum()), count + len(known)
    return math.sqrt(total / count) if count else math.nan


def largest(*parts: Tensor) -> float:
    """Largest of what is not NaN in all parts of distances, 0 where nothing is known."""
    return max((float(piece.nan_to_num(0.0).max()) for piece in _pieces(parts)), default=0.0)


def _pieces(parts: Iterable[Tensor]) -> Iterator[Tensor]:
    """A copy of an hour's errors has no room beside the errors."""
    return (piece for part in parts for piece in part.split(PIECE) if piece.numel())


def inertia_table(outcome: Outcome) -> dict[str, Any]:
    """Content of ``inertia.json``."""
    base = {} if outcome.base is None else {"base": identified_table(outcome.base)}
    return {
        **({} if outcome.quality is None else {"quality": quality_table(outcome.quality)}),
        **identified_table(outcome),
        "attachments": attachments(outcome),
        "residuals": outcome.residuals,
        "trials": {name: _trial_residual(outcome, name) for name in outcome.session.trials},
        **base,
    }


def quality_table(quality: Quality) -> dict[str, Any]:
    """Verdict of a run, the number that decides, and every figure beside its norm."""
    deciding = quality.deciding
    return {
        "level": quality.level.value,
        "line": quality.line,
        "deciding": None if deciding is None else deciding.name,
        "criteria": quality.criteria,
    }


def attachments(outcome: Outcome) -> list[dict[str, Any]]:
    """What the diagnosis found on segments; their own parameters are without it."""
    causes = () if outcome.diagnosis is None else outcome.diagnosis.causes
    keys = ("effect", "where", "when", "parameters")
    attached = [cause for cause in causes if cause.applied and isinstance(effect(cause.effect), AttachedLoad)]
    return [{key: getattr(cause, key) for key in keys} for cause in attached]


def identified_table(outcome: Outcome) -> dict[str, Any]:
    """What ``inertia.json`` says of the body; residuals, which take a pass over all frames, are left out."""
    assert outcome.identified is not None
    identified = outcome.identified
    fit = identified.fit
    total = torch.zeros(10 * len(fit.names), dtype=fit.phi.dtype)
    total[::10] = 1.0
    return {
        "segments": segments_table(fit, outcome.prior),
        "total_mass": {
            "value_kg": fit.mass.sum(),
            "sd_kg": (total @ fit.covariance @ total).sqrt(),
            "progress": fit.progress.total_mass,
            "recorded_kg": outcome.config.subject.mass_kg,
        },
        "rank": fit.rank,
        "base_parameters": None
        if fit.base is None
        else [
            {"name": name, "value": value, "sd": sd}
            for name, value, sd in zip(fit.base.names, fit.base.value.tolist(), fit.base.sd.tolist(), strict=True)
        ],
        "weights": {"omega_1": fit.omega_1, "omega_2": fit.omega_2, "rows": identified.rows},
        "cutoff_hz": outcome.cutoff_hz,
        "status": fit.status.value,
        "certificate": fit.certificate,
    }


def segments_table(fit: InertiaFit, prior: InertialPrior) -> dict[str, dict[str, Any]]:
    """What ``inertia.json`` says of every segment.

    Args:
        fit: identified parameters.
        prior: what was known of them before.
    """
    phi_sd, sd = fit.sd.phi, fit.sd
    return {
        name: {
            "mass_kg": fit.mass[k],
            "com_m": fit.com[k],
            "inertia_kgm2": fit.inertia_com[k],
            "sd": {"mass_kg": phi_sd[k, 0], "com_m": sd.com[k], "inertia_kgm2": sd.inertia_com[k]},
            "progress": fit.progress.segment[k],
            "progress_mass": fit.progress.phi[k, 0],
            "progress_parameters": dict(zip(INERTIAL_NAMES, fit.progress.phi[k].tolist(), strict=True)),
            "prior": {"mass_kg": prior.mean[k, 0], "sd_kg": prior.covariance[10 * k, 10 * k].sqrt()},
        }
        for k, name in enumerate(fit.names)
    }


def _trial_residual(outcome: Outcome, name: str) -> dict[str, Any] | None:
    item = outcome.followed[name]
    if item.wrench is None or item.contact is None:
        return None
    force, moment = residual_rms([item.wrench], outcome.phi)
    return {
        "role": outcome.session.trials[name].role,
        "force_rmse_N": force,
        "moment_rmse_Nm": moment,
        "used": int(item.contact.used.sum()),
        "frames": len(item.contact.used),
        "beside_plates": item.contact.excluded,
        "unmeasured_contacts": int(item.contact.unmeasured.sum()),
    }
