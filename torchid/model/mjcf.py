"""MuJoCo models in (https://mujoco.readthedocs.io/en/stable/XMLreference.html), without MuJoCo.

Bodies with hinge, slide, ball and free joints, default classes, the compiler's angle and orientation options,
inertials or simple shapes, sites as landmarks. What changes the tree in ways not read here (includes, frames,
replicas, equality constraints) is refused; controllers, contacts, tendons and looks do not matter to the model.
"""

import math
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from torchid.errors import Note
from torchid.model.assembly import ModelLink, assemble, check_body
from torchid.model.markup import Element, fault, numbers, place, read_xml, unread
from torchid.model.mechanics import Array, axis_rotation, pose, pseudo_inertia
from torchid.model.mjcf_shapes import shape_inertia, z_to
from torchid.model.mjcf_words import WORDS
from torchid.model.model import Model
from torchid.model.tree_of_links import FileScatter, LinkAxis

REFUSED = ("include", "frame", "replicate", "attach", "composite", "flexcomp", "plugin")
COMPILED = "Let MuJoCo write the compiled model: <compiler saveinertial='true'/>, then mujoco.mj_saveLastXML."
TOTALS = ("settotalmass", "boundmass", "boundinertia", "balanceinertia", "inertiagrouprange", "coordinate")
"""Options of the compiler that change masses or frames."""


@dataclass
class _Reading:
    """What stands for the whole file, and what was found so far."""

    path: Path
    degrees: bool = True
    sequence: str = "xyz"
    from_shapes: str = "auto"
    classes: dict[str, dict[str, dict[str, str]]] = field(default_factory=lambda: {"main": {}})
    """Class: tag: attributes, inherited ones included."""
    links: list[ModelLink] = field(default_factory=list)
    sites: dict[str, tuple[str, Array]] = field(default_factory=dict)
    armature: list[str] = field(default_factory=list)
    """Joints that have one."""
    notes: list[Note] = field(default_factory=list)

    def say(self, code: str, message: str) -> None:
        """Collect a note."""
        self.notes.append(Note(f"mjcf.{code}", message, str(self.path)))


def read_mjcf(path: str | Path, scatter: FileScatter | None = None) -> tuple[Model, tuple[Note, ...]]:
    """Model of an MJCF file, and what was merged, left out or repaired.

    A ball joint becomes three turns about X, Y, Z. A root without free joint floats all the same, and a note says so.

    Args:
        scatter: how uncertain its numbers are; default ``FileScatter()``.

    Raises:
        InputError: not such a file, something of ``REFUSED``, constraints that close loops, inertia that no body has
            or that needs a mesh. It names the line.
    """
    root = read_xml(path, "mujoco")
    reading = _Reading(Path(path))
    _refuse(root, path)
    for compiler in root.findall("compiler"):
        _read_compiler(compiler, reading)
    for default in root.findall("default"):
        _read_default(default, "main", reading)
    tops = [body for world in root.findall("worldbody") for body in world.findall("body")]
    free = [body for body in tops if _free_joint(body, reading, "main") is not None]
    if len(free) != 1 and len(tops) != 1:
        found = f"{len(tops)} bodies in the world, {len(free)} free"
        message, remedy = "needs one body in the world, or one with a free joint", "Leave one body there."
        raise fault(root, path, "mjcf.root", message, found, remedy=remedy)
    top = (free or tops)[0]
    if not free:
        reading.say("base_floats", f"{place(top)}: has no free joint; it floats, and its own joints are left out")
    if len(tops) > 1:
        reading.say("scenery", f"{len(tops) - 1} other bodies of the world are left out")
    _read_body(top, None, "main", reading)
    if reading.armature:
        reading.say("armature", f"{', '.join(reading.armature)}: armature is no inertia of a body and is left out")
    model, notes = assemble(reading.links, path, reading.sites, scatter or FileScatter())
    return model, (*unread(root, WORDS, str(path)), *reading.notes, *notes)


def _refuse(root: Element, path: str | Path) -> None:
    for element in root.iter(*REFUSED):
        raise fault(element, path, "mjcf.unsupported", "this element is not read", remedy=COMPILED)
    for constraint in (child for equality in root.findall("equality") for child in equality):
        if constraint.get("active", "true") == "true" and constraint.tag in ("connect", "weld", "joint"):
            raise fault(constraint, path, "mjcf.equality", "a constraint between bodies or joints", remedy="Remove it.")
    for option in root.findall("option"):
        x, y, z = numbers(option.get("gravity", "0 0 -9.81"), option, path, (3,))
        if math.hypot(x, y) > 1e-3 * abs(z) or z > 0.0:
            remedy = "Turn the model until Z points up."
            raise fault(option, path, "mjcf.up", "gravity does not point along -Z", f"{x:g} {y:g} {z:g}", remedy=remedy)


