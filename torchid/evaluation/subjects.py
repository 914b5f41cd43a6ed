"""Several subjects together: the paired differences of their finished evaluations, signs flipped.

Every subject is one unit: its difference between condition and reference is one number per measure. Under the null
hypothesis its sign is as likely either way (Nichols & Holmes 2002, Hum Brain Mapp 15:1); the largest statistic over all
measures adjusts the p-values as it does for one subject.
"""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.config.conditions import EvaluateOptions
from torchid.errors import InputError
from torchid.evaluation.arrangements import flip
from torchid.evaluation.comparing import Column
from torchid.evaluation.effects import Estimate, mean_of
from torchid.evaluation.permutation import Tested, sign_means, step_down

FILE = "evaluation.json"
READ = ("subject", "reference", "conditions", "differences", "template")
"""Keys of ``evaluation.json`` that are read."""


@dataclass(frozen=True)
class SubjectsComparison:
    """One condition against the reference, over subjects."""

    condition: str
    body: str
    """identified or template."""
    subjects: tuple[str, ...]
    columns: tuple[Column, ...]
    values: Float[Tensor, "subjects columns"]
    """Differences of the subjects, NaN where one has none."""
    difference: Estimate
    tested: Tested
    least_p: float


def compare_subjects(tables: Sequence[dict], options: EvaluateOptions, seed: int) -> tuple[SubjectsComparison, ...]:
    """Compare every condition that all subjects have with the reference, with both bodies.

    Args:
        tables: contents of the subjects' ``evaluation.json``.
        options: level and number of permutations.
        seed: of random signs.
    """
    names = tuple(str(table["subject"]) for table in tables)
    conditions = [one for one in tables[0]["conditions"] if one != tables[0]["reference"]]
    found = []
    for condition in conditions:
        if all(condition in table["conditions"] for table in tables):
            found += [_compare(tables, names, condition, body, options, seed) for body in ("identified", "template")]
    return tuple(found)


def _compare(
    tables: Sequence[dict], names: tuple[str, ...], condition: str, body: str, options: EvaluateOptions, seed: int
) -> SubjectsComparison:
    each = [_differences(table, condition, body) for table in tables]
    keys = list(dict.fromkeys(key for one in each for key in one))
    rows = [[one.get(key, torch.nan) for key in keys] for one in each]
    values = torch.tensor(rows, dtype=torch.float64).reshape(len(tables), len(keys))
    signs = flip(len(tables), options.permutations, seed)
    statistics = sign_means(values, signs)
    enough = torch.isfinite(values).sum(0) >= 2
    tested = step_down(torch.where(enough, statistics, 0.0), options.level)
    columns = tuple(Column(where, measure) for where, measure in keys)
    return SubjectsComparison(condition, body, names, columns, values, mean_of(values, None), tested, 2.0 / len(signs))


def _differences(table: dict, condition: str, body: str) -> dict[tuple[str, str], float]:
    rows = table["differences"] if body == "identified" else table["template"]["differences"]
    own = [row for row in rows if row["condition"] == condition and row["value"] is not None]
    return {(row["where"], row["measure"]): float(row["value"]) for row in own}


def read_subjects(folders: Sequence[Path]) -> list[dict]:
    """Contents of finished evaluations.

    Args:
        folders: ``out`` of each.

    Raises:
        InputError: ``evaluate.subject`` where a folder has no evaluation.
    """
    found = []
    for folder in folders:
        try:
            table = json.loads((folder / FILE).read_text(encoding="utf-8"))
            found.append({key: table[key] for key in READ})
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise InputError(
                "evaluate.subject", "this folder has no finished evaluation", source=folder, found=str(error)[:120],
                remedy="Run `torchid evaluate` on that subject's config first, or correct evaluate.subjects",
            ) from error  # fmt: skip
    return found


def subjects_table(found: Sequence[SubjectsComparison], level: float) -> list[dict]:
    """What ``subjects.json`` says.

    Args:
        found: comparisons over subjects.
        level: family-wise.
    """
    return [
        {
            "condition": one.condition, "body": one.body, "subjects": list(one.subjects), "least_p": one.least_p,
            "where": column.where, "measure": column.measure, "each": one.values[:, k].tolist(),
            **{name: float(getattr(one.difference, name)[k]) for name in ("value", "sd", "low", "high")},
            "p": float(one.tested.p[k]), "p_adjusted": float(one.tested.adjusted[k]),
            "found": float(one.tested.adjusted[k]) <= level,
        }
        for one in found
        for k, column in enumerate(one.columns)
    ]  # fmt: skip
