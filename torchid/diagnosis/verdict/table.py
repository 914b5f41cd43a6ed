"""The content of ``diagnosis.json``."""

import dataclasses
from collections.abc import Sequence
from typing import Any

from torchid.checks.finding import record_of
from torchid.diagnosis.evidence.detectable import Detectable
from torchid.diagnosis.evidence.planted_moments import WIDEST
from torchid.diagnosis.evidence.planted_rules import CHANCE
from torchid.diagnosis.trace import TraceStep
from torchid.diagnosis.verdict.instruments import instrument_findings
from torchid.diagnosis.verdict.records import Cause, Diagnosis, Twin
from torchid.effects.catalogue import effect
from torchid.effects.place import Place
from torchid.effects.quantities import units_of
from torchid.effects.recommendations import tell_apart
from torchid.observation.plate_registry import SessionPlate


def verdict_table(diagnosis: Diagnosis) -> dict[str, Any]:
    """Return the content of ``diagnosis.json``, but for what the extended model makes of markers.

    Args:
        diagnosis: the verdict.
    """
    beside = {} if diagnosis.earlier is None else {"earlier_sessions": dataclasses.asdict(diagnosis.earlier)}
    return beside | {
        "baseline": {"heldout": dataclasses.asdict(diagnosis.baseline)},
        "causes": [cause_table(cause) for cause in diagnosis.causes],
        "unexplained": diagnosis.unexplained,
        "extended": {"heldout": dataclasses.asdict(diagnosis.extended)},
        "not_testable": [{"effect": name, "why": why} for name, why in diagnosis.not_testable.items()],
        "detectable": [_detectable(one) for one in diagnosis.detectable],
        "nearest": [dataclasses.asdict(near) for near in diagnosis.nearest],
        "refuted": [dataclasses.asdict(one) for one in diagnosis.refuted],
        "trace": [_step(k, one) for k, one in enumerate(diagnosis.trace, 1)],
        "plates": plates_table(diagnosis.plates),
        "findings": [dataclasses.asdict(record_of(one)) for one in instrument_findings(diagnosis)],
    }


def _detectable(one: Detectable) -> dict[str, Any]:
    """Return the smallest size of an effect that would have been named, or why there is none and what would show it."""
    found = {"effect": one.effect, "where": one.where, "parameter": one.key}
    if one.size is None:
        why = f"not named even at {WIDEST:.0f} prior standard deviations"
        return found | {"why": why, "record": effect(one.effect).advice}
    return found | {"size": one.size, "unit": units_of(one.key)[0], "power": CHANCE}


def plates_table(plates: Sequence[SessionPlate]) -> dict[str, Any]:
    """Return a session's plates by name: their channels in each trial, and where they are [m].

    Args:
        plates: as the trials' plates were recognised.
    """
    return {p.frame.name: {"channels": p.channels, "position_m": p.frame.p_WF} for p in plates}


def _step(number: int, one: TraceStep) -> dict[str, Any]:
    """Return one step of the trace with its number."""
    return {"step": number, "kind": str(one.kind), "effect": one.effect, "where": one.where, "rule": one.rule,
            "numbers": dict(one.numbers)}  # fmt: skip


def cause_table(cause: Cause) -> dict[str, Any]:
    """Return one cause with its parameters, rivals and gains.

    Args:
        cause: as a verdict names it.
    """
    names = ("effect", "where", "when", "parameters", "confidence", "level", "applied", "alternatives",
             "indistinguishable", "gain")  # fmt: skip
    found = {name: getattr(cause, name) for name in names}
    found["witnesses"] = [dataclasses.asdict(one) | {"agrees": one.agrees} for one in cause.witnesses]
    found["indistinguishable"] = [_twin(cause, twin) for twin in cause.indistinguishable]
    return found | _joint_and_markers(cause.place)


def _twin(cause: Cause, twin: Twin) -> dict[str, Any]:
    """Return one twin of a cause, with the motion that would tell the two apart."""
    names = ("effect", "where", "confidence", "parameters")
    found = {name: getattr(twin, name) for name in names} | {"motion": tell_apart(cause.effect, twin.effect)}
    return found if twin.place is None else found | _joint_and_markers(twin.place)


def _joint_and_markers(place: Place) -> dict[str, Any]:
    """Return what of a place only some effects have."""
    return {"follows": place.follows and str(place.follows), "markers": place.markers or None}
