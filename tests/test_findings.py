"""Findings about instruments: a verdict, a stream and a check say the same things in the same form."""

import numpy as np
import pytest
import torch
from walker import walking_trial

from torchid.checks.clocks import Lateness
from torchid.checks.finding import InstrumentFault, Severity, record_of
from torchid.checks.instruments import late_forces, unloaded_reading
from torchid.diagnosis.verdict.instruments import FAULTS, instrument_findings
from torchid.diagnosis.verdict.records import Cause, Diagnosis
from torchid.effects.catalogue import CATALOGUE, effect
from torchid.effects.place import SESSION, Place
from torchid.io.mend import ForcesAs, PlateAs, mend
from torchid.live.estimation.watch import Notice
from torchid.observation.plate_registry import recognise
from torchid.recording import Forces


def cause(name: str, where: tuple[str, ...], parameters: dict[str, list[float]], confidence: float) -> Cause:
    """A cause with parameters whose deviations are a tenth of themselves."""
    values = {key: torch.tensor(value).double() for key, value in parameters.items()}
    both = {key: {"value": value, "sd": 0.1 * value.abs()} for key, value in values.items()}
    place = SESSION if where == SESSION.where else Place(where)
    return Cause(name, place.where, None, both, confidence, (), (), {}, place, torch.zeros(1, 1), (), True)


def told(causes: tuple[Cause, ...], forces: Forces):
    """What a verdict with these causes says of instruments; the rest of it is not asked."""
    plates, _ = recognise({"walk": forces})
    diagnosis = Diagnosis.__new__(Diagnosis)
    object.__setattr__(diagnosis, "causes", causes)
    object.__setattr__(diagnosis, "plates", plates)
    return instrument_findings(diagnosis)


def test_a_verdict_gives_the_line_that_mends(seed):
    """A gain and a place that the verdict names, read again with its lines, are undone; a pull on the body is none."""
    random, forces = np.random.default_rng(seed), walking_trial(seed).forces
    assert forces is not None
    gain, shift = (
        float(1.0 + random.choice([-1, 1]) * random.uniform(0.02, 0.1)),
        [*random.uniform(-0.05, 0.05, 2).round(4).tolist(), 0.0],
    )
    plates, _ = recognise({"walk": forces})
    one, two = (plate.frame.name for plate in plates)
    causes = (
        cause("plate_gain", (one,), {"gain": [gain]}, 0.97),
        cause("plate_pose", (two,), {"shift_m": shift, "rotation_rad": [0.0, 0.0, 0.0]}, 0.4),
        cause("time_offset", SESSION.where, {"lag_s": [0.0123]}, 0.999),
        cause("body_mass", SESSION.where, {"mass_kg": [2.0]}, 0.9),
    )
    first, second, third = told(causes, forces)
    assert first.config == f"plates: {{1: {{gain: {1.0 / gain:.4g}}}}}" and first.severity is Severity.PROBLEM
    assert second.fault is InstrumentFault.PLACE and second.unit == "m" and second.severity is Severity.WARNING
    assert second.size == pytest.approx(np.linalg.norm(shift)) and second.sd == pytest.approx(0.1 * second.size)
    assert third.config == "forces_as: {lag_ms: 12.3}" and third.size == pytest.approx(0.0123)
    for found in (first, second, third):
        record = record_of(found)
        assert record.message == found.note.message and record.found.endswith("%)") and record.config in record.remedy
    x, y, _ = shift
    assert second.cures[0].config == f"plates: {{2: {{shift_m: [{x:.6g}, {y:.6g}]}}}}"
    moved = mend(forces, ForcesAs(), {2: PlateAs(shift_m=(x, y))})
    assert moved is not None
    torch.testing.assert_close(moved.plates[1].corners, forces.plates[1].corners + torch.tensor(shift).double())


def test_every_fault_of_a_plate_has_a_name():
    """Effects that witnesses hear in the plates are faults of instruments; each of them exists."""
    assert set(FAULTS) <= set(CATALOGUE)
    assert {name for name in CATALOGUE if name.startswith("plate_")} <= set(FAULTS)
    assert all(effect(name).noun for name in FAULTS)


def test_a_stream_says_what_a_check_says():
    """A plate that reads 30 N unloaded, and a clock: the page of a stream has the words of the check."""
    for found in (unloaded_reading("plate 2", 30.0, "live.offset"), late_forces(Lateness(-0.04, 0.003), "live.clock")):
        notice = Notice.of(found)
        assert notice.text == found.message and f"live.{notice.what}" == found.code
    assert unloaded_reading("plate 2", 30.0, "plates.offset").message == Notice.of(
        unloaded_reading("plate 2", 30.0, "live.offset")
    ).text  # fmt: skip