def _read_compiler(compiler: Element, reading: _Reading) -> None:
    for key in TOTALS:
        if key in compiler.attrib and compiler.get(key) not in ("-1", "0", "false", "local", "0 5"):
            raise fault(compiler, reading.path, "mjcf.compiler", "this option is not read", key, remedy=COMPILED)
    reading.degrees = compiler.get("angle", "degree" if reading.degrees else "radian") != "radian"
    reading.sequence = compiler.get("eulerseq", reading.sequence)
    reading.from_shapes = compiler.get("inertiafromgeom", reading.from_shapes)


def _read_default(default: Element, parent: str, reading: _Reading) -> None:
    """A class of defaults, its parent's attributes under its own."""
    name = default.get("class") or "main"  # as MuJoCo reads an empty one here, and nowhere else
    classes = reading.classes
    known = {tag: dict(values) for tag, values in classes.get(parent, {}).items()}
    for child in default:
        if child.tag != "default":
            known[str(child.tag)] = known.get(str(child.tag), {}) | dict(child.attrib)
    classes[name] = known
    for child in default.findall("default"):
        if not child.get("class"):
            raise fault(child, reading.path, "mjcf.default", "an inner default needs a class", remedy="Name it.")
        _read_default(child, name, reading)


def _attributes(element: Element, inherited: str, reading: _Reading) -> dict[str, str]:
    """Attributes of an element over those of its class."""
    name = element.get("class", inherited)
    if name not in reading.classes:
        remedy = f"Known: {', '.join(list(reading.classes)[:20])}."
        raise fault(element, reading.path, "mjcf.class", "unknown class", name, remedy=remedy)
    return reading.classes[name].get(str(element.tag), {}) | dict(element.attrib)


def _free_joint(body: Element, reading: _Reading, inherited: str) -> Element | None:
    inherited = body.get("childclass", inherited)
    for joint in body.findall("joint"):
        if _attributes(joint, inherited, reading).get("type") == "free":
            return joint
    return body.find("freejoint")


def _read_body(body: Element, parent: str | None, inherited: str, reading: _Reading) -> None:
    """A body and all below it (libxml2 bounds how deep elements nest)."""
    inherited = body.get("childclass", inherited)
    name = body.get("name") or f"body_{len(reading.links)}"
    if parent is not None and _free_joint(body, reading, inherited) is not None:
        remedy = "Move the body into the world, or give it another joint."
        raise fault(body, reading.path, "mjcf.free", "only a body of the world may be free", remedy=remedy)
    axes, anchor = _joints(body, name, inherited, reading) if parent is not None else ((), np.zeros(3))
    pseudo = _inertia(body, inherited, reading)
    reading.links.append(
        ModelLink(name, parent, _pose(body, dict(body.attrib), reading), axes, anchor, pseudo, place(body))
    )
    for site in body.findall("site"):
        values = _attributes(site, inherited, reading)
        label = site.get("name") or f"site_{len(reading.sites)}"
        if "fromto" in values:
            ends = numbers(values["fromto"], site, reading.path, (6,))
            values["pos"] = " ".join(repr(0.5 * (a + b)) for a, b in zip(ends[:3], ends[3:], strict=True))
        reading.sites[label] = name, np.array(numbers(values.get("pos", "0 0 0"), site, reading.path, (3,)))
    for child in body.findall("body"):
        _read_body(child, name, inherited, reading)


def _joints(body: Element, name: str, inherited: str, reading: _Reading) -> tuple[tuple[LinkAxis, ...], Array]:
    """Axes of a body's joints and the point they share."""
    axes: list[LinkAxis] = []
    anchor: Array | None = None
    for joint in body.findall("joint"):
        values = _attributes(joint, inherited, reading)
        label = joint.get("name") or f"{name}_joint_{len(axes)}"
        found = _axes(joint, label, values, reading)
        axes += found
        if not all(axis.slide for axis in found):
            here = np.array(numbers(values.get("pos", "0 0 0"), joint, reading.path, (3,)))
            if anchor is not None and np.abs(here - anchor).max() > 1e-9:
                message, remedy = "turns of one body about different points", "Put a body with mass between them."
                raise fault(joint, reading.path, "mjcf.anchor", message, remedy=remedy)
            anchor = here
        if numbers(values.get("armature", "0"), joint, reading.path, (1,))[0] != 0.0:
            reading.armature.append(label)
    return tuple(axes), np.zeros(3) if anchor is None else anchor


def _axes(joint: Element, label: str, values: dict[str, str], reading: _Reading) -> list[LinkAxis]:
    kind = values.get("type", "hinge")
    if numbers(values.get("ref", "0"), joint, reading.path, (1,))[0] != 0.0:
        message = "a reference other than zero is not read"
        raise fault(joint, reading.path, "mjcf.ref", message, values["ref"], remedy=COMPILED)
    if kind == "ball":
        reading.say("ball", f"{label}: a ball joint, read as turns about X, Y, Z")
        return [LinkAxis(f"{label}_{axis}", False, np.eye(3)[k]) for k, axis in enumerate("xyz")]
    if kind not in ("hinge", "slide"):
        raise fault(
            joint, reading.path, "mjcf.joint", "unknown type of joint", kind, remedy="Use free, ball, slide or hinge."
        )
    unit = np.array(numbers(values.get("axis", "0 0 1"), joint, reading.path, (3,)))
    if not np.linalg.norm(unit) > 0.0:
        raise fault(joint, reading.path, "mjcf.axis", "an axis of length zero", remedy="Give it a direction.")
    lower, upper = -math.inf, math.inf
    if "range" in values and values.get("limited", "auto") != "false":
        lower, upper = numbers(values["range"], joint, reading.path, (2,))
        if reading.degrees and kind == "hinge":
            lower, upper = math.radians(lower), math.radians(upper)
        if lower > upper:
            message, remedy = "the lower limit is above the upper", "Exchange them."
            raise fault(joint, reading.path, "mjcf.range", message, values["range"], remedy=remedy)
    return [LinkAxis(label, kind == "slide", unit / np.linalg.norm(unit), lower, upper)]


