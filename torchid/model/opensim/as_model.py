"""An OpenSim model as a model of torchid: its tree, and priors of geometry, inertia and markers about the file's."""

from collections.abc import Sequence
from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.conventions import GRAVITY
from torchid.errors import Note
from torchid.model.model import Landmark, Model
from torchid.model.opensim.binding import OsimBinding
from torchid.model.opensim.group_inertia import heavy_enough, of_groups
from torchid.model.opensim.joint_values import is_floating
from torchid.model.opensim.model import OsimModel
from torchid.model.opensim.posing import body_poses, coupled, marker_places
from torchid.model.opensim.reading import read_osim
from torchid.model.opensim.rotations import moved
from torchid.model.opensim.tree_of_osim import tree_of_osim
from torchid.model.tree import Tree
from torchid.model.tree_of_links import LEAST_EXTENT, FileScatter, file_geometry, file_inertia

LEAST_MASS = 0.01
"""Chosen. Mass that a body without any gets, since identification asks for one [kg]: 10 g, which plates cannot see."""
FEET = ("calcn", "foot")
"""Cited. What OpenSim's gait models call the body that stands on the ground, by the beginning of its name."""
HEADS = {"toe": (1.0, 0.0), "mt1": (0.73 / 0.79, -0.18 / 0.79), "mt5": (0.64 / 0.79, 0.18 / 0.79)}
"""Cited. Points of a sole, along and outwards from the line between heel and second metatarsal head, as shares of its
length: those of the built-in model (``model/landmarks.py``)."""


def read_osim_model(path: str | Path, scatter: FileScatter | None = None) -> tuple[Model, tuple[Note, ...]]:
    """Return the model of an OpenSim file of version 2, 3 or 4, and notes about what was changed in reading it.

    Args:
        scatter: how uncertain its numbers are; default ``FileScatter()``.

    Raises:
        InputError: as ``read_osim``.
    """
    model, notes = read_osim(path)
    made, said = model_of_osim(model, scatter)
    return made, (*notes, *said)


def model_of_osim(model: OsimModel, scatter: FileScatter | None = None) -> tuple[Model, tuple[Note, ...]]:
    """Return the model of torchid that an OpenSim model is, and notes.

    Every component of every joint centre is free about the file's, leans of axes are not; inertia scatters about the
    file's; the file's markers are landmarks of their names.

    Args:
        model: as it was read.
        scatter: how uncertain its numbers are; default ``FileScatter()``.
    """
    scatter, source = scatter or FileScatter(), str(model.source)
    tree, geometry, binding = tree_of_osim(model)
    phi, light = heavy_enough(of_groups(binding, model.inertias.phi), LEAST_MASS, LEAST_EXTENT)
    notes = _notes(model, tree, binding, light)
    made = Model(
        tree=tree,
        geometry=file_geometry(tree, geometry, scatter.offset),
        inertia=file_inertia(phi, scatter),
        landmarks=_soles(binding, tree, geometry.offset, scatter.landmark) | _markers(binding, tree, scatter.marker),
        height=_size(binding),
        sources=(f"geometry, inertia and markers: {source}", "scatter: chosen, the same for every body"),
        osim=binding,
    )
    return made, notes


def _notes(model: OsimModel, tree: Tree, binding: OsimBinding, light: Sequence[int]) -> tuple[Note, ...]:
    source, found = str(model.source), []
    for name, members in zip(tree.names, binding.groups, strict=True):
        if len(members) > 1:
            others = ", ".join(model.bodies[body] for body in members[1:])
            found.append(Note("osim.welded", f"{others} welded to {name}: one body to identify", source))
    names = [tree.names[k] for k in light]
    if names:
        found.append(Note("osim.massless", f"{', '.join(names)}: no mass; taken as {1e3 * LEAST_MASS:g} g", source))
    found += _hung(binding)
    opened = ", ".join(one.name for one in model.couplers if one not in binding.model.couplers)
    if opened:
        said = f"{opened}: couplers with coordinates of where the person is, or beside it; not held"
        found.append(Note("osim.uncoupled", said, source))
    kept = [one for row, one in enumerate(model.coordinates) if row not in binding.root.rows]
    locked = ", ".join(one.name for one in kept if one.locked)
    if locked:
        found.append(Note("osim.locked", f"locked at their defaults: {locked}", source))
    gravity = float((model.gravity - model.gravity.new_tensor([0.0, -GRAVITY, 0.0])).norm())
    if gravity > 1e-6:
        found.append(Note("osim.gravity", f"gravity {model.gravity.tolist()} m/s^2 is not used: {GRAVITY} is", source))
    return tuple(found)


