"""Every error says what to do."""

import ast
import pickle
from pathlib import Path

import pytest

from torchid.config.explain import InvalidConfig
from torchid.errors import ConfigError, InputError, OptionError, TorchidError

PACKAGE = Path(__file__).resolve().parents[1] / "torchid"
ERRORS = {"InputError", "DataError", "OptionError", "ConfigError", "TorchidError"}


def bare(path: Path) -> list[int]:
    """Lines of a module that make an error without a remedy, or with an empty one."""
    calls = [one for one in ast.walk(ast.parse(path.read_text(encoding="utf-8"))) if isinstance(one, ast.Call)]
    made = [one for one in calls if isinstance(one.func, ast.Name) and one.func.id in ERRORS]
    return [
        one.lineno
        for one in made
        if not any(key.arg == "remedy" and ast.unparse(key.value) not in ("''", '""') for key in one.keywords)
    ]


def test_every_error_has_a_remedy() -> None:
    """No place in the package makes an error that leaves the user alone."""
    assert not [f"{path.relative_to(PACKAGE)}:{line}" for path in PACKAGE.rglob("*.py") for line in bare(path)]


def test_an_error_without_a_remedy_is_found(tmp_path: Path) -> None:
    """In the source, and where it is made."""
    path = tmp_path / "some.py"
    path.write_text("InputError('a', 'b', remedy='c')\nInputError('a', 'b', remedy='')\nDataError('a', 'b')\n")
    assert bare(path) == [2, 3]
    with pytest.raises(TypeError, match="remedy"):
        InputError("a", "b")  # pyright: ignore[reportCallIssue]


def test_errors_come_back_from_another_process() -> None:
    """A worker's error ends its job alone, with its words: one that cannot be unpickled ends the whole pool."""
    one = OptionError("a.b", "what", source="file", place="where", found="this", remedy="Do that")
    for error in (
        one,
        InputError("a.c", "other", remedy="Do"),
        InvalidConfig([ConfigError("k", "key", remedy="Go"), one]),
    ):
        back = pickle.loads(pickle.dumps(error))  # noqa: S301
        assert type(back) is type(error) and str(back) == str(error) and isinstance(back, TorchidError)
        assert (back.code, back.source, back.place, back.remedy) == (
            error.code,
            error.source,
            error.place,
            error.remedy,
        )
