#!/usr/bin/env python
"""Fit a subject's inertia with the loop in sight: noise and parameters, each improved by the other.

    python scripts/fit_inertia.py --config configs/demo.yaml --iterations 4 --out out/train

Takes the geometry from geometry.snapshot in the same folder (scripts/fit_geometry.py), else fits it with the arrow.
Writes metrics.jsonl, inertia.snapshot and checkpoint_inertia.snapshot; the next call goes on from there.
"""

import json
from dataclasses import replace
from pathlib import Path

import torch
from harness.command import Command

from torchid.config import load_config
from torchid.dynamics.rows import residual_rms
from torchid.dynamics.whitening import accumulate, estimate_whitening, initial_whitening, spectra
from torchid.geometry.fit import fit_geometry
from torchid.geometry.result import GeometryFit
from torchid.geometry.tracking import track
from torchid.inertia.fit import fit_inertia
from torchid.inertia.identify import determined
from torchid.inertia.options import of_whitened_rows
from torchid.run.simulation import with_recordings
from torchid.session.following import Following, cutoff, follow
from torchid.session.opening import Session, read_session
from torchid.session.people import subject_prior
from torchid.session.unseen import hold_unseen
from torchid.storage.snapshot import from_bytes, to_bytes


def main(argv: list[str] | None = None) -> None:
    args = Command(
        __doc__, ("overrides",), config={"required": True}, iterations=4, out=Path("out/train"),
        overrides=({"nargs": "*"}, "key=value"),
    ).asked(argv)  # fmt: skip
    args.out.mkdir(parents=True, exist_ok=True)

    # 1. Follow every trial with the identified geometry; motion and forces pass the same filter.
    config = with_recordings(load_config(args.config, args.overrides), lambda stage, fraction: None)
    session = read_session(config)
    fit, limit = geometry(session, args.out / "geometry.snapshot", config), cutoff(config.motion, session)
    wrenches = {}
    for name, trial in session.trials.items():
        followed = follow(fit, trial, track(fit, trial.markers), Following.of(config, limit))
        if followed.wrench is not None:
            wrenches[name] = followed.wrench
    train = [wrenches[name] for name in session.fit("inertia") if name in wrenches]
    held = [wrenches[name] for name in session.role("heldout") if name in wrenches]

    # 2. Six rows a frame, base of the tree only: Y phi = F. In the frequency domain their noise is nearly independent.
    blocks = [block for trial in train for block in spectra(trial)]
    prior, names = subject_prior(config.model, config.subject, fit), fit.model.tree.names
    asked, prior = hold_unseen(config.inertia, prior, fit)
    options = replace(of_whitened_rows(asked), refuse=False)

    # 3. The loop: weigh the rows by the noise, solve for phi with every pseudo-inertia positive definite (Clarabel),
    # estimate the noise again from what is left.
    state = {"iteration": 0, "whitening": initial_whitening(prior.mean)}
    checkpoint = args.out / "checkpoint_inertia.snapshot"
    if checkpoint.exists():
        state = from_bytes(checkpoint.read_bytes())
    with (args.out / "metrics.jsonl").open("a") as metrics:
        for k in range(state["iteration"], args.iterations):
            found = fit_inertia(accumulate(blocks, state["whitening"]), prior, names, options)
            whitening = estimate_whitening(((b, found.phi.reshape(-1)) for b in blocks), determined(found))
            state = {"iteration": k + 1, "whitening": whitening, "fit": found}
            checkpoint.write_bytes(to_bytes(state))
            row = {"iteration": k + 1, "mass_kg": float(found.mass.sum()), "omega_2": found.omega_2}
            for role, trials in (("fit", train), ("heldout", held)):
                row |= dict(zip((f"{role}_force_N", f"{role}_moment_Nm"), residual_rms(trials, found.phi), strict=True))
            metrics.write(json.dumps(row) + "\n")
            print("  ".join(f"{key} {value:.4g}" for key, value in row.items()), flush=True)

    # 4. What the data decided, segment by segment.
    found = state["fit"]
    (args.out / "inertia.snapshot").write_bytes(to_bytes(found))
    for k, name in enumerate(names):
        sd, before = float(found.sd.phi[k, 0]), float(prior.mean[k, 0])
        share = float(found.progress.phi[k, 0])
        print(f"{name:14s} {float(found.mass[k]):7.3f} +- {sd:.3f} kg  tables {before:7.3f}  progress {share:.2f}")


def geometry(session: Session, path: Path, config) -> GeometryFit:
    """The geometry that was fitted before, or the arrow's."""
    if path.exists():
        return from_bytes(path.read_bytes())
    trials = {name: trial.markers for name, trial in session.fit("geometry").items()}
    static = None if session.static is None else session.static.markers
    given = session.assignment
    return fit_geometry(given.model, given.attachment, trials, static, config.geometry)


if __name__ == "__main__":
    torch.set_grad_enabled(False)
    main()
