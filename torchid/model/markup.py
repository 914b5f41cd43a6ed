"""XML that people send: read without entities or network, numbers with the line they stand on, and written whole."""

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import lxml.etree as etree
from lxml.etree import _Element as Element

from torchid.errors import InputError, Note
from torchid.storage.files import atomic_write

MAX_BYTES = 64 << 20
MAX_NUMBER = 1e30
"""Larger numbers than any model has; products of a few of these are still finite."""


def read_xml(path: str | Path, root: str) -> Element:
    """Root element of an XML file.

    Raises:
        InputError: no such file, larger than MAX_BYTES, not XML, a document type (entities), or another root element.
    """
    return parse_xml(read_bytes(path), path, root)


def read_bytes(path: str | Path) -> bytes:
    """Bytes of an XML file.

    Raises:
        InputError: no such file, or larger than MAX_BYTES.
    """
    path = Path(path)
    try:
        with path.open("rb") as file:
            content = file.read(MAX_BYTES + 1)
    except (OSError, ValueError) as error:  # ValueError: a NUL in the name
        remedy = "Check the path and the permissions."
        raise InputError("xml.unreadable", "cannot be read", source=path, found=str(error), remedy=remedy) from error
    if len(content) > MAX_BYTES:
        raise InputError("xml.too_large", f"larger than {MAX_BYTES} bytes", source=path, remedy="Name a model file.")
    return content


def parse_xml(content: bytes, path: str | Path, root: str) -> Element:
    """Root element of a file's bytes.

    Raises:
        InputError: not XML, a document type (entities), or another root element.
    """
    parser = etree.XMLParser(
        resolve_entities=False, no_network=True, load_dtd=False, huge_tree=False, remove_comments=True, remove_pis=True
    )
    try:
        element = etree.fromstring(content, parser)
    except (etree.XMLSyntaxError, ValueError) as error:
        raise InputError(
            "xml.syntax", "not well-formed XML", source=path, found=str(error)[:200], remedy="Export the model again."
        ) from error
    if element.getroottree().docinfo.doctype:
        raise InputError("xml.doctype", "a document type is not accepted", source=path, remedy="Remove <!DOCTYPE ...>.")
    if element.tag != root:
        remedy = f"The file must start with <{root}>."
        raise InputError("xml.root", "another kind of file", source=path, found=f"<{element.tag}>"[:80], remedy=remedy)
    return element


def place(element: Element) -> str:
    """Where an element stands: its line, tag and name."""
    name = element.get("name")
    return f"line {element.sourceline}, <{element.tag}{f' name={name!r}' if name else ''}>"[:160]


def fault(element: Element, source: str | Path, code: str, message: str, found: str = "", *, remedy: str) -> InputError:
    """The error of an element."""
    return InputError(code, message, source=source, place=place(element), found=found[:80], remedy=remedy)


def numbers(text: str, element: Element, source: str | Path, counts: Sequence[int]) -> list[float]:
    """Numbers in ``text`` of an attribute of ``element``; as many as one of ``counts``.

    Raises:
        InputError: ``xml.number`` for anything else.
    """
    try:
        values = [float(word) for word in text.split()]
    except ValueError:
        values = [math.nan]
    if len(values) not in counts or not all(abs(value) <= MAX_NUMBER for value in values):
        wanted = " or ".join(str(count) for count in counts)
        message = f"needs {wanted} number(s) of sound size"
        raise fault(element, source, "xml.number", message, text, remedy="Write plain numbers with blanks between.")
    return values


def write_xml(path: str | Path, root: Element) -> None:
    """``root`` as UTF-8 XML, indented, atomically."""
    etree.indent(root, space=" ")
    content = etree.tostring(root, encoding="utf-8", xml_declaration=True)
    with atomic_write(path) as file:
        file.write(content + b"\n")


def document(tag: str, **attributes: str) -> Element:
    """The root of a new document."""
    return etree.Element(tag, attributes)


def node(parent: Element, tag: str, text: str | None = None, **attributes: str) -> Element:
    """A new child of ``parent``."""
    child = etree.SubElement(parent, tag, {key.rstrip("_"): value for key, value in attributes.items()})
    child.text = text
    return child


def spelt(values: Iterable[float]) -> str:
    """Numbers that read back bit for bit."""
    return " ".join(repr(float(value) + 0.0) for value in values)


def plain_name(text: str, taken: Iterable[str] = ()) -> str:
    """A name that URDF and OpenSim accept and that is not in ``taken``: odd characters become ``_``."""
    base = re.sub(r"[^A-Za-z0-9_.+-]", "_", text) or "_"
    used, name, count = set(taken), base, 1
    while name in used:
        count += 1
        name = f"{base}_{count}"
    return name


Vocabulary = Mapping[str, tuple[str, str]]
"""tag: its attributes, and the elements inside it, words between blanks; ``*`` behind those that may stand again."""
MOST = 8
"""Names that are listed."""


def unread(root: Element, words: Vocabulary, source: str) -> tuple[Note, ...]:
    """Notes on attributes and elements of ``root`` that the format does not have, and on elements that stand twice.

    Args:
        words: of the format; elements that have no entry are not looked into.
    """
    strange: list[str] = []
    twice: list[str] = []
    _look(root, words, strange, twice)
    texts = (("unread", strange, "not known to the format, ignored"), ("twice", twice, "only the first is read"))
    return tuple(
        Note(f"model.{code}", f"{'; '.join(found[:MOST])}{' ...' if len(found) > MOST else ''}: {text}", source)
        for code, found, text in texts
        if found
    )


def _look(element: Element, words: Vocabulary, strange: list[str], twice: list[str]) -> None:
    attributes, inside = (text.split() for text in words[str(element.tag)])
    strange += [
        f"{place(element)} {key}" for key in map(str, element.attrib) if key not in (*attributes, *_foreign(key))
    ]
    seen: set[str] = set()
    for child in element:
        tag = str(child.tag)
        if tag not in inside and f"{tag}*" not in inside and not _foreign(tag):
            strange.append(place(child))
        if tag in seen and tag in inside:
            twice.append(place(child))
        seen.add(tag)
        if tag in words and (tag in inside or f"{tag}*" in inside):
            _look(child, words, strange, twice)


def _foreign(name: str) -> tuple[str, ...]:
    """The name itself where it belongs to another namespace."""
    return (name,) if name.startswith("{") else ()
