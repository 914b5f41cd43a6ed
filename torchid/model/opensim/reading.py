"""OpenSim models in: the whole file, from its bytes to a model."""

import logging
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import torch

from torchid.conventions import GRAVITY
from torchid.errors import InputError, Note
from torchid.io.b3d_header import read_b3d_model
from torchid.io.files import container_of
from torchid.model.markup import Element, Vocabulary, parse_xml, read_bytes, unread
from torchid.model.opensim.bodies import consistent, read_inertias
from torchid.model.opensim.constraints import PROPERTIES, WELD, constraint_elements, links, weld_of
from torchid.model.opensim.couplers import read_couplers
from torchid.model.opensim.frames import Frames, Stated, body_elements
from torchid.model.opensim.function_elements import READERS
from torchid.model.opensim.joint_values import is_floating
from torchid.model.opensim.joints import ELLIPSOID, KINDS, SCAPULOTHORACIC, JointElement, joint_elements, read_joint
from torchid.model.opensim.model import Marker, OsimCoordinate, OsimJoint, OsimModel
from torchid.model.opensim.spanning import Spanning, spanning
from torchid.model.opensim.words import OsimDocument, child_text, objects

JOINTS = ("CustomJoint", *KINDS, ELLIPSOID, SCAPULOTHORACIC)
_LOOKS = "FrameGeometry attached_geometry WrapObjectSet VisibleObject frame_geometry"
_JOINT = (
    "socket_parent_frame socket_child_frame coordinates frames components parent_body location_in_parent "
    "orientation_in_parent location orientation location_in_child orientation_in_child CoordinateSet reverse"
)
_OF_JOINTS = {
    "CustomJoint": "SpatialTransform",
    ELLIPSOID: "radii_x_y_z Appearance",
    SCAPULOTHORACIC: "thoracic_ellipsoid_radii_x_y_z scapula_winging_axis_origin scapula_winging_axis_direction",
}
_FUNCTIONS = " ".join(READERS)
_POINTS = dict.fromkeys(
    ("SimmSpline", "NaturalCubicSpline", "natCubicSpline", "PiecewiseLinearFunction"), ("name", "x y")
)

WORDS: Vocabulary = {
    "Model": (
        "name",
        "Ground gravity credits publications length_units force_units assembly_accuracy components frames defaults "
        "BodySet JointSet ConstraintSet MarkerSet ForceSet ControllerSet ContactGeometrySet ProbeSet ComponentSet "
        "ModelVisualPreferences CoordinateSet AnalysisSet",
    ),
    **dict.fromkeys(("BodySet", "JointSet", "ConstraintSet", "MarkerSet", "CoordinateSet"), ("name", "objects groups")),
    "objects": ("", " ".join(f"{tag}*" for tag in ("Body", "Marker", "Coordinate", *JOINTS, *PROPERTIES))),
    "Body": (
        "name",
        f"mass mass_center inertia inertia_xx inertia_yy inertia_zz inertia_xy inertia_xz inertia_yz Joint components "
        f"{_LOOKS}",
    ),
    "Joint": ("name", " ".join(JOINTS)),
    **{kind: ("name", f"{_JOINT} {_OF_JOINTS.get(kind, '')}") for kind in JOINTS},
    "coordinates": ("", "Coordinate*"),
    "Coordinate": (
        "name",
        "default_value default_speed_value range clamped locked prescribed prescribed_function "
        "is_free_to_satisfy_constraints components motion_type initial_value",
    ),
    "frames": ("", "PhysicalOffsetFrame*"),
    "PhysicalOffsetFrame": ("name", f"socket_parent translation orientation components {_LOOKS}"),
    "SpatialTransform": ("name", "TransformAxis*"),
    "TransformAxis": ("name", f"coordinates axis function {_FUNCTIONS}"),
    **{kind: ("name", words) for kind, words in PROPERTIES.items()},
    "coupled_coordinates_function": ("", _FUNCTIONS),
    "function": ("", _FUNCTIONS),
    "Marker": ("name", f"socket_parent_frame body location fixed components {_LOOKS}"),
    "Constant": ("name", "value"),
    "LinearFunction": ("name", "coefficients"),
    "PolynomialFunction": ("name", "coefficients"),
    "MultivariatePolynomialFunction": ("name", "coefficients dimension order"),
    "MultiplierFunction": ("name", "function scale"),
    "Sine": ("name", "amplitude omega phase offset"),
    **_POINTS,
}
"""Cited. The elements of OpenSim files that are looked into, and what may stand in them: properties that OpenSim 4
lists of its classes (``Object::getPropertyByIndex``) and those of older versions that it renames on reading
(``updateFromXMLNode`` of Body, Joint, Coordinate, Constraint and Marker)."""


