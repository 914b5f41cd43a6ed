"""Links of a model file put together: rigid ones merged, massless ones composed, the rest a tree with priors.

Rules, each said in a note where it acts: a link without joint is part of its parent; a massless link without joint is
a landmark; massless links that only carry the next axis through the same point become one joint of several axes; a
body's origin is its joint centre.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from torchid.errors import InputError, Note
from torchid.model.markup import Element, fault
from torchid.model.mechanics import Array, pose
from torchid.model.model import Landmark, Model
from torchid.model.tree_of_links import FileScatter, LinkAxis, PlacedBody, model_of

SAME_POINT = 1e-9
"""Points closer than this are one [m]."""

NOT_A_BODY = 1e-4
"""Negative second moment over their sum from which an inertia is refused rather than taken as rounded."""


@dataclass(frozen=True)
class ModelLink:
    """A link as the file states it."""

    name: str
    parent: str | None
    X_PL: Array
    """Pose in the parent at zero coordinates; of the root: where the base rests in W."""
    axes: tuple[LinkAxis, ...] = ()
    anchor: Array = field(default_factory=lambda: np.zeros(3))
    """Point of the link that its axes pass through [m]."""
    pseudo: Array = field(default_factory=lambda: np.zeros((4, 4)))
    """Pseudo-inertia about the link's origin; zero for a massless one."""
    place: str = ""
    """Where it stands in the file."""


def assemble(
    links: Sequence[ModelLink], source: str | Path, landmarks: dict[str, tuple[str, Array]], scatter: FileScatter
) -> tuple[Model, tuple[Note, ...]]:
    """Model of the links of one file.

    Args:
        links: in any order.
        landmarks: name: (link, place in the link's axes [m]).
        scatter: how uncertain the numbers of the file are.

    Raises:
        InputError: names twice, no single root, a loop, a massless link that moves, a slide behind a turn.
    """
    builder = _Assembly(source)
    for link in _ordered(links, source):
        builder.add(link)
    for name, (link, p) in landmarks.items():
        builder.landmark(name, link, p)
    builder.compose()
    model, notes = model_of(builder.placed(), builder.landmarks(scatter), str(source), scatter)
    return model, (*builder.notes, *notes)


def check_body(mass: float, I_C: Array, element: Element, path: str | Path) -> None:
    """Refuse what no distribution of mass has.

    Raises:
        InputError: ``model.mass`` or ``model.inertia``: principal moments of which one exceeds the others' sum.
    """
    if not mass > 0.0:
        remedy = "Correct the mass, or leave the inertial of a massless link out."
        raise fault(element, path, "model.mass", "a mass must be positive", f"{mass:g} kg", remedy=remedy)
    second = np.linalg.eigvalsh(0.5 * np.trace(I_C) * np.eye(3) - I_C)
    if second[0] < -NOT_A_BODY * np.abs(second).sum():
        moments = ", ".join(f"{value:.3g}" for value in np.linalg.eigvalsh(I_C))
        remedy = "Each must be positive and at most the sum of the two others; export the inertia again."
        raise fault(element, path, "model.inertia", "no body has these principal moments", moments, remedy=remedy)


def _ordered(links: Sequence[ModelLink], source: str | Path) -> list[ModelLink]:
    """Parents before children, otherwise in the file's order (depth first)."""
    twice = [name for name, count in Counter(link.name for link in links).items() if count > 1]
    if twice:
        raise InputError(
            "model.name_twice", "a name stands twice", source=source, found=", ".join(twice[:5]), remedy="Rename one."
        )
    roots = [link for link in links if link.parent is None]
    if len(roots) != 1:
        found = ", ".join(link.name for link in roots[:5]) or "none: the joints form a loop"
        remedy = "Join the links by joints, so that one alone is no joint's child."
        raise InputError(
            "model.root", "needs exactly one link without parent", source=source, found=found, remedy=remedy
        )
    children: dict[str, list[ModelLink]] = {link.name: [] for link in links}
    for link in links:
        if link.parent is not None:
            if link.parent not in children:
                raise InputError(
                    "model.parent", "unknown parent", source=source, place=link.place, found=link.parent,
                    remedy="Name a link that the file has.",
                )  # fmt: skip
            children[link.parent].append(link)
    order, waiting = [], [roots[0]]
    while waiting:
        order.append(waiting.pop())
        waiting += reversed(children[order[-1].name])
    if len(order) < len(links):
        lost = [link for link in links if link not in order]
        names = ", ".join(link.name for link in lost[:5])
        remedy = "Open it: closed chains cannot be read."
        raise InputError(
            "model.loop", "links form a loop", source=source, place=lost[0].place, found=names, remedy=remedy
        )
    return order


