"""URDF in and out (http://wiki.ros.org/urdf/XML). Meshes are never opened.

Reading: the root link floats. Revolute, continuous and prismatic joints about any axis; fixed links become part of
their parent, or its landmarks when massless; massless links that carry the next axis through the same point become
one joint. Writing: the same backwards, so that a written model reads back.
"""

import math
from pathlib import Path

import numpy as np
from jaxtyping import Float
from torch import Tensor

from torchid.errors import InputError, Note
from torchid.model.assembly import ModelLink, assemble, check_body
from torchid.model.markup import (
    Element,
    document,
    fault,
    node,
    numbers,
    place,
    plain_name,
    read_xml,
    spelt,
    unread,
    write_xml,
)
from torchid.model.mechanics import (
    Array,
    MarkerTable,
    matrix_to_rpy,
    phi_to_centre,
    pose,
    pseudo_inertia,
    rpy_to_matrix,
    zero_pose,
)
from torchid.model.model import Geometry, Model
from torchid.model.tree import Body, Dof, Tree
from torchid.model.tree_of_links import FileScatter, LinkAxis

UNLIMITED = 1e9
"""Written for a limit that does not exist, where URDF demands one; read as none [m, rad]."""
MOVING = ("revolute", "continuous", "prismatic")
_PARTS = "inertial visual* collision* contact sensor* self_collision_checking"
_WORDS = {
    "robot": ("name version", "link* joint* material* transmission* gazebo* ros2_control* sensor* mujoco drake"),
    "link": ("name type", _PARTS),
    "inertial": ("", "origin mass inertia"),
    "origin": ("xyz rpy", ""),
    "mass": ("value", ""),
    "inertia": ("ixx ixy ixz iyy iyz izz", ""),
    "joint": ("name type", "origin parent child axis limit mimic dynamics calibration safety_controller actuator*"),
    "parent": ("link", ""),
    "child": ("link", ""),
    "axis": ("xyz", ""),
    "limit": ("lower upper effort velocity acceleration deceleration jerk", ""),
}
"""http://wiki.ros.org/urdf/XML, with what URDF 1.2, Gazebo and MuJoCo add."""


def read_urdf(path: str | Path, scatter: FileScatter | None = None) -> tuple[Model, tuple[Note, ...]]:
    """Model of a URDF file, and what was merged or repaired.

    Args:
        scatter: how uncertain its numbers are; default ``FileScatter()``.

    Raises:
        InputError: not such a file; mimic, planar or inner floating joints; loops; inertia that no body has; a
            moving link without mass. It names the line.
    """
    root = read_xml(path, "robot")
    alien = next((e for e in root.iter() if "xacro" in str(e.tag)), None)
    if alien is not None:
        raise InputError(
            "urdf.xacro", "macros are not expanded", source=path, place=place(alien), remedy="Run xacro on it first."
        )
    links: dict[str, Element] = {}
    for element in root.findall("link"):
        name = _name(element, path)
        if name in links:
            found = f"{name}, also in line {links[name].sourceline}"
            raise fault(
                element, path, "model.name_twice", "two links have one name", found, remedy="Rename one of them."
            )
        links[name] = element
    joints: dict[str, Element] = {}
    for element in root.findall("joint"):
        child = _end(element, "child", links, path)
        if child in joints:
            raise fault(element, path, "model.loop", "a link hangs on two joints", child, remedy="Cut the loop.")
        joints[child] = element
    _drop_world(links, joints, path)
    read = [_link(name, links[name], joints.get(name), links, path) for name in links]
    model, notes = assemble(read, path, {}, scatter or FileScatter())
    return model, (*unread(root, _WORDS, str(path)), *notes)


def _name(element: Element, path: str | Path) -> str:
    name = element.get("name")
    if not name:
        raise fault(element, path, "urdf.name", "needs a name", remedy='Give it name="...".')
    return name


def _end(joint: Element, which: str, links: dict[str, Element], path: str | Path) -> str:
    end = joint.find(which)
    name = end.get("link", "") if end is not None else ""
    if name not in links:
        remedy = f'Write <{which} link="..."/> with the name of a link.'
        raise fault(joint, path, "urdf.link", f"its {which} is no link of the file", name, remedy=remedy)
    return name