def _pose(element: Element, values: dict[str, str], reading: _Reading) -> Array:
    """Pose of an element by its ``pos`` and one of the five spellings of an orientation."""
    p = numbers(values.get("pos", "0 0 0"), element, reading.path, (3,))
    return pose(_orientation(element, values, reading), p)


def _orientation(element: Element, values: dict[str, str], reading: _Reading) -> Array:
    """Rotation matrix (MuJoCo's modelling chapter, "Frame orientations")."""
    spellings = [key for key in ("quat", "axisangle", "xyaxes", "zaxis", "euler") if key in values]
    if not spellings:
        return np.eye(3)
    if len(spellings) > 1:
        found = " and ".join(spellings)
        raise fault(element, reading.path, "mjcf.orientation", "two orientations", found, remedy="Leave one.")
    kind = spellings[0]
    count = {"quat": 4, "axisangle": 4, "xyaxes": 6}.get(kind, 3)
    v = np.array(numbers(values[kind], element, reading.path, (count,)))
    norm = np.linalg.norm(v[:3] if kind in ("axisangle", "xyaxes") else v)
    if kind != "euler" and not norm > 0.0:
        message, remedy = f"a {kind} of length zero", "Give it a direction, or leave it out."
        raise fault(element, reading.path, "mjcf.orientation", message, values[kind], remedy=remedy)
    unit = math.radians(1.0) if reading.degrees else 1.0
    if kind == "quat":
        return Rotation.from_quat(v[[1, 2, 3, 0]]).as_matrix()
    if kind == "axisangle":
        return Rotation.from_rotvec(v[:3] / norm * v[3] * unit).as_matrix()
    if kind == "euler":
        return _euler(element, v * unit, reading)
    if kind == "zaxis":
        return z_to(v / norm)
    x, y = v[:3] / norm, v[3:] - (v[3:] @ v[:3]) / norm**2 * v[:3]
    if not np.linalg.norm(y) > 0.0:
        message, remedy = "axes of one direction", "Give two that are not parallel."
        raise fault(element, reading.path, "mjcf.orientation", message, values[kind], remedy=remedy)
    y = y / np.linalg.norm(y)
    return np.stack([x, y, np.cross(x, y)], axis=1)


def _euler(element: Element, angles: Array, reading: _Reading) -> Array:
    """Three turns: lower case about axes that turn along, upper case about the parent's."""
    if len(reading.sequence) != 3 or not set(reading.sequence.lower()) <= set("xyz"):
        message, remedy = "not a sequence of three axes", "Write three of x, y, z, X, Y, Z in <compiler eulerseq>."
        raise fault(element, reading.path, "mjcf.eulerseq", message, reading.sequence, remedy=remedy)
    R = np.eye(3)
    for letter, angle in zip(reading.sequence, angles, strict=True):
        turn = axis_rotation("xyz".index(letter.lower()), angle)
        R = R @ turn if letter.islower() else turn @ R
    return R


def _inertia(body: Element, inherited: str, reading: _Reading) -> Array:
    """Pseudo-inertia of a body about its origin, from its inertial or its shapes, as the compiler chooses."""
    inertial = body.find("inertial")
    if reading.from_shapes == "true" or (reading.from_shapes == "auto" and inertial is None):
        total = np.zeros((4, 4))
        for geom in body.findall("geom"):
            values = _attributes(geom, inherited, reading)
            mass, I_C, X_SC = shape_inertia(geom, values, reading.path, COMPILED)
            if mass > 0.0:
                X_BS = np.eye(4) if "fromto" in values else _pose(geom, values, reading)
                total += pseudo_inertia(mass, I_C, X_BS @ X_SC)
        return total
    if inertial is None:
        return np.zeros((4, 4))
    values = dict(inertial.attrib)
    mass = numbers(values.get("mass", ""), inertial, reading.path, (1,))[0]
    if "fullinertia" in values:
        xx, yy, zz, xy, xz, yz = numbers(values["fullinertia"], inertial, reading.path, (6,))
        I_C = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    else:
        I_C = np.diag(numbers(values.get("diaginertia", ""), inertial, reading.path, (3,)))
    check_body(mass, I_C, inertial, reading.path)
    return pseudo_inertia(mass, I_C, _pose(inertial, values, reading))
