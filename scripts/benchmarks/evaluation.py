"""False findings of evaluations without an effect, and the smallest assistance that evaluations find.

    cd scripts && python -m benchmarks.evaluation --null 200 [--seed N] [--trials 4] [--cycles 5] [--units trials]
    cd scripts && python -m benchmarks.evaluation --power [--evaluations 200] [--out ../docs]
    cd scripts && python -m benchmarks.evaluation --whole 200 [--seed N] [--trials 5] [--body reference] [--out DIR]
    cd scripts && python -m benchmarks.evaluation --learn OUT      # anew from a finished evaluation of walks

What is in: courses of torque and angle of whole trials and cycles, whose means, scatter and correlation over the cycle
and between joints are those of twelve walks of one subject (``evaluation_walks.json``: deviations of each walk from
the mean of its kind), measures of every cycle, units, permutations, adjusted p-values, gatekept courses, intervals.
What is not: recordings, body and device. ``--whole`` has them all (``evaluation_whole.py``); it goes on where it was
interrupted.
Cycles of one trial scatter about the trial's own mean as much as trials do, with a correlation of 0.3 from one to the
next; the walks, of one stride each, do not tell that.
"""

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
import xarray
from harness.command import Among, Command
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from benchmarks import evaluation_whole
from torchid.config.conditions import EvaluateOptions
from torchid.cycles.cycles import Cycle
from torchid.cycles.measures import measure
from torchid.evaluation.statistics.comparing import Comparison, MeasureColumn, Sample, compare

WALKS = Path(__file__).with_name("evaluation_walks.json")
KIND = 2
"""Letters behind ``walking`` that tell the kind of a walk: none, TS, TI, TO."""
WITHIN, LAGGED = 1.0, 0.3
"""Choice. Scatter of cycles about their trial against that of trials, and correlation from one cycle to the next."""
CYCLE_S = 0.7
"""Duration of a stance of these walks [s]."""
BODY_SD = 0.03
"""Choice. Scatter of a torque, in proportion, over bodies drawn."""
DRAWS = 64
POWER = 0.8
SHARES = tuple(0.01 * k for k in (2, 4, 6, 8, 10, 12, 15, 20, 25, 30, 40, 50, 60))
"""Parts of a coordinate's torque that a device takes."""
HELPED = "hip_l_flexion"


@dataclass(frozen=True)
class Walks:
    """Mean courses, and how whole walks deviate from the mean of their kind."""

    names: tuple[str, ...]
    mean: torch.Tensor
    """(2, points, coordinates): torques [N m], angles [rad]."""
    deviations: torch.Tensor
    """(walks, 2, points, coordinates), scaled so that their sum of squares is the variance."""


def learn(out: Path) -> None:
    """Take courses from the ``cycles_*.nc`` of an evaluation of walks and write ``evaluation_walks.json``."""
    sets = [xarray.open_dataset(path, engine="h5netcdf") for path in sorted(out.glob("cycles_*.nc"))]
    names = [str(n) for n in sets[0].coordinate.values if "_r_" not in str(n)]
    courses, kinds = [], []
    for data in sets:
        for k in np.flatnonzero(data.side.values == "l"):
            own = [list(data.coordinate.values).index(n) for n in names]
            both = np.stack([data.human.values[k][:, own], data.angle.values[k][:, own]])
            courses.append(both[:, ::2])
            kinds.append(str(data.trial.values[k]).removeprefix("walking")[:KIND].rstrip("0123456789"))
    stack, kinds = np.stack(courses), np.array(kinds)
    good = np.isfinite(stack).all((1, 2, 3))
    stack, kinds = stack[good], kinds[good]
    away = np.concatenate([stack[kinds == kind] - stack[kinds == kind].mean(0) for kind in np.unique(kinds)])
    away /= np.sqrt(len(stack) - len(np.unique(kinds)))
    held = {"names": names, "mean": np.round(stack.mean(0), 4).tolist(), "deviations": np.round(away, 4).tolist()}
    WALKS.write_text(json.dumps(held, separators=(",", ":")) + "\n")
    print(f"{len(stack)} walks of {len(np.unique(kinds))} kinds: {WALKS}")