def _drop_world(links: dict[str, Element], joints: dict[str, Element], path: str | Path) -> None:
    """A floating joint under a massless root is the floating base itself."""
    for child, joint in list(joints.items()):
        if joint.get("type") == "floating":
            parent = _end(joint, "parent", links, path)
            alone = sum(_end(other, "parent", links, path) == parent for other in joints.values()) == 1
            if parent in joints or links[parent].find("inertial") is not None or not alone:
                remedy = f"Use one of fixed, {', '.join(MOVING)}."
                raise fault(joint, path, "urdf.joint", "only the root may float", "floating", remedy=remedy)
            del joints[child], links[parent]


def _link(name: str, element: Element, joint: Element | None, links: dict[str, Element], path: str | Path) -> ModelLink:
    pseudo = _inertial(element, path)
    if joint is None:
        return ModelLink(name, None, np.eye(4), pseudo=pseudo, place=place(element))
    axes = _axes(joint, path)
    X_PL = _origin(joint, path)
    return ModelLink(name, _end(joint, "parent", links, path), X_PL, axes, pseudo=pseudo, place=place(element))


def _axes(joint: Element, path: str | Path) -> tuple[LinkAxis, ...]:
    kind = joint.get("type", "")
    if kind == "fixed":
        return ()
    if kind not in MOVING:
        remedy = f"Known: fixed, {', '.join(MOVING)}."
        raise fault(joint, path, "urdf.joint", "a joint of unknown type", kind, remedy=remedy)
    mimic = joint.find("mimic")
    if mimic is not None:
        remedy = "Make the joint fixed or free."
        raise fault(
            mimic, path, "urdf.mimic", "coupled joints are not supported", mimic.get("joint", ""), remedy=remedy
        )
    element = joint.find("axis")
    unit = np.array([1.0, 0.0, 0.0])
    if element is not None:
        unit = np.array(numbers(element.get("xyz", "1 0 0"), element, path, (3,)))
    if element is not None and not np.linalg.norm(unit) > 0.0:
        raise fault(element, path, "urdf.axis", "an axis of length zero", remedy="Give it a direction.")
    lower, upper = _limits(joint, path) if kind != "continuous" else (-math.inf, math.inf)
    return (LinkAxis(_name(joint, path), kind == "prismatic", unit / np.linalg.norm(unit), lower, upper),)


def _limits(joint: Element, path: str | Path) -> tuple[float, float]:
    limit = joint.find("limit")
    if limit is None or limit.get("lower") is None and limit.get("upper") is None:
        return -math.inf, math.inf
    lower, upper = (numbers(limit.get(end, "0"), limit, path, (1,))[0] for end in ("lower", "upper"))
    if lower > upper:
        found = f"{lower:g} > {upper:g}"
        raise fault(limit, path, "urdf.limit", "the lower limit is above the upper", found, remedy="Exchange them.")
    return (-math.inf if lower <= -UNLIMITED else lower), (math.inf if upper >= UNLIMITED else upper)


def _origin(element: Element, path: str | Path) -> Array:
    origin = element.find("origin")
    if origin is None:
        return np.eye(4)
    xyz = numbers(origin.get("xyz", "0 0 0"), origin, path, (3,))
    roll, pitch, yaw = numbers(origin.get("rpy", "0 0 0"), origin, path, (3,))
    return pose(rpy_to_matrix(roll, pitch, yaw), xyz)


def _inertial(link: Element, path: str | Path) -> Array:
    """Pseudo-inertia of a link about its origin; zeros without inertial or with one of nothing but zeros."""
    inertial = link.find("inertial")
    if inertial is None:
        return np.zeros((4, 4))
    mass_element, tensor = inertial.find("mass"), inertial.find("inertia")
    if mass_element is None or tensor is None:
        remedy = "Give both, or leave the inertial of a massless link out."
        raise fault(inertial, path, "urdf.inertial", "needs mass and inertia", remedy=remedy)
    mass = numbers(mass_element.get("value", ""), mass_element, path, (1,))[0]
    xx, xy, xz, yy, yz, zz = (
        numbers(tensor.get(key, "0"), tensor, path, (1,))[0] for key in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
    )
    inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    if mass == 0.0 and not inertia.any():
        return np.zeros((4, 4))
    check_body(mass, inertia, inertial, path)
    return pseudo_inertia(mass, inertia, _origin(inertial, path))


