"""A changed model written into its laboratory's own file, every byte that states something else untouched."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.errors import DataError
from torchid.model.markup import Element, place, spelt
from torchid.model.model import Geometry
from torchid.model.opensim.binding import OsimBinding
from torchid.model.opensim.bodies import MOMENTS, SPELT, compact, stated_moments
from torchid.model.opensim.frames import Stated
from torchid.model.opensim.group_inertia import of_bodies
from torchid.model.opensim.model import Frame, OsimJoint, OsimModel
from torchid.model.opensim.reading import Parts, model_of, open_document, osim_bytes, parts_of
from torchid.model.opensim.rotations import inverse, moved
from torchid.model.opensim.spans import Edit, edited, element_spans, new_child, new_text
from torchid.storage.files import atomic_write


def identified_model(
    binding: OsimBinding,
    geometry: Geometry,
    phi: Float[Tensor, "groups 10"],
    places: Mapping[str, Float[Tensor, "3"]],
) -> OsimModel:
    """Return the file's model with another geometry, inertia and markers; ``write_back`` writes it.

    A joint's place moves the offset of its frame on the body nearer to ground; frames of welded bodies stay.

    Args:
        places: place p_TM_T of markers on the tree's bodies, by their names in the file [m]; others stay.
    """
    model = binding.model
    joints = tuple(_placed(binding, geometry, joint) for joint in model.joints)
    markers = []
    for marker in model.markers:
        if marker.name in places:
            X_BT = inverse(binding.X_TB[marker.frame.body])
            p_BM = moved(X_BT, places[marker.name].detach().cpu().double())
            marker = replace(marker, location=moved(inverse(marker.frame.X_BF), p_BM))
        markers.append(marker)
    inertias = of_bodies(binding, phi.detach().cpu().double())
    return replace(model, inertias=inertias, joints=joints, markers=tuple(markers))


def _placed(binding: OsimBinding, geometry: Geometry, joint: OsimJoint) -> OsimJoint:
    """The joint whose carrier's frame stands where the geometry has it."""
    if joint is binding.root or joint.carried.body not in binding.bodies:
        return joint
    at, group = joint.carrier, binding.group_of(joint.carried.body)
    if group == binding.group_of(at.body):
        return joint
    p_BF = moved(inverse(binding.X_TB[at.body]), geometry.offset[group].detach().cpu().double())
    new = _at(at, p_BF)
    return replace(joint, parent=new) if joint.outward else replace(joint, child=new)


def _at(frame: Frame, p_BF: Float[Tensor, "3"]) -> Frame:
    """The frame at another place on its body, its offset from the frame that it stands on moved; rounding aside."""
    if float((p_BF - frame.X_BF[:3, 3]).abs().max()) < torch.finfo(torch.float64).eps:
        return frame
    return replace(frame, translation=moved(inverse(frame.base), p_BF))


@dataclass(frozen=True)
class _Numbers:
    """Numbers for a child element: those that the file states (or means by leaving it out) and those wanted."""

    parent: Element
    tag: str
    before: Tensor
    wanted: Tensor


@dataclass
class _Wanted:
    """Numbers for a file, each element's once."""

    source: Path
    numbers: dict[tuple[Element, str], _Numbers] = field(default_factory=dict)

    def add(self, one: _Numbers) -> None:
        """Take in the numbers of an element, unless they contradict what it was given before."""
        if not bool(one.wanted.isfinite().all()):
            raise self.fault(
                "osim.not_finite", one.parent, "a number that is not finite", remedy="Write finite numbers."
            )
        other = self.numbers.setdefault((one.parent, one.tag), one)
        if not torch.equal(other.wanted, one.wanted):
            remedy = "Give each joint a frame of its own in OpenSim, or move both alike."
            raise self.fault(
                "osim.shared_frame", one.parent, "two joints want their common frame elsewhere", remedy=remedy
            )

    def fault(self, code: str, element: Element, message: str, *, remedy: str) -> DataError:
        """Return the error of an element."""
        return DataError(code, message, source=self.source, place=place(element), remedy=remedy)

    def changed(self) -> Iterator[_Numbers]:
        """Yield the numbers that differ from those of the file."""
        yield from (one for one in self.numbers.values() if not torch.equal(one.before, one.wanted))