def _hung(binding: OsimBinding) -> list[Note]:
    """What the file has beside the person, and what it leaves free of where the person is, where that is not all."""
    model, root, source, found = binding.model, binding.root, str(binding.model.source), []
    beside = [name for body, name in enumerate(model.bodies) if body not in binding.bodies]
    if beside:
        found.append(Note("osim.beside", f"{', '.join(beside)}: no part of the person; kept in the file", source))
    if not is_floating(root):
        body, names = model.bodies[root.carried.body], binding.root_names
        held = f"has {len(names)} coordinates there ({', '.join(names)})" if names else "does not move there"
        shown = "holds the nearest to it" if names else "does not show where it is"
        said = f"{body} {held}; markers and plates place it freely, and `_ik.mot` {shown}"
        found.append(Note("osim.floats", said, source))
    locked = [model.coordinates[row].name for row in root.rows if model.coordinates[row].locked]
    if locked:
        found.append(Note("osim.floats", f"locks of {', '.join(locked)} are not held: the person moves there", source))
    return found


def _markers(binding: OsimBinding, tree: Tree, sd: float) -> dict[str, Landmark]:
    """The file's markers on the bodies of the tree."""
    found = {}
    for marker in binding.model.markers:
        body = marker.frame.body
        if body in binding.bodies:
            place = moved(binding.X_TB[body], marker.p_BM_B).tolist()
            name = tree.names[binding.group_of(body)]
            found[marker.name] = Landmark(name, (place[0], place[1], place[2]), (sd, sd, sd))
    return found


def _soles(binding: OsimBinding, tree: Tree, offset: Float[Tensor, "bodies 3"], sd: float) -> dict[str, Landmark]:
    """Heel, toe and metatarsal heads of each foot: its body's origin in the file, and the joint of the toes."""
    model, found = binding.model, dict[str, Landmark]()
    for body, name in enumerate(model.bodies):
        side = name[-1:].lower()
        toes = [joint for joint in model.joints if joint.carrier.body == body]
        if body not in binding.bodies or not name.lower().startswith(FEET) or side not in "lr" or not toes:
            continue
        heel, tip = (moved(binding.X_TB[body], p) for p in (torch.zeros(3).to(offset), toes[0].carrier.X_BF[:3, 3]))
        line = tip - heel
        outward = torch.stack([-line[1], line[0], 0.0 * line[0]]) * (1.0 if side == "l" else -1.0)
        places = {"heel": heel} | {key: heel + a * line + b * outward for key, (a, b) in HEADS.items()}
        segment = tree.names[binding.group_of(body)]
        for key, place in places.items():
            x, y, z = place.tolist()
            found[f"{key}_{side}"] = Landmark(segment, (x, y, z), (sd, sd, sd))
    return found


def _size(binding: OsimBinding) -> float:
    """Largest distance between origins of the person's bodies and markers in the default pose, which stands for stature
    [m]."""
    model = binding.model
    q = coupled(model, model.defaults)
    names = [marker.name for marker in model.markers if marker.frame.body in binding.bodies]
    points = torch.cat([body_poses(model, q)[sorted(binding.bodies), :3, 3], marker_places(model, q, names)])
    return float(torch.cdist(points, points).max())
