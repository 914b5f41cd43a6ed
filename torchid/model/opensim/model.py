"""What an OpenSim model says of a body: frames, joints, coordinates, couplers, inertia and markers.

All vectors are in OpenSim's own axes: ground is X forward, Y up, Z right, and bodies have the axes of the file. A
frame on ground has the body ``GROUND``.
"""

from dataclasses import dataclass
from enum import StrEnum
from functools import cached_property
from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.conventions import INERTIA_PAIRS
from torchid.model.opensim.functions import Function
from torchid.model.opensim.rotations import body_xyz, moved, pose

GROUND = -1
"""Wording. Index that stands for ground where an index of a body is expected."""


class CoordinateKind(StrEnum):
    """Kinds of coordinates."""

    ROTATIONAL = "rotational"
    TRANSLATIONAL = "translational"
    COUPLED = "coupled"
    """Coordinates that turn and slide, or move something other than in proportion 1."""


@dataclass(frozen=True)
class OsimCoordinate:
    """A generalised coordinate."""

    name: str
    motion: CoordinateKind
    default: float
    lower: float
    upper: float
    clamped: bool
    """True where the range is a limit, else it is a range of use."""
    locked: bool
    """True where the coordinate stays at its default."""
    prescribed: bool
    """True where the file drives it by a function of time, which is not read."""

    @property
    def unit(self) -> str:
        """Return the unit of its values; coupled ones are angles in OpenSim's files."""
        return "m" if self.motion is CoordinateKind.TRANSLATIONAL else "rad"


@dataclass(frozen=True)
class Frame:
    """A frame fixed on a body or on ground."""

    body: int
    base: Float[Tensor, "4 4"]
    """Pose on the body of the frame that this one is offset from."""
    translation: Float[Tensor, "3"]
    """Offset [m], as the file states it."""
    orientation: Float[Tensor, "3"]
    """Angles of the offset about X, the new Y and the new Z [rad], as the file states them."""

    @cached_property
    def X_BF(self) -> Float[Tensor, "4 4"]:
        """Return the pose on the body."""
        return self.base @ pose(body_xyz(self.orientation), self.translation)


@dataclass(frozen=True)
class TransformAxis:
    """One turn or slide of a joint, driven by a function of coordinates."""

    unit: Float[Tensor, "3"]
    """Direction: of a turn in the axes reached so far, of a slide in the joint's parent frame."""
    rows: tuple[int, ...]
    """Rows of the coordinates that the function is given."""
    function: Function


@dataclass(frozen=True)
class OsimJoint:
    """A joint, whatever its kind, as turns one after the other and slides in its parent frame."""

    name: str
    kind: str
    """Element of the file, such as PinJoint."""
    parent: Frame
    child: Frame
    turns: tuple[TransformAxis, ...]
    slides: tuple[TransformAxis, ...]
    rows: tuple[int, ...]
    """Rows of its own coordinates."""
    outward: bool = True
    """True where the parent is nearer to ground; else the child carries the parent."""

    @property
    def carrier(self) -> Frame:
        """Return the frame nearer to ground."""
        return self.parent if self.outward else self.child

    @property
    def carried(self) -> Frame:
        """Return the frame farther from ground."""
        return self.child if self.outward else self.parent


@dataclass(frozen=True)
class Coupler:
    """A coordinate that is a function of others."""

    name: str
    dependent: int
    """Row of the coordinate that follows."""
    independents: tuple[int, ...]
    """Rows of the coordinates that lead."""
    function: Function


@dataclass(frozen=True)
class Marker:
    """A marker and the frame that it is fixed on."""

    name: str
    frame: Frame
    location: Float[Tensor, "3"]
    """Place in the frame [m]."""

    @cached_property
    def p_BM_B(self) -> Float[Tensor, "3"]:
        """Return the place on the body [m]."""
        return moved(self.frame.X_BF, self.location)


@dataclass(frozen=True)
class Inertias:
    """Mass, centre and inertia of all bodies."""

    mass: Float[Tensor, " bodies"]
    """Masses [kg]."""
    centre: Float[Tensor, "bodies 3"]
    """Centres of mass p_BC_B in the bodies' axes [m]."""
    moments: Float[Tensor, "bodies 3 3"]
    """Inertia about the centres of mass, in the bodies' axes [kg m^2]."""

    @property
    def phi(self) -> Float[Tensor, "bodies 10"]:
        """Return the ten inertial parameters about the bodies' origins, in the order of ``conventions.Inertial``."""
        m, c = self.mass[:, None], self.centre
        steiner = (c * c).sum(-1)[:, None, None] * torch.eye(3).to(c) - c[:, :, None] * c[:, None]
        about_origin = self.moments + m[:, :, None] * steiner
        return torch.cat([m, m * c, torch.stack([about_origin[:, i, j] for i, j in INERTIA_PAIRS], dim=1)], dim=1)


@dataclass(frozen=True)
class OsimModel:
    """A model as its file states it, its inertia made physically consistent."""

    source: Path
    name: str
    version: int
    """Version of the file's format, such as 40500."""
    gravity: Float[Tensor, "3"]
    """Gravity in ground [m/s^2]."""
    bodies: tuple[str, ...]
    """Names in the order of the file; ground is none of them."""
    stated: Inertias
    """Inertia as the file states it."""
    inertias: Inertias
    """Inertia that a distribution of mass can have: the nearest to what is stated."""
    coordinates: tuple[OsimCoordinate, ...]
    joints: tuple[OsimJoint, ...]
    """Joints from ground outwards: each stands behind the one that moves its carrier. Welds among the constraints that
    hold a body which its own joint leaves free are joints too, called by their path."""
    closing: tuple[OsimJoint, ...]
    """Joints that would close loops: they hold nothing, and their coordinates follow from where their bodies are."""
    couplers: tuple[Coupler, ...]
    """Couplers in an order in which every leading coordinate is known."""
    markers: tuple[Marker, ...]

    @cached_property
    def coordinate_names(self) -> tuple[str, ...]:
        """Return the names of the rows of q."""
        return tuple(coordinate.name for coordinate in self.coordinates)

    @cached_property
    def parents(self) -> tuple[int, ...]:
        """Return the body that carries each body, ``GROUND`` for ground."""
        carrier = {joint.carried.body: joint.carrier.body for joint in self.joints}
        return tuple(carrier[body] for body in range(len(self.bodies)))

    @property
    def defaults(self) -> Float[Tensor, " coordinates"]:
        """Return the default values, couplers not yet obeyed [rad, m]."""
        return torch.tensor([coordinate.default for coordinate in self.coordinates], dtype=torch.float64)
