"""What a verdict gains on held-out motion, against what one would gain who knew what is hidden.

    python -m batteries.gain out/battery/single-medium-drag-7

takes up finished runs of ``scripts/battery --keep``. Whoever knows all is the extension itself, given the truth instead
of the verdict: recordings corrected, everything fitted again. Models are compared by the density of the held-out
residuals of forces and markers under one noise: that which perfect knowledge leaves.
"""

import json
import shutil
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import torch
from harness.command import Command
from torch import Tensor

from torchid.config import load_config
from torchid.diagnosis.verdict.records import Cause
from torchid.dynamics.rows import WrenchTrial
from torchid.dynamics.whitening import BlockSpectrum, Whitening, accumulate, estimate_whitening, spectra
from torchid.effects.catalogue import effect
from torchid.effects.place import Angle, Interval, Place
from torchid.extension.correction import extend_outcome
from torchid.run import run_experiment
from torchid.session import Outcome
from torchid.storage.results import OutputFolder

UNTOLD = ("moving_ground", "missing_dof", "unmeasured_contact")
"""Effects with a course in time that no parameter tells: nobody can know them by their parameters."""
COARSE_HZ = 5.0
"""Distances of markers this far apart are taken for independent."""


def heldout_gains(outcome: Outcome, truth: Sequence[dict], scratch: Path) -> tuple[float, float] | None:
    """Nats that the verdict gains, and that the truth would; None where the truth is more than parameters tell. Fits of
    the second stay in ``scratch``."""
    if any(_untold(one) for one in truth):
        return None
    base = outcome if outcome.base is None else outcome.base
    assert base.diagnosis is not None
    causes = tuple(_known(base, one) for one in truth)
    perfect = replace(base, diagnosis=replace(base.diagnosis, causes=causes))
    # Stages of another day were made by other code.
    shutil.rmtree(scratch, ignore_errors=True)
    with OutputFolder(scratch) as folder:
        perfect = extend_outcome(perfect, perfect, folder, json.dumps(truth), lambda stage, fraction: None)
        noise, scatter = _noise(perfect)
        whole, some, none = (_density(one, noise, scatter) for one in (perfect, outcome, base))
    return some - none, whole - none


def _untold(one: dict) -> bool:
    return one["effect"] in UNTOLD or one["effect"].startswith("offcat_")


def _known(base: Outcome, truth: dict) -> Cause:
    """The truth as a cause that nobody doubts."""
    own, parameters, names = effect(truth["effect"]), dict(truth["parameters"]), tuple(base.session.trials)
    when = None if truth["when"] is None else tuple(Interval(**one) for one in truth["when"])
    grid = {key: parameters.pop(key) for key in ("frequency_hz", "damping_ratio") if own.name == "wobbling_mass"}
    place = Place(tuple(truth["where"]), when, grid=grid)
    if own.name == "soft_tissue":
        place = replace(place, follows=_angle(parameters.pop("joint")), markers=tuple(parameters["shift_90_m"]))
    if "point_seg_m" in parameters:
        place = replace(place, point=tuple(parameters["point_seg_m"]))
    plain = {key: list(value.values()) if isinstance(value, dict) else value for key, value in parameters.items()}
    values = {key: torch.as_tensor(value, dtype=torch.float64) for key, value in plain.items()}
    theta = own.internal(place, values)[None]
    if own.name == "joint_centre_shift":
        # MuJoCo's centres go with one minus cosine, of which ``internal`` knows nothing.
        place, theta = replace(place, follows=_angle(f"{truth['where'][0]}_flexion")), theta.roll(3)
    trials = names if when is None else tuple(one.trial for one in when)
    told = {key: {"value": value, "sd": torch.full_like(value, 1e-3)} for key, value in values.items()}
    return Cause(own.name, place.where, when, told, 1.0, (), (), {}, place, theta, trials, when is None)


def _angle(flexion: str) -> Angle:
    """MuJoCo's arms are lifted sideways before they turn about themselves."""
    joint = flexion.removesuffix("_flexion")
    return Angle(flexion, f"{joint}_adduction" if joint.startswith("shoulder") else None)


def _rows(outcome: Outcome) -> list[WrenchTrial]:
    found = [outcome.followed[name].wrench for name in outcome.session.part("heldout", "inertia")]
    return [rows for rows in found if rows is not None]


def _left(outcome: Outcome) -> list[BlockSpectrum]:
    phi = outcome.phi.reshape(-1)
    return [
        BlockSpectrum(block.Y[:, :0], block.F - torch.einsum("ipk,p->ik", block.Y, phi), block.frequency)
        for rows in _rows(outcome)
        for block in spectra(rows)
    ]


def _errors(outcome: Outcome) -> Tensor:
    """Distances of held-out markers, coarse in time."""
    found = []
    for name in outcome.session.part("heldout", "geometry"):
        tracked = outcome.followed[name].tracked
        found.append(tracked.error[:: max(1, round(1.0 / COARSE_HZ / float(tracked.time[1] - tracked.time[0])))])
    return torch.cat(found)


def _noise(outcome: Outcome) -> tuple[Whitening, Tensor]:
    """Of forces, and of each marker along one axis."""
    nothing = outcome.phi.new_zeros(0)
    forces = estimate_whitening([(block, nothing) for block in _left(outcome)], 0.0)
    return forces, (_errors(outcome).square().nanmean(0) / 3.0).sqrt()


def _density(outcome: Outcome, noise: Whitening, scatter: Tensor) -> float:
    forces = accumulate(_left(outcome), noise).square
    return -0.5 * (float(forces) + float((_errors(outcome) / scatter).square().nansum()))


def main() -> None:
    """A line for each folder."""
    for folder in Command(__doc__, ("folders",), folders={"nargs": "+", "type": Path}).asked().folders:
        outcome = run_experiment(load_config(folder / "config.yaml"))
        truth = json.loads((folder / "truth" / "truth.json").read_text())["effects"]
        found = heldout_gains(outcome, truth, folder / "perfect")
        said = "course in time" if found is None else f"reached {found[0]:9.1f} of {found[1]:9.1f} nats"
        print(f"{folder.name:50s} {said}", flush=True)


if __name__ == "__main__":
    main()
