"""Pages of the API reference, one a module, from docstrings alone: nothing of torchid is imported."""

from collections.abc import Iterator
from pathlib import Path

import griffe

PACKAGE = "torchid"
FOLDER = "api"


def load(root: Path) -> griffe.Module:
    """What the source says of the package."""
    found = griffe.load(PACKAGE, search_paths=[root], resolve_aliases=True)
    assert isinstance(found, griffe.Module)
    return found


def page_of(module: griffe.Module) -> str:
    """Its page, from the top of the site."""
    parts = [FOLDER, *module.path.split(".")[1:], *(["index"] if module.is_init_module else [])]
    return "/".join(parts) + ".md"


def modules(package: griffe.Module) -> Iterator[griffe.Module]:
    """The package and all modules in it."""
    yield package
    for child in _children(package):
        yield from modules(child)


def _children(module: griffe.Module) -> list[griffe.Module]:
    own = [one for one in module.modules.values() if not one.is_alias and not one.name.startswith("_")]
    return sorted((one for one in own if isinstance(one, griffe.Module)), key=lambda one: one.name)


def write(package: griffe.Module, out: Path) -> None:
    """All pages under ``out/api``."""
    for module in modules(package):
        path = out / page_of(module)
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(_page(module), encoding="utf-8")


def _page(module: griffe.Module) -> str:
    children = _children(module)
    if not children and not module.is_init_module:
        return f"::: {module.path}\n"
    text = f"::: {module.path}\n    options: {{members: false}}\n"
    if module.path == PACKAGE:
        text += "\n## What `import torchid` offers\n\n" + _table(_exported(module))
    # A folder's own file may hold definitions beside its modules.
    own = [one.path for one in module.members.values() if not (one.is_alias or one.is_module) and one.is_public]
    text += "".join(f"\n::: {path}\n    options: {{heading_level: 2}}\n" for path in own if module.path != PACKAGE)
    here = str(Path(page_of(module)).parent)
    rows = [(f"[`{one.name}`]({page_of(one).removeprefix(here + '/')})", one) for one in children]
    return text + "\n## Modules\n\n" + _table(rows)


def _exported(package: griffe.Module) -> list[tuple[str, griffe.Object]]:
    named = [one for one in package.members.values() if isinstance(one, griffe.Alias)]
    inner = [(one.name, one.final_target) for one in named if one.target_path.startswith(f"{PACKAGE}.")]
    return [(f"[`{name}`][{target.path}]", target) for name, target in inner]


def _table(rows: list[tuple[str, griffe.Object]]) -> str:
    lines = [f"| {name} | {_summary(one)} |" for name, one in rows]
    return "\n".join(("| name | what it is |", "|---|---|", *lines, ""))


def _summary(one: griffe.Object) -> str:
    """The first paragraph of its docstring."""
    text = one.docstring.value.split("\n\n")[0] if one.docstring else ""
    return " ".join(text.split()).replace("|", "\\|")


def navigation(module: griffe.Module) -> list:
    """Entries of the site's menu, folders with their modules."""
    entries: list = [page_of(module)]
    for child in _children(module):
        inner = navigation(child)
        entries.append({child.name: inner if len(inner) > 1 else inner[0]})
    return entries
