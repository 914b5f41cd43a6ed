"""Findings that several rooms make, in the same words: a zero, a clock, a gain, a weight."""

from torchid.checks.clocks import Lateness
from torchid.checks.finding import Cure, Finding, InstrumentFault, Severity
from torchid.conventions import GRAVITY


def unloaded_reading(
    plate: str, newton: float, code: str, source: str = "", severity: Severity = Severity.PROBLEM
) -> Finding:
    """Return that a plate reads something while nobody is on it.

    Args:
        plate: its name.
        newton: mean vertical force then [N].
        code: under which it is known.
        source: file or trial; empty for a stream.
        severity: how much it matters.
    """
    return Finding(
        InstrumentFault.ZERO, code, f"{plate} reads {newton:.1f} N while nobody is on it", source, (plate,), newton,
        unit="N", advice="set it to zero before recording; else the diagnosis may name a plate_offset",
        severity=severity,
    )  # fmt: skip


def late_forces(late: Lateness, code: str, source: str = "") -> Finding:
    """Return that forces come late, or early.

    Args:
        late: by how much.
        code: under which it is known.
        source: trial; empty for a stream or a whole session.
    """
    lag_ms = 1e3 * late.seconds
    seen = f"Forces come {abs(lag_ms):.0f} ms (sd {1e3 * late.sd:.0f} ms) {'late' if lag_ms > 0.0 else 'early'}"
    cure = Cure("their clock is off by that", f"forces_as: {{lag_ms: {lag_ms:.1f}}}", f"lag_ms={lag_ms:.1f}")
    return Finding(
        InstrumentFault.CLOCK, code, seen, source, (), late.seconds, late.sd, "s", (cure,),
        severity=Severity.WARNING,
    )  # fmt: skip


def unlike_gains(low: str, high: str, share: float, sd: float, code: str) -> Finding:
    """Return that two plates disagree about one weight.

    Args:
        low: the plate that reads less.
        high: the one that reads more.
        share: by which part of the weight they differ.
        sd: standard deviation of that.
        code: under which it is known.
    """
    seen = f"{low} reads {100.0 * share:.0f} % (sd {100.0 * sd:.0f} %) less than {high} for the same weight"
    return Finding(
        InstrumentFault.GAIN, code, seen, "", (low, high), share, sd, advice="look at their gains",
        severity=Severity.WARNING,
    )  # fmt: skip


def other_weight(moved_kg: float, mass_kg: float, source: str, known: str = "on record") -> Finding:
    """Return that plates carry another weight than the body's: check says it, and a run that it stops.

    Args:
        moved_kg: mass that the vertical force moves while somebody stands on the plates [kg].
        mass_kg: of the body [kg].
        source: file or trial.
        known: how that is known, as the end of ``70.0 kg are ...``.
    """
    more = moved_kg - mass_kg
    seen = (
        f"the plates move {moved_kg:.1f} kg on average while loaded, {mass_kg:.1f} kg are {known}: "
        f"{abs(more):.1f} kg ({abs(more) * GRAVITY:.0f} N) {'beyond' if more > 0.0 else 'short of'} the body"
    )
    why = "a load or a pull downwards without a sensor" if more > 0.0 else "a support, or contact beside the plates"
    advice = (
        f"Check the mass; it is else {why}, or a gain (`forces_as: {{gain: {mass_kg / moved_kg:.4g}}}`). "
        "The fit takes all of it for the body: give the trial role: heldout where the body alone is asked for"
    )
    return Finding(InstrumentFault.WEIGHT, "plates.weight", seen, source, (), more, unit="kg", advice=advice)
