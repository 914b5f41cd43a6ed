"""Smooth motion with derivatives, free of the singularities of Euler angles.

Orientations of the base and of three-axis joints are filtered and differentiated as quaternions (sign-continuous,
normalised after the filter); only then are angles and their rates taken from them. Angular velocities and
accelerations of the bodies, which is all that dynamics sees, therefore do not feel a pole of the angles.
"""

from dataclasses import dataclass, replace

import roma
from jaxtyping import Bool, Float
from torch import Tensor

from torchid.filters import Smoother, differentiate
from torchid.model.tree import Tree
from torchid.motion.rotations import AngularMotion, filter_rotation, joint_rates, rotation_to_turns, turns_to_rotation


@dataclass(frozen=True)
class Motion:
    """Motion of one trial at marker rate."""

    time: Float[Tensor, " frames"]
    q: Float[Tensor, "frames dofs"]
    v: Float[Tensor, "frames dofs"]
    """Rates: base linear and angular velocity in W, then time derivatives of the joint coordinates."""
    a: Float[Tensor, "frames dofs"]
    smoother: Smoother

    def frames(self, part: slice) -> "Motion":
        """Some of the frames, at equal steps."""
        smoother = replace(self.smoother, rate_hz=self.smoother.rate_hz / (part.step or 1))
        return Motion(self.time[part], self.q[part], self.v[part], self.a[part], smoother)


def smooth_motion(
    tree: Tree,
    time: Float[Tensor, " frames"],
    q: Float[Tensor, "frames dofs"],
    smoother: Smoother,
    seen: Bool[Tensor, " frames"] | None = None,
) -> Motion:
    """Filter and differentiate the coordinates of a trial.

    Args:
        time: uniform clock [s].
        q: coordinates [m, rad]; three-axis joints may jump by 2 pi.
        smoother: the filter, also used for the forces.
        seen: frames that the markers determined; the others are bridged.
    """
    weight = None if seen is None else seen.to(q.dtype)
    rate = smoother.rate_hz
    smooth = smoother(q, weight)
    v, a = differentiate(smooth, rate)
    base = filter_rotation(roma.rotvec_to_rotmat(q[:, 3:6]), smoother, weight)
    smooth[:, 3:6], v[:, 3:6], a[:, 3:6] = roma.rotmat_to_rotvec(base.R), base.w, base.alpha
    for k, body in enumerate(tree.bodies):
        turns = tree.own_turns(k)
        if len(turns) == 3 and len(turns) == len(body.turns):
            rows = [turn.row for turn in turns]
            moving: AngularMotion = filter_rotation(turns_to_rotation(turns, q[:, rows]), smoother, weight)
            smooth[:, rows] = rotation_to_turns(turns, moving.R, q[:, rows])
            v[:, rows], a[:, rows] = joint_rates(turns, smooth[:, rows], moving)
    return Motion(time, smooth, v, a, smoother)
