"""Names that a model file may use, so that a misspelt one is said instead of read as if it were absent."""

from collections.abc import Mapping

from torchid.errors import Note
from torchid.model.markup import Element, place

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
    texts = (("unread", strange, "no name of this format, left out"), ("twice", twice, "only the first is read"))
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
