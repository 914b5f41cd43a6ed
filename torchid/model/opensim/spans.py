"""Where elements stand in the bytes of an XML file, so that numbers are exchanged and nothing else is touched."""

import codecs
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from xml.parsers import expat

from torchid.errors import InputError
from torchid.model.markup import Element


@dataclass
class Span:
    """Bytes of one element."""

    tag: str
    start: int
    """Place of the start tag's ``<``."""
    inside: int = -1
    """Place behind the start tag's ``>``, or behind the whole of an element that closes itself."""
    end: int = -1
    """Place of the end tag, or ``start`` where the element closes itself."""
    texts: list[tuple[int, int]] = field(default_factory=list)
    """Runs of its own text, from and to."""


@dataclass(frozen=True)
class Edit:
    """Bytes to put in place of others."""

    start: int
    stop: int
    text: bytes


class _Walk:
    """The parser's events, which give each place as the beginning of the next event."""

    def __init__(self, content: bytes) -> None:
        self.spans: list[Span] = []
        self._open: list[Span] = []
        self._entered: Span | None = None
        self._text = -1
        self._parser = expat.ParserCreate()
        self._parser.buffer_text = False
        self._parser.StartElementHandler = self._start
        self._parser.EndElementHandler = self._end
        self._parser.CharacterDataHandler = self._characters
        self._parser.CommentHandler = self._parser.ProcessingInstructionHandler = self._other
        self._parser.StartCdataSectionHandler = self._parser.EndCdataSectionHandler = self._other
        self._parser.Parse(content, True)

    def _other(self, *_: object) -> None:
        here = self._parser.CurrentByteIndex
        if self._entered is not None:
            self._entered.inside, self._entered = here, None
        if self._text >= 0 and self._open:
            self._open[-1].texts.append((self._text, here))
        self._text = -1

    def _characters(self, _: str) -> None:
        begun = self._text
        if begun < 0:
            self._other()
            self._text = self._parser.CurrentByteIndex

    def _start(self, tag: str, _: Mapping[str, str]) -> None:
        self._other()
        span = Span(tag, self._parser.CurrentByteIndex)
        self.spans.append(span)
        self._open.append(span)
        self._entered = span

    def _end(self, _: str) -> None:
        here, span = self._parser.CurrentByteIndex, self._open[-1]
        if here == span.start:  # closes itself: what is behind it is told by the next event
            span.end = here
            self._open.pop()
            return
        self._other()
        span.end = here
        self._open.pop()


def element_spans(content: bytes, elements: Iterable[Element], source: str | Path) -> dict[Element, Span]:
    """Return the bytes of elements.

    Args:
        content: the file's bytes, well-formed and without a document type.
        elements: all elements of the file in the order in which they begin.

    Raises:
        InputError: ``osim.encoding`` for an encoding in which plain letters are not single bytes of ASCII.
    """
    if content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE, b"\0", b"<\0")):
        raise _encoding(source, "UTF-16")
    try:
        spans = _Walk(content).spans
    except expat.ExpatError as error:
        raise _encoding(source, str(error)) from error
    found = dict(zip(elements, spans, strict=True))
    assert all(str(element.tag).endswith(span.tag.split(":")[-1]) for element, span in found.items()), "same order"
    return found


def _encoding(source: str | Path, found: str) -> InputError:
    return InputError(
        "osim.encoding", "numbers cannot be exchanged in a file of this encoding", source=source, found=found,
        remedy="Save it as UTF-8, as OpenSim does.",
    )  # fmt: skip


def new_text(span: Span, text: str, content: bytes) -> list[Edit]:
    """Return the edits that give an element another text; the blanks around the old one stay."""
    runs = [run for run in span.texts if content[slice(*run)].strip()]
    assert runs, "an element that was read has a text"
    (start, stop), *others = runs
    old = content[start:stop]
    start += len(old) - len(old.lstrip())
    stop -= len(old) - len(old.rstrip())
    return [Edit(start, stop, text.encode("ascii")), *(Edit(*run, b"") for run in others)]


def new_child(span: Span, tag: str, text: str) -> list[Edit]:
    """Return the edits that give an element a first child.

    Args:
        span: the parent, which has other children.
    """
    assert span.end > span.start, "a parent that was read has children"
    return [Edit(span.inside, span.inside, f"<{tag}>{text}</{tag}>".encode("ascii"))]


def edited(content: bytes, edits: Iterable[Edit]) -> bytes:
    """Return the bytes after edits that do not overlap.

    Args:
        edits: in any order; those at one place in the order in which they are given.
    """
    parts: list[bytes] = []
    place = 0
    for edit in sorted(edits, key=lambda one: one.start):
        parts += [content[place : edit.start], edit.text]
        place = edit.stop
    return b"".join([*parts, content[place:]])
