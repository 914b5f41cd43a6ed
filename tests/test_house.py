"""The house is as its page says: rooms, layers, and one meaning for each public name."""

import ast
import sys
from collections import defaultdict
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "scripts"))

from documentation.rooms import LAYERS, PACKAGE, ROOMS, contracts, doc, lines, names, room_paths, table

MOST_ROOMS = 36
"""Choice. Folders and single modules of the package, as its contract of layers orders them."""


def test_the_page_shows_rooms_and_layers_as_they_are():
    """docs/architecture.md is what pyproject.toml and docstrings say; ``python -m documentation.rooms`` writes it."""
    assert ROOMS.read() == "\n".join(table())
    assert LAYERS.read() == "\n".join(lines())


def test_every_room_says_what_it_is():
    """Its docstring is its row in the page."""
    assert not [str(path) for path in room_paths() if len(doc(path)) < 15]


def test_there_are_few_rooms():
    """A newcomer can learn their names."""
    assert sum(len(names(layer)) for layer in contracts()[0]["layers"]) <= MOST_ROOMS


def test_no_public_class_name_stands_twice():
    """One name means one thing, all over the package."""
    places = defaultdict(list)
    for path in sorted(PACKAGE.rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                places[node.name].append(str(path.relative_to(PACKAGE)))
    assert not {name: found for name, found in places.items() if len(found) > 1}
