"""How well forces could tell an effect's size: with body, geometry and everything else given.

    PYTHONPATH=.:scripts python -m batteries.bound --effects plate_pose plate_crosstalk --each 4

For sessions of the MuJoCo simulator that hide the effect at medium size: the size of each parameter, and standard
deviations of its parts, as stated with everything else unknown, and if all else were known (the inverse of the
effect's own block of the posterior's precision). What exceeds a quarter of the size even so is not in the columns that
the diagnosis has; other evidence, such as feet that stand on a plate and show its height, is left out.
"""

import shutil
import time
from pathlib import Path

import numpy as np
import torch
from harness.command import Among, Command
from harness.runs import ran
from mujoco_laboratory.draws import draw_effect
from mujoco_laboratory.session import simulate
from torch import Tensor

from batteries.judge import UNNAMED
from torchid.diagnosis.evidence.model import Identification
from torchid.diagnosis.search.estimates import estimate, internal
from torchid.diagnosis.search.result import SearchResult
from torchid.diagnosis.search.stepwise import search
from torchid.effects.catalogue import CATALOGUE, effect
from torchid.extension.diagnosing import observe_outcome


def found(name: str, seed: int, out: Path) -> tuple[SearchResult, dict]:
    """What a search for this effect alone finds in a session that hides it, and the truth."""
    hidden = draw_effect(name, "medium", np.random.default_rng((seed, 7)))
    outcome = ran(simulate(out, seed, [hidden]), out / "out")
    identified = outcome.identified
    assert identified is not None, "the session has forces"
    observed = list(observe_outcome(outcome, "fit").values())
    known = Identification(outcome.prior, identified.fit.omega_2, identified.whitening, outcome.fit)
    return search(observed, [effect(name)], known, 1), hidden


def known_else(said: SearchResult, k: int) -> dict[str, Tensor]:
    """Standard deviations of the named parameters of the k-th chosen effect, all others given."""
    one = said.chosen[k]
    precision = torch.diag(one.relative**-2)
    for trial in sorted(one.trials):
        raw = said.model.statistics.trials[trial]
        at = raw.at(one.columns)
        precision = precision + raw.gram[at][:, at]
    scale = torch.tensor(one.source.scale, dtype=torch.float64)
    covariance = scale[:, None] * torch.linalg.inv(precision) * scale
    values = one.effect.estimated(one.place, internal(said, k), covariance)
    return {key: sd for key, (_, sd) in values.items()}


def told(name: str, seed: int, out: Path) -> str:
    """Lines of one session."""
    said, hidden = found(name, seed, out)
    if not said.chosen:
        return f"{name} {seed}: not found"
    lines, stated, bound = [], estimate(said, 0), known_else(said, 0)
    for key in bound.keys() & hidden["parameters"].keys():
        true = hidden["parameters"][key]
        whole = list(true.values()) if isinstance(true, dict) else true
        size = np.linalg.norm(np.ravel(whole) - (1.0 if key in UNNAMED else 0.0))
        parts = stated[key][1], bound[key]
        text = ", ".join(
            f"{what} {float(x.norm()) / size:.0%}" for what, x in zip(("stated", "at best"), parts, strict=True)
        )
        each = " ".join(f"{x:.2g}" for x in bound[key].reshape(-1).tolist() if x > 0.0)
        lines.append(f"{name} {seed} {key}: size {size:.3g}; sd over size: {text}; parts at best: {each}")
    return "\n".join(sorted(lines)) or f"{name} {seed}: nothing of it has a size"


def main() -> None:
    """Session by session."""
    once = [name for name, one in CATALOGUE.items() if not one.per_trial]
    asked = Command(
        __doc__, effects=Among(once, ["plate_pose", "plate_crosstalk"], True), each=(4, "sessions per effect"),
        first=(int(time.time()) % 10**6, "seed (default: the clock's)"), out=Path("out/bound"),
    ).asked()  # fmt: skip
    for k in range(asked.each):
        for name in asked.effects:
            print(told(name, asked.first + k, asked.out), flush=True)
            shutil.rmtree(asked.out, ignore_errors=True)


if __name__ == "__main__":
    main()