log = logging.getLogger(__name__)

VERSIONS = ((20000, 30499), (40000, 49999))
"""Choice. Versions of the format that are read, first and last: those of OpenSim 2 and 3, and those of OpenSim 4.
Numbers between them belong to development versions."""
NO_JOINTS = ("Joint", "CMC_Joint")
"""Cited. Elements whose names end as if they were joints: what holds the joint of a body in older files, and a tracking
task of OpenSim's CMC tool."""
COLONS = re.compile(rb"</?[A-Za-z_][\w.-]*(?:::[\w.-]+)+")
"""Format. Tags with a name that is none of XML, as OpenSim writes of classes within others."""
LOOKED_AT = ("BodySet", "JointSet", "ConstraintSet", "MarkerSet")
"""Wording. Sets of the model whose members are read; constraints may stand among components as well."""


@dataclass(frozen=True)
class Parts:
    """A file's elements that state numbers, beside what they state."""

    document: OsimDocument
    bodies: Mapping[str, Element]
    joints: tuple[JointElement, ...]
    links: tuple[JointElement, ...]
    """Constraints that hold two bodies."""
    markers: tuple[tuple[Element, Stated], ...]


def read_osim(path: str | Path) -> tuple[OsimModel, tuple[Note, ...]]:
    """Read the model of an OpenSim file of version 2, 3 or 4, or the one in a .b3d of AddBiomechanics.

    Muscles, other forces, wrapping and looks are passed over.

    Returns:
        The model, and notes about what was changed or passed over, which are logged as well.

    Raises:
        InputError: ``xml.*`` for what is no XML, or has entities; ``osim.*`` for what is no such model, or holds
            something that cannot be read exactly. It names the line. As ``osim_bytes``.
    """
    path = Path(path)
    model, notes = model_of(parts_of(open_document(osim_bytes(path), path)))
    for note in notes:
        log.warning("%s", note)
    return model, notes


def osim_bytes(path: Path) -> bytes:
    """Return the text of the model in a file, which is the file or, of a .b3d, a part of it.

    Raises:
        InputError: ``xml.unreadable``, ``xml.too_large``; of a .b3d as ``read_b3d_model``.
    """
    return read_b3d_model(path) if container_of(path) == path else read_bytes(path)


def open_document(content: bytes, path: Path) -> OsimDocument:
    """Return the document of a file's bytes.

    Raises:
        InputError: ``xml.*``, ``osim.version``, ``osim.model``.
    """
    # As long as it was, so that lines and bytes are where they were.
    root = parse_xml(COLONS.sub(lambda tag: tag[0].replace(b"::", b"__"), content), path, "OpenSimDocument")
    text = root.get("Version", "")
    version = int(text) if text.isdecimal() and len(text) < 10 else 0
    if not any(first <= version <= last for first, last in VERSIONS):
        raise InputError(
            "osim.version", "a version of the format that is not read", source=path, place="<OpenSimDocument>",
            found=text, remedy="Open it with OpenSim 4 and save it again.",
        )  # fmt: skip
    model = root.find("Model")
    if model is None:
        remedy = "Name a model file, not a setup file."
        raise InputError("osim.model", "holds no <Model>", source=path, place="<OpenSimDocument>", remedy=remedy)
    return OsimDocument(path, model, version)


def parts_of(document: OsimDocument) -> Parts:
    """Return the elements of a document that state numbers.

    Raises:
        InputError: ``osim.body``, ``osim.frame``, ``osim.constraint``, ``osim.elsewhere`` for a part that is not read.
    """
    bodies = body_elements(document)
    frames = Frames(document, bodies)
    markers = []
    for element in objects(document.model, "MarkerSet"):
        if element.tag == "Marker":
            frame = child_text(element, "socket_parent_frame") or child_text(element, "body")
            markers.append((element, frames.named(frame, element)))
    joints = tuple(joint_elements(document, frames, bodies))
    parts = Parts(document, bodies, joints, tuple(links(document, frames)), tuple(markers))
    _refuse_elsewhere(parts)
    return parts


def _refuse_elsewhere(parts: Parts) -> None:
    """Refuse parts of the model that stand where they are not looked for, and defaults that change what is left out."""
    document = parts.document
    looked_at = {element for tag in LOOKED_AT if tag != "JointSet" for element in objects(document.model, tag)}
    looked_at |= {one.element for one in parts.joints} | set(constraint_elements(document))
    for element in document.model.iterdescendants():
        tag = str(element.tag)
        moves = tag in ("Body", "Marker") or tag not in NO_JOINTS and tag.endswith(("Joint", "Constraint"))
        changes = element.getparent().tag == "defaults" and tag in WORDS
        if changes or moves and element not in looked_at:
            remedy = f"Put it into {', '.join(LOOKED_AT)}; write defaults out: saving with OpenSim 4 does."
            message = "a part of the model that stands where it is not read"
            raise document.fault(element, "osim.elsewhere", message, remedy=remedy)


