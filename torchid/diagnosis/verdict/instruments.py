"""Faults of instruments that a verdict names, as findings.

They are of the type of those of a check before any fit, with config lines of the same keys.
"""

from collections.abc import Sequence

from torchid.checks.finding import Cure, Finding, Severity
from torchid.diagnosis.verdict.records import Cause, Diagnosis
from torchid.effects.catalogue import effect
from torchid.effects.instrument_faults import FAULTS
from torchid.effects.place import SESSION
from torchid.effects.plates import PlateGain, PlatePose
from torchid.effects.quantities import of
from torchid.effects.timing import TimeOffset
from torchid.io.mend import ForcesAs, PlateAs, in_words
from torchid.observation.plate_registry import SessionPlate


def instrument_findings(diagnosis: Diagnosis) -> tuple[Finding, ...]:
    """Return the causes of a verdict that are faults of instruments.

    Args:
        diagnosis: the verdict.
    """
    return tuple(_finding(cause, diagnosis.plates) for cause in diagnosis.causes if cause.effect in FAULTS)


def _finding(cause: Cause, plates: Sequence[SessionPlate]) -> Finding:
    """Return a cause as a finding, of the size of its first parameter."""
    own = effect(cause.effect)
    evidence = f"{own.sentence(cause)} (confidence {100.0 * cause.confidence:.0f} %)"
    place = () if cause.where == SESSION.where else tuple(cause.where)
    size, sd, unit = None, None, ""
    if cause.parameters:
        key = next(iter(cause.parameters))
        value, deviation = of(cause, key)
        size, sd, unit = float(value.norm()), float(deviation.norm()), _unit(key)
        size = float(value[0]) if len(value) == 1 else size
    sure = cause.level != "possible"
    severity = Severity.PROBLEM if sure else Severity.WARNING
    # A line that makes the model predict worse is none to advise.
    cure = () if sure and not cause.applied else _cure(cause, plates)
    return Finding(
        FAULTS[cause.effect], f"diagnosis.{cause.effect}", evidence, "", place, size, sd, unit, cure,
        advice="" if cure else f"to be sure, record {own.advice}" if own.advice else "", severity=severity,
    )  # fmt: skip


def _unit(key: str) -> str:
    """Return the unit in which a parameter's key ends; empty where it has none."""
    ending = key.rsplit("_", 1)[-1]
    return ending if ending in ("s", "m", "rad", "kg", "N", "Nm", "Hz", "hz") else ""


def _cure(cause: Cause, plates: Sequence[SessionPlate]) -> tuple[Cure, ...]:
    """Return the config line that does what the verdict says, where a config has a key for it."""
    if cause.effect == TimeOffset.name:
        lag = round(1e3 * float(of(cause, "lag_s")[0][0]), 1)
        return (Cure("their clock is off by that", f"forces_as: {in_words(ForcesAs(lag_ms=lag))}", f"lag_ms={lag}"),)
    numbers = [number for name in cause.where if (number := _number(name, plates)) is not None]
    if not numbers or len(numbers) < len(cause.where):
        return ()
    if cause.effect == PlateGain.name:
        change = PlateAs(gain=float(f"{1.0 / float(of(cause, 'gain')[0][0]):.4g}"))
    elif cause.effect == PlatePose.name:
        x, y = (round(float(v), 4) for v in of(cause, "shift_m")[0][:2])
        turn, sd = of(cause, "rotation_rad")
        if bool((turn.abs() > 2.0 * sd).any()):
            return ()  # a config has no key for a turn by any angle
        change = PlateAs(shift_m=(x, y))
    else:
        return ()
    if change == PlateAs():
        return ()
    entries = ", ".join(f"{n}: {in_words(change)}" for n in numbers)
    names = " and ".join(f"plate {n}" for n in numbers)
    return (Cure(f"{names} is read so", f"plates: {{{entries}}}", in_words(change).strip("{}"), tuple(numbers)),)


def _number(name: str, plates: Sequence[SessionPlate]) -> int | None:
    """Return the number by which a config names a plate of the session; None where its trials disagree."""
    numbers = {number for plate in plates if plate.frame.name == name for number in plate.numbers.values()}
    return numbers.pop() if len(numbers) == 1 else None
