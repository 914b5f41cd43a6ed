"""The uniform clock behind a time column: rounded times, missing rows, times in ms."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from torchid.errors import InputError, Note

ROUNDED = 0.01
"""Deviation of a stored time from a uniform clock, in periods, above which the rounding is said."""
IRREGULAR = 0.5
"""Deviation in periods above which samples are missing or doubled."""
WHOLE = 0.25
"""Deviation of a step from whole periods up to which rows may be missing: a wider step is no sign of them, and times
rounded to a quarter of a period are."""
PLACES = 0.1
"""Share of the steps that may leap over missing rows; where more do, the clock is another or none."""
SLOWEST = 5.0
"""Rate [Hz] below which nobody records movement: a time column in ms looks like 0.02 to 2 Hz for the customary 20 to
2000 Hz."""
MS_MATCH = 0.01
"""Relative deviation of the rate stated from a thousand times that of the time column that still shows times in ms."""
SHORTEST = 1e-9
"""A period [s] that no clock goes below."""
LATEST = 1e9
"""Time [s] that no clock of a recording reaches, thirty years."""
LISTED = 5
"""Places that a note names."""


@dataclass(frozen=True)
class Clock:
    """A uniform clock and where a file's rows stand on it."""

    time: Float[np.ndarray, " frames"]
    """Without holes [s]."""
    rows: Int[np.ndarray, " rows"]
    """Frame of every row of the file."""

    @property
    def rate(self) -> float:
        """Frames per second, 0 for fewer than two."""
        return (len(self.time) - 1) / float(self.time[-1] - self.time[0]) if len(self.time) > 1 else 0.0

    def spread(self, values: np.ndarray, missing: float | int = np.nan) -> np.ndarray:
        """Values (rows, ...) of a file at their frames (frames, ...), ``missing`` where the file has no row."""
        if len(self.rows) == len(self.time):
            return values
        spread = np.full((len(self.time), *values.shape[1:]), missing, values.dtype)
        spread[self.rows] = values
        return spread


def uniform_clock(
    times: Float[np.ndarray, " rows"],
    lines: Int[np.ndarray, " rows"],
    source: str,
    notes: list[Note],
    nominal: float | None = None,
) -> Clock:
    """The uniform clock behind a time column that may be rounded, lack rows or be in ms.

    Args:
        times: as stored [s], or in ms where ``nominal`` proves it.
        lines: of the file in which they stand.
        notes: rounding, missing rows and ms are said here.
        nominal: rate that the file states [Hz]; used where it fits the column at least as well as first and last time.

    Raises:
        InputError: ``time.invalid``, ``time.order``, ``time.irregular`` or ``time.unit``.
    """
    bad = lambda code, message, row: _bad_time(code, message, row, times, lines, source)  # noqa: E731
    possible = np.abs(times) < LATEST
    if not possible.all():
        raise bad("time.invalid", "a time is missing or cannot be", int(np.argmin(possible)))
    if len(times) < 2:
        return Clock(times, np.arange(len(times)))
    steps = np.diff(times)
    if (steps <= 0).any():
        raise bad("time.order", "time does not increase", int(np.argmax(steps <= 0)) + 1)
    nominal = nominal if nominal and 1e-3 < nominal < 1e6 else None
    stored, times = times, times * _unit(float(np.median(steps)), nominal, lines, source, notes)
    rows = _rows(times, nominal)
    candidates = [(times[-1] - times[0]) / rows[-1], *([1.0 / nominal] if nominal else [])]
    # The rate that the file states wins a tie.
    period = min(reversed(candidates), key=lambda p: float(np.abs(times - times[0] - rows * p).max()))
    deviation = np.abs(times - times[0] - rows * period) / period
    if deviation.max() > IRREGULAR:
        row = int(np.argmax(deviation > IRREGULAR))
        raise _bad_time("time.irregular", "the samples are not evenly spaced", row, stored, lines, source)
    if deviation.max() > ROUNDED:
        text = f"times are rounded (by up to {deviation.max():.2f} periods); {1 / period:.6g} Hz throughout used"
        notes.append(Note("time.rounded", text, source))
    notes += _gaps(times, rows, lines, source)
    return Clock(times[0] + np.arange(rows[-1] + 1) * period, rows)


def _unit(step: float, nominal: float | None, lines: np.ndarray, source: str, notes: list[Note]) -> float:
    """Seconds of the column's unit: 1, or 0.001 where only that gives the rate that the file states."""
    if nominal and abs(step * nominal / 1e3 - 1.0) <= MS_MATCH:
        notes.append(Note("time.ms", f"times are in ms, as DataRate {nominal:g} Hz shows; divided by 1000", source))
        return 1e-3
    if step * SLOWEST <= 1.0 or nominal and abs(step * nominal - 1.0) <= MS_MATCH:
        return 1.0
    raise InputError(
        "time.unit", "the time column cannot be in seconds", source=source,
        place=f"lines {lines[0]} to {lines[-1]}, column time",
        found=f"a row every {step:g}, which would be {1 / step:.3g} Hz",
        remedy="Divide the times by 1000 if they are in ms; they must be in s",
    )  # fmt: skip


def _rows(times: np.ndarray, nominal: float | None) -> Int[np.ndarray, " rows"]:
    """Frame of every row: one after the other, unless some steps are several whole periods and all others one."""
    steps = np.diff(times)
    if steps.max() < (2.0 - WHOLE) * steps.min():
        return np.arange(len(times))
    for period in (float(np.median(steps)), *([1.0 / nominal] if nominal else [])):
        jumps = np.rint(steps / max(period, SHORTEST))
        leaping, missing = jumps > 1, (jumps - 1).sum()
        if (
            (jumps >= 1).all()
            and np.abs(steps / period - jumps).max() <= WHOLE
            and leaping.sum() <= max(1.0, PLACES * len(steps))
            and missing <= len(times)
        ):
            return np.concatenate([[0], np.cumsum(jumps)]).astype(int)
    return np.arange(len(times))


def _gaps(times: np.ndarray, rows: np.ndarray, lines: np.ndarray, source: str) -> list[Note]:
    """What to say of missing rows."""
    missing = np.diff(rows) - 1
    at = np.flatnonzero(missing)
    if not len(at):
        return []
    places = [f"{missing[k]} before line {lines[k + 1]} ({times[k]:g} to {times[k + 1]:g} s)" for k in at[:LISTED]]
    more = f" and {len(at) - LISTED} more places" if len(at) > LISTED else ""
    return [Note("time.gaps", f"{missing.sum()} rows are missing, left as gaps: {', '.join(places)}{more}", source)]


def _bad_time(code: str, message: str, row: int, times: np.ndarray, lines: np.ndarray, source: str) -> InputError:
    return InputError(
        code, message, source=source, place=f"line {lines[row]}, column time",
        found=f"{times[row]:g} after {times[row - 1]:g}" if row else f"{times[row]:g}",
        remedy="Correct that cell, or export the file again with every sample on one clock",
    )  # fmt: skip
