"""Coverage of the torques' bands, and their error beside the scaled template's and beside that of torques of the motion
that obeys its forces, on simulated subjects.

    cd scripts && python -m benchmarks.torques [--subjects 10] [--seed 700] [--skin-mm 0] [--draws 48]

Of each subject the recordings alone are read; then the truth is opened. Plates of simulated subjects are in order, so
that no error of theirs is drawn. Torques are compared where contacts are measured. Writes ``out/torques.json``.
"""

import tempfile
import time

import torch
from harness.command import ROOT, Command
from harness.rows import figures, means, write_json
from harness.runs import each, simulated

from torchid.run.torque_bands import outcome_draws
from torchid.session import Outcome
from torchid.simulate.options import SimulateOptions
from torchid.simulate.session import SimulatedSession
from torchid.torque.draws import PlateErrors
from torchid.torque.inverse import Load, joint_torques

WITHIN = 1.959964
"""Standard deviations of a 95 % band."""


def true_torques(session: SimulatedSession, name: str) -> torch.Tensor:
    """Torques of the true body in its true motion on its true contacts."""
    subject, truth = session.subject, session.trial(name).truth
    loads = [Load(f"foot_{side}", truth.feet.wrench[:, k]) for k, side in enumerate("lr")]
    return joint_torques(subject.model.tree, subject.geometry, subject.phi, truth.motion, loads)


def compare(session: SimulatedSession, outcome: Outcome, draws: int, seed: int) -> dict[str, float]:
    """Coverage of the bands, and errors of the identified body and of the template in N m."""
    names = [n for n in outcome.session.trials if outcome.followed[n].wrench is not None and n != "static"]
    began = time.perf_counter()
    drawn = outcome_draws(outcome, names, draws, seed, PlateErrors(0.0, 0.0))
    seconds = time.perf_counter() - began
    found = {"seconds": seconds}
    inside, error, template, width, filtered, template_filtered, consistent = [], [], [], [], [], [], []
    for name in names:
        true, published, scaled = true_torques(session, name), outcome.torque[name], outcome.torque_scaled[name]
        used = outcome.followed[name].wrench.used
        if name not in outcome.consistent:
            continue
        kept = torch.isfinite(published) & torch.isfinite(scaled) & used[:, None]
        kept[:, :6] = False
        off, sd = published - true, drawn.sd(name)
        obeying = outcome.consistent[name].torque
        inside.append((off.abs() < WITHIN * sd)[kept])
        error.append(off[kept])
        template.append((scaled - true)[kept])
        alike = outcome.followed[name].motion.smoother(true)
        filtered.append((published - alike)[kept])
        consistent.append((obeying - alike)[kept])
        template_filtered.append((scaled - alike)[kept])
        width.append(sd[kept])
    rms = lambda parts: float(torch.cat(parts).square().mean().sqrt())  # noqa: E731
    off = outcome.phi[:, 0] - session.subject.phi[:, 0]
    covered = lambda sd: float((off.abs() < WITHIN * sd).double().mean())  # noqa: E731
    found["mass_coverage"] = covered((drawn.bodies.phi - outcome.phi).square().mean(0).sqrt()[:, 0])
    found["mass_coverage_stated"] = covered(outcome.identified.fit.sd.mass)
    return found | {
        "coverage": float(torch.cat(inside).double().mean()),
        "rmse_Nm": rms(error), "template_rmse_Nm": rms(template), "sd_Nm": rms(width),
        "rmse_filtered_Nm": rms(filtered), "template_rmse_filtered_Nm": rms(template_filtered),
        "consistent_rmse_filtered_Nm": rms(consistent),
    }  # fmt: skip


def main() -> None:
    """Print a row for each subject, then the means; who cannot walk in balance, or whose feet and plates are said to
    disagree, is left out."""
    wanted = Command(__doc__, subjects=10, seed=700, skin_mm=0.0, draws=48).asked()
    options = SimulateOptions(duration_s=6.0, skin_motion_mm=wanted.skin_mm)

    def row(seed: int) -> dict[str, float]:
        with tempfile.TemporaryDirectory() as folder:
            return compare(*simulated(options, seed, folder, "motion.consistent=true"), wanted.draws, seed)

    rows = list(each(range(wanted.seed, wanted.seed + wanted.subjects), row, skip=True))
    print("mean  " + figures(means(rows)))
    write_json(ROOT / "out" / "torques.json", {"subjects": rows, "mean": means(rows)})


if __name__ == "__main__":
    main()