class _Assembly:
    """Moving links so far, and where every link of the file lies on one of them."""

    def __init__(self, source: str | Path) -> None:
        self.source, self.said = source, dict[tuple[str, str], list[str]]()
        self.moving: dict[str, ModelLink] = {}
        self.on: dict[str, tuple[str, Array]] = {}
        """Link of the file: moving link that carries it, and its pose there."""
        self.points: dict[str, tuple[str, Array]] = {}

    def add(self, link: ModelLink) -> None:
        """A link whose parent was added before."""
        base, X_BP = self.on[link.parent] if link.parent is not None else (None, np.eye(4))
        if base is None or link.axes:
            at_joint = pose(p=link.anchor if base else None)
            if np.abs(at_joint[:3, 3]).max() > SAME_POINT:
                self._say("origin_moved", link.name, "origin moved to the joint centre")
            back = pose(p=-at_joint[:3, 3])
            pseudo = back @ link.pseudo @ back.T
            self.moving[link.name] = replace(link, parent=base, X_PL=X_BP @ link.X_PL @ at_joint, pseudo=pseudo)
            self.on[link.name] = link.name, back
            return
        X = X_BP @ link.X_PL
        self.on[link.name] = base, X
        carrier = self.moving[base]
        self.moving[base] = replace(carrier, pseudo=carrier.pseudo + X @ link.pseudo @ X.T)
        if link.pseudo[3, 3] > 0.0:
            self._say("merged", f"{link.name} (on {base})", "without joint, part of its parent")
        else:
            self.points[link.name] = base, X[:3, 3]

    def landmark(self, name: str, link: str, p: Array) -> None:
        """A point of a link of the file."""
        base, X = self.on[link]
        self.points[name] = base, X[:3, :3] @ p + X[:3, 3]

    def compose(self) -> None:
        """Give the axes of massless links to the one link that each of them carries."""
        for name in list(self.moving):
            link = self.moving[name]
            if link.pseudo[3, 3] > 0.0:
                continue
            carried = [other for other in self.moving.values() if other.parent == name]
            if link.parent is None or len(carried) != 1 or np.abs(carried[0].X_PL[:3, 3]).max() > SAME_POINT:
                raise InputError(
                    "model.massless", "a link that moves has no mass", source=self.source, place=link.place,
                    remedy="Give it an inertial, or let the joint that it carries pass through its own joint's point.",
                )  # fmt: skip
            self._carry(link, carried[0])

    def _carry(self, link: ModelLink, child: ModelLink) -> None:
        R = child.X_PL[:3, :3]
        before = tuple(replace(axis, unit=R.T @ axis.unit) for axis in link.axes)
        X_PL = link.X_PL @ pose(R)
        del self.moving[link.name]
        self.moving[child.name] = replace(child, parent=link.parent, X_PL=X_PL, axes=before + child.axes)
        lost = [name for name, (on, _) in self.points.items() if on == link.name]
        for point in lost:
            self._say("landmark_lost", f"{point} (on {link.name})", "on a link without mass, left out")
            del self.points[point]

    def placed(self) -> list[PlacedBody]:
        """The moving links as bodies-to-be, parents first."""
        names = list(self.moving)
        found = []
        for link in self.moving.values():
            kinds = [axis.slide for axis in link.axes]
            if kinds != sorted(kinds, reverse=True):
                raise InputError(
                    "model.slide_after_turn", "a slide behind a turn of the same body", source=self.source,
                    place=link.place, remedy="Slides come first in a joint; give the link between them a mass.",
                )  # fmt: skip
            parent = -1 if link.parent is None else names.index(link.parent)
            found.append(PlacedBody(link.name, parent, link.X_PL, link.axes, link.pseudo, link.place))
        return found

    def landmarks(self, scatter: FileScatter) -> dict[str, Landmark]:
        """Points as landmarks of the model."""
        sd = (scatter.landmark, scatter.landmark, scatter.landmark)
        return {n: Landmark(on, (float(p[0]), float(p[1]), float(p[2])), sd) for n, (on, p) in self.points.items()}

    def _say(self, code: str, name: str, text: str) -> None:
        self.said.setdefault((code, text), []).append(name)

    @property
    def notes(self) -> tuple[Note, ...]:
        """What was changed, one note per kind."""
        said = self.said.items()
        return tuple(
            Note(f"model.{code}", f"{', '.join(names)}: {text}", str(self.source)) for (code, text), names in said
        )
