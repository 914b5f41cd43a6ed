"""The tables of all config keys in docs/config.md, made of the models that read a config.

PYTHONPATH=.:scripts python -m documentation.config_keys
"""

import dataclasses
import re
import types
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

from pydantic import BaseModel
from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined

from documentation.marked import Part
from documentation.pages import anchors
from torchid.config import Config, GroupQuestion, Study
from torchid.diagnosis.options import field_docs

PAGE = Path(__file__).resolve().parents[2] / "docs" / "config.md"
PART = Part(PAGE, "keys")
REQUIRED = object()
"""Default of a key that has none."""
_UNITS = {
    "kg": "kg", "m": "m", "mm": "mm", "hz": "Hz", "s": "s", "ms": "ms", "deg": "deg", "n": "N", "N": "N",
    "m_s": "m/s", "N_s": "N/s", "nats": "nats", "years": "years",
}  # fmt: skip
"""Unit of a key by what its name ends in, longest first where two fit."""
_KINDS = ("Derived. ", "Cited. ", "Calibrated. ", "Choice. ", "Chosen: ")
"""What the docstring of a threshold begins with."""
_WORDS: dict[Any, str] = {
    bool: "`true`, `false`", int: "whole number", float: "number", str: "text", Path: "path", type(None): "none",
}  # fmt: skip


@dataclass(frozen=True)
class Key:
    """One key of a section."""

    name: str
    hint: Any
    default: Any
    """``REQUIRED`` where there is none."""
    doc: str
    """Its docstring, empty where it has none."""

    @property
    def unit(self) -> str:
        """Unit by the name's end, else the one in brackets that ends a clause of the docstring; empty without any."""
        ends = [own for own in sorted(_UNITS, key=len, reverse=True) if self.name.endswith(f"_{own}")]
        bracket = re.search(r"\[(rad|m|s|kg|mm|N)\](?=[.:;])", self.doc)
        return _UNITS[ends[0]] if ends else bracket[1] if bracket else ""

    @property
    def meaning(self) -> str:
        """The first sentence of its docstring, without the kind of a threshold."""
        text = " ".join(self.doc.split())
        for kind in _KINDS:
            text = text.removeprefix(kind)
        text = re.sub(r"`{2}", "`", text)
        return re.split(r"(?<=[.]) (?=[A-Z0-9])", text)[0].rstrip(".")


@cache
def keys(section: type) -> tuple[Key, ...]:
    """The keys of a section, those of its parents included."""
    docs: dict[str, str] = {}
    for parent in reversed(section.__mro__):
        if getattr(parent, "__module__", "").startswith("torchid"):
            docs |= field_docs(parent)
    hints = get_type_hints(section, include_extras=True)
    if issubclass(section, BaseModel):
        made = {name: own.get_default(call_default_factory=True) for name, own in section.model_fields.items()}
        defaults = {name: REQUIRED if default is PydanticUndefined else default for name, default in made.items()}
    else:
        defaults = {own.name: _default(own) for own in dataclasses.fields(section)}
    return tuple(Key(name, hints[name], default, docs.get(name, "")) for name, default in defaults.items())


def _default(own: Any) -> Any:
    if own.default_factory is not dataclasses.MISSING:
        return own.default_factory()
    return REQUIRED if own.default is dataclasses.MISSING else own.default


@cache
def sections(root: type) -> dict[type, list[str]]:
    """Every section below a model, the model first, with the places at which it stands, as ``trials[].plates.ID``."""
    found: dict[type, list[str]] = {root: [""]}
    for section, path in _below(root, ""):
        found.setdefault(section, []).append(path)
    return found


def _below(section: type, place: str) -> Iterator[tuple[type, str]]:
    for key in keys(section):
        for inner, path in _inside(key.hint, f"{place}.{key.name}".lstrip(".")):
            yield inner, path
            yield from _below(inner, path)


