"""Arguments are checked in the first calls of a function, in every test anew."""

import dataclasses
from collections.abc import Callable

import jaxtyping
import pytest
import torch
import type_checks
from beartype import beartype
from jaxtyping import Float, TypeCheckError
from torch import Tensor

from torchid.inertia.options import InertiaOptions
from torchid.kinematics import recursion
from torchid.recording import Markers


def doubled(x: Float[Tensor, " n"], y: Float[Tensor, " n"]) -> Float[Tensor, " n"]:
    """Two of one length."""
    return x + y[: len(x)]


def refused(function: Callable, *arguments: object) -> bool:
    """Whether a call is."""
    try:
        function(*arguments)
    except TypeCheckError:
        return True
    return False


def test_first_calls_are_checked_and_those_of_the_next_test_again():
    """A wrong shape passes only in calls that nobody looks at."""
    checked = type_checks.first_calls(typechecker=beartype)(doubled)
    x, longer = torch.zeros(3), torch.zeros(4)
    assert all(refused(checked, x, longer) for _ in range(type_checks.CALLS)) and not refused(checked, x, longer)
    type_checks.begin_test()
    assert refused(checked, x, longer) and not refused(checked, x, x)


def test_what_is_called_is_called_with_what_was_given():
    """Keywords, defaults and names are the function's own."""

    @type_checks.first_calls(typechecker=beartype)
    def power(x: float, *, by: int = 2) -> float:
        return x**by

    assert [power(3.0), power(3.0, by=3), power.__name__] == [9.0, 27.0, "power"]


def test_dataclasses_are_checked_when_they_are_made():
    """Also frozen ones."""

    @type_checks.first_calls(typechecker=beartype)
    @dataclasses.dataclass(frozen=True)
    class Pair:
        x: Float[Tensor, " n"]
        y: Float[Tensor, " n"]

    assert refused(Pair, torch.zeros(3), torch.zeros(4)) and not refused(Pair, torch.zeros(3), torch.zeros(3))


@pytest.mark.skipif(not hasattr(recursion.poses, "__wrapped__"), reason="types are checked in the quick tests alone")
def test_the_package_is_checked():
    """Its functions and its dataclasses, as they were imported."""
    assert jaxtyping.jaxtyped is type_checks.first_calls
    assert refused(Markers, ("a",), torch.zeros(2).double(), "no tensor")
    assert refused(InertiaOptions, 3.5, 3.5)
