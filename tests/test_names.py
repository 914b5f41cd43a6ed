"""Every name in the code is defined; ruff cannot tell by itself, for jaxtyping's shapes are words in strings."""

import ast
import json
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]


def strings(path: Path) -> list[tuple[tuple[int, int], tuple[int, int]]]:
    """Where string constants begin and end: line and column, from one."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    return [
        ((one.lineno, one.col_offset + 1), (one.end_lineno or one.lineno, (one.end_col_offset or 0) + 1))
        for one in ast.walk(tree)
        if isinstance(one, ast.Constant) and isinstance(one.value, str)
    ]


def undefined(folder: Path) -> list[str]:
    """Names outside strings that nothing defines, and capitalised ones in strings, which are types."""
    command = [sys.executable, "-m", "ruff", "check", "--select", "F821", "--isolated", "--exit-zero"]
    done = subprocess.run(
        [*command, "--output-format", "json", str(folder)], capture_output=True, text=True, check=True
    )
    found = []
    for one in json.loads(done.stdout):
        path, at = Path(one["filename"]), (one["location"]["row"], one["location"]["column"])
        name = one["message"].split("`")[1]
        if name[0].isupper() or not any(start <= at < end for start, end in strings(path)):
            found.append(f"{path.name}:{at[0]} {name}")
    return found


def test_every_name_is_defined():
    """In the package, its scripts and its tests."""
    assert not [one for folder in ("torchid", "scripts", "tests") for one in undefined(ROOT / folder)]


def test_an_undefined_name_is_found(tmp_path):
    """A word of a shape is none, a type in quotes and a bare name are."""
    (tmp_path / "some.py").write_text(
        'from jaxtyping import Float\nfrom torch import Tensor\n\n\n'
        'def f(x: Float[Tensor, "frames 3"]) -> "Lost":\n    return x + LOST_N\n'
    )  # fmt: skip
    assert [one.split()[1] for one in undefined(tmp_path)] == ["Lost", "LOST_N"]
