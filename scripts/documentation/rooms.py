"""The rooms of the package and who imports whom, in docs/architecture.md, made of pyproject.toml and the docstrings.

PYTHONPATH=.:scripts python -m documentation.rooms
"""

import ast
import tomllib
from collections.abc import Iterator
from pathlib import Path

from documentation.marked import Part

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = ROOT / "torchid"
PAGE = ROOT / "docs" / "architecture.md"
ROOMS, LAYERS = Part(PAGE, "rooms"), Part(PAGE, "layers")


def contracts() -> list[dict]:
    """The contracts of import-linter that order layers, that of the whole package first."""
    found = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["importlinter"]["contracts"]
    return [one for one in found if one["type"] == "layers"]


def names(layer: str) -> list[str]:
    """Modules of one layer; those between bars do not import each other."""
    return [name.strip(" ()") for name in layer.split("|")]


def doc(path: Path) -> str:
    """First sentence of a module's docstring."""
    module = path / "__init__.py" if path.is_dir() else path.with_suffix(".py")
    text = ast.get_docstring(ast.parse(module.read_text(encoding="utf-8"))) or ""
    return " ".join(text.split("\n\n")[0].split())


def folders(path: Path) -> list[Path]:
    """Rooms within a room."""
    return sorted(one.parent for one in path.glob("*/__init__.py"))


def room_paths() -> list[Path]:
    """Every folder of the package, those within others included."""
    return sorted(one.parent for one in PACKAGE.rglob("__init__.py") if one.parent != PACKAGE)


def table() -> Iterator[str]:
    """A row a room in the order of the layers, from below: the way that data go."""
    yield from ("| room | what it is | files |", "|---|---|---|")
    for layer in reversed(contracts()[0]["layers"]):
        for name in names(layer):
            yield from _rows(PACKAGE / name)


def _rows(path: Path) -> Iterator[str]:
    shown = path.relative_to(PACKAGE).as_posix()
    count = len([one for one in path.glob("*.py") if one.name != "__init__.py"]) if path.is_dir() else 1
    yield f"| `{shown}` | {doc(path)} | {count} |"
    for inner in folders(path) if path.is_dir() else []:
        yield from _rows(inner)


def lines() -> Iterator[str]:
    """The order of each contract, from the top to the bottom."""
    for contract in contracts():
        (container,) = contract["containers"]
        yield f"- `{container}`: " + " > ".join(" \\| ".join(names(layer)) for layer in contract["layers"])


if __name__ == "__main__":
    ROOMS.write("\n".join(table()))
    LAYERS.write("\n".join(lines()))
