"""Bodies with axes in any direction as a tree of turns about coordinate axes, and the priors of a model from a file.

An axis that leans from its nearest coordinate axis is turned there by two hinge angles, which are undone behind it.
A file does not say how well its numbers are known: ``FileScatter`` does.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from torchid.conventions import INERTIA_PAIRS, NonNegative, Positive
from torchid.errors import InputError, Note
from torchid.model.mechanics import Array, as_rotation, pseudo_to_phi
from torchid.model.model import Geometry, GeometryPrior, InertialPrior, Landmark, Model
from torchid.model.rotation import rotation_vector
from torchid.model.skeleton import BASE_SD
from torchid.model.tree import Body, Dof, Slide, Tree, Turn

ALIGNED = 1e-12
"""Sine of the lean below which an axis is its coordinate axis."""
LEAST_MASS = 1e-9
"""Below it a body has none [kg]: it moves nothing, and quotients by it overflow."""
LEAST_EXTENT = 1e-3
"""Root of the second moment per mass along a principal axis that every body has at least [m]."""


@dataclass(frozen=True)
class FileScatter:
    """How uncertain the numbers of a model file are; a choice, about as the built-in model's."""

    offset: NonNegative = 0.01
    """Of each component of a joint centre [m]; 0 fixes the geometry."""
    mass: Positive = 0.15
    """Of the logarithm of a body's mass."""
    centre: Positive = 0.20
    """Of the centre of mass along a principal axis, fraction of the extent there."""
    extent: Positive = 0.10
    """Of the logarithm of an extent."""
    product: Positive = 0.08
    """Of a product of inertia over the mass and the two extents."""
    landmark: Positive = 0.01
    """Of each component of a landmark's place [m]."""
    marker: Positive = 0.02
    """Of each component of the place of a marker that an OpenSim file brings [m]; OpenSim's user's guide calls a scaled
    model good whose markers miss by 20 mm, and those of its ``example3DWalking`` miss by 12 to 54 mm."""


@dataclass(frozen=True)
class LinkAxis:
    """One coordinate of a link's joint."""

    name: str
    slide: bool
    unit: Array
    """Axis in the link's own axes at zero coordinates."""
    lower: float = -float("inf")
    upper: float = float("inf")


@dataclass(frozen=True)
class PlacedBody:
    """A body-to-be."""

    name: str
    parent: int
    X_PB: Array
    """Pose in the parent at zero coordinates; of the root: where it rests in W."""
    axes: tuple[LinkAxis, ...]
    """Slides before turns, all through the origin."""
    pseudo: Array
    """Pseudo-inertia about the origin."""
    place: str


def model_of(
    bodies: Sequence[PlacedBody], landmarks: dict[str, Landmark], source: str, scatter: FileScatter
) -> tuple[Model, tuple[Note, ...]]:
    """Model of bodies, parents first (float64, CPU).

    Raises:
        InputError: a coordinate's name stands twice, slides of one joint are neither square nor single, or a body's
            inertia is no body's.
    """
    builder = _Builder(bodies[0])
    for body in bodies[1:]:
        builder.add(body, source)
    names = [dof.name for dof in builder.dofs]
    if len(set(names)) < len(names):
        twice = sorted({name for name in names if names.count(name) > 1})
        raise InputError(
            "model.name_twice", "a coordinate's name stands twice", source=source, found=", ".join(twice),
            remedy="Rename one of the joints.",
        )  # fmt: skip
    tree = Tree(tuple(builder.bodies), tuple(builder.dofs), tuple(builder.hinges))
    offset = np.array([np.zeros(3) if b.parent < 0 else b.X_PB[:3, 3] for b in bodies])
    geometry = Geometry(torch.tensor(offset), torch.tensor(builder.angles, dtype=torch.float64))
    thick, notes = _thicken(bodies, source)
    model = Model(
        tree=tree,
        geometry=file_geometry(tree, geometry, scatter.offset),
        inertia=file_inertia(torch.tensor(thick), scatter),
        landmarks=landmarks,
        height=_size(bodies, landmarks),
        sources=(f"geometry and inertia: {source}", "scatter: chosen, the same for every body"),
    )
    return model, notes


