"""Recovery of simulated subjects: simulate, write files, identify from the files alone, and only then open the truth.

    python scripts/recovery.py --seeds 10 --first 100 --out out/recovery

Prints a row per seed and the figures over all of them; writes recovery.json.
"""

from dataclasses import replace
from pathlib import Path

import torch
from harness.command import Command
from harness.pool import alone
from harness.rows import means, write_json
from harness.runs import each, simulated

from torchid.dynamics.rows import predict, residual_rms
from torchid.geometry.result import GeometryFit
from torchid.geometry.tracking import track
from torchid.kinematics.chain import chain_poses
from torchid.model.pseudo import params_to_pseudo, pseudo_to_params
from torchid.session import Outcome
from torchid.session.following import Following, follow
from torchid.simulate.options import SimulateOptions
from torchid.simulate.session import SimulatedSession


def main() -> None:
    asked = Command(
        __doc__, seeds=10, first=0, duration=10.0, skin=(0.0, "skin motion [mm]"), out=Path("out/recovery")
    ).asked()
    options = SimulateOptions(duration_s=asked.duration, skin_motion_mm=asked.skin)
    alone()

    def row(seed: int) -> dict[str, float]:
        session, outcome = simulated(options, seed, asked.out / f"seed_{seed}")
        return score(outcome, session)

    rows = list(each(range(asked.first, asked.first + asked.seeds), row))
    print(summary := means(rows))
    write_json(asked.out / "recovery.json", {"rows": rows, "mean": summary})


def score(outcome: Outcome, session: SimulatedSession) -> dict[str, float]:
    """Everything that is compared with the truth of one subject."""
    assert outcome.identified is not None
    subject, fit = session.subject, outcome.identified.fit
    truth = true_phi(outcome, session)
    assert fit.base is not None
    held = [f.wrench for n, f in outcome.followed.items() if session.trial(n).trial.role == "heldout" and f.wrench]
    force, _ = residual_rms(held, fit.phi)
    floor, _ = residual_rms(perfect(outcome, session), subject.phi)
    base, base_prior = (fit.base.project(phi) - fit.base.project(truth) for phi in (fit.phi, outcome.prior.mean))
    base_error = base.abs()
    xi_error = (outcome.fit.xi[: len(outcome.fit.prior.mean)] - subject.xi).abs()
    trunk = [outcome.fit.model.tree.index(name) for name in ("pelvis", "abdomen", "thorax")]
    total = torch.zeros_like(fit.phi)
    total[trunk, 0] = 1.0
    return {
        "marker_mm": 1e3 * max(f.tracked.rmse for f in outcome.followed.values()),
        "joint_mm": joint_error(outcome, session, scaled=False),
        "joint_scaled_mm": joint_error(outcome, session, scaled=True),
        "force_N": force,
        "floor_N": floor,
        "force_ratio": force / floor,
        "base_ratio": float(base.norm() / base_prior.norm()),
        "base_wrench_ratio": wrench_ratio(outcome, truth),
        "base_mahalanobis": fit.base.distance(fit.phi, truth, outcome.prior.covariance),
        "base_mahalanobis_prior": fit.base.distance(outcome.prior.mean, truth, outcome.prior.covariance),
        "xi_covered": float((xi_error <= 1.96 * outcome.fit.uncertainty.sd[: len(xi_error)]).double().mean()),
        "base_covered": float((base_error <= 1.96 * fit.base.sd).double().mean()),
        "progress_thigh": float(fit.progress.phi[[outcome.fit.model.tree.index(f"thigh_{s}") for s in "lr"], 0].min()),
        "progress_trunk": group_progress(outcome, total.reshape(-1)),
        "omega_1": fit.omega_1,
        "omega_2": fit.omega_2,
    }


def wrench_ratio(outcome: Outcome, truth: torch.Tensor) -> float:
    """Wrench that the error of phi makes in the fit trials over the wrench that the prior's error makes."""
    trials = [f.wrench for n, f in outcome.followed.items() if f.wrench and n in outcome.session.fit("inertia")]
    wrong = [torch.cat([predict(t, phi - truth)[t.used] for t in trials]) for phi in (outcome.phi, outcome.prior.mean)]
    return float(wrong[0].norm() / wrong[1].norm())


def group_progress(outcome: Outcome, row: torch.Tensor) -> float:
    """Share of the prior variance of a combination of parameters that the motion removed."""
    fit = outcome.identified.fit
    return 1.0 - float((row @ fit.covariance @ row) / (row @ outcome.prior.covariance @ row / fit.omega_2))


def joint_error(outcome: Outcome, session: SimulatedSession, scaled: bool) -> float:
    """RMS distance of joint centres from the true ones over held-out frames [mm]."""
    source, fit = (outcome.followed_scaled, outcome.scaled) if scaled else (outcome.followed, outcome.fit)
    parts = []
    for item in session.trials:
        if item.trial.role != "heldout":
            continue
        tree, subject = session.subject.model.tree, session.subject
        true = chain_poses(tree, item.truth.motion.q, subject.geometry)[..., :3, 3]
        mine = chain_poses(fit.model.tree, source[item.trial.name].tracked.q, fit.geometry)[..., :3, 3]
        parts.append((mine - true).square().sum(-1).reshape(-1))
    return 1e3 * float(torch.cat(parts).mean().sqrt())


def true_phi(outcome: Outcome, session: SimulatedSession) -> torch.Tensor:
    """The true inertia about the identified origins, in identified axes (mean relative pose over the fit trials)."""
    relative = []
    for item in session.trials:
        if item.trial.role == "fit":
            tree, fit = session.subject.model.tree, outcome.fit
            X_true = chain_poses(tree, item.truth.motion.q[::10], session.subject.geometry)
            X_mine = chain_poses(fit.model.tree, outcome.followed[item.trial.name].tracked.q[::10], fit.geometry)
            relative.append(torch.linalg.inv(X_mine) @ X_true)
    X = torch.cat(relative).mean(0)
    U, _, Vh = torch.linalg.svd(X[:, :3, :3])
    X[:, :3, :3] = U @ Vh
    return pseudo_to_params(X @ params_to_pseudo(session.subject.phi) @ X.mT)


def perfect(outcome: Outcome, session: SimulatedSession) -> list:
    """Held-out wrench trials followed with the true geometry and marker places: what noise alone leaves."""
    subject = session.subject
    order = [subject.labels.index(label) for label in outcome.fit.attachment.labels]
    prior = replace(outcome.fit.prior, mean=subject.xi)
    known: GeometryFit = replace(
        outcome.fit, prior=prior, xi=torch.cat([subject.xi, subject.p_BM_B[order].reshape(-1)]), model=subject.model
    )
    found = []
    for item in session.trials:
        if item.trial.role == "heldout":
            trial = outcome.session.trials[item.trial.name]
            followed = follow(
                known, trial, track(known, trial.markers), Following.of(outcome.config, outcome.cutoff_hz)
            )
            if followed.wrench is not None:
                used = outcome.followed[item.trial.name].wrench.used
                found.append(replace(followed.wrench, used=used))
    return found


if __name__ == "__main__":
    main()
