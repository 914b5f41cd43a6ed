"""Runs the gallery and builds the site of all pages and the API reference into out/docs/site."""

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import yaml

from documentation import examples, reference
from documentation.finish import finish
from documentation.links import Link, links
from documentation.pages import FENCE, pages

ROOT = Path(__file__).resolve().parents[2]
OUT = ROOT / "out" / "docs"
SHOWN = ROOT / "docs" / "gallery.md"
"""The page whose examples are run, so that what they print and draw is shown."""
_PRINTED = re.compile(r"\s*^```text\n.*?^```$", re.M | re.S)


def main() -> None:
    """Make the site anew."""
    parser = argparse.ArgumentParser(prog="scripts/docs", description=__doc__)
    parser.add_argument("--no-run", action="store_true", help="show the gallery without running it")
    arguments = parser.parse_args()
    shutil.rmtree(OUT, ignore_errors=True)
    source, package = OUT / "source", reference.load(ROOT)
    for page in pages(ROOT):
        results = {} if arguments.no_run or page != SHOWN else _results(page, source / "docs")
        _stage(page, source, results)
    reference.write(package, source)
    _build(package)
    finish(OUT / "site")
    print(f"The site: {OUT / 'site' / 'index.html'}")


def _results(page: Path, pictures: Path) -> dict[int, str]:
    """What each block prints and draws, by the block's end in the page."""
    found = {}
    pictures.mkdir(parents=True, exist_ok=True)
    for run in examples.runs(page):
        with tempfile.TemporaryDirectory() as folder:
            said = examples.perform(run, Path(folder))
            drawn = sorted(Path(folder).glob("*.svg"))
            for picture in drawn:
                shutil.copy(picture, pictures)
        shown = "".join(f"\n\n![{one.stem.replace('_', ' ')}]({one.name})" for one in drawn)
        for block, text in zip(run, said, strict=True):
            found[block.end] = f"\n\n```text\n{text}```" if text else ""
        found[run[-1].end] += shown
    return found


def _stage(page: Path, source: Path, results: dict[int, str]) -> None:
    """Copy a page to its place in the site's source, with what it links and the results of its examples."""
    text = page.read_text(encoding="utf-8")
    for end, result in sorted(results.items(), reverse=True):
        rest = text[end:]
        printed = _PRINTED.match(rest)
        text = text[:end] + result + (rest[printed.end() :] if printed else rest)
    text = FENCE.sub(_plain_fence, text)
    for link in links(page):
        if not link.external and link.path.suffix != ".md":
            text = _relinked(text, link, source)
    place = source / page.relative_to(ROOT)
    place.parent.mkdir(parents=True, exist_ok=True)
    place.write_text(text, encoding="utf-8")


def _plain_fence(match: re.Match) -> str:
    """The block without the words of ``examples``, which the site's highlighter does not know."""
    info = " ".join(word for word in match["info"].split(" ") if word not in (examples.CONTINUE, examples.SKIP))
    return match[0].replace(match["info"], info, 1) if info else match[0]


def _relinked(text: str, link: Link, source: Path) -> str:
    """A link to a module leads to its reference, one to another file to a copy; a folder is only named."""
    inside = link.path.relative_to(ROOT)
    if inside.parts[0] == reference.PACKAGE and (link.path.suffix == ".py" or link.path.is_dir()):
        parts = [part for part in inside.with_suffix("").parts[1:] if part != "__init__"]
        module = Path(os.path.relpath(ROOT, link.page.parent), reference.FOLDER, *parts)
        package = link.path.is_dir() or link.path.name == "__init__.py"
        return text.replace(f"]({link.target})", f"]({module / 'index.md' if package else f'{module}.md'})")
    if link.path.is_dir():
        return re.sub(rf"\[([^\]]*)\]\({re.escape(link.target)}\)", r"\1", text)
    (source / inside).parent.mkdir(parents=True, exist_ok=True)
    shutil.copy(link.path, source / inside)
    return text


def _build(package: object) -> None:
    """Run MkDocs; any warning of it is an error."""
    base = os.path.relpath(Path(__file__).with_name("mkdocs.yml"), OUT)
    project = [name for name in ("CONTRIBUTING.md", "CHANGELOG.md") if (ROOT / name).exists()]
    menu = [{"torchid": "README.md"}, {"Pages": _order()}, {"Reference": reference.navigation(package)},
            {"Project": project}]  # fmt: skip
    config = {"INHERIT": base, "docs_dir": "source", "site_dir": "site", "nav": menu}
    (OUT / "mkdocs.yml").write_text(yaml.safe_dump(config, sort_keys=False), encoding="utf-8")
    command = [sys.executable, "-m", "mkdocs", "build", "--quiet", "--config-file", str(OUT / "mkdocs.yml")]
    subprocess.run(command, check=True)  # noqa: S603


def _order() -> list[str]:
    """Pages of docs/ as docs/index.md lists them, the rest after them."""
    first = ROOT / "docs" / "index.md"
    listed = [link.path for link in links(first) if not link.external]
    own = [page for page in (first, *listed, *pages(ROOT)) if page.suffix == ".md" and (ROOT / "docs") in page.parents]
    return list(dict.fromkeys(str(page.relative_to(ROOT)) for page in own))


if __name__ == "__main__":
    main()
