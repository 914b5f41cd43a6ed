"""Frames that OpenSim files name, found by their paths.

OpenSim 4 states joints and markers in PhysicalOffsetFrames, which it finds by a path from the model or from the
element that asks; older files name bodies.
"""

import posixpath
from collections.abc import Mapping
from dataclasses import dataclass

import torch

from torchid.model.markup import Element
from torchid.model.opensim.model import GROUND, Frame
from torchid.model.opensim.words import OsimDocument, child_text, objects

OFFSET = ("translation", "orientation")
"""Wording. Elements of an offset frame that hold its numbers."""
UNNAMED = ("objects", "frames", "components", "Joint")
"""Wording. Elements that are no component of their own, and so no part of a path."""


@dataclass(frozen=True)
class Stated:
    """A frame and the elements that its offset is written in."""

    frame: Frame
    element: Element | None
    """Parent of the elements ``tags``; None for the origin of a body, which has no offset."""
    tags: tuple[str, str] = OFFSET


def body_elements(document: OsimDocument) -> dict[str, Element]:
    """Return the bodies of the file by name, without ground.

    Raises:
        InputError: ``osim.body`` for another element among them or a name that stands twice.
    """
    found: dict[str, Element] = {}
    for element in objects(document.model, "BodySet"):
        name = document.name(element)
        if element.tag != "Body" or name in found:
            message = "two bodies have one name" if element.tag == "Body" else "is no body"
            raise document.fault(element, "osim.body", message, name, remedy="Leave it out or rename it.")
        found[name] = element
    if not document.sets_of_joints:
        found.pop("ground", None)  # a body among others in older files
    return found


def component_path(element: Element, document: OsimDocument) -> str:
    """Return OpenSim's absolute path of a component."""
    parts: list[str] = []
    for one in (element, *element.iterancestors()):
        if one is document.model:
            break
        tag = str(one.tag)
        if tag not in UNNAMED:
            parts.append(tag.lower() if tag.endswith("Set") or tag == "Ground" else document.name(one))
    return "/" + "/".join(reversed(parts))


class Frames:
    """All frames of a file."""

    def __init__(self, document: OsimDocument, bodies: Mapping[str, Element]) -> None:
        """Collect them."""
        self.document = document
        self.bodies = {"/ground": GROUND}
        self.bodies |= {f"/bodyset/{name}": index for index, name in enumerate(bodies)}
        offsets = document.model.iter("PhysicalOffsetFrame")
        self.offsets = {component_path(element, document): element for element in offsets}

    def named(self, name: str, asking: Element) -> Stated:
        """Return the frame that an element asks for.

        Args:
            name: path from the model or from the element that asks; in older files the name of a body.
            asking: element that is shown when there is none.

        Raises:
            InputError: ``osim.frame`` when there is none, or a chain of offsets without end.
        """
        return self._at(self._path(name, asking), asking, ())

    def _path(self, name: str, asking: Element) -> str:
        if self.document.sets_of_joints:
            path = posixpath.normpath(posixpath.join(component_path(asking, self.document), name))
        else:
            path = "/ground" if name == "ground" else f"/bodyset/{name}"
        if path not in self.bodies and path not in self.offsets or not name:
            remedy = "Name a body or a frame of the file; saving with OpenSim 4 writes whole paths."
            raise self.document.fault(asking, "osim.frame", "no such body or frame", name, remedy=remedy)
        return path

    def _at(self, path: str, asking: Element, behind: tuple[str, ...]) -> Stated:
        zero = torch.zeros(3, dtype=torch.float64)
        if path in self.bodies:
            return Stated(Frame(self.bodies[path], torch.eye(4, dtype=torch.float64), zero, zero), None)
        if path in behind:
            remedy = "Let one of them stand on a body."
            raise self.document.fault(asking, "osim.frame", "offset from itself", path, remedy=remedy)
        element = self.offsets[path]
        base = self._at(self._path(child_text(element, "socket_parent"), element), element, (*behind, path)).frame
        return self.offset(base, element, OFFSET)

    def offset(self, base: Frame, element: Element, tags: tuple[str, str]) -> Stated:
        """Return a frame offset from another one.

        Args:
            element: parent of the elements that state the offset.
            tags: names of these elements, translation [m] first, then angles [rad].

        Raises:
            InputError: ``xml.number``.
        """
        translation, orientation = (self.document.vector(element, tag, [0.0] * 3) for tag in tags)
        return Stated(Frame(base.body, base.X_BF, translation, orientation), element, tags)
