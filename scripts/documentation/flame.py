"""A flame graph of torchid's own functions, from the stacks of a sampling profiler (``scripts/flame``).

``python -m documentation.flame STACKS PICTURE``: STACKS has lines ``frame;frame;frame COUNT``, outermost first.
"""

import re
import sys
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

from markupsafe import escape

WIDTH, ROW, LETTER = 1200.0, 17.0, 6.2
"""Of the picture, of a row and of a letter [px]."""
NARROWEST = 0.004
"""Share of the time below which a function is left out; those above are to be read."""
COLOURS = ("#f4c7a1", "#f0d9a8", "#f2b8a0", "#ecd0b5")
OWN = re.compile(r"^(?P<name>.+) \((?P<file>torchid/[^:]+)(:\d+)?\)$")
IMPORT, IMPORTS = "_find_and_load (", "imports"


@dataclass
class Call:
    """A function below those that call it, and the samples that were taken in it."""

    name: str
    count: int = 0
    within: dict[str, "Call"] = field(default_factory=dict)


def own_frames(stack: str) -> list[str]:
    """The frames of torchid's functions but for those without a name; what is imported, whenever it is, is one frame.

    Args:
        stack: frames, outermost first, with semicolons between.
    """
    if IMPORT in stack:
        return [IMPORTS]
    found = [match for one in stack.split(";") if (match := OWN.match(one))]
    named = [(m["name"], m["file"].removeprefix("torchid/").removesuffix(".py")) for m in found]
    return [f"{name} ({file})" for name, file in named if not name.endswith(">")]


def tree_of(stacks: Iterable[str]) -> Call:
    """All stacks as one tree, whose root counts all samples.

    Args:
        stacks: lines of the profiler.
    """
    root = Call("run")
    for line in filter(str.strip, stacks):
        stack, _, count = line.rpartition(" ")
        root.count += int(count)
        at = root
        for name in own_frames(stack):
            at = at.within.setdefault(name, Call(name))
            at.count += int(count)
    return root


def boxes(call: Call, root: Call, left: float = 0.0, depth: int = 0) -> Iterator[tuple[Call, float, int]]:
    """The functions to draw, each with the share of the samples at its left and its row; widest first.

    Args:
        call: function from which on to draw.
        root: of the tree.
        left: share of the samples at its left.
        depth: its row.
    """
    yield call, left, depth
    for one in sorted(call.within.values(), key=lambda other: -other.count):
        if one.count >= NARROWEST * root.count:
            yield from boxes(one, root, left, depth + 1)
            left += one.count / root.count


def drawn(root: Call) -> str:
    """The picture as SVG: a row for each depth, each function as wide as its share, its words where they fit."""
    every = list(boxes(root, root))
    high = ROW * (1 + max(depth for _, _, depth in every))
    parts = []
    for call, left, depth in every:
        share = call.count / root.count
        words = escape(f"{call.name}, {100.0 * share:.1f} %")
        fits = int((WIDTH * share - 4.0) / LETTER)
        shown = escape(call.name if len(call.name) <= fits else call.name.split(" (")[0][:fits])
        colour = COLOURS[sum(map(ord, call.name)) % len(COLOURS)]
        parts.append(
            f'<g><title>{words}</title><rect x="{WIDTH * left:.1f}" y="{ROW * depth:.0f}" width="{WIDTH * share:.1f}" '
            f'height="{ROW - 1:.0f}" fill="{colour}"/>'
            f'<text x="{WIDTH * left + 2:.1f}" y="{ROW * depth + 12:.0f}">{shown if fits > 2 else ""}</text></g>'
        )
    style = "text { font: 10.5px monospace; fill: #111; }"
    head = f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH:.0f} {high:.0f}"><style>{style}</style>'
    return "\n".join([head, *parts, "</svg>", ""])


if __name__ == "__main__":
    source, picture = map(Path, sys.argv[1:])
    sampled = tree_of(source.read_text(encoding="utf-8").splitlines())
    if not sampled.count:
        sys.exit(f"{source}: nothing was sampled")
    picture.write_text(drawn(sampled), encoding="utf-8")
