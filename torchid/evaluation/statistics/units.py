"""The units that a test exchanges between conditions: trials, or on demand blocks of successive cycles.

Cycles of one trial share what that trial got wrong (a marker that was put on again, where the plates stood, how tired
the subject was), so that a trial is the unit. With a single long trial per condition only blocks of cycles are left.
They are made long enough that neighbouring ones hardly correlate; what differs between whole trials for other reasons
than the condition is then taken for the condition's, and the result says so (docs/evaluate.md has how often).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchid.config.conditions import EvaluateOptions
from torchid.evaluation.statistics.arrangements import count_arrangements

FORGOTTEN = 0.2
"""Choice. Correlation between cycles below which they are taken as independent: that of five cycles by chance alone is
larger than twice that in one case of three."""
MOST_LAGS = 5
"""Choice. Longest memory that is looked for [cycles]."""


@dataclass(frozen=True)
class Units:
    """What is exchanged in the comparison of two conditions."""

    kind: Literal["trials", "blocks", "none"]
    index: tuple[int, ...]
    """Unit of every cycle of both conditions."""
    second: Bool[Tensor, " units"]
    """Units of the second condition."""
    cycles_per_block: int = 1
    reason: str = ""
    """Why nothing can be tested, where ``kind`` is none; what blocks take for granted, where it is blocks."""

    @property
    def testable(self) -> bool:
        """Whether some arrangement can be rare enough."""
        return self.kind != "none"


def choose_units(
    values: Float[Tensor, "cycles columns"],
    trials: Sequence[str],
    second: Sequence[bool],
    options: EvaluateOptions,
) -> Units:
    """The units of a comparison as asked, and whether they can show anything at the level.

    Args:
        values: measures of the cycles of both conditions in the order of recording.
        trials: trial of every cycle.
        second: whether a cycle is of the second condition.
        options: which units are wanted, and the level.
    """
    kind, length, reason = options.units, 1, ""
    if kind == "trials":
        index, labels = _units([(trial,) for trial in trials], second)
    else:
        length = memory(values, trials)
        blocks = [(trial, k // length) for trial, k in zip(trials, _positions(trials), strict=True)]
        index, labels = _units(blocks, second)
        reason = (
            f"blocks of {length} successive cycles were exchanged instead of trials: this takes for granted that "
            "whole trials of one condition do not differ from each other, and finds whatever made them differ"
        )
    if _enough(labels, options.level):
        return Units(kind, index, labels, length, reason)
    first, own = len(labels) - int(labels.sum()), int(labels.sum())
    wanted = least_units(options.level)
    reason = (
        f"{first} against {own} {kind} cannot show anything at a level of {options.level:g}: "
        f"record {wanted} of each condition or more"
    )
    return Units("none", index, labels, length, reason)


def trial_units(trials: Sequence[str]) -> Units:
    """The trials of one condition as units.

    Args:
        trials: trial of every cycle.
    """
    index, labels = _units([(trial,) for trial in trials], [False] * len(trials))
    return Units("trials", index, labels)


def least_units(level: float) -> int:
    """Units of each of two conditions from which on a two-sided test can reach a level.

    Args:
        level: of the test.
    """
    return next(n for n in range(2, 100) if 2.0 / count_arrangements(n, n) <= level)


def memory(values: Float[Tensor, "cycles columns"], trials: Sequence[str]) -> int:
    """Cycles after which a trial has forgotten a deviation from its mean, at least one.

    The autocorrelation is the median over columns, pooled over trials, of deviations from the trial's own mean; its
    bias of minus one over the number of cycles is added back.

    Args:
        values: in the order of recording.
        trials: trial of every cycle.
    """
    for lag in range(1, MOST_LAGS + 1):
        products, squares, count = 0.0, 0.0, 0
        for trial in dict.fromkeys(trials):
            own = values[[k for k, name in enumerate(trials) if name == trial]]
            if len(own) > lag + 1:
                away = (own - own.nanmean(0)).nan_to_num(0.0)
                products = products + (away[lag:] * away[:-lag]).sum(0) * len(own) / (len(own) - lag)
                squares = squares + away.square().sum(0)
                count += len(own)
        if not isinstance(squares, Tensor):
            return lag
        r = torch.where(squares > 0.0, products / squares.clamp(min=1e-300), torch.nan).nanmedian()
        if not math.isfinite(float(r)) or float(r) + 1.0 / count < FORGOTTEN:
            return lag
    return MOST_LAGS


def unit_means(values: Float[Tensor, "*draws cycles columns"], units: Units) -> Float[Tensor, "*draws units columns"]:
    """Mean over the cycles of every unit that have a value.

    Args:
        values: NaN where a cycle has none.
        units: of the same cycles.
    """
    index = torch.tensor(units.index, device=values.device)
    own = [values[..., (index == k).nonzero()[:, 0], :].nanmean(-2) for k in range(len(units.second))]
    return torch.stack(own, dim=-2)


def _enough(second: Tensor, level: float) -> bool:
    own = int(second.sum())
    other = len(second) - own
    ways = count_arrangements(other, own)
    return min(own, other) >= 2 and (2 if own == other else 1) / ways <= level


def _units(keys: Sequence[tuple], second: Sequence[bool]) -> tuple[tuple[int, ...], Bool[Tensor, " units"]]:
    names = list(dict.fromkeys(keys))
    index = tuple(names.index(key) for key in keys)
    labels = [any(s for i, s in zip(index, second, strict=True) if i == k) for k in range(len(names))]
    return index, torch.tensor(labels, dtype=torch.bool)


def _positions(trials: Sequence[str]) -> list[int]:
    """Number of every cycle within its trial."""
    seen: dict[str, int] = {}
    found = []
    for trial in trials:
        found.append(seen.get(trial, 0))
        seen[trial] = found[-1] + 1
    return found
