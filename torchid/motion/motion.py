"""Smooth motion with derivatives, free of the singularities of Euler angles.

Orientations of the base and of three-axis joints are filtered and differentiated as quaternions (sign-continuous,
normalised after the filter); only then are angles and their rates taken from them. Angular velocities and
accelerations of the bodies, which is all that dynamics sees, therefore do not feel a pole of the angles.
"""

from dataclasses import dataclass, replace

import numpy as np
import scipy.signal
from jaxtyping import Bool, Float
from torch import Tensor

from torchid.filters import Smoother, differentiate
from torchid.model.rotation import rotation_matrix, rotation_vector
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
    base = filter_rotation(rotation_matrix(q[:, 3:6]), smoother, weight)
    smooth[:, 3:6], v[:, 3:6], a[:, 3:6] = rotation_vector(base.R), base.w, base.alpha
    for k, body in enumerate(tree.bodies):
        turns = tree.own_turns(k)
        if len(turns) == 3 and len(turns) == len(body.turns):
            rows = [turn.row for turn in turns]
            moving: AngularMotion = filter_rotation(turns_to_rotation(turns, q[:, rows]), smoother, weight)
            smooth[:, rows] = rotation_to_turns(turns, moving.R, q[:, rows])
            v[:, rows], a[:, rows] = joint_rates(turns, smooth[:, rows], moving)
    return Motion(time, smooth, v, a, smoother)


LOWEST, HIGHEST = 4.0, 20.0
"""Bounds [Hz], a choice: below, steps of walking are lost; above, skin and soft tissue ring."""
UNKNOWN = 6.0
"""For a recording too short or too full of gaps to tell [Hz]."""
SHARE = 0.99
"""Of the power of velocity that the cut-off must leave below it, before the margin."""
MARGIN = 1.5
"""From there to -3 dB."""
JUMP = (0.02, 200.0)
"""Second difference of a coordinate beyond which a label jumped: both as a length [m] and an acceleration [m/s^2].
Two labels exchanged for a second put a session's cut-off at the upper bound, and its residual at 70 N."""
WINDOW = 1.28
"""Length of the periodograms [s]."""


def choose_cutoff(position: Float[Tensor, "frames markers 3"], rate_hz: float) -> float:
    """Cut-off [Hz] that keeps a motion whole: 1.5 times the frequency below which 99 % of the velocity's power lies.

    Powers of all coordinates are summed, each less three times its noise floor (the median above 20 Hz, or above 0.3
    of the rate). It gives 5 to 10 Hz in walking, 8 to 11 in running, 4 to 6 in squats. Where the spectrum meets its
    floor, the textbook's sign, it does not say: most laboratories filter before they export, no floor is left, and on
    ten of eleven public data sets the answer was the upper bound. The power of acceleration instead of velocity
    follows narrow lines (cameras, 28 Hz) as soon as the motion is slow.

    Args:
        position: marker trajectories [m]; coordinates with gaps are left out, and those that jump.
    """
    if len(position) < 32:
        return UNKNOWN
    frequency, total = np.zeros(1), np.zeros(1)
    for marker in range(position.shape[1]):  # one at a time: the periodograms take several times a marker's memory
        x = position[:, marker].detach().cpu().numpy()
        x = x[:, np.isfinite(x).all(axis=0) & ~_jumps(x, rate_hz)]
        if x.shape[1]:
            frequency, power = _power(x, rate_hz)
            total = total + power
    below = np.cumsum(np.where(frequency <= HIGHEST, total * frequency**2, 0.0))
    if below[-1] <= 0.0:
        return UNKNOWN
    return float(np.clip(MARGIN * np.interp(SHARE, below / below[-1], frequency), LOWEST, HIGHEST))


def _jumps(x: Float[np.ndarray, "frames channels"], rate_hz: float) -> np.ndarray:
    bend = np.abs(np.nan_to_num(np.diff(x, 2, axis=0))).max(axis=0)
    return bend > max(JUMP[0], JUMP[1] / rate_hz**2)


def _power(x: Float[np.ndarray, "frames channels"], rate_hz: float) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies [Hz] and the channels' power above their noise floors."""
    length = min(len(x), round(WINDOW * rate_hz))
    frequency, power = scipy.signal.welch(x, rate_hz, nperseg=length, axis=0, detrend="linear")
    floor = np.median(power[frequency > min(HIGHEST, 0.3 * rate_hz)], axis=0)
    return frequency, np.clip(power - 3.0 * floor, 0.0, None).sum(axis=1)
