"""Docstrings are sentences about what goes in and comes out; what was measured stands in docs/decisions.md.

Both rules are checked by heuristics on the text, which are kept short: openings that only fragments have, and phrases
that only stories have. Where one takes a good sentence for something else, the sentence is easily put in other words.
"""

import ast
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

PACKAGE = Path(__file__).resolve().parents[1] / "torchid"
FOLDERS = ("geometry", "observation", "diagnosis", "effects")
"""Folders of the package whose docstrings are held to the rules, subfolders included."""

Definition = ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef

FRAGMENT = re.compile(
    # a preposition: the subject is in the name of the function or in another sentence
    r"(?:of|in|by|with|without|from|at|on|for|to|under|between|among|against|per|over|below|above|beside|like"
    # a relative clause or an indirect question: the sentence that it belongs to is missing
    r"|that|those|which|who|whose|whom|what|whatever|whether|how|why|where|when|while|if|because"
    # a pronoun, a comparison or a reference: its noun is somewhere else
    r"|it|its|they|their|the same|the others?|the rest|likewise|also|as|see|and|but|or|so|then)\b",
    re.IGNORECASE,
)
FIGURE = r"(?<![\w.^-])\d+(?:\.\d+)? ?(?:%|(?:N|nats?|kg|m|mm|s|ms|rad|Hz|times|frames|iterations)\b)"
STORY = re.compile(
    # what happened once, where a rule would be in the present tense
    r"\b(?:was|were) (?:found (?:in|on|to|with|by)|named|taken for)\b|\bhad been\b|\bcame out (?:as|at)\b"
    # where it happened
    r"|\bin (?:one|that) (?:session|recording|trial of|landing|walk)\b|\bon real (?:walks|recordings|data)\b"
    r"|\b(?:one|two|three|four|five|\d+) of (?:three|four|five|six|eight|ten|\d+) [a-z]+s\b"
    # what it cost, in figures
    r"|\b(?:cost|took|fell|rose|raised|ended|stayed|drew|gave|led|left|made|held|gained|lost|hid)\b"
    rf"[^.;:]*{FIGURE}",
    re.IGNORECASE,
)


KIND = re.compile(r"^(Derived|Cited|Calibrated|Resolution|Estimator|Proposal|Wording)\. ")
"""The kind of a threshold or a constant, which stands before its sentence."""


@dataclass(frozen=True)
class Docstring:
    """A docstring with the place where it stands."""

    where: str
    text: str

    @property
    def plain(self) -> str:
        """Return the text on one line, without marks of literals and emphasis."""
        return re.sub(r"[`*]", "", KIND.sub("", " ".join(self.text.split())))

    @property
    def opening(self) -> str:
        """Return the first sentence."""
        return re.split(r"(?<=[.!?:])\s", self.plain, maxsplit=1)[0]


def _silent(tree: ast.Module, told: dict[str, set[str]]) -> Iterator[tuple[int, str]]:
    """Yield line and name of public definitions without a docstring, but for methods whose base's docstring holds."""
    for node in tree.body:
        if not isinstance(node, Definition) or node.name.startswith("_"):
            continue
        if not ast.get_docstring(node):
            yield node.lineno, node.name
        for method in node.body if isinstance(node, ast.ClassDef) else ():
            if isinstance(method, ast.FunctionDef) and method.name not in told[node.name]:
                if not method.name.startswith("_"):
                    yield method.lineno, f"{node.name}.{method.name}"


def _told(trees: list[ast.Module]) -> dict[str, set[str]]:
    """Return the methods with a docstring of every class, its bases' in the same folder included."""
    classes = {node.name: node for tree in trees for node in tree.body if isinstance(node, ast.ClassDef)}

    def methods(node: ast.ClassDef) -> set[str]:
        own = {one.name for one in node.body if isinstance(one, ast.FunctionDef) and ast.get_docstring(one)}
        bases = [classes[name] for base in node.bases if (name := ast.unparse(base).split("[")[0]) in classes]
        return own.union(*map(methods, bases))

    return {name: methods(node) for name, node in classes.items()}


def _docstrings(tree: ast.Module) -> Iterator[tuple[int, str]]:
    """Yield line and text of all docstrings of a module, those below constants and fields included."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
            yield node.lineno, node.value.value


def _modules(folder: str) -> list[tuple[str, ast.Module]]:
    """Return the path and the syntax tree of every module of a folder."""
    paths = sorted((PACKAGE / folder).rglob("*.py"))
    assert paths, f"no module in {folder}"
    return [(str(p.relative_to(PACKAGE.parent)), ast.parse(p.read_text(encoding="utf-8"))) for p in paths]


def _texts(folder: str) -> list[Docstring]:
    return [Docstring(f"{name}:{line}", text) for name, tree in _modules(folder) for line, text in _docstrings(tree)]


def _report(offenders: list[str]) -> str:
    return "\n  ".join([f"{len(offenders)} offenders", *offenders])


@pytest.mark.parametrize("folder", FOLDERS)
def test_all_that_is_public_has_a_docstring(folder: str) -> None:
    """Public functions, classes and methods say what they are."""
    modules = _modules(folder)
    told = _told([tree for _, tree in modules])
    found = [f"{name}:{line} {what}" for name, tree in modules for line, what in _silent(tree, told)]
    assert not found, _report(found)


@pytest.mark.parametrize("folder", FOLDERS)
def test_docstrings_begin_with_a_sentence(folder: str) -> None:
    """No docstring begins as a fragment does, and every first sentence has at least two words and an end."""
    found = [
        f"{one.where} {one.opening}"
        for one in _texts(folder)
        if FRAGMENT.match(one.opening) or len(one.opening.split()) < 2 or one.opening[-1] not in ".!?:"
    ]
    assert not found, _report(found)


@pytest.mark.parametrize("folder", FOLDERS)
def test_docstrings_tell_no_stories(folder: str) -> None:
    """No docstring argues by what happened once; such figures belong into docs/decisions.md."""
    found = [f"{one.where} ... {told[0]} ..." for one in _texts(folder) if (told := STORY.search(one.plain))]
    assert not found, _report(found)


@pytest.mark.parametrize(
    ("text", "fragment"),
    [
        ("Of the frames.", True),
        ("The same with limits.", True),
        ("Whether it costs too much.", True),
        ("``with`` the markers' weights [1/m^2].", True),
        ("Index of the frame.", False),
        ("Return the prior of xi.", False),
        ("Offsets are linear in xi.", False),
        ("Torques of the joints [N m].", False),
    ],
)
def test_fragments_are_told_from_sentences(text: str, fragment: bool) -> None:
    """Whole words at the beginning make a fragment, letters do not."""
    assert bool(FRAGMENT.match(Docstring("", text).opening)) == fragment


@pytest.mark.parametrize(
    ("text", "story"),
    [
        ("In one session the pelvis leaps.", True),
        ("On walks without noise it raised the force residual from 25 N to 41 N.", True),
        ("Of 288 drawn starts ten ended with 3 to 14 % of the frames so.", True),
        ("A shift had been taken for mass.", True),
        ("Three of four trials show it.", True),
        ("Damping them for it cost 50 iterations instead of 5.", True),
        ("Evaluate the cost of each frame, zero where the weight is.", False),
        ("Return the share that was removed, 0 to 1.", False),
        ("Cut-off of the course (6 Hz at 100 Hz); chosen.", False),
        ("Postures at which the run is found, for all frames of a session.", False),
    ],
)
def test_stories_are_told_from_rules(text: str, story: bool) -> None:
    """Events of the past and figures after them make a story, figures alone do not."""
    assert bool(STORY.search(text)) == story
