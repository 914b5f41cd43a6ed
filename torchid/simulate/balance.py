"""Where the pelvis must go so that the ground can carry the motion.

The centre of pressure of a motion is where the total wrench has no horizontal moment. It must lie where the feet bear.
Near any motion, shifting the pelvis by s moves it by about 0.9 (s - h/g s''), as for a pendulum on a cart (Kajita et
al. 2003, ICRA); the bounded solution of that equation, repeated, brings the centre of pressure where the script wants
it.
"""

from dataclasses import dataclass

import numpy as np
import scipy.linalg
import torch
from jaxtyping import Float
from torch import Tensor

from torchid.conventions import GRAVITY
from torchid.effects.scene import make_scene
from torchid.filters import Smoother
from torchid.motion.motion import Motion, smooth_motion
from torchid.simulate.legs import bearing_point, stand
from torchid.simulate.script import Script
from torchid.simulate.subject import SimulatedSubject

ITERATIONS = 10
ENOUGH = 0.003
"""Distance of the centre of pressure from the wanted one that ends the search [m]."""
LOST = 0.5
"""Distance that no iteration mends: a leg does not reach its foot's path [m]."""
GAIN = 0.9
CUTOFF = 12.0
"""Of the pelvis' corrections [Hz]; the discrete pendulum would amplify what is faster."""


@dataclass(frozen=True)
class Moving:
    """A motion that the ground carries."""

    motion: Motion
    wrench: Float[Tensor, "frames 6"]
    """Needed from the ground, about the origin of W."""
    miss: float
    """Largest distance of the centre of pressure from the wanted one [m]."""


def needed_wrench(
    subject: SimulatedSubject, motion: Motion, phi: Float[Tensor, "bodies 10"] | None = None
) -> Float[Tensor, "frames 6"]:
    """Total wrench that the ground must supply for the motion, about the origin of W."""
    scene = make_scene(subject.trial, subject.model.tree, subject.geometry, motion, subject.phi if phi is None else phi)
    total = scene.needed()
    for hidden in subject.hidden:
        total = total + hidden.load(scene)
    return total.T.contiguous()


def centre_of_pressure(wrench: Float[Tensor, "frames 6"]) -> Float[Tensor, "frames 2"]:
    """Point of the floor where the wrench has no horizontal moment [m]."""
    return torch.stack([-wrench[:, 4], wrench[:, 3]], 1) / wrench[:, 2:3]


def wanted_pressure(subject: SimulatedSubject, script: Script) -> Float[Tensor, "frames 2"]:
    """Centre of pressure of both feet together as the script shares the weight."""
    left, right = (bearing_point(path, subject.sole)[:, :2] for path in script.feet)
    return script.share[:, None] * left + (1.0 - script.share[:, None]) * right


def balance(subject: SimulatedSubject, script: Script, rate: float) -> Moving:
    """Solve for pelvis and legs."""
    wanted = wanted_pressure(subject, script)
    exact, calm = Smoother(rate, rate), Smoother(CUTOFF, rate)
    place = pendulum(wanted, rate)
    legs = None
    for k in range(ITERATIONS):
        q, legs = stand(subject, script, place, legs)
        motion = smooth_motion(subject.model.tree, script.time, q, exact)
        wrench = needed_wrench(subject, motion)
        error = centre_of_pressure(wrench) - wanted
        inner = slice(int(0.3 * rate), -int(0.3 * rate))
        miss = float(error[inner].norm(dim=1).max())
        if miss < ENOUGH or miss > LOST or k == ITERATIONS - 1:
            break
        place = place - calm(pendulum(error, rate)) / GAIN
    return Moving(motion, wrench, miss)


def pendulum(
    e: Float[Tensor, "frames 2"], rate: float, support: Float[Tensor, " frames"] | None = None, height: float = 1.05
) -> Float[Tensor, "frames 2"]:
    """Bounded solution of s - h/g s'' = e, at rest at the ends; of ``support`` s - h/g s'' = e where that is given."""
    n, k = len(e), height / GRAVITY * rate**2
    bands = np.zeros((3, n))
    bands[0, 1:], bands[2, :-1] = -k, -k
    bands[1] = 2.0 * k
    bands[1, 0] = bands[1, -1] = k
    bands[1] += 1.0 if support is None else support.cpu().numpy()
    return torch.as_tensor(scipy.linalg.solve_banded((1, 1), bands, e.cpu().numpy()), dtype=e.dtype, device=e.device)
