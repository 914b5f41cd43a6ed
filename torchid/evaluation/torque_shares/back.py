"""The low back: net moment between pelvis and trunk, and the compression that a published formula makes of it.

The net moment M at L5/S1 is what pelvis and muscles exert on the trunk, in the pelvis' axes: extension -M_y, bending to
the right M_x, turning to the left M_z. It follows from the torques of the joint's three turns, tau_k = e_k . M, with
their axes e_k. Compression is that of a single equivalent extensor muscle (Chaffin & Andersson, Occupational
Biomechanics; Chaffin 1969, J Biomech 2:429): C = |M_y| / d + F, with the muscle's lever arm d and the net force F on
the trunk along its long axis. Antagonists and the tilt of the disc against that axis are not in it.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.dynamics.equations_of_motion import body_rows, body_wrenches, dynamic_state, joint_axes
from torchid.model.model import Geometry
from torchid.model.tree import Tree
from torchid.motion import Motion
from torchid.torque.inverse import Load

NIOSH_N = 3400.0
"""Cited. Compression above which the risk of injury rises for some workers: NIOSH's 3.4 kN (Waters, Putz-Anderson, Garg
& Fine 1993, Ergonomics 36:749)."""
TRUNKS = ("abdomen", "lumbar", "torso", "thorax")
"""Bodies that stand on the pelvis by L5/S1, in the models that are known."""
CHUNK = 2048
"""Choice. Frames whose equations of motion are held at a time, for memory."""


@dataclass(frozen=True)
class LowBack:
    """What the joint is made of at every frame, with one body."""

    rows: tuple[int, int, int]
    """Coordinates of its turns."""
    inverse: Float[Tensor, "frames 3 3"]
    """From the torques of the turns to M in the pelvis' axes."""
    force: Float[Tensor, " frames"]
    """Net force on the trunk along its long axis, positive where it compresses the joint [N]."""

    def moment(self, torque: Float[Tensor, "*draws frames dofs"]) -> Float[Tensor, "*draws frames 3"]:
        """Net moment as extension, bending to the right and turning to the left [N m].

        Args:
            torque: of all coordinates of the model [N m].
        """
        M_P = torch.einsum("fij,...fj->...fi", self.inverse, torque[..., list(self.rows)])
        return torch.stack([-M_P[..., 1], M_P[..., 0], M_P[..., 2]], dim=-1)

    def compression(
        self, torque: Float[Tensor, "*draws frames dofs"], lever_m: Float[Tensor, "*levers"]
    ) -> Float[Tensor, "*draws frames"]:
        """Compression of the joint [N].

        Args:
            torque: of all coordinates of the model [N m].
            lever_m: lever arm of the equivalent muscle [m], one, or one for each draw.
        """
        return self.moment(torque)[..., 0].abs() / lever_m[..., None] + self.force


def trunk_of(tree: Tree) -> str | None:
    """Body that stands on the root by a joint of three turns, each driven by a coordinate of its own; None where the
    model has no such joint.
    """
    for name in TRUNKS:
        if name in tree.names:
            k = tree.index(name)
            moving = [turn for turn in tree.bodies[k].turns if turn.moving]
            if tree.bodies[k].parent == 0 and len(moving) == 3 and tree.own_turns(k) == moving:
                return name
    return None


def low_back(
    tree: Tree, geometry: Geometry, phi: Float[Tensor, "bodies 10"], motion: Motion, loads: Sequence[Load] = ()
) -> LowBack | None:
    """The joint between pelvis and trunk over a motion.

    Args:
        tree: of the model; None comes back where it has no such joint.
        phi: inertial parameters of the bodies, a device's parts included.
        loads: wrenches of the contacts; those on trunk, head, arms and hands are borne by the joint too.
    """
    trunk = trunk_of(tree)
    if trunk is None:
        return None
    turns = [turn.row for turn in tree.bodies[tree.index(trunk)].turns if turn.moving]
    inverse, force, above = [], [], tree.subtree(tree.index(trunk))
    borne = [load.wrench[:, :3] for load in loads if tree.index(load.body) in above]
    for start in range(0, len(motion.q), CHUNK):
        part = slice(start, start + CHUNK)
        state = dynamic_state(tree, geometry, *(x[part].T.contiguous() for x in (motion.q, motion.v, motion.a)))
        axes, _ = joint_axes(state)
        e_W = axes[turns, 3:].permute(2, 0, 1)
        # R[body, column, row]: columns first
        R_WP = state.at.R[0].permute(2, 1, 0)
        inverse.append(R_WP.mT @ torch.linalg.pinv(e_W))
        own = [state.plan.position[k] for k in above]
        total = body_wrenches(state.plan, body_rows(state), phi)[own].sum(0)[:3]
        total = total - sum(one[part].T for one in borne)
        long_axis = state.at.R[state.plan.position[tree.index(trunk)], 2]
        force.append((total * long_axis).sum(0))
    rows = (turns[0], turns[1], turns[2])
    return LowBack(rows, torch.cat(inverse), torch.cat(force))


def lever_arms(between: tuple[float, float], draws: int, like: Tensor, seed: int) -> Float[Tensor, " draws"]:
    """Lever arms of the equivalent muscle, uniform between two published ones [m].

    Args:
        between: the smaller and the larger one [m].
    """
    generator = torch.Generator().manual_seed(seed)
    low, high = between
    return low + (high - low) * torch.rand(draws, generator=generator, dtype=torch.float64).to(like)
