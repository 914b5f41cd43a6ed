"""This module checks shapes and types of arguments in the first calls of each function in a test, not in all.

jaxtyping's import hook decorates every function and dataclass of torchid, and a check takes tens of microseconds. Where
a solver calls the same function a hundred thousand times, the later calls tell nothing that the first ones did not.
What a function's checks need is made when it is first called: most are never called in one process.
"""

import dataclasses
import functools
from collections.abc import Callable
from typing import Any

import jaxtyping

CALLS = 10
"""Choice. Calls of a function that are checked in each test: later ones of the same test tell little beyond these."""
_checks = jaxtyping.jaxtyped
"""What checks every call."""
_test = 0
"""Number of the test that runs."""


def begin_test() -> None:
    """From now on the first calls of every function are checked again."""
    global _test  # noqa: PLW0603 - read in every call of every function
    _test += 1


def install() -> None:
    """Let what jaxtyping's import hook decorates from now on be checked so."""
    jaxtyping.jaxtyped = first_calls  # type: ignore[assignment]


def first_calls(*, typechecker: Callable) -> Callable:
    """A decorator that stands for ``jaxtyping.jaxtyped``.

    Args:
        typechecker: as there.
    """

    def decorated(what: Any) -> Any:
        if not isinstance(what, type):
            return _checked(what, typechecker)
        if dataclasses.is_dataclass(what) and not hasattr(what.__init__, "__wrapped__"):
            what.__init__ = _checked(what.__init__, typechecker)  # type: ignore[misc]
        return what

    return decorated


def _checked(plain: Callable, typechecker: Callable) -> Callable:
    every, test, left = None, -1, 0

    @functools.wraps(plain)
    def call(*args: Any, **kwargs: Any) -> Any:
        nonlocal every, test, left
        if test != _test:
            test, left = _test, CALLS
        if left <= 0:
            return plain(*args, **kwargs)
        left -= 1
        if every is None:
            every = _checks(plain, typechecker=typechecker)
        return every(*args, **kwargs)

    return call
