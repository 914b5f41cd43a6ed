"""Damage to YAML and XML: to the text, to the tree behind it, and bombs."""

import copy
from collections.abc import Iterator
from typing import Any

import yaml
from lxml import etree

from fuzzing.damage_bytes import Damaged, Random, repeated
from fuzzing.damage_text import NUMBER, changed_number

VALUES = (
    None, True, False, 0, -1, 1, 10**400, 2**64, 1e308, -1e308, 1e-320, float("nan"), float("inf"), "", " ", "no",
    "1e3", "x" * 5000, "../../etc/passwd", "/dev/zero", "${HOME}", "${NOT_SET}", "~nobody", "\0", "\x1b[31m", [], {},
    [[]], {"": 0},
)  # fmt: skip
WORDS = (
    "",
    "0",
    "-1",
    "nan",
    "inf",
    "1e400",
    "1e-320",
    "1e29",
    "0 0 0",
    "1 2",
    "x",
    "true",
    " 1 0 0 ",
    "1,0,0",
    "\u0661",
)
TAG = "x"
QUICK_LOADER = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
QUICK_DUMPER = getattr(yaml, "CSafeDumper", yaml.SafeDumper)


def damage_yaml(content: bytes, random: Random) -> Damaged:
    """A bomb in one of thirty files; else one damage or a few."""
    if random.random() < 0.033:
        return _yaml_bomb(content, random)
    return repeated(content, random, lambda data: (_yaml_node if random.random() < 0.5 else _line)(data, random))


def damage_xml(content: bytes, random: Random) -> Damaged:
    """A bomb in one of thirty files; else one damage or a few."""
    if random.random() < 0.033:
        return _xml_bomb(content, random)
    return repeated(content, random, lambda data: (_element if random.random() < 0.65 else _line)(data, random))


def _yaml_nodes(tree: Any) -> Iterator[tuple[Any, Any]]:
    """Every (holder, key) below ``tree``."""
    entries = tree.items() if isinstance(tree, dict) else enumerate(tree) if isinstance(tree, list) else ()
    for key, value in entries:
        yield tree, key
        yield from _yaml_nodes(value)


def _yaml_node(data: bytes, random: Random) -> Damaged:
    """A value replaced, a key renamed, lost or moved."""
    try:
        tree = QUICK_LOADER(data).get_single_data()
        nodes = list(_yaml_nodes(tree))
    except (yaml.YAMLError, ValueError, RecursionError):
        nodes = []
    if not nodes:
        return _line(data, random)
    holder, key = nodes[random.integers(len(nodes))]
    way = ("value", "number", "lost", "renamed", "moved", "wrapped")[random.integers(6)]
    value, place = holder[key], str(key)[:20]
    if way == "value":
        holder[key] = VALUES[random.integers(len(VALUES))]
    elif way == "number" and isinstance(value, int | float):
        holder[key] = float(value) * float(random.choice([-1.0, 10.0, 0.1, 1e3, 1.5]))
    elif way == "wrapped":
        holder[key] = [copy.deepcopy(value)]
    elif way == "renamed" and isinstance(holder, dict):
        holder[str(key)[:-1] + "x"] = holder.pop(key)
    elif way == "moved":
        other, at = nodes[random.integers(len(nodes))]
        other[at] = copy.deepcopy(value)
    else:
        way = "lost"
        del holder[key]
    return Damaged(
        yaml.dump(tree, Dumper=QUICK_DUMPER, sort_keys=False, allow_unicode=True).encode(), f"node {way}", place
    )


def _yaml_bomb(data: bytes, random: Random) -> Damaged:
    """Aliases of aliases, deep nesting, a self-reference, tags, a long number, many keys, many documents."""
    kind = ("aliases", "deep", "itself", "tag", "long number", "many", "documents", "merge")[random.integers(8)]
    aliases = "\n".join(f"k{k}: &a{k} [{', '.join([f'*a{k - 1}'] * 9)}]" if k else "k0: &a0 x" for k in range(12))
    text = {
        "aliases": aliases,
        "deep": f"deep: {'[' * 4000}{']' * 4000}",
        "itself": "loop: &l {again: *l}",
        "tag": "tag: !!python/object/apply:os.system [true]",
        "long number": f"long: {'9' * 50000}",
        "many": "\n".join(f"many{k}: {k}" for k in range(20000)),
        "documents": "---\nother: 1\n---\n",
        "merge": "base: &b {segment: pelvis}\nused: {<<: *b}",
    }[kind]
    head = random.random() < 0.5
    return Damaged(
        text.encode() + b"\n" + data if head else data + b"\n" + text.encode(),
        f"bomb {kind}",
        "head" if head else "end",
    )


