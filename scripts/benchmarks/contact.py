"""Shared and predicted contact on real walks: ``python -m benchmarks.contact [RECORDING ...]``.

Two plates are merged by arithmetic, so that what each bore is known. Tuned on the first group of recordings only; the
second group was set aside before anything was fitted to walks.

``--synthetic`` needs no data: it holds the batched solver against Clarabel and measures its throughput, on the CPU and
on ``--device``.
"""

import json
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import torch
from harness.command import ROOT, Command, said_seed
from harness.pool import alone
from harness.rows import write_json
from harness.runs import ran
from planted_faults.real_sessions import of_child
from sharing_by_clarabel import share_by_clarabel
from torch import Tensor

from benchmarks.contact_baselines import lever_rule, smooth_transition
from benchmarks.contact_measures import Errors, Split, errors, forward_axis, handovers, merged, table, truth_of
from benchmarks.sharing_problem import moved, random_problem
from torchid.contact.sharing.solver import share
from torchid.conventions import GRAVITY
from torchid.session import Outcome
from torchid.session.contact_wrenches import body_needs, wrenches_under
from torchid.session.following import Following, follow, soles

TUNED = ("opencap_subject4", "schreiber_moissenet_2014001", "opensim_subject01_gait2354")
RUNNING = ("hamner2013_subject04",)
"""No double support: for the case without plates only."""
ASIDE = ("biomechzoo_hc030a", "biomechzoo_hc040a", "opensim_rajagopal_walk")
CHILDREN = {f"biomechzoo_{code.lower()}": code for code in ("HC031A", "HC033A", "HC038A", "HC044A")}
"""Children without a config of their own."""


def walks(outcome: Outcome) -> Iterator[str]:
    """Names of the trials in which somebody goes."""
    for name, trial in outcome.session.trials.items():
        if trial.forces is not None and name.startswith(("walk", "run", "turn")):
            yield name


def merged_plates(outcome: Outcome, name: str) -> tuple[dict[str, Errors], dict[str, float]] | None:
    """Errors of the three ways to split one walk's double supports, and the cost of the first."""
    one, trial, fit = outcome.followed[name], outcome.session.trials[name], outcome.fit
    assert trial.forces is not None and one.contact is not None
    raw = truth_of(one.contact, trial.forces)
    loaded = handovers(raw, one.contact)
    if not bool(loaded.any()):
        return None
    both = replace(trial, forces=merged(trial.forces))
    followed = follow(fit, both, one.tracked, Following.of(outcome.config, outcome.cutoff_hz))
    start = time.process_time()
    found = wrenches_under(followed, fit, outcome.phi, both, outcome.config.contact)
    seconds = time.process_time() - start
    assert found is not None and both.forces is not None and followed.contact is not None
    smoother, weight = one.motion.smoother, float(outcome.phi[:, 0].sum()) * GRAVITY
    outline = list(soles(fit, one.tracked).values())
    total, height = torch.nan_to_num(both.forces.total), _height(both.forces)
    com, _ = body_needs(fit.model.tree, fit.geometry, one.motion, outcome.phi)
    lever, smooth = raw.clone(), raw.clone()
    lever[loaded] = lever_rule((outline[0][loaded], outline[1][loaded]), total[loaded], height)
    _transitions(smooth, loaded, total, com, outline)
    truth, axis = smoother(raw), forward_axis(outline)
    splits = {"shared": found.wrench, "lever rule": smoother(lever), "smooth transition": smoother(smooth)}
    # What an unloaded plate reads is nobody's, and a filter carries it over.
    borne = torch.where((followed.contact.plate[:, :1] != -1), total, 0.0)
    split = Split(truth, smoother(borne), loaded, axis, weight, height)
    report = {way: errors(split, wrench) for way, wrench in splits.items()}
    known = (found.source[loaded] == 1).all(dim=1)
    z = ((found.wrench - truth) / found.sd)[loaded][known][..., 2]
    z = z[torch.isfinite(z)]
    return report, {
        "frames": len(total), "seconds": seconds, "double": int(loaded.sum()), "shared": int(known.sum()),
        "inside_95": float((z.abs() < 1.96).sum()), "judged": len(z),
    }  # fmt: skip


def _height(forces) -> float:
    corners = [float(p.corners[:, 2].mean()) for p in forces.plates if p.corners is not None]
    return sum(corners) / len(corners) if corners else 0.0