def model_of(parts: Parts) -> tuple[OsimModel, tuple[Note, ...]]:
    """Return the model that elements state, and notes.

    Raises:
        InputError: as ``read_osim``.
    """
    document, source = parts.document, str(parts.document.source)
    joints, coordinates = _joints(parts)
    if not parts.bodies:
        raise document.fault(document.model, "osim.body", "the model has no bodies", remedy="Name a whole model.")
    stated = read_inertias(parts.bodies, document)
    inertias, notes = consistent(stated, tuple(parts.bodies), source)
    driven = ", ".join(one.name for one in coordinates if one.prescribed)
    if driven:
        notes += (Note("osim.prescribed", f"{driven}: driven by functions of time, taken as free", source),)
    couplers, markers = read_couplers([one.name for one in coordinates], document), _markers(parts)
    welds = [weld_of(link) for link in parts.links if link.element.tag == WELD]
    span = spanning(joints, welds, coordinates, couplers, markers)
    _refuse_unjoined(span.joints, parts)
    model = OsimModel(
        source=document.source,
        name=document.model.get("name", ""),
        version=document.version,
        gravity=document.vector(document.model, "gravity", [0.0, -GRAVITY, 0.0]),
        bodies=tuple(parts.bodies),
        stated=stated,
        inertias=inertias,
        coordinates=coordinates,
        joints=span.joints,
        closing=span.closing,
        couplers=couplers,
        markers=markers,
    )
    notes += _notes_of_loops(span, parts)
    return model, (*unread(document.model, WORDS, source), *notes)


def _joints(parts: Parts) -> tuple[list[OsimJoint], tuple[OsimCoordinate, ...]]:
    joints: list[OsimJoint] = []
    coordinates: list[OsimCoordinate] = []
    for stated in parts.joints:
        if stated.parent.frame.body == stated.child.frame.body:
            remedy = "Let it stand between two bodies."
            raise parts.document.fault(stated.element, "osim.loop", "a joint of a body with itself", remedy=remedy)
        joint, own = read_joint(stated, len(coordinates), parts.document)
        known = {one.name for one in coordinates}
        twice = [joint.name] if joint.name in {one.name for one in joints} else []
        twice += [one.name for one in own if one.name in known]
        if twice:
            message = "a name of a joint or a coordinate stands twice"
            raise parts.document.fault(stated.element, "osim.twice", message, twice[0], remedy="Rename one of them.")
        joints.append(joint)
        coordinates += own
    return joints, tuple(coordinates)


def _refuse_unjoined(joints: Sequence[OsimJoint], parts: Parts) -> None:
    reached = {joint.carried.body for joint in joints}
    for body, element in enumerate(parts.bodies.values()):
        if body not in reached:
            remedy = "Join it to ground or to a body that is; a FreeJoint leaves it free."
            raise parts.document.fault(element, "osim.unjoined", "no chain of joints leads to ground", remedy=remedy)


def _notes_of_loops(span: Spanning, parts: Parts) -> tuple[Note, ...]:
    """What holds bodies in the file and not in the model, and what hangs by a weld instead of its own free joint."""
    source, names = str(parts.document.source), ("ground", *parts.bodies)
    hung = [joint.name for joint in span.joints if joint.kind == WELD]
    left = {joint.name for joint in span.closing if not is_floating(joint)} | {weld.name for weld in span.opened}
    found, opened = [], []
    for one in (*parts.joints, *parts.links):
        said = f"{one.element.tag} {one.name.rpartition('/')[2]}"
        said += f" ({names[one.parent.frame.body + 1]}, {names[one.child.frame.body + 1]})"
        if one.name in hung:
            said += ": one hangs on the other by it, not by its own joint, which is free or which no marker tells"
            found.append(Note("osim.hung", said, source))
        elif one.name in left or one in parts.links and one.element.tag != WELD:
            opened.append(said)
    if opened:
        said = f"{', '.join(opened)}: kept in the file, not held: markers tell where bodies are; those without rest"
        found.append(Note("osim.opened", said, source))
    return tuple(found)


def _markers(parts: Parts) -> tuple[Marker, ...]:
    zero = torch.zeros(3).tolist()
    document, found = parts.document, dict[str, Marker]()
    for element, stated in parts.markers:
        name = document.name(element)
        if name in found:
            raise document.fault(element, "osim.twice", "two markers have one name", name, remedy="Rename one of them.")
        found[name] = Marker(name, stated.frame, document.vector(element, "location", zero))
    return tuple(found.values())