def write_back(model: OsimModel, path: str | Path) -> None:
    """Write what was changed in a model into the text of the file that it was read from.

    Masses, centres of mass and inertia of bodies, offsets of joints' frames and places of markers are compared with
    those of ``model.source``; only numbers that differ are written, with all their digits. Names, comments, blanks,
    line ends and all other elements keep their bytes. A body whose inertia was not changed keeps what the file states,
    even where ``stated`` and ``inertias`` differ. A frame's own offset is written, not that of a frame it stands on.

    Args:
        model: the model that was read, with other ``inertias``, ``joints`` or ``markers``.
        path: the file to write; it may be the source.

    Raises:
        DataError: ``osim.no_element`` for bodies, joints or markers that the file does not have, ``osim.no_offset``
            for a moved frame that the file states without an offset, ``osim.shared_frame`` for one moved two ways,
            ``osim.not_finite``, ``osim.negative_mass``.
        InputError: the source cannot be read any more, ``osim.encoding``, or the file cannot be written.
    """
    content = osim_bytes(model.source)
    parts = parts_of(open_document(content, model.source))
    before, _ = model_of(parts)
    wanted = _Wanted(model.source)
    _bodies(model, before, parts, wanted)
    _joints(model, before, parts, wanted)
    _markers(model, before, parts, wanted)
    elements = list(parts.document.model.getroottree().getroot().iter())
    spans = element_spans(content, elements, model.source)
    edits: list[Edit] = []
    for one in wanted.changed():
        child = one.parent.find(one.tag)
        text = spelt(one.wanted.tolist())
        if child is None:
            edits += new_child(spans[one.parent], one.tag, text)
        else:
            edits += new_text(spans[child], text, content)
    with atomic_write(path) as file:
        file.write(edited(content, edits))


def _same(kind: str, model: OsimModel, ours: Sequence[str], theirs: Sequence[str]) -> None:
    strange = [name for name in ours if name not in theirs]
    if strange:
        remedy = "Change what was read from this file; new parts are added in OpenSim."
        raise DataError(
            "osim.no_element", f"the file has no such {kind}", source=model.source, found=", ".join(strange[:5]),
            remedy=remedy,
        )  # fmt: skip


def _bodies(model: OsimModel, before: OsimModel, parts: Parts, wanted: _Wanted) -> None:
    _same("body", model, model.bodies, before.bodies)
    rows = {name: k for k, name in enumerate(before.bodies)}
    ours, theirs, stated = model.inertias, before.inertias, before.stated
    for k, name in enumerate(model.bodies):
        row, element = rows[name], parts.bodies[name]
        pairs = ((ours.mass, theirs.mass), (ours.centre, theirs.centre), (ours.moments, theirs.moments))
        if all(torch.equal(a[k].cpu(), b[row]) for a, b in pairs):
            continue
        if float(ours.mass[k]) < 0.0:
            raise wanted.fault("osim.negative_mass", element, "a mass cannot be negative", remedy="Correct it.")
        wanted.add(_Numbers(element, "mass", stated.mass[row][None], _plain(ours.mass[k][None])))
        wanted.add(_Numbers(element, "mass_center", stated.centre[row], _plain(ours.centre[k])))
        moments = _plain(torch.stack([ours.moments[k, i, j] for i, j in MOMENTS]))
        known = stated_moments(element, parts.document)
        if compact(element, parts.document):
            wanted.add(_Numbers(element, "inertia", known, moments))
        else:
            for tag, a, b in zip(SPELT, known[:, None], moments[:, None], strict=True):
                wanted.add(_Numbers(element, tag, a, b))


def _joints(model: OsimModel, before: OsimModel, parts: Parts, wanted: _Wanted) -> None:
    old = {joint.name: joint for joint in before.joints}
    _same("joint", model, [joint.name for joint in model.joints], list(old))
    stated = {one.name: one for one in (*parts.joints, *parts.links)}
    for joint in model.joints:
        holder = stated[joint.name]
        _frame(joint.parent, holder.parent, wanted, holder.element)
        _frame(joint.child, holder.child, wanted, holder.element)


def _frame(frame: Frame, stated: Stated, wanted: _Wanted, joint: Element) -> None:
    pairs = ((stated.frame.translation, frame.translation), (stated.frame.orientation, frame.orientation))
    if stated.element is not None:
        for tag, (a, b) in zip(stated.tags, pairs, strict=True):
            wanted.add(_Numbers(stated.element, tag, a, _plain(b)))
    elif not all(torch.equal(a, _plain(b)) for a, b in pairs):
        remedy = "Give the joint a PhysicalOffsetFrame in OpenSim."
        raise wanted.fault("osim.no_offset", joint, "its frame is a body's own and cannot be moved", remedy=remedy)


def _markers(model: OsimModel, before: OsimModel, parts: Parts, wanted: _Wanted) -> None:
    old = {marker.name: marker for marker in before.markers}
    _same("marker", model, [marker.name for marker in model.markers], list(old))
    elements: Mapping[str, Element] = {parts.document.name(element): element for element, _ in parts.markers}
    for marker in model.markers:
        wanted.add(_Numbers(elements[marker.name], "location", old[marker.name].location, _plain(marker.location)))


def _plain(values: Tensor) -> Tensor:
    return values.detach().cpu().double()
