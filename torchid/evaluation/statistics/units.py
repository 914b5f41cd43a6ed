"""The units of a test: trials, on demand blocks of successive cycles, subjects with a difference each, or people.

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

from torchid.evaluation.statistics.arrangements import count_arrangements

FORGOTTEN = 0.2
"""Choice. Correlation between cycles below which they are taken as independent: that of five cycles by chance alone is
larger than twice that in one case of three."""
MOST_LAGS = 5
"""Choice. Longest memory that is looked for [cycles]."""


@dataclass(frozen=True)
class Units:
    """What is exchanged in the comparison of two conditions."""

    kind: Literal["trials", "blocks", "subjects", "people"]
    index: tuple[int, ...]
    """Unit of every cycle of both conditions; of every subject."""
    second: Bool[Tensor, " units"]
    """Units of the second condition; all of them where they are paired."""
    cycles_per_block: int = 1

    @property
    def paired(self) -> bool:
        """Whether every unit has a difference of its own."""
        return self.kind == "subjects"

    @property
    def counts(self) -> tuple[int, int]:
        """Units of the reference and of the other condition."""
        second = int(self.second.sum())
        return (second, second) if self.paired else (len(self.second) - second, second)

    @property
    def granted(self) -> str:
        """What blocks take for granted; empty of other units."""
        if self.kind != "blocks":
            return ""
        return (
            f"blocks of {self.cycles_per_block} successive cycles were exchanged instead of trials: this takes for "
            "granted that whole trials of one condition do not differ, and finds whatever made them differ"
        )


@dataclass(frozen=True)
class LeastUnits:
    """What a comparison would need for any finding to be possible."""

    units: int
    """Of each condition, with permutations enough."""
    permutations: int
    """With units enough."""
    said: str = ""
    """What is too few, and what is the least that can; empty where a finding is possible."""
    least: str = ""
    """That least alone."""


def needed_for(units: Units, least_p: float, permutations: int, level: float) -> LeastUnits:
    """What a finding needs at a level.

    Args:
        least_p: smallest p-value that they give.
        permutations: that are tried at most.
    """
    wanted = (least_subjects if units.paired else least_units)(level)
    tries = math.ceil(1.0 / level - 1e-9)
    smaller = min(units.counts)
    if least_p <= level + 1e-12 and smaller >= 2:
        return LeastUnits(wanted, tries)
    few = permutations < tries
    own = f"{units.counts[0]} subjects" if units.paired else f"{units.counts[0]} against {units.counts[1]} {units.kind}"
    whose = "group" if units.kind == "people" else "condition"
    many = f"{wanted} subjects" if units.paired else f"{wanted} {units.kind} of each {whose}"
    least = " with ".join([many] * (smaller < wanted) + [f"permutations: {tries}"] * few)
    said = (
        f"{own}{f' with permutations: {permutations}' if few else ''} cannot show anything at a level of {level:g}: no "
        f"p-value is below {least_p:.3g}; {least} are the least that can"
    )
    return LeastUnits(wanted, tries, said, least)


def choose_units(
    values: Float[Tensor, "cycles columns"],
    trials: Sequence[str],
    second: Sequence[bool],
    kind: Literal["trials", "blocks"],
) -> Units:
    """The units of a comparison as asked.

    Args:
        values: measures of the cycles of both conditions in the order of recording.
        trials: trial of every cycle.
        second: whether a cycle is of the second condition.
    """
    if kind == "trials":
        return trial_units(trials, second)
    length = memory(values, trials)
    blocks = [(trial, k // length) for trial, k in zip(trials, _positions(trials), strict=True)]
    return Units(kind, *_units(blocks, second), length)


def subject_units(count: int) -> Units:
    """Subjects, each with a difference."""
    return Units("subjects", tuple(range(count)), torch.ones(count, dtype=torch.bool))


def trial_units(trials: Sequence[str], second: Sequence[bool] | None = None) -> Units:
    """Trials as units.

    Args:
        trials: trial of every cycle.
        second: whether a cycle is of the second condition; absent: all are of one.
    """
    return Units("trials", *_units([(trial,) for trial in trials], second or [False] * len(trials)))


def least_units(level: float) -> int:
    """Units of each of two conditions from which on a two-sided test can reach a level."""
    return next(n for n in range(2, 100) if 2.0 / count_arrangements(n, n) <= level + 1e-12)


def least_subjects(level: float) -> int:
    """Subjects from which on flipped signs can reach a level: 2^(1 - n) is no larger.

    Args:
        level: of the test.
    """
    return 1 + math.ceil(math.log2(1.0 / level) - 1e-9)


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
    """
    index = torch.tensor(units.index, device=values.device)
    own = [values[..., (index == k).nonzero()[:, 0], :].nanmean(-2) for k in range(len(units.second))]
    return torch.stack(own, dim=-2)


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
