"""Tests of torchid.io.clock: rounded times, missing rows, times in ms."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from torchid.errors import InputError, Note
from torchid.io.clock import Clock, uniform_clock


def clock(times: np.ndarray, nominal: float | None = None) -> tuple[Clock, list[Note]]:
    notes: list[Note] = []
    return uniform_clock(times, np.arange(len(times)) + 7, "x", notes, nominal), notes


@pytest.mark.parametrize("nominal", [None, 100.0])
@pytest.mark.parametrize("missing", [[1], [50], [98], [30, 31, 32], [3, 40, 41, 77]])
def test_missing_rows_become_gaps_where_they_were(missing: list[int], nominal: float | None) -> None:
    """Rows taken out anywhere leave their frames on the clock, and the line after each hole is named."""
    kept = np.setdiff1d(np.arange(100), missing)
    found, notes = clock(2.0 + kept / 100.0, nominal)
    assert_allclose(found.time, 2.0 + np.arange(100) / 100.0, atol=1e-12)
    assert_array_equal(found.rows, kept)
    spread = found.spread(kept[:, None].astype(float))
    assert_array_equal(np.flatnonzero(np.isnan(spread[:, 0])), missing)
    assert [note.code for note in notes] == ["time.gaps"]
    assert f"before line {7 + np.flatnonzero(np.diff(kept) > 1)[0] + 1}" in notes[0].message


@pytest.mark.parametrize(("rate", "digits"), [(60.0, 3), (60.0, 2), (70.0, 2), (250.0, 3), (29.97, 2)])
def test_rounding_is_not_taken_for_missing_rows(rate: float, digits: int) -> None:
    """However coarse the rounding of a time column, all rows stay neighbours where the rate is stated."""
    found, notes = clock(np.round(np.arange(200) / rate, digits), rate)
    assert_array_equal(found.rows, np.arange(200))
    assert "time.gaps" not in [note.code for note in notes]


def test_clocks_that_wander_are_refused() -> None:
    """Steps that are no whole periods, and more holes than rows, are no uniform clock."""
    times = np.arange(60) / 100.0
    for bad in (times + 0.02 * np.sin(np.arange(60) / 9.0), np.where(times > 0.3, times + 0.0163, times), times**1.3):
        with pytest.raises(InputError, match=r"time\.irregular"):
            clock(bad)
    with pytest.raises(InputError, match=r"time\.irregular"):
        clock(np.concatenate([times, [30.0]]))


def test_times_in_ms_need_a_witness() -> None:
    """The stated rate proves ms; without it a row every 10 s is refused; a slow rate that is stated is believed."""
    times = 10.0 * np.arange(50)
    found, notes = clock(times, 100.0)
    assert_allclose(found.time, times / 1e3)
    assert [note.code for note in notes] == ["time.ms"]
    for nominal in (None, 30.0):
        with pytest.raises(InputError, match=r"1000.*time\.unit"):
            clock(times, nominal)
    assert_allclose(clock(times, 0.1)[0].time, times)


def test_one_bad_time_is_refused_with_its_line() -> None:
    """A time that goes back or is missing names the line and both times."""
    times = np.arange(30) / 100.0
    for value, code in ((0.02, "time.order"), (np.nan, "time.invalid")):
        bad = times.copy()
        bad[12] = value
        with pytest.raises(InputError) as caught:
            clock(bad)
        assert (caught.value.code, caught.value.place) == (code, "line 19, column time")
