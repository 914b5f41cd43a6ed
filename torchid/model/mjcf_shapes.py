"""Mass and inertia of MuJoCo's simple shapes, where a body has no inertial of its own."""

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from torchid.model.markup import Element, fault, numbers
from torchid.model.mechanics import Array, pose

DENSITY = 1000.0
"""MuJoCo's default [kg/m^3]."""
SIZES = {"sphere": 1, "capsule": 2, "cylinder": 2, "ellipsoid": 3, "box": 3}
"""Numbers in ``size``: radius; radius and half length; half axes."""
WITHOUT_MASS = ("plane", "hfield")


def shape_inertia(geom: Element, values: dict[str, str], path: str | Path, remedy: str) -> tuple[float, Array, Array]:
    """Mass [kg], inertia about the centre in the shape's axes [kg m^2], and pose of the shape.

    The pose is that of ``fromto`` in the body, or the identity where ``pos`` and an orientation give it.

    Raises:
        InputError: the shape is a mesh or hollow, or its numbers are wrong.
    """
    kind = values.get("type", "sphere")
    if kind in WITHOUT_MASS or _is(values, "mass", geom, path, 0.0):
        return 0.0, np.zeros((3, 3)), np.eye(4)
    if kind not in SIZES or "mesh" in values or values.get("shellinertia", "false") == "true":
        raise fault(geom, path, "mjcf.shape", "the inertia of this shape is not computed", kind, remedy=remedy)
    X, half = (np.eye(4), None) if "fromto" not in values else _between(geom, values, path)
    size = numbers(values.get("size", ""), geom, path, range(1, 4))
    if half is not None:
        size = [size[0], half] if SIZES[kind] == 2 else [size[0], size[0], half]  # MuJoCo ignores a second one
    if len(size) < SIZES[kind] or min(size[: SIZES[kind]]) <= 0.0:
        message, found = f"a {kind} needs {SIZES[kind]} positive size(s)", values.get("size", "")
        raise fault(geom, path, "mjcf.size", message, found, remedy="Write them in size, or give an inertial.")
    volume, per_mass = _UNIT[kind](*size[: SIZES[kind]])
    mass = numbers(values.get("mass", ""), geom, path, (1,))[0] if "mass" in values else (
        volume * numbers(values.get("density", str(DENSITY)), geom, path, (1,))[0]
    )  # fmt: skip
    if mass < 0.0:
        raise fault(
            geom, path, "model.mass", "a mass must be positive", f"{mass:g} kg", remedy="Correct mass or density."
        )
    x, y, z = per_mass
    return mass, mass * np.diag([y + z, x + z, x + y]), X


def _is(values: dict[str, str], key: str, geom: Element, path: str | Path, number: float) -> bool:
    return key in values and numbers(values[key], geom, path, (1,))[0] == number


def _between(geom: Element, values: dict[str, str], path: str | Path) -> tuple[Array, float]:
    """Pose and half length of a shape between two points; its Z points from the second to the first."""
    ends = np.array(numbers(values["fromto"], geom, path, (6,)))
    along = ends[:3] - ends[3:]
    length = float(np.linalg.norm(along))
    if not length > 0.0:
        remedy = "Give two points that differ."
        raise fault(geom, path, "mjcf.fromto", "two equal points", values["fromto"], remedy=remedy)
    return pose(z_to(along / length), 0.5 * (ends[:3] + ends[3:])), 0.5 * length


def z_to(direction: Array) -> Array:
    """Smallest rotation that takes Z to a unit vector; about X where it is opposite."""
    axis = np.cross([0.0, 0.0, 1.0], direction)
    sine = np.linalg.norm(axis)
    axis = axis / sine if sine > 1e-14 else np.array([1.0, 0.0, 0.0])
    return Rotation.from_rotvec(axis * math.atan2(sine, direction[2])).as_matrix()


_Unit = tuple[float, tuple[float, float, float]]
"""Volume [m^3] and second moments per mass along the axes [m^2]."""


def _ellipsoid(a: float, b: float, c: float) -> _Unit:
    return 4.0 / 3.0 * math.pi * a * b * c, (a * a / 5.0, b * b / 5.0, c * c / 5.0)


def _capsule(r: float, h: float) -> _Unit:
    """A cylinder and two half spheres, whose centres lie 3/8 r beyond its ends."""
    tube, caps = 2.0 * math.pi * r * r * h, 4.0 / 3.0 * math.pi * r**3
    share = h / (h + 2.0 / 3.0 * r)  # of the tube in the volume, also where that is too small for a number
    across = share * r * r / 4.0 + (1.0 - share) * r * r / 5.0
    along = share * h * h / 3.0 + (1.0 - share) * (r * r / 5.0 + h * h + 0.75 * r * h)
    return tube + caps, (across, across, along)


_UNIT: dict[str, Callable[..., _Unit]] = {
    "sphere": lambda r: _ellipsoid(r, r, r),
    "ellipsoid": _ellipsoid,
    "box": lambda a, b, c: (8.0 * a * b * c, (a * a / 3.0, b * b / 3.0, c * c / 3.0)),
    "cylinder": lambda r, h: (2.0 * math.pi * r * r * h, (r * r / 4.0, r * r / 4.0, h * h / 3.0)),
    "capsule": _capsule,
}
