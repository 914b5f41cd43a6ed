"""Frames between which a joint turns faster than any body can: tracking went wrong there, not the person."""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchid.model.rotation import rotation_matrix, rotation_vector
from torchid.model.tree import Tree
from torchid.motion.rotations import turns_to_rotation

SHOULDER_RAD_S = 196.0
"""Cited. The fastest rotation of a human joint: college pitchers turn the throwing shoulder inwards at 7430 deg/s, with
1270 between people (Fleisig et al., J Biomech 32:1371 (1999)); three standard deviations above that mean."""
JOINT_RAD_S = 57.0
"""Cited. The fastest of all others, an elbow that extends in a pitch: 2380 +- 300 deg/s (ibid.), as far above."""
SHOULDERS = ("upper_arm", "humerus")
"""Segments that a shoulder turns, by the beginning of their names."""
LEAST_RAD = 0.35
"""Choice. Turn between two frames that noise of markers may feign where these are close in time [rad]: of a forearm
whose markers lie 60 mm apart, one of them off by 20 mm."""
TOGETHER_S = 0.1
"""Choice. Time between two such steps of one joint for which it is wrong meanwhile [s]. What lasts longer explains the
markers otherwise, and was kept because nothing that goes on unbroken does (``geometry.posture.continuity``)."""


@dataclass(frozen=True)
class ImpossibleStep:
    """A step from one frame to the next that no joint makes."""

    body: str
    """Segment that the joint turns."""
    frame: int
    """The frame before the step."""
    rate_rad_s: float
    """Rate of the turn."""
    limit_rad_s: float
    """What no body reaches."""


def impossible_steps(tree: Tree, q: Float[Tensor, "frames dofs"], rate_hz: float) -> list[ImpossibleStep]:
    """Return all steps in which a joint turns faster than any body can.

    Args:
        q: coordinates of consecutive frames, unfiltered [m, rad].
    """
    found = []
    for k, body in enumerate(tree.bodies):
        turns = [turn for turn in body.turns if turn.moving and turn.row < len(tree.dofs)]
        if not turns and k:
            continue
        if k == 0:
            step = _turned(rotation_matrix(q[:, 3:6]))
        elif len(turns) == len(body.turns) == 3:
            step = _turned(turns_to_rotation(turns, q[:, [turn.row for turn in turns]]))
        else:
            step = q[:, [turn.row for turn in turns]].diff(dim=0).abs().amax(dim=1)
        limit = SHOULDER_RAD_S if body.name.startswith(SHOULDERS) else JOINT_RAD_S
        for frame in (step > max(limit / rate_hz, LEAST_RAD)).nonzero()[:, 0].tolist():
            found.append(ImpossibleStep(body.name, frame, float(step[frame]) * rate_hz, limit))
    return found


def _turned(R: Float[Tensor, "frames 3 3"]) -> Float[Tensor, " steps"]:
    """Return the angle of the turn from each frame to the next [rad]."""
    return rotation_vector(R[:-1].mT @ R[1:]).norm(dim=1)


def frames_of(steps: list[ImpossibleStep], frames: int, rate_hz: float) -> Bool[Tensor, " frames"]:
    """Return the frames on either side of impossible steps, and those between two steps of a joint that follow soon."""
    marked = torch.zeros(frames, dtype=torch.bool)
    last: dict[str, int] = {}
    for one in steps:
        first = last.get(one.body, -frames)
        soon = one.frame - first <= TOGETHER_S * rate_hz
        marked[max(first if soon else one.frame, 0) : one.frame + 2] = True
        last[one.body] = one.frame
    return marked