def write_urdf(
    tree: Tree,
    geometry: Geometry,
    phi: Float[Tensor, "bodies 10"],
    path: str | Path,
    markers: MarkerTable | None = None,
    name: str = "torchid",
) -> None:
    """Write a model as URDF: a joint of several axes as massless links at one point, markers as massless fixed links.

    Every body's frame, its coordinates' names and signs are kept; constant rotations and leans go into ``origin`` and
    ``axis``. The root floats (load it with a free joint).

    Raises:
        DataError: a body has no positive mass.
        InputError: the file cannot be written.
    """
    root = document("robot", name=plain_name(name))
    hinge, offset = geometry.hinge.detach().tolist(), geometry.offset.detach().cpu().double().numpy()
    for k, body in enumerate(tree.bodies):
        if k:
            _write_joints(root, tree, body, hinge, offset[k])
        _write_link(root, body.name, phi[k].detach().cpu().double().numpy())
    taken = {link.get("name", "") for link in root.findall("link")} | set(tree.names)
    for label, (segment, p) in (markers or {}).items():
        plain = plain_name(label, taken)
        taken.add(plain)
        node(root, "link", name=plain)
        _write_joint(root, f"{plain}_fixed", "fixed", segment, plain, np.asarray(p, dtype=np.float64))
    write_xml(path, root)


def _write_link(root: Element, name: str, phi: Array) -> None:
    mass, centre, inertia = phi_to_centre(phi, name)
    inertial = node(node(root, "link", name=name), "inertial")
    node(inertial, "origin", xyz=spelt(centre), rpy="0 0 0")
    node(inertial, "mass", value=spelt([mass]))
    entries = {f"i{'xyz'[i]}{'xyz'[j]}": spelt([inertia[i, j]]) for i in range(3) for j in range(i, 3)}
    node(inertial, "inertia", **entries)


def _write_joints(root: Element, tree: Tree, body: Body, hinge: list[float], offset: Array) -> None:
    """The chain from the parent to the body: the first joint carries the constant pose."""
    joint, parent = zero_pose(body, hinge), tree.names[body.parent]
    steps = [(row, unit, True) for row, unit in joint.slides] + [(row, unit, False) for row, unit in joint.turns]
    p, rpy = offset, matrix_to_rpy(joint.R_PB)
    if not steps:
        _write_joint(root, f"{body.name}_fixed", "fixed", parent, body.name, p, rpy)
    for count, (row, unit, slide) in enumerate(steps, start=1):
        dof = tree.dofs[row]
        child = body.name if count == len(steps) else f"{body.name}__{dof.name}"
        if child != body.name:
            node(root, "link", name=child)
        endless = not slide and math.isinf(dof.lower) and math.isinf(dof.upper)
        kind = "prismatic" if slide else "continuous" if endless else "revolute"
        element = _write_joint(root, dof.name, kind, parent, child, p, rpy)
        node(element, "axis", xyz=spelt(unit))
        if not endless:
            _write_limit(element, dof)
        parent, p, rpy = child, np.zeros(3), np.zeros(3)


def _write_limit(joint: Element, dof: Dof) -> None:
    lower, upper = max(dof.lower, -UNLIMITED), min(dof.upper, UNLIMITED)
    # URDF has no word for "no such limit": effort and velocity are required.
    node(joint, "limit", lower=spelt([lower]), upper=spelt([upper]), effort="1000", velocity="100")


def _write_joint(
    root: Element, name: str, kind: str, parent: str, child: str, p: Array, rpy: Array | None = None
) -> Element:
    joint = node(root, "joint", name=name, type=kind)
    node(joint, "origin", xyz=spelt(p), rpy=spelt(np.zeros(3) if rpy is None else rpy))
    node(joint, "parent", link=parent)
    node(joint, "child", link=child)
    return joint