class _Builder:
    """Bodies, coordinates and hinge angles so far."""

    def __init__(self, root: PlacedBody) -> None:
        self.bodies = [Body(root.name, -1)]
        rest = [*root.X_PB[:3, 3], *rotation_vector(torch.tensor(root.X_PB[:3, :3])).tolist()]
        units = [(axis, "m") for axis in "xyz"] + [(f"r{axis}", "rad") for axis in "xyz"]
        self.dofs = [
            Dof(f"{root.name}_{axis}", unit, rest=float(value), sd=BASE_SD)
            for (axis, unit), value in zip(units, rest, strict=True)
        ]
        self.hinges: list[str] = []
        self.angles: list[float] = []

    def add(self, body: PlacedBody, source: str) -> None:
        """The body and its joint."""
        R_slide, axes = _slide_frame(body, source)
        slides: list[Slide] = []
        turns: list[Turn] = []
        for axis in body.axes:
            unit = R_slide.T @ axis.unit
            if axis.slide:
                slides.append(Slide(axes[len(slides)], len(self.dofs)))
            else:
                turns += leaning_turn(axis.name, unit, len(self.dofs), self.hinges, self.angles)
            rest = min(max(0.0, axis.lower), axis.upper)
            self.dofs.append(Dof(axis.name, "m" if axis.slide else "rad", axis.lower, axis.upper, rest))
        R_PJ = as_rotation(body.X_PB[:3, :3] @ R_slide)
        self.bodies.append(Body(body.name, body.parent, tuple(turns), tuple(slides), R_PJ, as_rotation(R_slide.T)))


def leaning_turn(name: str, unit: Array, row: int, hinges: list[str], angles: list[float]) -> list[Turn]:
    """A turn about any unit axis by axis value ``row``: lean there, turn, lean back.

    Args:
        name: of the axis, from which the leans have theirs.
        unit: the axis, in the axes reached so far.
        hinges: names of the tree's hinge angles so far; those of the leans are appended.
        angles: the angles [rad], likewise.
    """
    k = int(np.abs(unit).argmax())
    i, j = (k + 1) % 3, (k + 2) % 3
    sign = math.copysign(1.0, unit[k])
    moving = Turn(k, row, sign=sign)
    along, first, second = (float(sign * unit[axis]) for axis in (k, i, j))
    lean = [(j, math.atan2(first, along)), (i, math.atan2(-second, math.hypot(along, first)))]
    tilt = []
    for axis, angle in lean:
        if abs(angle) > ALIGNED:
            tilt.append(Turn(axis, len(hinges), moving=False))
            hinges.append(f"{name}_axis_{'xyz'[axis]}")
            angles.append(angle)
    return [*tilt, moving, *(Turn(t.axis, t.row, moving=False, sign=-1.0) for t in reversed(tilt))]


def _slide_frame(body: PlacedBody, source: str) -> tuple[Array, list[int]]:
    """Rotation R with R e_k along each slide, and the k of each: slides of a tree have no sign."""
    units = np.array([axis.unit for axis in body.axes if axis.slide]).reshape(-1, 3)
    axes: list[int] = []
    for unit in units:
        free = [k for k in range(3) if k not in axes]
        axes += [max(free, key=lambda k, u=unit: abs(u[k]))] if free else [0]
    if not len(units) or np.abs(units - np.eye(3)[axes]).max() < ALIGNED:
        return np.eye(3), axes
    R = _rotation_onto(units, axes)
    if np.abs(R.T @ units.T - np.eye(3)[axes].T).max() > ALIGNED:
        remedy = "They must be at right angles, and three of them right-handed."
        raise InputError("model.slides", "slides of one joint", source=source, place=body.place, remedy=remedy)
    return R, axes


def _rotation_onto(units: Array, axes: list[int]) -> Array:
    """Rotation whose columns ``axes`` are ``units``, made square where these are not."""
    R, rest = np.zeros((3, 3)), [k for k in range(3) if k not in axes]
    R[:, axes] = units.T
    if len(rest) == 2:
        R[:, rest[0]] = np.linalg.svd(units[:1])[2][1]
    if rest:
        k = rest[-1]
        R[:, k] = np.cross(R[:, (k + 1) % 3], R[:, (k + 2) % 3])
    U, _, Vt = np.linalg.svd(R)
    return U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt


def _thicken(bodies: Sequence[PlacedBody], source: str) -> tuple[Array, tuple[Note, ...]]:
    """Ten parameters of each body; a point, a rod or a plate gets LEAST_EXTENT where it has none.

    A pseudo-inertia on the boundary has no inverse, and identification needs one.
    """
    phi, thin = [], []
    for body in bodies:
        P, mass = body.pseudo.copy(), body.pseudo[3, 3]
        if not mass > LEAST_MASS:
            remedy = "Give it an inertial."
            raise InputError(
                "model.massless", "a body has no mass", source=source, place=body.place, found=f"{mass:g} kg",
                remedy=remedy,
            )  # fmt: skip
        centre = P[:3, 3] / mass
        square, axes = np.linalg.eigh(P[:3, :3] / mass - np.outer(centre, centre))
        if square[0] < LEAST_EXTENT**2:
            thin.append(body.name)
            thick = (axes * np.maximum(square, LEAST_EXTENT**2)) @ axes.T
            P[:3, :3] = mass * (thick + np.outer(centre, centre))
        phi.append(pseudo_to_phi(P))
    text = f"{', '.join(thin)}: no thickness along an axis; taken as {LEAST_EXTENT:g} m"
    return np.array(phi), (Note("model.thin", text, source),) if thin else ()


