"""What README and pages say can be done can be done: examples run, links lead somewhere, pages are found.

Every fenced ``python`` block of README.md, CONTRIBUTING.md and docs/*.md is run; ``python no-run`` marks a fragment,
``python continue`` a block that goes on where the one before it ended, and a ``title=`` a file (see
``scripts/documentation/examples.py``).
"""

import re
import sys
from pathlib import Path

import pytest
import yaml
from documentation.joints import joint_table

from torchid.config import load_config
from torchid.model.whole_body import whole_body

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "scripts"))

from documentation.examples import Block, all_runs, blocks, perform, runs
from documentation.links import broken, unlinked
from documentation.marked import Part
from documentation.pages import anchors, pages

PROJECT = Path(__file__).resolve().parents[1]
README = PROJECT / "README.md"


def name(run: list[Block]) -> str:
    """Page and line."""
    return f"{run[0].page.relative_to(PROJECT)}:{run[0].line}"


@pytest.mark.slow
@pytest.mark.usefixtures("no_report")
@pytest.mark.parametrize("run", all_runs(PROJECT), ids=name)
def test_examples_run(run, tmp_path):
    """Every example runs as printed, in a folder of its own, and says something; errors of markers are plausible."""
    said = "".join(perform(run, tmp_path))
    assert said
    errors = [float(error) for error in re.findall(r"([\d.]+) mm on a trial", said)]
    assert (errors or run[0].page != README) and all(0.5 < error < 10.0 for error in errors)


def test_configs_are_valid(tmp_path):
    """The README's example config loads once the files that it names exist."""
    for k, block in enumerate(blocks(README, "yaml")):
        for trial in yaml.safe_load(block.code)["trials"]:
            for key in ("file", "forces"):
                (tmp_path / trial[key]).parent.mkdir(exist_ok=True)
                (tmp_path / trial[key]).touch()
        path = tmp_path / f"config_{k}.yaml"
        path.write_text(block.code)
        assert load_config(path, ["geometry.solver=lbfgs"]).markers == "opencap"
    assert blocks(README, "yaml")


def test_the_joint_table_is_the_models():
    """The published table is what the model prints."""
    assert Part(PROJECT / "docs" / "conventions.md", "joints").read() == joint_table(whole_body(None, None).tree)


def test_links_lead_somewhere():
    """No page links a file or a heading that is not there, or an address that cannot be one."""
    assert not broken(PROJECT)


def test_every_page_is_found():
    """README or docs/index.md links each page."""
    assert not unlinked(PROJECT)


def test_scripts_that_are_named_exist():
    """Pages name no command that is gone."""
    texts = [page.read_text(encoding="utf-8") for page in pages(PROJECT)]
    named = {one for text in texts for one in re.findall(r"scripts/[\w./]+\w", text)}
    assert {"scripts/demo", "scripts/test", "scripts/docs"} <= named
    assert not [one for one in sorted(named) if not (PROJECT / one).exists()]


def test_broken_links_are_told(tmp_path):
    """Each kind of fault is found at its line; links in code are none."""
    (tmp_path / "docs").mkdir()
    (tmp_path / "docs" / "other.md").write_text("# A `B`, c!\n\n## Twice\n\n## Twice\n\n[up](../README.md#top)\n")
    (tmp_path / "README.md").write_text(
        "# Top\n[good](docs/other.md#a-b-c) [good](docs/other.md#twice-1) [good](#top) `[code](no.md)`\n"
        "```python\n[code](no.md)\n```\n[gone](docs/no.md)\n![gone](no.svg 'title')\n"
        "[heading](docs/other.md#twice-2)\n[web](https://example.org/a_(b)?c=d#e) [web](https:/no)\n"
        "[out](../x.md)\n[ref]\n\n[ref]: docs/nowhere.md\n<a href=\"gone.html\">x</a> [mail](mailto:nobody)\n"
    )  # fmt: skip
    told = [line.split(": ")[:2] for line in broken(tmp_path)]
    expected = [
        ("6", "docs/no.md"), ("7", "no.svg"), ("8", "docs/other.md#twice-2"), ("9", "https:/no"), ("10", "../x.md"),
        ("13", "docs/nowhere.md"), ("14", "gone.html"), ("14", "mailto:nobody"),
    ]  # fmt: skip
    assert sorted(told) == sorted([f"README.md:{line}", target] for line, target in expected)
    (tmp_path / "docs" / "alone.md").write_text("nobody links it\n")
    assert unlinked(tmp_path) == ["docs/alone.md"]
    assert anchors("# X\n```\n# no heading\n```\n# X #\n") == {"x", "x-1"}


def test_blocks_say_whether_they_run(tmp_path):
    """Fragments and files are left out, continued blocks share names, and an unknown word is an error."""
    page = tmp_path / "page.md"
    page.write_text(
        "```python\na = 1\n```\n```python no-run\na = ...\n```\n- item\n  ```python continue\n  print(a)\n  ```\n"
        '```python title="a.py"\nreturn\n```\n````markdown\n```python\nfail\n```\n````\n```pythonic\nfail\n```\n'
    )
    (run,) = runs(page)
    assert [block.line for block in run] == [2, 9] and perform(run, tmp_path) == ["", "1\n"]
    page.write_text("```python norun\n```\n")
    with pytest.raises(ValueError, match="norun"):
        runs(page)
