"""Text of OpenSim's elements: numbers, flags, names and paths, each with its place in the file when it is wrong."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.errors import InputError
from torchid.model.markup import Element, fault, numbers

FLAGS = {"true": True, "false": False, "1": True, "0": False}


@dataclass(frozen=True)
class OsimDocument:
    """An OpenSim file that is being read."""

    source: Path
    model: Element
    version: int
    """Version of the format, such as 40500."""

    @property
    def sets_of_joints(self) -> bool:
        """Return True for OpenSim 4, whose joints have a set of their own; older ones stand in the bodies they move."""
        return self.version >= 40000

    def fault(self, element: Element, code: str, message: str, found: str = "", *, remedy: str) -> InputError:
        """Return the error of an element, with its line."""
        return fault(element, self.source, code, message, found, remedy=remedy)

    def vector(self, parent: Element, tag: str, default: Sequence[float]) -> Float[Tensor, " values"]:
        """Return the numbers of a child element, or ``default`` where there is none.

        Raises:
            InputError: ``xml.number`` unless it holds as many numbers as the default.
        """
        child = parent.find(tag)
        if child is None:
            return torch.tensor(default, dtype=torch.float64)
        values = numbers(child.text or "", child, self.source, (len(default),))
        return torch.tensor(values, dtype=torch.float64)

    def number(self, parent: Element, tag: str, default: float) -> float:
        """Return the number of a child element, or ``default`` where there is none; raises as ``vector``."""
        return float(self.vector(parent, tag, [default])[0])

    def series(self, parent: Element, tag: str) -> Float[Tensor, " values"]:
        """Return all numbers of a child element, none where it is missing; raises as ``vector``."""
        text = child_text(parent, tag)
        child = parent.find(tag)
        values = [] if child is None else numbers(text, child, self.source, (len(text.split()),))
        return torch.tensor(values, dtype=torch.float64)

    def flag(self, parent: Element, tag: str, default: bool) -> bool:
        """Return the truth of a child element, or ``default`` where there is none.

        Raises:
            InputError: ``osim.flag`` for other words than true and false.
        """
        child = parent.find(tag)
        if child is None:
            return default
        word = (child.text or "").strip().lower()
        if word not in FLAGS:
            raise self.fault(child, "osim.flag", "is neither true nor false", word, remedy="Write true or false.")
        return FLAGS[word]

    def name(self, element: Element) -> str:
        """Return the name of an element; of one without, the name that OpenSim gives it: its class in small letters,
        and behind the first of a set a number from 0, whatever others are called."""
        name = (element.get("name") or "").strip()
        if name:
            return name
        before = [
            one for one in element.itersiblings(element.tag, preceding=True) if not (one.get("name") or "").strip()
        ]
        return str(element.tag).lower() + (f"_{len(before) - 1}" if before else "")


def child_text(parent: Element, tag: str) -> str:
    """Return the text of a child element, without blanks around it; empty where there is none."""
    return (parent.findtext(tag) or "").strip()


def objects(parent: Element, tag: str) -> list[Element]:
    """Return the elements of one of the model's sets, such as BodySet; none where the set is missing."""
    return [element for one in parent.findall(tag) for inside in one.findall("objects") for element in inside]
