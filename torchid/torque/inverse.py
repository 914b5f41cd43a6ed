"""Joint torques of a motion under the wrenches of its contacts."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.dynamics.equations_of_motion import (
    body_rows,
    body_wrenches,
    dynamic_state,
    generalised_forces,
    wrench_about,
)
from torchid.model.model import Geometry
from torchid.model.tree import Tree
from torchid.motion import Motion

CHUNK = 2048
"""Frames whose equations of motion are held at a time; chosen for memory."""


@dataclass(frozen=True)
class Load:
    """What one body of the subject receives from outside."""

    body: str
    wrench: Float[Tensor, "frames 6"]
    """Force [N] and moment [N m] on the subject about the origin of W, through the filter of the motion."""
    plate: str | None = None
    """Plate that has read it, one list for the session; None where it is no plate's reading."""
    fast: Float[Tensor, "frames 6"] | None = None
    """What the filter has taken from the reading [N, N m]."""
    doubt: Float[Tensor, "frames 6 causes"] | None = None
    """What is added to a wrench that was not read but computed, per standard normal cause [N, N m]; all loads of a
    trial have the causes in common."""


def joint_torques(
    tree: Tree, geometry: Geometry, phi: Float[Tensor, "bodies 10"], motion: Motion, loads: Sequence[Load]
) -> Float[Tensor, "frames dofs"]:
    """Return the generalised forces that a motion under some loads needs.

    Args:
        tree: whose coordinates the motion has.
        phi: inertial parameters of the bodies [kg, kg m, kg m^2].

    Returns:
        Torques of the joints [N m], forces of slides [N]; columns 0 to 5 are the force [N] and moment [N m] at the
        root's origin, in W, that nothing accounts for.
    """
    out = torch.empty_like(motion.q)
    for start in range(0, len(motion.q), CHUNK):
        part = slice(start, start + CHUNK)
        state = dynamic_state(tree, geometry, *(x[part].T.contiguous() for x in (motion.q, motion.v, motion.a)))
        needed = body_wrenches(state.plan, body_rows(state), phi)
        for load in loads:
            position = state.plan.position[tree.index(load.body)]
            needed[position] -= wrench_about(load.wrench[part], motion.q[part, :3]).T
        out[part] = generalised_forces(state, needed).T
    return out
