"""What sound sessions seem to have of each effect, by rows of forces and markers alone.

    PYTHONPATH=.:scripts:tests python -m batteries.apparent --out out/apparent

Every shared session that is not kept aside is searched as recorded, with nothing named but what bodies do and what is
known to be wrong with it; every other effect is then asked for the evidence of each size (``evidence/apparent.SIZES``).
From these the shares of sizes are estimated by expectation maximisation, of all effects together and of each beside
``STRENGTH`` sessions that are like all. Prints the common shares and that of the largest size of each effect
(``SHARES``, ``Traits.mistaken``; ``apparent.jsonl`` keeps what sessions said when these were last set). Sessions that a
folder keeps are not searched again.
"""

import json
import math
from collections import defaultdict
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import torch
from harness.command import DATA, Command
from harness.pool import performed
from harness.rows import read_lines
from planted_faults.real_kinds import UNPLANTED
from planted_faults.real_sessions import RealSession, sessions

from batteries.real import Case, planted
from torchid.config import load_config
from torchid.diagnosis.candidates.candidate import Candidate
from torchid.diagnosis.evidence.apparent import SIZES
from torchid.diagnosis.evidence.gains import informed
from torchid.diagnosis.evidence.model import LinearModel
from torchid.diagnosis.evidence.per_trial import marginalise_per_trial
from torchid.diagnosis.evidence.posterior import fit
from torchid.diagnosis.evidence.spread import evidence_of_sizes
from torchid.diagnosis.search import stepwise
from torchid.effects.catalogue import effect
from torchid.extension.diagnosing import diagnose_outcome
from torchid.run import run_experiment

STRENGTH = 4.0
"""Choice. Sessions that are like all effects together, beside those of each effect."""
STEPS = 300
"""Resolution. Steps of expectation maximisation."""


def asked(session: RealSession, root: Path, out: Path) -> dict[str, Any]:
    """Evidence of each size of each effect in a session [nat], averaged over its places."""
    _, path = planted(Case(session.name, "none", UNPLANTED, 0), session, root, out / "scratch" / session.name)
    with patch("torchid.run.sequence.write_report"):
        outcome = run_experiment(load_config(path, ["diagnosis.enabled=false"]))
    found: dict[str, list[list[float]]] = defaultdict(list)
    offered, ended = stepwise.open_candidates, stepwise.reduced

    def known(one: Candidate) -> bool:
        return any(one.effect.name == name and at in ("*", *one.place.where) for name, at in session.known)

    def few(*given: Any) -> list[Candidate]:
        return [one for one in offered(*given) if one.effect.bodily or known(one)]

    def end(model: LinearModel, chosen: Sequence[Candidate], *rest: Any) -> Any:
        statistics, others = marginalise_per_trial(model.statistics.unstated, chosen)
        left = [one for one in model.design.candidates if not (one.effect.bodily or known(one))]
        left = [one for one in left if one.effect.mistaken > 0.0]
        for rows, told, moment in informed(statistics, fit(statistics, others), left):
            nats = evidence_of_sizes(told, moment, torch.tensor(SIZES, dtype=torch.float64))
            for k, own in zip(rows, nats.tolist(), strict=True):
                found[left[k].effect.name].append(own)
        return ended(model, chosen, *rest)

    with (
        patch.object(stepwise, "open_candidates", few),
        patch.object(stepwise, "reduced", end),
        patch.object(stepwise, "_narrow", lambda state: state),
    ):
        diagnose_outcome(outcome)
    places = {name: torch.tensor(own, dtype=torch.float64) for name, own in found.items()}
    mean = {name: (torch.logsumexp(own, 0) - math.log(len(own))).tolist() for name, own in places.items()}
    return {"session": session.name, "evidence": mean}


def shares(evidence: np.ndarray, like: np.ndarray | None = None) -> np.ndarray:
    """Shares of the sizes by evidence (sessions, sizes), likeliest, beside ``STRENGTH`` sessions of given shares."""
    found = np.full(evidence.shape[1], 1.0 / evidence.shape[1]) if like is None else like.copy()
    for _ in range(STEPS):
        log = np.log(np.maximum(found, 1e-12)) + evidence
        total = np.exp(log - np.logaddexp.reduce(log, 1)[:, None]).sum(0)
        found = total / total.sum() if like is None else (total + STRENGTH * like) / (len(evidence) + STRENGTH)
    return found


def measured(rows: Sequence[dict[str, Any]]) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Shares of sizes of all effects together and of each, from what sessions said."""
    # Widespread effects, which bodies imitate at all places, are like no others.
    alike = [own for row in rows for name, own in row["evidence"].items() if not effect(name).widespread]
    common = shares(np.array(alike))
    names = sorted({name for row in rows for name in row["evidence"]})
    asked = {name: np.array([row["evidence"][name] for row in rows if name in row["evidence"]]) for name in names}
    return common, {name: shares(own, common) for name, own in asked.items()}


def main() -> None:
    """Search what is missing, print the shares."""
    given = Command(__doc__, jobs=2, out=(Path("out/apparent"), "folder of what sessions said")).asked()
    some, kept = sessions(DATA, aside=False), given.out / "sessions.jsonl"
    work = partial(asked, root=DATA, out=given.out)
    for one in performed(some, work, given.jobs, kept, "session"):
        print(one["session"], flush=True)
    rows = read_lines(kept)
    common, each = measured(rows)
    print(f"{len(rows)} sessions; sizes {SIZES}: {json.dumps(common.round(3).tolist())}")
    for name, own in each.items():
        print(f"{name:24s}{json.dumps(own.round(3).tolist())}")


if __name__ == "__main__":
    main()
