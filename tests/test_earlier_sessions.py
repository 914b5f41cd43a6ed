"""What earlier sessions of a laboratory say of the next: it tells what that one cannot alone, and misleads nobody."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import torch
from draws import seed_of
from laboratory_sessions import FAULTS, PARAMETERS, SESSIONS, columns, here, hidden, laboratory, session
from rates import at_least
from small_session import outcome
from test_witnesses import diagnosed, planted

from torchid.cohort.pooling import pooled
from torchid.diagnosis.evidence.earlier_sessions import among, beside_bodies, integrated_out, unlike
from torchid.diagnosis.evidence.laboratory import LaboratoryEvidence
from torchid.diagnosis.options import NamingOptions
from torchid.diagnosis.verdict.records import Diagnosis
from torchid.diagnosis.verdict.table import verdict_table
from torchid.effects.catalogue import effect
from torchid.effects.place import Place
from torchid.errors import InputError
from torchid.report.diagnosis import diagnosis_section
from torchid.session import Outcome
from torchid.session.laboratory import (
    LaboratoryPlate,
    SessionEvidence,
    earlier_sessions,
    laboratory_dataset,
    laboratory_plate,
)
from torchid.session.plates import session_plates
from torchid.storage.netcdf import write_netcdf

NAMED = NamingOptions().named_nats
LABORATORIES = 12


def expected(draw: np.random.Generator, theta: np.ndarray) -> LaboratoryEvidence:
    """What twelve sessions with such parameters say of one more."""
    return pooled(laboratory(draw, theta)).expected


def one_more(draw: np.random.Generator, theta: np.ndarray) -> LaboratoryEvidence:
    """What one more session says, whose forces come late by a usual body's lag."""
    lagging = theta.copy()
    lagging[0] += 0.45
    return session(draw, lagging)


def test_a_session_of_the_same_laboratory_is_hardly_ever_unlike_and_knows_more_with_it() -> None:
    draw, alike, off = np.random.default_rng(seed_of("alike")), 0, []
    for _ in range(LABORATORIES):
        fault, theta = hidden(draw)
        earlier, own = expected(draw, theta), one_more(draw, theta)
        found = unlike(own, earlier)
        assert found is not None
        alike += found.nats < NAMED
        if fault:  # the clock's size is the bodies' as well
            both = earlier.information + own.information + torch.eye(PARAMETERS).double()
            mean = torch.linalg.solve(both, earlier.moment + own.moment)[columns(fault)]
            off.append(float((mean - torch.from_numpy(theta[columns(fault)])).norm()))
    assert alike >= at_least(0.95, LABORATORIES)
    assert np.median(off) < 0.3, "one session alone knows a parameter to 0.3"


def test_a_session_of_another_laboratory_says_that_it_is_unlike() -> None:
    draw, told = np.random.default_rng(seed_of("other")), 0
    for _ in range(LABORATORIES):
        fault, theta = hidden(draw)
        found = unlike(one_more(draw, 0.0 * theta), expected(draw, 2.0 * theta))
        assert found is not None
        told += found.nats >= NAMED and (found.effect, found.where) == FAULTS[fault]
    assert told >= at_least(0.85, LABORATORIES)


def test_what_is_integrated_out_leaves_the_marginal_distribution() -> None:
    draw = np.random.default_rng(seed_of("marginal"))
    one = session(draw, np.zeros(PARAMETERS))
    kept = torch.arange(2, 9)
    A, a = integrated_out(one.information, one.moment, kept)
    unit = torch.eye(PARAMETERS).double()
    whole = torch.linalg.inv(one.information + unit)
    torch.testing.assert_close(torch.linalg.inv(A + unit[kept][:, kept]), whole[kept][:, kept])
    mean = torch.linalg.solve(A + unit[kept][:, kept], a)
    torch.testing.assert_close(mean, (whole @ one.moment)[kept])


def test_only_common_faults_are_kept_in_the_order_that_is_asked() -> None:
    draw = np.random.default_rng(seed_of("common"))
    one = session(draw, np.zeros(PARAMETERS))
    some = among(one, [FAULTS[3], ("plate_drift", ("plate_9",)), FAULTS[0]])
    assert some.faults == (FAULTS[3], FAULTS[0]) and some.sizes == (6, 1) and some.information.shape == (7, 7)


