"""What witnesses name and the body model finds again is one fault, or none."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from torch.testing import assert_close

from torchid.diagnosis.verdict.causes import parameter_table
from torchid.diagnosis.verdict.one_fault import joined
from torchid.diagnosis.verdict.records import Cause
from torchid.effects.catalogue import effect
from torchid.effects.place import Place

BODY = Place(("session",), grid={"recorded_kg": 70.0})
PLATE = Place(("plate_1",))


def named(name: str, place: Place, theta: list[float], sd: float, confidence: float = 0.95) -> Cause:
    """A cause as a verdict has it."""
    size = torch.tensor(theta, dtype=torch.float64)
    values = effect(name).estimated(place, size, sd**2 * torch.eye(len(size), dtype=torch.float64))
    return Cause(name, place.where, None, parameter_table(values), confidence, (), (), {}, place, size[None], ("walk",),
                 True)  # fmt: skip


def test_what_is_taken_back_was_never_there(seed):
    """A wrong weight that stood for a load leaves with its own undoing; the load stays."""
    rng = np.random.default_rng(seed)
    size, rest = float(rng.uniform(2.0, 5.0)), named("plate_offset", PLATE, [5.0, 0.0, 8.0, 0.0, 0.0, 0.0], 1.0)
    first = named("body_mass", BODY, [size], 0.8)
    again = named("body_mass", replace(BODY, grid={"recorded_kg": 70.0 + size}), [-size + 0.5], 0.8)
    left, others, trace = joined((first,), (rest, again))
    assert left == () and others == (rest,)
    assert [(one.rule, one.kind.value) for one in trace] == [("taken_back", "leave")] * 2
    assert math.isclose(trace[0].numbers["size_sd"], 0.5 / 0.8, rel_tol=1e-6)


def test_one_place_is_one_fault_of_the_summed_size(seed):
    """With the spread of what was found last, and against the record as it stands."""
    rng = np.random.default_rng(seed)
    one, two = (float(x) for x in rng.uniform(3.0, 6.0, 2))
    again = named("body_mass", replace(BODY, grid={"recorded_kg": 70.0 + one}), [two], 0.4)
    left, others, trace = joined((named("body_mass", BODY, [one], 0.9),), (again,))
    assert others == () and [step.rule for step in trace] == ["one_fault"]
    (cause,) = left
    assert_close(cause.parameters["mass_kg"]["value"], torch.tensor(70.0 + one + two, dtype=torch.float64))
    assert_close(cause.parameters["recorded_kg"]["value"], torch.tensor(70.0, dtype=torch.float64))
    assert_close(cause.parameters["mass_kg"]["sd"], torch.tensor(0.4, dtype=torch.float64))
    assert cause.theta.tolist() == [[one + two]]


def test_where_nothing_was_put_right_sizes_are_not_added():
    """What the body model finds in recordings as they are is the fault itself, and not what is left of it."""
    first, again = (
        named("plate_offset", PLATE, [0.0] * 5 + [40.0], 1.0),
        named("plate_offset", PLATE, [0.0] * 5 + [39.0], 1.0),
    )
    left, others, trace = joined((first,), (again,), put_right=False)
    assert left == (first,) and others == () and [step.rule for step in trace] == ["only_refined"]


@pytest.mark.parametrize("place", ["plate_1", "plate_2"])
def test_what_is_only_possible_or_elsewhere_changes_nothing(place):
    """A refinement that is only possible leaves; another plate's fault is another fault."""
    first = named("plate_offset", PLATE, [0.0, 0.0, 12.0, 0.0, 0.0, 0.0], 1.0)
    again = named("plate_offset", Place((place,)), [0.0, 0.0, -11.5, 0.0, 0.0, 0.0], 1.0, 0.4)
    left, others, trace = joined((first,), (again,))
    assert left == (first,)
    assert others == (() if place == "plate_1" else (again,))
    assert [step.rule for step in trace] == (["only_refined"] if place == "plate_1" else [])