def _element(data: bytes, random: Random) -> Damaged:
    """An element lost, doubled, moved, renamed; an attribute with another value or name, or lost."""
    try:
        root = etree.fromstring(data, etree.XMLParser(resolve_entities=False, remove_comments=True))
    except (etree.XMLSyntaxError, ValueError):
        return _line(data, random)
    every = list(root.iter(etree.Element))
    one = every[random.integers(len(every))]
    way = ("value", "value", "number", "number", "attribute lost", "attribute renamed", "lost", "doubled", "moved",
           "renamed")[random.integers(10)]  # fmt: skip
    place = f"<{one.tag}>"[:20]
    if way in ("value", "number", "attribute lost", "attribute renamed") and one.attrib:
        key = list(one.attrib)[random.integers(len(one.attrib))]
        place = f"<{one.tag} {key}>"[:40]
        _attribute(one, str(key), way, random)
    elif way == "renamed" or one.getparent() is None:
        way, one.tag = "renamed", str(one.tag) + TAG
    elif way == "moved":
        every[random.integers(len(every))].append(copy.deepcopy(one))
    elif way == "doubled":
        one.addnext(copy.deepcopy(one))
    else:
        way = "lost"
        one.getparent().remove(one)
    return Damaged(etree.tostring(root), way, place)


def _attribute(one: etree._Element, key: str, way: str, random: Random) -> None:
    text = one.attrib.pop(key)
    found = list(NUMBER.finditer(text))
    if way == "number" and found:
        match = found[random.integers(len(found))]
        one.set(key, text[: match.start()] + changed_number(match[0], random)[0] + text[match.end() :])
    elif way in ("value", "number"):
        one.set(key, str(random.choice(WORDS)))
    elif way == "attribute renamed":
        one.set(key + TAG, text)


def _xml_bomb(data: bytes, random: Random) -> Damaged:
    """Entities of entities, outside files, deep nesting, many attributes and elements, instructions, namespaces."""
    kind = ("entities", "outside", "deep", "many", "wide", "namespace", "text", "encoding")[random.integers(8)]
    body = data.split(b"?>\n", 1)[-1]
    close = body.rindex(b"</")
    lol = "".join(f'<!ENTITY a{k} "{f"&a{k - 1};" * 10 if k else "lol"}">' for k in range(10))
    inside = {
        "deep": b"<body>" * 3000 + b"</body>" * 3000,
        "many": b'<link name="m"/><site/>' * 4000,
        "wide": b"<geom " + b" ".join(b'a%d="1"' % k for k in range(4000)) + b"/>",
        "namespace": b'<n:joint xmlns:n="http://localhost/n" name="n"/>',
        "text": b"<![CDATA[" + b"x" * 100000 + b"]]>",
    }
    if kind in inside:
        return Damaged(body[:close] + inside[kind] + body[close:], f"bomb {kind}", "root")
    root = body[1 : min(body.find(b" ") % 99, body.index(b">"))]
    if kind == "encoding":
        return Damaged(b'<?xml version="1.0" encoding="utf-16"?>' + body, "bomb encoding", "head")
    outside = b'<!ENTITY a9 SYSTEM "file:///etc/passwd">'
    doctype = b"<!DOCTYPE " + root + b" [" + (lol.encode() if kind == "entities" else outside) + b"]>"
    return Damaged(doctype + body[:close] + b"&a9;" + body[close:], f"bomb {kind}", "head")


def _line(data: bytes, random: Random) -> Damaged:
    """A line lost, doubled, exchanged, indented; a number, letter or mark changed; bytes."""
    lines = data.split(b"\n")
    k = int(random.integers(len(lines)))
    one, two = lines[k], lines[k + 1 : k + 2]
    way = ("lost", "doubled", "exchange", "indented", "number", "letter", "bytes", "cut")[random.integers(8)]
    text = one.decode("latin-1")
    match = NUMBER.search(text)
    if way == "number" and match:
        one = (text[: match.start()] + changed_number(match[0], random)[0] + text[match.end() :]).encode("latin-1")
    at = int(random.integers(len(one) + 1))
    lines[k : k + 2] = {
        "lost": two, "doubled": [one, one, *two], "exchange": [*two, one], "indented": [b"  " + one, *two],
        "number": [one, *two],
        "letter": [one[:at] + bytes([int(random.choice([*b"aZ0: {}[]<>&*!#'\"\t-"]))]) + one[at + 1 :], *two],
        "bytes": [one[:at] + bytes(random.integers(0, 256, 3).tolist()) + one[at:], *two],
        "cut": [one[:at], *two],
    }[way]  # fmt: skip
    return Damaged(b"\n".join(lines), f"line {way}", "text")