def test_sessions_before_the_plate_was_moved_say_nothing_of_the_next() -> None:
    draw = np.random.default_rng(seed_of("since"))
    theta, at = np.zeros(PARAMETERS), columns(1)
    theta[at] = 1.0
    values = []
    for _ in range(LABORATORIES):
        moved = pooled(laboratory(draw, theta, SESSIONS // 2, dated=True))
        assert [one.effect for one in moved.faults if one.confidence > 0.5] == ["plate_gain"]
        whole = moved.expected.information + torch.eye(PARAMETERS).double()
        values.append(float(torch.linalg.solve(whole, moved.expected.moment)[at]))
    # It is half of it where the sessions before count: in one of 24 laboratories the date was not found.
    assert sum(abs(value - 1.0) < 0.3 for value in values) >= at_least(0.9, LABORATORIES)


def told_by(path: Path, gain: float, sd: float) -> Path:
    """A laboratory that knows the gain of the session's first plate, in units of its prior, and the plates' places."""
    base = outcome()
    own = [laboratory_plate(one) for one in session_plates(base.session)[0]]
    # Another list of the same plates, in another order.
    plates = tuple(
        LaboratoryPlate(replace(one.frame, name=f"plate_{k}"), one.corners)
        for k, one in enumerate(reversed(own), 1)
    )  # fmt: skip
    A, none = torch.full((1, 1), sd**-2).double(), torch.zeros(1).double()
    evidence = LaboratoryEvidence((("plate_gain", (f"plate_{len(own)}",)),), (1,), A, gain * A[0], 0.0 * A, none)
    write_netcdf(path, [laboratory_dataset(SessionEvidence(evidence, plates, pooled=True))])
    return path


def test_plates_are_found_by_their_places(tmp_path: Path) -> None:
    base = outcome()
    path = told_by(tmp_path / "lab.nc", 1.0, 0.1)
    given = replace(base, config=base.config.model_copy(update={"laboratory": path}))
    found = earlier_sessions(given.config.laboratory, given.session)
    first = session_plates(base.session)[0][0].frame.name
    assert found is not None and found.faults == (("plate_gain", (first,)),)
    assert earlier_sessions(None, base.session) is None


def test_a_laboratory_of_other_plates_is_refused(tmp_path: Path) -> None:
    base, path = outcome(), tmp_path / "lab.nc"
    away = here(session(np.random.default_rng(0), np.zeros(PARAMETERS)), away=50.0)
    write_netcdf(path, [laboratory_dataset(replace(away, pooled=True))])
    given = replace(base, config=base.config.model_copy(update={"laboratory": path}))
    with pytest.raises(InputError, match="none of these plates is one of the session's"):
        earlier_sessions(given.config.laboratory, given.session)


def test_one_session_alone_is_refused_whose_bodies_seem_to_be_a_late_clock(tmp_path: Path) -> None:
    draw, path = np.random.default_rng(seed_of("one session")), tmp_path / "laboratory.nc"
    late = among(one_more(draw, np.zeros(PARAMETERS)), [FAULTS[0]])
    A, _ = beside_bodies(late.information, late.moment, late.at[FAULTS[0]])
    assert float(integrated_out(A, A[0], torch.tensor([1]))[0]) < 0.5 * float(late.information), "most of it is the lag"
    write_netcdf(path, [laboratory_dataset(here(late))])
    with pytest.raises(InputError, match="one_session"):
        earlier_sessions(path, outcome().session)


GAIN = 0.0012
"""Of the plate: as large as the session's own standard deviation of it, so that alone it says nothing. A laboratory
that is off by nine of these is worth more than the price of an amount of the session's own."""


def with_a_gain() -> tuple[Outcome, Place]:
    """The session whose first plate has it, and the place."""
    base, own = outcome(), effect("plate_gain")
    place = Place((session_plates(base.session)[0][0].frame.name,))
    return planted(base, own.name, place, torch.tensor([GAIN]).double()), place


@cache
def alone_with_a_gain() -> Diagnosis:
    """What it says without any laboratory."""
    return diagnosed(with_a_gain()[0])


def said(outcome: Outcome, found: Diagnosis) -> str:
    """The report's words on a verdict."""
    section = diagnosis_section(replace(outcome, diagnosis=found))
    assert section is not None
    return section.finding


@pytest.mark.slow
@pytest.mark.parametrize("knows", [GAIN, -8.0 * GAIN])
def test_a_gain_is_named_by_a_laboratory_that_knows_it_and_by_no_other(tmp_path: Path, knows: float) -> None:
    (wrong, place), own = with_a_gain(), effect("plate_gain")
    (scale,) = own.scale(place)
    path = told_by(tmp_path / "lab.nc", knows / scale, 0.0002 / scale)
    found = diagnosed(replace(wrong, config=wrong.config.model_copy(update={"laboratory": path})))
    alone = alone_with_a_gain()
    assert found.earlier is not None and alone.earlier is None
    named = [(one.effect, one.where) for one in found.likely]
    if knows == GAIN:
        assert found.earlier.unlike is None and (own.name, place.where) in named
        assert not found.earlier.alone and verdict_table(found)["earlier_sessions"] == {"unlike": None, "alone": ()}
        assert "this one alone would not" in said(wrong, found)
    else:
        assert found.earlier.unlike is not None and found.earlier.unlike.effect == own.name
        assert named == [(one.effect, one.where) for one in alone.likely]
        assert "unlike the earlier ones" in said(wrong, found)
        assert "earlier" not in said(wrong, alone) and "earlier_sessions" not in verdict_table(alone)
