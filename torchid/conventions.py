"""Conventions of torchid: units, axes, orders, names and types of options that must not vary.

Units are SI and radians; files are converted in ``io`` and nowhere else. The world W is right-handed with Z up.
In the neutral standing pose every body's axes point X forward, Y left, Z up; a body's origin is its proximal joint
centre (the pelvis' is the midpoint of the hip centres).

Names follow the monogram notation: ``X_WB`` pose of B in W, ``R_WB`` rotation, ``p_BM_B`` position of M from B in
axes of B. Frames: W world, B body, P parent, J joint, M marker, F plate, C centre of mass.
Six-vectors are linear first: wrench (force, moment), twist (linear, angular). Quaternions are wxyz.
Arrays lead with ``*batch``, then ``frames``, ``bodies``, ``dofs``, ``markers``, ``plates``, ``params``.
"""

from enum import IntEnum
from typing import Annotated

import torch
from annotated_types import Ge, Gt, Le, Len
from torch import Tensor

Positive = Annotated[float, Gt(0)]
NonNegative = Annotated[float, Ge(0)]
Share = Annotated[float, Ge(0), Le(1)]
Count = Annotated[int, Gt(0)]
Name = Annotated[str, Len(1, 200)]
# Types of options with their bounds, which the config checks (https://github.com/annotated-types/annotated-types).

GRAVITY = 9.80665
"""Standard gravity [m/s^2]; the field points along -Z of W."""
LOADED_N = 20.0
"""A plate is loaded where it bears more than this vertical force [N], a choice within the 10 to 50 N by which contacts
of a heel are timed alike (Tirosh & Sparrow, J Appl Biomech 19:178 (2003)); the one definition for reading, contact and
diagnosis."""
SAMPLE_LOADED_N = 2.5 * LOADED_N
"""A single unfiltered sample shows a load above this vertical force [N]: idle plates that scatter by 6 N at 1 kHz pass
``LOADED_N`` once in 700 samples, and this never."""

STANDING_M_S = 0.4
"""Choice. A point of a foot stands below this speed [m/s]."""

ZERO_SD_N, ZERO_SD_NM = 1.5, 0.5
"""Standard deviation of what a channel of an idle plate reads, its zero: forces [N] and moments [N m]. An estimator:
robust scatter between eight public sessions of five laboratories, of which none is quoted in a figure
(`docs/decisions.md`)."""
ZERO_NOTED_N, ZERO_WRONG_N = ZERO_SD_N, 3.0 * ZERO_SD_N
"""Mean vertical reading of an idle plate [N] beyond which a note tells it, and beyond which it is a fault that somebody
should mend: one and three standard deviations between laboratories. Derived."""
ZERO_MOST_N = 100.0
"""Vertical reading [N] beyond which no plate's zero lies: half of the weight of a child of 20 kg, so that a plate that
never reads less was stood on all the time. Derived."""


class Inertial(IntEnum):
    """Order of the ten inertial parameters of a body, about its origin, in its axes (the order of Pinocchio)."""

    M = 0
    MCX = 1
    MCY = 2
    MCZ = 3
    IXX = 4
    IXY = 5
    IYY = 6
    IXZ = 7
    IYZ = 8
    IZZ = 9


INERTIAL_NAMES = ("m", "mc_x", "mc_y", "mc_z", "Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz")
INERTIA_PAIRS = ((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2))
"""Matrix entries of the six moments of inertia, in the order of ``Inertial``."""


def y_up_to_z_up(vector: Tensor) -> Tensor:
    """Rotate vectors (*batch, 3) of a Y-up file into W: (x, y, z) -> (x, -z, y)."""
    return torch.stack([vector[..., 0], -vector[..., 2], vector[..., 1]], dim=-1)


ROOT_MARKERS = 3
"""Markers on the root body without which no posture is told."""