def load() -> Walks:
    """The measured walks."""
    held = json.loads(WALKS.read_text())
    tensors = (torch.tensor(held[name], dtype=torch.float64) for name in ("mean", "deviations"))
    return Walks(tuple(held["names"]), *tensors)


def draw(walks: Walks, rng: np.random.Generator, trials: int, cycles: int) -> torch.Tensor:
    """Courses (trials, cycles, 2, points, coordinates) of one condition."""
    basis = walks.deviations
    own = torch.as_tensor(rng.normal(size=(trials, 1, len(basis))))
    each = torch.as_tensor(rng.normal(size=(trials, cycles, len(basis))))
    for k in range(1, cycles):
        each[:, k] = LAGGED * each[:, k - 1] + (1.0 - LAGGED**2) ** 0.5 * each[:, k]
    return walks.mean + torch.einsum("tcw,wkpj->tckpj", own + WITHIN * each, basis)


def sample_of(
    walks: Walks, courses: torch.Tensor, conditions: int, options: EvaluateOptions, rng: np.random.Generator
) -> Sample:
    """Measures and courses of torque of all cycles, as an evaluation has them."""
    trials, cycles, _, points, joints = courses.shape
    flat = courses.flatten(0, 1)
    step = CYCLE_S / (points - 1)
    whole = Cycle("walk", 0, points - 1)
    rates = torch.gradient(flat[:, 1], spacing=step, dim=1)[0]
    rows = [measure(options.measures, whole, c[0], v, c[1], step) for c, v in zip(flat, rates, strict=True)]
    values = torch.stack(rows).flatten(1)
    columns = tuple(MeasureColumn(name, m) for name in walks.names for m in options.measures)
    body = 1.0 + BODY_SD * torch.as_tensor(rng.normal(size=(DRAWS, 1, joints))).repeat_interleave(
        len(options.measures), 2
    )
    names = tuple(f"trial {t}" for t in range(trials) for _ in range(cycles))
    per = trials // conditions
    labels = tuple(("without", "with")[t // per] for t in range(trials) for _ in range(cycles))
    courses = tuple(MeasureColumn(name, "torque_Nm") for name in walks.names)
    return Sample(names, labels, columns, values, values * body, (), courses, flat[:, 0])


def evaluate(
    walks: Walks, rng: np.random.Generator, trials: int, cycles: int, options: EvaluateOptions, share: float, seed: int
) -> tuple[Comparison, torch.Tensor]:
    """One simulated evaluation: its comparison, and the true differences of the measures."""
    both = torch.cat([draw(walks, rng, trials, cycles), draw(walks, rng, trials, cycles)])
    plain = sample_of(walks, both, 2, options, np.random.default_rng(0))
    helped = both.clone()
    helped[trials:, :, 0, :, walks.names.index(HELPED)] *= 1.0 - share
    sample = sample_of(walks, helped, 2, options, rng)
    found = compare(sample, "without", "with", options, seed)
    taken = (sample.values - plain.values)[trials * cycles :].mean(0)
    return found, taken


def null(walks: Walks, evaluations: int, trials: int, cycles: int, options: EvaluateOptions, seed: int) -> dict:
    """Family-wise false findings of measures and courses, how often of courses, and what intervals cover."""
    rng = np.random.default_rng(seed)
    wrong = courses = 0
    covered, widths, units = [], [], ""
    for k in range(evaluations):
        found, _ = evaluate(walks, rng, trials, cycles, options, 0.0, seed + k)
        wrong += bool(found.found(options.level) or found.found_courses(options.level))
        courses += bool(found.found_courses(options.level))
        covered.append(((found.difference.low <= 0.0) & (found.difference.high >= 0.0)).double().mean())
        widths.append((found.effect.high - found.effect.low).nanmedian())
        units = found.units.kind
    rate = wrong / evaluations
    return {
        "evaluations": evaluations, "trials": trials, "cycles": cycles, "units": units, "seed": seed,
        "false_findings": rate, "sd": (rate * (1.0 - rate) / evaluations) ** 0.5,
        "of_which_in_courses": courses / evaluations,
        "interval_coverage": float(torch.stack(covered).mean()), "measures": len(found.columns),
        "courses": len(found.courses),
    }  # fmt: skip


def power(walks: Walks, evaluations: int, options: EvaluateOptions, seed: int) -> list[dict]:
    """Against trials per condition, the part of the assistance at which 80 % of evaluations find it."""
    rows = []
    peak = float(walks.mean[0, :, walks.names.index(HELPED)].abs().max())
    for trials in (4, 5, 6, 8, 10, 12):
        chances = []
        for share in SHARES:
            rng = np.random.default_rng((seed, trials))
            hits = 0
            for k in range(evaluations):
                found, _ = evaluate(walks, rng, trials, 3, options, share, seed + k)
                hits += any(found.columns[c].where == HELPED for c in found.found(options.level))
            chances.append(hits / evaluations)
            if chances[-1] > 0.97:
                break
        least = smallest(SHARES, chances)
        rows.append({"trials": trials, "share": list(SHARES[: len(chances)]), "power": chances, "smallest_share": least,
                     "smallest_Nm": None if least is None else least * peak, "peak_Nm": peak})  # fmt: skip
        print(rows[-1], flush=True)
    return rows


def smallest(shares: Sequence[float], chances: Sequence[float]) -> float | None:
    """Share at which the chance first passes ``POWER``, linear in between; None where it never does."""
    for k, chance in enumerate(chances):
        if chance >= POWER:
            if k == 0:
                return shares[0]
            part = (POWER - chances[k - 1]) / max(chance - chances[k - 1], 1e-9)
            return shares[k - 1] + part * (shares[k] - shares[k - 1])
    return None


def plot(rows: list[dict], path: Path) -> None:
    """Smallest assistance against trials per condition, for a planner."""
    figure = Figure(figsize=(6.2, 3.8), layout="constrained")
    FigureCanvasAgg(figure)
    left, right = figure.subplots(1, 2)
    good = [row for row in rows if row["smallest_share"] is not None]
    left.plot([r["trials"] for r in good], [100.0 * r["smallest_share"] for r in good], "o-", color="#0b5394")
    left.set(xlabel="trials per condition", ylabel="smallest assistance found in 80 % [% of torque]", ylim=(0, None))
    for row in rows:
        right.plot([100.0 * s for s in row["share"]], [100.0 * p for p in row["power"]], label=f"{row['trials']}")
    right.axhline(80.0, color="#8a8a8a", linewidth=0.8)
    right.set(xlabel="assistance [% of torque]", ylabel="evaluations that find it [%]", ylim=(0, 100))
    right.legend(title="trials", frameon=False, fontsize=8)
    for axes in (left, right):
        axes.grid(True, color="#dddddd")
        axes.spines[["top", "right"]].set_visible(False)
    figure.savefig(path, dpi=140)


def main() -> None:
    """Run from the command line."""
    given = Command(
        __doc__, learn=Path, null=int, power=False, evaluations=200, whole=int, trials=int, cycles=5, seed=0, out=Path,
        body=Among(("apart", "reference"), "reference"), units=Among(("trials", "blocks"), "trials"), permutations=999,
    ).asked()  # fmt: skip
    options = replace(EvaluateOptions(), permutations=given.permutations, units=given.units)
    if given.learn:
        learn(given.learn)
    if given.whole:
        plan = evaluation_whole.Plan(given.body, trials=given.trials or 5, seed=given.seed)
        print(json.dumps(evaluation_whole.run(plan, given.whole, given.out or Path("../out/benchmarks")), indent=1))
    if given.null:
        print(json.dumps(null(load(), given.null, given.trials or 4, given.cycles, options, given.seed), indent=1))
    if given.power:
        rows = power(load(), given.evaluations, options, given.seed)
        if given.out:
            (given.out / "evaluation_power.json").write_text(json.dumps(rows) + "\n")
            plot(rows, given.out / "evaluation_power.png")


if __name__ == "__main__":
    main()
