"""Every threshold that decides a verdict stands in ``DiagnosisOptions``, with its kind and its source."""

import ast
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "scripts"))

from documentation.thresholds import PAGE, rows, table

from torchid.diagnosis.options import ThresholdKind, threshold_kinds

PACKAGE = Path(__file__).resolve().parents[1] / "torchid"
ROOMS = sorted(path for room in ("diagnosis", "observation", "effects") for path in (PACKAGE / room).rglob("*.py"))
PLAIN = (0, 1, 2, 3)
"""Numbers that count or tell signs; more than a millionth, they are no guards against division by zero."""
FINELY = ("Resolution. ", "Estimator. ", "Proposal. ", "Wording. ")
"""How the docstring of a module's constant begins, none of which decides by itself (``torchid.diagnosis.options``)."""


@pytest.mark.parametrize("name", sorted(threshold_kinds()))
def test_a_threshold_has_a_kind_and_a_reason(name):
    """Derived, cited or calibrated; a reason is a sentence, a source has a year."""
    kind, reason = threshold_kinds()[name]
    assert len(reason) > 40 and reason.endswith("."), name
    assert kind is not ThresholdKind.CITED or any(word in reason for word in ("(19", "(20", "contract")), name


def documented(tree: ast.Module) -> dict[str, str]:
    """Docstrings of the constants of a module."""
    found = {}
    for own, behind in zip(tree.body, tree.body[1:], strict=False):
        if isinstance(own, ast.Assign) and isinstance(behind, ast.Expr) and isinstance(behind.value, ast.Constant):
            for target in own.targets:
                found |= {n.id: str(behind.value.value) for n in ast.walk(target) if isinstance(n, ast.Name)}
    return found


def constants(tree: ast.Module) -> set[str]:
    """Names of a module's constants that hold numbers."""
    return {
        n.id
        for own in tree.body
        if isinstance(own, ast.Assign) and any(isinstance(x, ast.Constant) and isinstance(x.value, int | float)
                                               for x in ast.walk(own.value))
        for target in own.targets
        for n in ast.walk(target)
        if isinstance(n, ast.Name)
    }  # fmt: skip


@pytest.mark.parametrize("path", ROOMS, ids=lambda path: str(path.relative_to(PACKAGE)))
def test_no_module_has_a_threshold_of_its_own(path):
    """Its constants say how finely something is computed, or are of the statistical model, with a source."""
    if path.name == "options.py":
        return
    tree = ast.parse(path.read_text(encoding="utf-8"))
    docs = documented(tree)
    bare = sorted(name for name in constants(tree) if not docs.get(name, "").startswith(FINELY))
    assert not bare, f"no kind beside {', '.join(bare)}"


@pytest.mark.parametrize("path", ROOMS, ids=lambda path: str(path.relative_to(PACKAGE)))
def test_nothing_is_compared_with_a_bare_number(path):
    """But for signs, counts and guards against division by zero."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    found = [
        f"line {one.lineno}: {ast.unparse(one)}"
        for one in ast.walk(tree)
        if isinstance(one, ast.Compare)
        for side in (one.left, *one.comparators)
        for x in ast.walk(side)
        if isinstance(x, ast.Constant) and type(x.value) in (int, float)
        and x.value not in PLAIN and abs(x.value) > 1e-6 and isinstance(side, ast.Constant | ast.UnaryOp)
    ]  # fmt: skip
    assert not found, found


def test_the_page_has_the_thresholds_as_they_are():
    """Name, value, kind and reason of each, as ``documentation.thresholds`` writes them."""
    assert table(PAGE.read_text(encoding="utf-8")).splitlines() == list(rows())
