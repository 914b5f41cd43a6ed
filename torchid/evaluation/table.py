"""Content of ``evaluation.json``, by joints, conditions and measures."""

from dataclasses import asdict
from typing import Any

from torchid.evaluation.cycle_measures.cycles import APART
from torchid.evaluation.evaluation import BodyAnswer, Evaluation
from torchid.evaluation.numbers import condition_means, condition_units
from torchid.evaluation.statistics.comparing import Comparison


def evaluation_table(found: Evaluation) -> dict[str, Any]:
    """Everything but courses; the keys other programs read are those of the contracts.

    Args:
        found: the evaluation.
    """
    options = found.config.evaluate
    return {
        "subject": found.config.subject.name,
        "reference": found.reference,
        "conditions": {
            name: {
                "device": getattr(found.worn[name].device, "name", None),
                "trials": [trial.name for trial in found.trials if trial.condition == name],
                "cycles": found.conditions.count(name),
            }
            for name in found.config.conditions
        },
        "convention": options.convention,
        "signs": found.signs,
        "template_is": found.usual,
        "per_mass_kg": found.per_mass_kg,
        **answer_table(found, found.identified),
        "device": {name: worn.parameters for name, worn in found.worn.items() if worn.device is not None},
        "sheet": {
            name: [asdict(finding) for finding in worn.findings]
            for name, worn in found.worn.items()
            if worn.device is not None
        },
        "template": answer_table(found, found.template),
        "test": {one.condition: _test(one, options.level) for one in found.identified.comparisons},
        "level": options.level,
        "contacts": [vars(one) for one in found.contacts],
        "cycles": [
            {"trial": c.trial, "condition": found.conditions[k], "side": c.side, "frames": [c.start, c.stop],
             "apart": float(found.apart[k]), "stands_apart": float(found.apart[k]) > APART}
            for k, c in enumerate(found.cycles)
        ],
        "not_determinable": [{"what": gap.what, "why": gap.why} for gap in found.gaps],
    }  # fmt: skip


def answer_table(found: Evaluation, answer: BodyAnswer) -> dict[str, Any]:
    """``joints`` and ``differences`` of one body.

    Args:
        found: the evaluation.
        answer: of one body.
    """
    joints: dict[str, Any] = {}
    for condition in found.config.conditions:
        mean = condition_means(answer, condition)
        own, _ = condition_units(answer, condition)
        for k, column in enumerate(answer.sample.columns):
            place = joints.setdefault(column.where, {}).setdefault(condition, {})
            place[column.measure] = {name: float(getattr(mean, name)[k]) for name in ("value", "sd", "low", "high")}
            place[column.measure]["cycles"] = int(answer.sample.values[own, k].isfinite().sum())
    return {"joints": joints, "differences": [row for one in answer.comparisons for row in _rows(one, found)]}


def _rows(one: Comparison, found: Evaluation) -> list[dict[str, Any]]:
    level = found.config.evaluate.level
    return [
        {
            "condition": one.condition, "where": column.where, "measure": column.measure,
            **{name: float(getattr(one.difference, name)[k]) for name in ("value", "sd", "low", "high")},
            "p": float(one.tested.p[k]), "p_adjusted": float(one.tested.adjusted[k]),
            "hedges_g": {name: float(getattr(one.effect, name)[k]) for name in ("value", "low", "high")},
            "found": float(one.tested.adjusted[k]) <= level,
        }
        for k, column in enumerate(one.columns)
    ]  # fmt: skip


def _test(one: Comparison, level: float) -> dict[str, Any]:
    second = int(one.units.second.sum())
    return {
        "units": one.units.kind, "reference": len(one.units.second) - second, "condition": second,
        "cycles_per_block": one.units.cycles_per_block, "least_p": one.least_p, "all_arrangements": one.complete,
        "findings": len(one.found(level)), "said": one.units.reason,
    }  # fmt: skip
