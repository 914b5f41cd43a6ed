"""The lean recursion, the pytorch-kinematics chain and Pinocchio agree on random trees."""

import numpy as np
import pytest
import torch
from torch.testing import assert_close
from trees import coupled_tree, pinocchio_state, pinocchio_twin, random_motion, random_tree

from torchid.kinematics.chain import chain_poses
from torchid.kinematics.plan import plan_tree
from torchid.kinematics.recursion import body_motion, body_transforms, poses
from torchid.model.model import Geometry

pin = pytest.importorskip("pinocchio")


@pytest.mark.parametrize("coupled", [False, True])
@pytest.mark.parametrize("case", range(6))
def test_recursion_equals_chain(case: int, coupled: bool, seed: int) -> None:
    """Poses of the lean recursion equal those of the pytorch-kinematics chain, also where functions drive joints."""
    rng = np.random.default_rng([seed, case])
    tree, geometry = random_tree(rng)
    tree = coupled_tree(rng, tree) if coupled else tree
    q, _, _ = random_motion(rng, tree, 5)
    X = chain_poses(tree, q, geometry, chunk=2)
    far = max(1.0, float(X[..., :3, 3].abs().max()))  # functions of functions reach far
    assert_close(body_transforms(tree, q, geometry), X, rtol=0, atol=1e-12 * far)


@pytest.mark.parametrize("coupled", [False, True])
@pytest.mark.parametrize("case", range(4))
def test_velocities_and_accelerations_equal_pinocchio(case: int, coupled: bool, seed: int) -> None:
    """Twists and classical accelerations of every body equal Pinocchio's, given what functions make of coordinates."""
    rng = np.random.default_rng([seed, case])
    tree, geometry = random_tree(rng)
    tree = coupled_tree(rng, tree) if coupled else tree
    q, v, a = (x.T.contiguous() for x in random_motion(rng, tree, 2))
    plan = plan_tree(tree)
    moving = body_motion(plan, poses(plan, q, geometry), v, a)
    (v, a), q, tree = tree.rates(q, v, a), tree.axes(q), tree.uncoupled
    twin = pinocchio_twin(tree, geometry)
    data = twin.createData()
    for t in range(2):
        pin.forwardKinematics(twin, data, *pinocchio_state(twin, tree, q[:, t], v[:, t], a[:, t]))
        pin.updateFramePlacements(twin, data)
        for k, body in enumerate(plan.order):
            frame = twin.getFrameId(tree.bodies[body].name)
            twist = pin.getFrameVelocity(twin, data, frame, pin.LOCAL_WORLD_ALIGNED)
            spatial = pin.getFrameClassicalAcceleration(twin, data, frame, pin.LOCAL_WORLD_ALIGNED)
            assert_close(moving.v[k, :, t], torch.tensor(twist.linear), rtol=1e-10, atol=1e-10)
            assert_close(moving.w[k, :, t], torch.tensor(twist.angular), rtol=1e-10, atol=1e-10)
            assert_close(moving.a[k, :, t], torch.tensor(spatial.linear), rtol=1e-9, atol=1e-9)
            assert_close(moving.alpha[k, :, t], torch.tensor(spatial.angular), rtol=1e-9, atol=1e-9)


def test_rates_of_axis_values_are_their_differences(seed: int) -> None:
    """Rates, accelerations and derivatives of what functions make of coordinates equal finite differences in time."""
    rng = np.random.default_rng(seed)
    tree = coupled_tree(rng, random_tree(rng)[0])
    assert tree.coupling is not None
    q, v, a = (x.T.contiguous() for x in random_motion(rng, tree, 3))
    step = 1e-5
    rate, acceleration = tree.rates(q, v, a)
    before, after = (q + s * v + 0.5 * s * s * a for s in (-step, step))
    difference = (tree.axes(after) - tree.axes(before)) / (2 * step)
    assert_close(rate, difference, rtol=1e-6, atol=1e-6 * float(rate.abs().max()))
    (early, _), (late, _) = tree.rates(before, v - step * a, a), tree.rates(after, v + step * a, a)
    assert_close(acceleration, (late - early) / (2 * step), rtol=1e-4, atol=1e-4 * float(acceleration.abs().max()))
    x = torch.tensor(rng.normal(size=(tree.n_axes, 2, 3)))
    assert_close((tree.fold(q, x) * v[:, None]).sum(0), (x * rate[:, None]).sum(0), rtol=1e-10, atol=1e-10)


def test_chain_gradients_reach_motion_and_geometry(seed: int) -> None:
    """Positions of the chain are differentiable in coordinates, offsets and hinge angles."""
    rng = np.random.default_rng(seed)
    tree, geometry = random_tree(rng, bodies=4)
    q, _, _ = random_motion(rng, tree, 2)

    def place(q: torch.Tensor, offset: torch.Tensor, hinge: torch.Tensor) -> torch.Tensor:
        return chain_poses(tree, q, Geometry(offset, hinge))[..., :3, :]

    inputs = tuple(x.clone().requires_grad_() for x in (q, geometry.offset, geometry.hinge))
    assert torch.autograd.gradcheck(place, inputs, atol=1e-6)
