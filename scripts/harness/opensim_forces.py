"""Inverse dynamics on the coordinates of an OpenSim file, to be held against OpenSim's own."""

from collections.abc import Mapping
from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.conventions import GRAVITY
from torchid.dynamics.equations_of_motion import (
    body_rows,
    body_wrenches,
    dynamic_state,
    generalised_forces,
    wrench_about,
)
from torchid.model.model import Geometry
from torchid.model.opensim.group_inertia import of_groups
from torchid.model.opensim.model import OsimModel
from torchid.model.opensim.rotations import R_OW
from torchid.model.opensim.tree_of_osim import tree_of_osim
from torchid.model.tree import Tree

CHUNK = 1024
"""Frames per batch; chosen for memory."""


def osim_inverse_dynamics(
    model: OsimModel,
    q: Float[Tensor, "frames coordinates"],
    v: Float[Tensor, "frames coordinates"],
    a: Float[Tensor, "frames coordinates"],
    external: Mapping[str, Float[Tensor, "frames 6"]] | None = None,
) -> dict[str, Float[Tensor, " frames"]]:
    """Return the generalised forces that a motion of an OpenSim model needs, by the names of its coordinates.

    The file's own inertia and gravity are used. OpenSim's tool moves coordinates that follow others, and locked ones,
    as if they were free: ``as_free`` makes a model that is understood like that.

    Args:
        model: the model.
        q: all its coordinates in the order of the file [rad, m].
        v: their rates.
        a: their accelerations.
        external: wrenches that act on bodies of the file, by the body's name: force and moment about ground's origin,
            in ground's axes [N, N m].

    Raises:
        InputError: as ``tree_of_osim``.
    """
    tree, geometry, binding = tree_of_osim(model)
    phi = of_groups(binding, model.stated.phi)
    states, out = binding.to_tree(tree.dof_names, q, v, a), []
    loads = {binding.group_of(model.bodies.index(name)): wrench for name, wrench in (external or {}).items()}
    for start in range(0, len(q), CHUNK):
        part = slice(start, start + CHUNK)
        some = {body: wrench[part] for body, wrench in loads.items()}
        out.append(_tree_forces(tree, geometry, phi, [x[part] for x in states], some, model.gravity))
    return binding.forces(tree.dof_names, q, torch.cat(out))


def _tree_forces(
    tree: Tree,
    geometry: Geometry,
    phi: Float[Tensor, "bodies 10"],
    states: list[Tensor],
    external: Mapping[int, Float[Tensor, "frames 6"]],
    gravity: Float[Tensor, "3"],
) -> Float[Tensor, "frames dofs"]:
    """Generalised forces of the tree; another gravity than ours is an acceleration of the base."""
    q, v, a = (x.T.contiguous() for x in states)
    ours = -(R_OW.T @ gravity).to(q)
    a[:3] += (ours - ours.new_tensor([0.0, 0.0, GRAVITY]))[:, None]
    state = dynamic_state(tree, geometry, q, v, a)
    needed = body_wrenches(state.plan, body_rows(state), phi)
    for body, wrench in external.items():
        turned = (wrench.view(-1, 2, 3) @ R_OW.to(q)).flatten(1)
        needed[state.plan.position[body]] -= wrench_about(turned, q[:3].T).T
    return generalised_forces(state, needed).T


def as_free(model: OsimModel) -> OsimModel:
    """Return a model whose coordinates are all free: no couplers, none locked, as OpenSim's inverse dynamics sees it.

    Args:
        model: any model.
    """
    free = tuple(replace(one, locked=False) for one in model.coordinates)
    return replace(model, coordinates=free, couplers=())
