"""Sentences that people read, drawn by lot: does somebody who has not seen the project know what each one means?

    PYTHONPATH=.:scripts python -m documentation.sentences 40 --seed 7

Half come from the README and the pages under ``docs``, half from what the package says: literals that hold words and
end as a sentence, or stand in the raising of an error or in what a finding says.
"""

import argparse
import ast
import random
import re
from collections.abc import Iterator
from pathlib import Path

from documentation.pages import FENCE

ROOT = Path(__file__).resolve().parents[2]
FEWEST_WORDS = 6
NOT_SHOWN = {"CHANGELOG.md", "CONTRIBUTING.md", "decisions.md", "architecture.md", "extending.md", "real_battery.md"}
"""Pages for those who change the project."""


def of_pages() -> Iterator[tuple[str, str]]:
    """Place and text of every sentence of a page that a user reads."""
    for page in [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]:
        if page.name in NOT_SHOWN:
            continue
        for paragraph in re.split(r"\n\s*\n|\n(?=[-*|#\d])", FENCE.sub("", page.read_text())):
            plain = " ".join(paragraph.split())
            if plain and plain[0] not in "|#<!":
                yield from ((page.name, said) for said in re.split(r"(?<=[.!?]) (?=[A-Z*`])", plain) if _is_one(said))


def of_package() -> Iterator[tuple[str, str]]:
    """Place and text of every literal of the package that is a sentence, its values as ``{}``."""
    for path in sorted((ROOT / "torchid").rglob("*.py")):
        tree = ast.parse(path.read_text())
        silent = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
        parts = {id(part) for node in ast.walk(tree) if isinstance(node, ast.JoinedStr) for part in node.values}
        for node in ast.walk(tree):
            if id(node) in silent | parts or not isinstance(node, ast.JoinedStr | ast.Constant):
                continue
            said = " ".join(_text(node).split())
            if _is_one(said):
                yield f"{path.relative_to(ROOT)}:{node.lineno}", said


def _text(node: ast.JoinedStr | ast.Constant) -> str:
    if isinstance(node, ast.Constant):
        return node.value if isinstance(node.value, str) else ""
    return "".join(_text(part) if isinstance(part, ast.Constant) else "{}" for part in node.values)


def _is_one(said: str) -> bool:
    prose = re.search(r"\b(the|a|an|is|are|of|to|in|no|and|not)\b", said)
    code = re.search(r"[<>\\^]|\(\?", said)
    return bool(prose) and not code and len(re.findall(r"[A-Za-z]{2,}", said)) >= FEWEST_WORDS


def main() -> None:
    """Print the drawn sentences with their places."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("count", nargs="?", type=int, default=40)
    parser.add_argument("--seed", type=int, default=None)
    arguments = parser.parse_args()
    lot = random.Random(arguments.seed)  # noqa: S311 (a sample, no secret)
    pages, package = list(of_pages()), list(of_package())
    half = arguments.count // 2
    for k, (place, said) in enumerate(lot.sample(pages, half) + lot.sample(package, arguments.count - half), 1):
        print(f"{k}. [{place}] {said}")


if __name__ == "__main__":
    main()