def _inside(hint: Any, path: str) -> Iterator[tuple[type, str]]:
    """Sections within a type, with the place of each."""
    if is_section(hint):
        yield hint, path
    origin, parts = get_origin(hint), get_args(hint)
    if origin is Annotated:
        yield from _inside(parts[0], path)
    elif origin is tuple:
        yield from _inside(parts[0], f"{path}[]")
    elif origin is dict:
        yield from _inside(parts[1], f"{path}.{'ID' if parts[0] is int else 'NAME'}")
    elif origin in (Union, types.UnionType):
        for part in parts:
            yield from _inside(part, path)


def is_section(hint: Any) -> bool:
    """Whether a type is a mapping of keys of its own."""
    plain = isinstance(hint, type) and get_origin(hint) is None
    return plain and (issubclass(hint, BaseModel) or dataclasses.is_dataclass(hint))


def in_words(hint: Any, titles: Mapping[type, str]) -> str:
    """A type as the page has it.

    Args:
        hint: the type.
        titles: heading of every section.
    """
    if is_section(hint):
        (anchor,) = anchors(f"# {titles[hint]}")
        return f"[section](#{anchor})"
    origin, parts = get_origin(hint), get_args(hint)
    if origin is Annotated:
        return _bounded(in_words(parts[0], titles), parts[1:])
    if origin is Literal:
        return ", ".join(f"`{part}`" for part in parts)
    if origin is tuple:
        if parts[-1] is Ellipsis:
            return f"list of {in_words(parts[0], titles)}"
        return f"list of {len(parts)}: {in_words(parts[0], titles)}"
    if origin is dict:
        return f"mapping of {in_words(parts[0], titles)} to {in_words(parts[1], titles)}"
    if origin in (Union, types.UnionType):
        return " or ".join(dict.fromkeys(in_words(part, titles) for part in parts if part is not type(None)))
    return _WORDS.get(hint, "list" if hint is list else str(hint))


def _bounded(word: str, bounds: tuple[Any, ...]) -> str:
    flat = [inner for own in bounds for inner in (own.metadata if isinstance(own, FieldInfo) else [own])]
    signs = (("gt", ">"), ("ge", ">="), ("lt", "<"), ("le", "<="))
    said = [f"{sign} {getattr(own, name)}" for own in flat for name, sign in signs if hasattr(own, name)]
    return f"{word} {', '.join(said)}" if said else word


def default_in_words(default: Any) -> str:
    """A default as a config writes it; empty for a section."""
    if default is REQUIRED:
        return "**required**"
    if default is None:
        return "none"
    if isinstance(default, bool):
        return f"`{str(default).lower()}`"
    if isinstance(default, tuple | list):
        return f"`[{', '.join(f'{one:g}' if isinstance(one, float) else str(one) for one in default)}]`"
    if is_section(type(default)):
        return ""
    return f"`{default:g}`" if isinstance(default, float) else f"`{default}`"


def rows() -> Iterator[str]:
    """Headings and tables: sections of a run's config, then those of a study."""
    for title, root in (("A run", Config), ("A study", Study), ("Groups of a cohort", GroupQuestion)):
        titles = _titles(root)
        for section in titles:
            yield from (f"## {title}" if section is root else f"### {titles[section]}", "")
            yield from _table(section, titles)


def _titles(root: type) -> dict[type, str]:
    """Headings of sections: their places, and their first key where others stand at the same place."""
    found = {section: ", ".join(f"`{place}`" for place in own) for section, own in sections(root).items()}
    many = [title for title in found.values() if list(found.values()).count(title) > 1]
    return {own: f"{title} with `{keys(own)[0].name}`" if title in many else title for own, title in found.items()}


def _table(section: type, titles: Mapping[type, str]) -> Iterator[str]:
    yield from ("| key | type | default | unit | meaning |", "|---|---|---|---|---|")
    for key in keys(section):
        cells = (f"`{key.name}`", in_words(key.hint, titles), default_in_words(key.default), key.unit, key.meaning)
        yield "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"
    yield ""


if __name__ == "__main__":
    PART.write("\n".join(rows()).rstrip())
