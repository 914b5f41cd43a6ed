"""YAML and JSON that people write, read strictly: no tags, no duplicate keys, no bombs, no guessed types.

Scalars follow the core schema of YAML 1.2 (https://yaml.org/spec/1.2.2/#103-core-schema): ``no`` and ``on`` are text,
``1e3`` is a number. PyYAML's own YAML 1.1 reads them as False, True and text.
"""

import json
import re
from collections.abc import Hashable
from pathlib import Path
from typing import Any

import yaml

from torchid.errors import ConfigError

MAX_BYTES = 1 << 20
MAX_DEPTH = 40
MAX_NODES = 100_000
"""Values in a document after its aliases are expanded."""
MAX_EVENTS = 10_000
"""Steps of YAML's parser, about one for each key and value; twice as many take it a second. JSON is read a thousand
times faster and has MAX_BYTES alone."""

SHORTEN = "Write plain keys and values only; docs and configs/ have examples."
ONCE = "Remove one of the two."
SYNTAX = "Correct that line; values with : or # in them need quotes."

Document = Any
"""Nested dict (text keys), list, str, int, float, bool or None."""

_TAG = "tag:yaml.org,2002:"
_CORE_SCHEMA = {
    "null": r"(?:~|null|Null|NULL|)",
    "bool": r"(?:true|True|TRUE|false|False|FALSE)",
    "int": r"(?:[-+]?[0-9]+|0o[0-7]+|0x[0-9a-fA-F]+)",
    "float": r"(?:[-+]?(?:\.[0-9]+|[0-9]+(?:\.[0-9]*)?)(?:[eE][-+]?[0-9]+)?|[-+]?\.(?:inf|Inf|INF)|\.(?:nan|NaN|NAN))",
}


class _Loader(yaml.SafeLoader):
    """SafeLoader with the core schema, bounded depth and no tags."""

    yaml_implicit_resolvers: dict[Any, Any] = {}
    depth = steps = 0

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        event = self.peek_event()
        if getattr(event, "tag", None) is not None:
            raise _marked("config.tag", "tags are not accepted", event.start_mark, str(event.tag), remedy="Remove it.")
        self.depth += 1
        if self.depth > MAX_DEPTH:
            raise _marked("config.too_deep", f"nested deeper than {MAX_DEPTH} levels", event.start_mark, remedy=SHORTEN)
        node = super().compose_node(parent, index)
        self.depth -= 1
        return node

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Hashable, Any]:
        mapping: dict[Hashable, Any] = {}
        for key_node, value_node in node.value:
            key = self.construct_object(key_node, deep=True)
            if type(key) is int:  # plates: {2: ...}; in JSON every key is text
                key = str(key)
            if not isinstance(key, str):
                raise _marked(
                    "config.key", "a key must be text", key_node.start_mark, str(key), remedy="Put it in quotes."
                )
            if key in mapping:
                raise _marked("config.duplicate_key", "this key stands twice", key_node.start_mark, key, remedy=ONCE)
            mapping[key] = self.construct_object(value_node, deep=True)
        return mapping

    def construct_integer(self, node: yaml.ScalarNode) -> int:
        text = str(self.construct_scalar(node))
        return int(text, 0) if text[:2] in ("0o", "0x") else int(text, 10)

    def get_event(self) -> Any:
        event = super().get_event()
        self.steps += 1
        if self.steps > MAX_EVENTS:
            message, remedy = f"more than {MAX_EVENTS} keys and values", "Write so long a document as JSON."
            raise _marked("config.too_large", message, event.start_mark, remedy=remedy)
        return event


for _kind, _pattern in _CORE_SCHEMA.items():
    _Loader.add_implicit_resolver(_TAG + _kind, re.compile(_pattern + r"\Z"), None)
_Loader.add_constructor(_TAG + "int", _Loader.construct_integer)


class _Dumper(yaml.SafeDumper):
    """Quotes whatever either YAML version would take for something else than text, and repeats instead of aliasing."""

    yaml_implicit_resolvers = dict(yaml.SafeDumper.yaml_implicit_resolvers)

    def ignore_aliases(self, data: Any) -> bool:
        del data
        return True


for _kind, _pattern in _CORE_SCHEMA.items():
    _Dumper.add_implicit_resolver(_TAG + _kind, re.compile(_pattern + r"\Z"), None)