def _transitions(out: Tensor, loaded: Tensor, total: Tensor, com: Tensor, outline: list[Tensor]) -> None:
    """Fill in smooth transitions, in place, their strikes and toe-offs taken from the plates."""
    edges = torch.diff(torch.nn.functional.pad(loaded.long(), (1, 1)))
    for a, b in zip((edges == 1).nonzero()[:, 0].tolist(), (edges == -1).nonzero()[:, 0].tolist(), strict=True):
        way = forward_axis(outline)
        ahead = ((outline[1] - outline[0])[a:b, :, :2].mean((0, 1)) * way).sum()
        order = [0, 1] if ahead > 0 else [1, 0]
        out[a:b, order] = smooth_transition(total[a:b], com[a:b], way)


def no_plates(outcome: Outcome, name: str) -> dict[str, Errors]:
    """Errors of what is predicted without any plate, by the identified inertia and by the template's."""
    one, trial, fit = outcome.followed[name], outcome.session.trials[name], outcome.fit
    assert trial.forces is not None and one.contact is not None
    blind = replace(trial, forces=None)
    options = replace(outcome.config.contact, torques="predicted")
    followed = replace(one, contact=None, wrench=None)
    truth = one.motion.smoother(truth_of(one.contact, trial.forces))
    outline = list(soles(fit, one.tracked).values())
    weight = float(outcome.phi[:, 0].sum()) * GRAVITY
    split = Split(truth, truth.sum(1), one.contact.used, forward_axis(outline), weight, _height(trial.forces))
    found = {}
    for kind, phi in (("identified inertia", outcome.phi), ("tabulated inertia", outcome.prior.mean)):
        under = wrenches_under(followed, fit, phi, blind, options)
        assert under is not None
        found[kind] = errors(split, under.wrench)
    return found


def real(names: list[str]) -> dict:
    """Both tables of every recording."""
    report: dict = {"merged": {}, "no plates": {}, "cost": {}}
    for name in names:
        with TemporaryDirectory() as folder:
            outcome = ran(_config(name, Path(folder)), f"{folder}/out")
            for walk in walks(outcome):
                key = f"{name}/{walk}"
                both = merged_plates(outcome, walk)
                if both is not None:
                    report["merged"][key], report["cost"][key] = {w: vars(e) for w, e in both[0].items()}, both[1]
                report["no plates"][key] = {kind: vars(e) for kind, e in no_plates(outcome, walk).items()}
    return report


def _config(name: str, folder: Path) -> Path:
    """The recording's config; of other children, one like it."""
    if name not in CHILDREN:
        return ROOT / "configs" / f"{name}.yaml"
    names = (("static", "static"), ("walk_straight", "fit"), ("walk_turn", "fit"))
    made = of_child(CHILDREN[name], names, "${TORCHID_DATA}", model="whole_body", seed=0)
    path = folder / f"{name}.json"
    path.write_text(json.dumps(made))
    return path


def synthetic(device: str, frames: int, seed: int) -> dict:
    """The solver against Clarabel, one device against the other, and frames per second of each."""
    few, _ = random_problem(20, seed)
    reference, own = share_by_clarabel(few), share(few)
    found = {"against_clarabel_N": float((own.wrench - reference)[..., :3].abs().max())}
    many, truth = random_problem(frames, seed + 1)
    solutions = {}
    for place in dict.fromkeys(("cpu", device)):
        here = moved(many, place)
        share(here)
        if place != "cpu":
            torch.cuda.synchronize()
        start, busy = time.perf_counter(), time.process_time()
        solutions[place] = share(here)
        if place != "cpu":
            torch.cuda.synchronize()
        found[f"{place}_frames_per_s"] = frames / (time.perf_counter() - start)
        if place == "cpu":
            found["cpu_frames_per_core_s"] = frames / (time.process_time() - busy)
        found[f"{place}_iterations"] = solutions[place].iterations
        sums = (solutions[place].wrench.sum(1) - here.total[:, 0]).abs().max()
        found[f"{place}_sums_N"] = float(sums)
    found["devices_apart_N"] = float((solutions["cpu"].wrench - solutions[device].wrench.cpu())[..., :3].abs().max())
    found["error_N"] = float((solutions["cpu"].wrench - truth)[..., 2].square().mean().sqrt())
    return found


def main() -> None:
    """Run, print, write JSON."""
    alone()
    asked = Command(
        __doc__, ("recordings",), recordings={"nargs": "*", "default": [*TUNED, *RUNNING]}, synthetic=False,
        aside=(False, "the recordings that nothing was tuned on"), device="cpu", frames=8000, seed=int,
        json=ROOT / "out" / "contact.json",
    ).asked()  # fmt: skip
    if asked.synthetic:
        report = synthetic(asked.device, asked.frames, said_seed(asked.seed, 10000))
    else:
        report = real([*ASIDE, *CHILDREN] if asked.aside else asked.recordings)
    print("\n".join(table(report)))
    write_json(asked.json, report)


if __name__ == "__main__":
    main()
