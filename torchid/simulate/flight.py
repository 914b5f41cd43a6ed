"""Motions that leave the floor: pelvis and trunk move so that nothing but gravity acts on the body in the air.

In the air the centre of mass follows a parabola and the angular momentum about it stays as it is. The script says how
high the centre of mass is; the pelvis' height follows from that, its place from the centre of pressure (as in
``balance``, by a pendulum, whose weight comes and goes), and its orientation in the air from the angular momentum.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import scipy.interpolate
import scipy.linalg
import torch
from jaxtyping import Float
from torch import Tensor

from torchid.conventions import GRAVITY
from torchid.filters import Smoother, differentiate
from torchid.kinematics.plan import plan_tree
from torchid.kinematics.recursion import points, poses
from torchid.motion.motion import Motion, smooth_motion
from torchid.simulate.balance import GAIN, Moving, needed_wrench, pendulum, wanted_pressure
from torchid.simulate.legs import stand
from torchid.simulate.script import Script, passages
from torchid.simulate.subject import SimulatedSubject

COUNTERMOVEMENT = (0.62, 0.42, 0.22, 0.07)
"""Times before take-off of the start, the fastest fall, and the beginning and end of the strongest push [s]; in reverse
after the landing."""
TIPTOE = 0.02
"""Height of the centre of mass over standing when the toes leave the floor, and when they are back [m]."""
ITERATIONS = 40
MEMORY = 6
"""Iterations that the next one learns from."""
AFRESH = 3
"""Iterations in which the legs do not start from where they were: under a pelvis out of place they twist."""
ENOUGH = 0.0003
"""Distance of the centre of pressure from the wanted one, times the share of the weight that it carries [m]."""
LOW = 1e-6
"""Error of the height of the centre of mass that ends the search [m]."""
LOST = 5.0
"""The same, where no iteration mends it."""
CUTOFF = 0.25
"""Of the corrections of place, part of the rate; with the 12 Hz of ``balance`` 20 N were left in the air."""
BARELY = 1.0
"""Vertical force below which the ground carries nothing [N]."""
TURN_S = 0.15
"""Time in which the trunk prepares for the air, and in which it comes back to its script [s]."""
LOOSE = 1e-6
"""What a turn away from the script costs, over what a wrong angular momentum in the air does."""


def leap_height(
    time: Float[Tensor, " frames"], t0: float, t1: float, moments: Sequence[float] = COUNTERMOVEMENT
) -> Float[Tensor, " frames"]:
    """Height of the centre of mass over standing: down, a push that ends in weightlessness at ``t0``, a parabola, back.

    Fall and push are as strong as it takes to leave at ``TIPTOE`` with the speed that lasts until ``t1`` [m].
    """
    start, fast, push, end = (-x for x in moments)
    fine = torch.linspace(start, 0.0, 6001, dtype=time.dtype)
    shapes = (
        passages(fine, [(start, 0.0), (fast, 1.0), (push, 0.0)]),
        passages(fine, [(fast, 0.0), (push, 1.0), (end, 1.0), (0.0, 0.0)]),
        passages(fine, [(end, 0.0), (0.0, -GRAVITY)]),
    )
    speed = [torch.cumulative_trapezoid(a, fine) for a in shapes]
    height = [torch.cumulative_trapezoid(v, fine[1:]) for v in speed]
    last = torch.stack([torch.stack([x[-1] for x in row]) for row in (speed, height)])
    wanted = last.new_tensor([0.5 * GRAVITY * (t1 - t0), TIPTOE]) - last[:, 2]
    factor = torch.linalg.solve(last[:, :2], wanted)
    z = factor[0] * height[0] + factor[1] * height[1] + height[2]
    spline = scipy.interpolate.make_interp_spline(fine[2:].numpy(), z.numpy(), k=5)
    away = torch.minimum(time - t0, t1 - time)
    ground = torch.as_tensor(spline(away.clamp(float(fine[2]), 0.0).numpy()), dtype=time.dtype)
    air = TIPTOE + 0.5 * GRAVITY * (time - t0) * (t1 - time)
    return torch.where(away > 0.0, air, torch.where(away > start, ground, 0.0))


def leap(subject: SimulatedSubject, script: Script, rate: float) -> Moving:
    """Solve for pelvis, trunk and legs of a script that says how high the centre of mass is.

    Returns:
        The motion; its ``miss`` counts as much as the ground carries of the weight. In the air the base's accelerations
        are those that need no force at all; they differ from the derivatives of its coordinates by a few cm/s^2.
    """
    assert script.rise is not None
    wanted, weight, rise = wanted_pressure(subject, script), subject.mass * GRAVITY, script.rise
    support = (1.0 + differentiate(rise, rate)[1] / GRAVITY).clamp(min=0.0)
    exact, calm = Smoother(rate, rate), Smoother(CUTOFF * rate, rate)
    inner = slice(int(0.3 * rate), -int(0.3 * rate))
    drop, legs, seen = script.drop - rise, None, []
    place, turn = pendulum(wanted, rate), torch.zeros_like(script.pelvis_turn)
    inertia, top = None, None
    for k in range(ITERATIONS):
        tried = replace(script, pelvis_turn=script.pelvis_turn + turn, drop=drop)
        q, legs = stand(subject, tried, place, legs if k > AFRESH else None)
        motion = smooth_motion(subject.model.tree, script.time, q, exact)
        wrench, centre = needed_wrench(subject, motion), centre_of_mass(subject, motion)
        if inertia is None or top is None:
            inertia, top = _inertia(subject, motion, centre), centre[0, 2]
        tilting = (torch.stack([-wrench[:, 4], wrench[:, 3]], 1) - wanted * wrench[:, 2:3]) / weight
        high = centre[:, 2] - top - rise
        miss, low = float(tilting[inner].norm(dim=1).max()), float(high[inner].abs().max())
        if (miss < ENOUGH and low < LOW) or (miss > LOST and k > AFRESH):
            break
        drop = drop + high
        turning = wrench[:, 3:] - torch.linalg.cross(centre, wrench[:, :3])
        spin = torch.linalg.solve(inertia, turning[:, :, None])[:, :, 0]
        steps = -calm(pendulum(tilting, rate, support)) / GAIN, _turned(turn, spin, support, rate) - turn
        seen = [*seen, (torch.cat([place, turn], 1), torch.cat(steps, 1))][-MEMORY:]
        place, turn = _mixed(seen).split([2, 3], 1)
    motion = _weightless(subject, motion)
    return Moving(motion, needed_wrench(subject, motion), miss)


def centre_of_mass(subject: SimulatedSubject, motion: Motion) -> Float[Tensor, "frames 3"]:
    """Of the whole body, in W [m]."""
    plan, phi = plan_tree(subject.model.tree), subject.phi
    at = poses(plan, motion.q.T.contiguous(), subject.geometry)
    p = points(at, torch.tensor(plan.position), phi[:, 1:4] / phi[:, :1])
    return torch.einsum("b,bat->ta", phi[:, 0] / phi[:, 0].sum(), p)


def _mixed(seen: list[tuple[Tensor, Tensor]]) -> Float[Tensor, "frames 5"]:
    """Next point of a fixed-point iteration from its last points and steps (Anderson 1965, J ACM 12(4))."""
    x, f = (torch.stack([pair[k].flatten() for pair in seen], 1) for k in (0, 1))
    dx, df = torch.diff(x, dim=1), torch.diff(f, dim=1)
    share = torch.linalg.lstsq(df, f[:, -1:]).solution if len(seen) > 1 else f.new_zeros(0, 1)
    return (x[:, -1] + f[:, -1] - ((dx + df) @ share)[:, 0]).reshape(seen[-1][0].shape)


def _responses(subject: SimulatedSubject, motion: Motion) -> Float[Tensor, "frames 6 6"]:
    """Change of the needed wrench with each acceleration of the base, as columns."""
    columns = []
    for k in range(6):
        a = motion.a.clone()
        a[:, k] += 1.0
        columns.append(needed_wrench(subject, replace(motion, a=a)))
    return torch.stack(columns, 2) - needed_wrench(subject, motion)[:, :, None]


def _inertia(
    subject: SimulatedSubject, motion: Motion, centre: Float[Tensor, "frames 3"]
) -> Float[Tensor, "frames 3 3"]:
    """Of the whole body about its centre of mass, as if its joints were locked."""
    turned = _responses(subject, motion)[:, :, 3:]
    return turned[:, 3:] - torch.linalg.cross(centre[:, :, None].expand(-1, -1, 3), turned[:, :3], dim=1)


def _turned(
    turn: Float[Tensor, "frames 3"], spin: Float[Tensor, "frames 3"], support: Float[Tensor, " frames"], rate: float
) -> Float[Tensor, "frames 3"]:
    """The turn whose acceleration is less by ``spin`` in the air and, ever less so, about it; elsewhere it fades."""
    n, weight = len(turn), (1.0 - 2.0 * support).clamp(min=0.0)[1:-1].numpy() ** 2
    goal = torch.diff(turn, n=2, dim=0).numpy() * rate**2 - spin[1:-1].numpy()
    second, third = np.array([1.0, -2.0, 1.0]) * rate**2, np.array([-1.0, 3.0, -3.0, 1.0]) * rate**3
    bands = np.zeros((4, n))
    bands[3] += LOOSE / TURN_S**4
    for stencil, cost in ((second, weight), (third, np.full(n - 3, LOOSE * TURN_S**2))):
        for i, x in enumerate(stencil):
            for j, y in enumerate(stencil[i:]):
                bands[3 - j, i + j : i + j + len(cost)] += cost * x * y
    right = np.zeros((n, 3))
    for i, x in enumerate(second):
        right[i : i + n - 2] += x * weight[:, None] * goal
    return torch.as_tensor(scipy.linalg.solveh_banded(bands, right), dtype=turn.dtype)


def _weightless(subject: SimulatedSubject, motion: Motion) -> Motion:
    """The same motion, its base's accelerations exactly those that need no force where hardly any is needed."""
    wrench = needed_wrench(subject, motion)
    change = torch.linalg.solve(_responses(subject, motion), wrench[:, :, None])[:, :, 0]
    a = motion.a.clone()
    a[:, :6] -= (wrench[:, 2:3] < BARELY) * change
    return replace(motion, a=a)
