"""The size at which half the sessions are found, and how often stated confidences are right."""

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from mujoco_laboratory.sizes import LEVELS, SIZES

from torchid.effects.catalogue import BODILY

STEEP = 3.0
"""Slope of the logistic curve of power over the logarithm of size; three levels of a few sessions tell the middle of a
curve, not its slope."""
REACH = math.log(30.0)
"""Beyond the levels to which the middle is looked for."""
BINS = (0.0, 0.5, 0.7, 0.8, 0.9, 0.97, 1.0)


def half_sizes(rows: Sequence[dict]) -> dict[str, dict]:
    """By effect: size found in half the sessions with a 68 % interval, beside the smallest that the ideal finds."""
    found = {}
    for name, sizes in SIZES.items():
        own = [r for r in rows if r["kind"] == "single" and list(r["names"]) == [name]]
        if sizes and len({r["level"] for r in own}) > 1:
            key, (small, large) = next(iter(sizes.items()))
            step = math.log(large / small)
            at = np.array([LEVELS[r["level"]] * abs(step) for r in own])
            hit = np.array([bool(r["first"]) for r in own])
            way = math.copysign(1.0, step)
            low, middle, high = (small * math.exp(way * x) for x in _middle(at, hit, abs(step)))
            found[name] = {"parameter": key, "half": middle, "interval": sorted((low, high)), "ideal": small,
                           "sessions": len(own)}  # fmt: skip
    return found


def _middle(at: np.ndarray, hit: np.ndarray, widest: float) -> tuple[float, float, float]:
    """Quantiles 0.16, 0.5 and 0.84 of where the curve crosses a half, under a flat prior."""
    where = np.linspace(-REACH, widest + REACH, 2000)
    up = STEEP * (at[:, None] - where)
    log = -np.logaddexp(0.0, np.where(hit[:, None], -up, up)).sum(0)
    share = np.exp(log - log.max()).cumsum()
    low, middle, high = (float(where[np.searchsorted(share / share[-1], q)]) for q in (0.16, 0.5, 0.84))
    return low, middle, high


def reliability(rows: Sequence[dict]) -> list[tuple[float, float, int, int]]:
    """Bins of stated confidence of laboratory causes: ends, verdicts, those that were right."""
    said = [(c, [e, w] not in [b[:2] for b in r["wrong"]])
            for r in rows if r["kind"] != "foreign" for e, w, c in r["named"] if e not in BODILY]  # fmt: skip
    found = []
    for low, high in zip(BINS[:-1], BINS[1:], strict=True):
        some = [right for c, right in said if low <= c < high or (high == 1.0 and c == 1.0)]
        found.append((low, high, len(some), sum(some)))
    return found


def draw_reliability(rows: Sequence[dict], path: Path) -> None:
    """Share of right verdicts over stated confidence, with 68 % intervals and numbers."""
    figure = Figure(figsize=(4.5, 4.2), layout="constrained")
    axes = figure.add_subplot()
    axes.plot([0, 1], [0, 1], color="0.7", lw=1.0)
    for low, high, n, right in reliability(rows):
        if n:
            share, middle = (right + 0.5) / (n + 1.0), 0.5 * (low + high)
            axes.errorbar(middle, right / n, math.sqrt(share * (1.0 - share) / n), 0.5 * (high - low), "o", color="C0")
            axes.annotate(f"{right}/{n}", (middle, right / n), (4, -12), textcoords="offset points", fontsize=8)
    axes.set(xlim=(0, 1.03), ylim=(0, 1.03), xlabel="stated confidence", ylabel="share of verdicts that are right",
             title="Causes in laboratory and forces")  # fmt: skip
    figure.savefig(path, dpi=110)