def read_document(path: Path) -> Document:
    """The content of a YAML or JSON file.

    Raises ConfigError with line and column for anything beyond plain data (module docstring) or MAX_BYTES.
    """
    try:
        if not path.is_file():
            raise ConfigError("config.missing_file", "no such file", source=path, remedy="Correct the path.")
        with path.open("rb") as file:
            content = file.read(MAX_BYTES + 1)
    except (OSError, ValueError) as error:  # ValueError: a NUL in the name
        remedy = "Check the path and the permissions."
        raise ConfigError(
            "config.unreadable", "cannot be read", source=path, found=str(error), remedy=remedy
        ) from error
    if len(content) > MAX_BYTES:
        raise ConfigError("config.too_large", f"larger than {MAX_BYTES} bytes", source=path, remedy=SHORTEN)
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise ConfigError(
            "config.encoding", "not UTF-8", source=path, place=f"byte {error.start}", remedy="Save it as UTF-8."
        ) from error
    return parse_document(text, str(path))


def parse_document(text: str, source: str = "") -> Document:
    """The value that ``text`` states in YAML or JSON; errors as in ``read_document``."""
    try:
        return _parse_json(text) if text.lstrip()[:1] in ("{", "[") else _parse_yaml(text)
    except ConfigError as error:
        raise ConfigError(
            error.code, error.message, source=source, place=error.place, found=error.found, remedy=error.remedy
        ) from error
    except RecursionError as error:
        raise _too_deep(source) from error


def dump_document(document: Document) -> str:
    """YAML of plain data; ``parse_document`` returns an equal value."""
    return yaml.dump(document, Dumper=_Dumper, sort_keys=False, allow_unicode=True, width=100)


def _parse_json(text: str) -> Document:
    """JSON first, because YAML refuses its tabs; text that is no JSON may still be YAML's flow style."""
    try:
        document = json.loads(text, object_pairs_hook=_unique)
    except ValueError:
        return _parse_yaml(text)
    _check_depth(document)
    return document


def _check_depth(document: Document) -> None:
    layer, depth = [document], 0
    while layer:
        depth += 1
        if depth > MAX_DEPTH:
            raise _too_deep()
        children = [value.values() if isinstance(value, dict) else value for value in layer]
        layer = [child for group in children if not isinstance(group, str | int | float | None) for child in group]


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    mapping = dict(pairs)
    if len(mapping) < len(pairs):
        keys = [key for key, _ in pairs]
        twice = next(key for key in keys if keys.count(key) > 1)
        raise ConfigError("config.duplicate_key", "this key stands twice", found=twice, remedy=ONCE)
    return mapping


def _parse_yaml(text: str) -> Document:
    try:
        loader = _Loader(text)
        node = loader.get_single_node()
        if node is None:
            return None
        if _count_nodes(node, {}) > MAX_NODES:
            message = f"more than {MAX_NODES} values after its aliases are expanded"
            raise ConfigError("config.too_large", message, remedy=SHORTEN)
        return loader.construct_document(node)
    except yaml.MarkedYAMLError as error:
        raise _marked("config.yaml", str(error.problem), error.problem_mark, remedy=SYNTAX) from error
    except (yaml.YAMLError, ValueError) as error:  # ValueError: an integer of more than 4300 digits
        raise ConfigError("config.yaml", " ".join(str(error).split()), remedy=SYNTAX) from error


def _count_nodes(node: yaml.Node, known: dict[int, int]) -> int:
    """Values below ``node`` with every alias written out; linear in the document because of ``known``."""
    if isinstance(node, yaml.ScalarNode):
        return 1
    if known.setdefault(id(node), -1) > 0:
        return known[id(node)]
    total = 1
    for child in node.value:
        for part in child if isinstance(child, tuple) else (child,):
            if known.get(id(part)) == -1:
                raise _marked(
                    "config.recursive_alias",
                    "an alias contains itself",
                    part.start_mark,
                    remedy="Write the values out.",
                )
            total += _count_nodes(part, known)
    known[id(node)] = total
    return total


def _too_deep(source: str = "") -> ConfigError:
    return ConfigError("config.too_deep", f"nested deeper than {MAX_DEPTH} levels", source=source, remedy=SHORTEN)


def _marked(code: str, message: str, mark: Any, found: str = "", *, remedy: str) -> ConfigError:
    place = f"line {mark.line + 1}, column {mark.column + 1}" if mark is not None else ""
    return ConfigError(code, message, place=place, found=found[:80], remedy=remedy)