def file_geometry(tree: Tree, geometry: Geometry, sd: float) -> GeometryPrior:
    """Prior about a file's geometry: every component of every joint centre free with ``sd`` [m], hinge angles fixed."""
    raw = torch.cat([geometry.offset.reshape(-1), geometry.hinge])
    free = range(3, 3 * len(tree.bodies)) if sd > 0.0 else range(0)
    columns = torch.zeros(len(raw), len(free)).to(raw)
    constant, rows = raw.clone(), list(free)
    columns[rows, list(range(len(rows)))] = 1.0
    constant[rows] = 0.0
    return GeometryPrior(
        names=tuple(f"{tree.names[row // 3]}_{'xyz'[row % 3]}" for row in rows),
        units=("m",) * len(rows),
        mean=raw[rows],
        sd=torch.full((len(rows),), sd).to(raw),
        map=columns,
        constant=constant,
        n_hinges=len(tree.hinges),
    )


def file_inertia(phi: Float[Tensor, "bodies 10"], scatter: FileScatter) -> InertialPrior:
    """Prior about a file's inertia: bodies independent, each scattering in mass, centre and extents.

    Latents per body: log mass, centre along the principal axes in extents, log extents, normalised products;
    linearised, as the built-in model's.
    """
    sd = [scatter.mass, *[scatter.centre] * 3, *[scatter.extent] * 3, *[scatter.product] * 3]
    blocks = []
    for row in phi:
        jacobian = torch.autograd.functional.jacobian(lambda x, row=row: _varied(row, x), phi.new_zeros(10))
        assert isinstance(jacobian, Tensor)
        half = jacobian * phi.new_tensor(sd)
        blocks.append(half @ half.T)
    return InertialPrior(mean=phi, covariance=torch.block_diag(*blocks))


def _varied(phi: Tensor, x: Tensor) -> Tensor:
    """Ten parameters at latents ``x``; ``phi`` at zero."""
    mass, centre = phi[0], phi[1:4] / phi[0]
    inertia = phi.new_zeros(3, 3)
    for k, (i, j) in enumerate(INERTIA_PAIRS):
        inertia[i, j] = inertia[j, i] = phi[4 + k]
    eye = torch.eye(3).to(phi)
    square, axes = torch.linalg.eigh((0.5 * inertia.trace() * eye - inertia) / mass - torch.outer(centre, centre))
    extents = axes * square.sqrt()
    shape = torch.diag((2.0 * x[4:7]).exp())
    for k, (i, j) in enumerate(((0, 1), (0, 2), (1, 2))):
        pair = torch.zeros(3, 3).to(phi)
        pair[i, j] = pair[j, i] = 1.0
        shape = shape + x[7 + k] * pair
    mass, centre = mass * x[0].exp(), centre + extents @ x[1:4]
    second = mass * (extents @ shape @ extents.T + torch.outer(centre, centre))
    moved = second.trace() * eye - second
    return torch.stack([mass, *(mass * centre), *(moved[i, j] for i, j in INERTIA_PAIRS)])


def _size(bodies: Sequence[PlacedBody], landmarks: dict[str, Landmark]) -> float:
    """Largest distance between joint centres, centres of mass and landmarks at zero coordinates [m].

    Files state no stature; this stands for it where a length of the subject's size is needed.
    """
    X_RB, points = [np.eye(4)], []
    for body in bodies[1:]:
        X_RB.append(X_RB[body.parent] @ body.X_PB)
    names = [body.name for body in bodies]
    for X, body in zip(X_RB, bodies, strict=True):
        points += [X[:3, 3], (X @ body.pseudo[:, 3] / body.pseudo[3, 3])[:3]]
    points += [(X_RB[names.index(mark.segment)] @ [*mark.p_BM_B, 1.0])[:3] for mark in landmarks.values()]
    apart = np.array(points)[:, None] - np.array(points)[None]
    return float(np.sqrt((apart**2).sum(-1)).max())
