"""Blocks of the arrow's normal matrix against finite differences, and their elimination against dense algebra."""

import numpy as np
import pytest
import torch
from benchmarks.first_order import make_gradient
from dense_blocks import assemble
from marker_problems import random_problem, retracted
from torch.testing import assert_close

from torchid.geometry.arrow.elimination import back_substitute, eliminate, reduce_shared
from torchid.geometry.arrow.index_tables import make_layout
from torchid.geometry.arrow.limb_partition import make_partition
from torchid.geometry.arrow.normal_blocks import make_pieces, shared_block, shared_curve
from torchid.geometry.problem import retract
from torchid.kinematics.plan import plan_tree
from torchid.model.whole_body import whole_body

STEP = 1e-6


def _jacobian(problem, layout, q, xi) -> torch.Tensor:
    """Marker positions' derivatives (frames, markers * 3, motion + xi) by central differences."""
    columns = []
    for row in layout.dof_rows.tolist():
        p = [problem.residual(retracted(q, row, s * STEP, retract), xi)[1] for s in (1, -1)]
        columns.append((p[0] - p[1]) / (2 * STEP))
    for k in range(len(xi)):
        d = torch.zeros_like(xi)
        d[k] = STEP
        columns.append((problem.residual(q, xi + d)[1] - problem.residual(q, xi - d)[1]) / (2 * STEP))
    return torch.stack(columns, -1).permute(2, 0, 1, 3).reshape(q.shape[1], -1, len(columns))


@pytest.mark.parametrize("case", range(5))
@pytest.mark.parametrize("robust", [None, 2.0])
@pytest.mark.parametrize("coupled", [False, True])
def test_blocks_equal_finite_differences(case: int, robust: float | None, coupled: bool, seed: int) -> None:
    """Gradient and every block of J'WJ equal those of a numerical marker Jacobian, for any tree, ties and gaps."""
    rng = np.random.default_rng([seed, case])
    problem, q, xi = random_problem(rng, robust=robust, coupled=coupled)
    q, layout = q + 0.02, make_layout(problem)
    blocks = assemble(problem, layout, q, xi)
    J, n = _jacobian(problem, layout, q, xi), len(q)
    _, _, residual = problem.residual(q, xi)
    _, weight = problem.robust_cost(residual)
    W = weight.repeat_interleave(3, 0).T
    _, pull, curvature = problem.posture.pull(q)
    H = J.mT @ (W[:, :, None] * J)
    g = (J.mT @ (W * residual.reshape(-1, q.shape[1]).T)[:, :, None])[:, :, 0]
    rows = layout.dof_rows
    H_qq = H[:, :n, :n] + torch.diag_embed(curvature[rows].T)
    scale = float(H.abs().max())
    assert_close(torch.tril(blocks.H_qq), torch.tril(H_qq), rtol=0, atol=1e-7 * scale)
    assert_close(blocks.H_qx, H[:, :n, n:], rtol=0, atol=1e-7 * scale)
    assert_close(blocks.H_xx, H[:, n:, n:].sum(0), rtol=0, atol=1e-6 * scale)
    assert_close(blocks.g_q, g[:, :n] + pull[rows].T, rtol=0, atol=1e-7 * scale)
    assert_close(blocks.g_x, g[:, n:], rtol=0, atol=1e-7 * scale)


@pytest.mark.parametrize("coupled", [False, True])
@pytest.mark.parametrize("case", range(3))
def test_gradient_is_that_of_the_robust_cost(case: int, coupled: bool, seed: int) -> None:
    """The gradient equals the finite difference of the cost itself, posture, limits and robust loss included."""
    problem, q, xi = random_problem(np.random.default_rng([seed, case]), robust=2.0, coupled=coupled)
    layout = make_layout(problem)
    blocks = assemble(problem, layout, q, xi)
    cost, g_q, g_x = make_gradient(problem, layout, q, xi, shared=True)
    fold = torch.nn.functional.one_hot(layout.entry_xi, len(xi)).to(q)
    assert_close(cost, problem.frame_cost(q, xi), rtol=1e-12, atol=1e-9)
    assert_close(g_q.T, blocks.g_q, rtol=1e-9, atol=1e-9)
    assert_close(g_x.T @ fold, blocks.g_x, rtol=1e-9, atol=1e-9)
    for k, row in enumerate(layout.dof_rows.tolist()):
        up, down = (problem.frame_cost(retracted(q, row, s * STEP, retract), xi) for s in (1, -1))
        assert_close(blocks.g_q[:, k], (up - down) / (2 * STEP), rtol=1e-4, atol=1e-4 * float(blocks.g_q.abs().max()))


@pytest.mark.parametrize("coupled", [False, True])
@pytest.mark.parametrize("case", range(6))
def test_elimination_by_branches_equals_dense_algebra(case: int, coupled: bool, seed: int) -> None:
    """Reduced matrix, step and predicted cost by branches equal those of the dense normal matrix."""
    rng = np.random.default_rng([seed, case])
    problem, q, xi = random_problem(rng, bodies=int(rng.integers(2, 12)) if case else 3, coupled=coupled)
    layout, n = make_layout(problem), len(xi)
    partition = make_partition(problem.plan, layout, n)
    dense = assemble(problem, layout, q, xi)
    pieces = make_pieces(problem, layout, problem.evaluate(q, problem.shape(xi)), shared=True)
    damping = torch.tensor(rng.uniform(1e-4, 1e-1, size=q.shape[1]))
    eliminated = eliminate(partition, pieces, damping)
    lower = torch.tril(dense.H_qq)
    full = lower + lower.mT - torch.diag_embed(torch.diagonal(lower, dim1=1, dim2=2))
    floor = 1e-9 * problem.weight.sum(0)[:, None] + 1e-12
    diagonal = torch.diagonal(full, dim1=1, dim2=2)
    damped = full + torch.diag_embed(damping[:, None] * (diagonal + floor) + floor)
    solved = torch.linalg.solve(damped, torch.cat([dense.H_qx, dense.g_q[:, :, None]], 2))
    S, rhs = torch.zeros(n, n, dtype=q.dtype), torch.zeros(n, dtype=q.dtype)
    reduce_shared(partition, eliminated, S, rhs)
    expected = -(dense.H_qx.mT @ solved).sum(0)[partition.xi]
    scale = float(expected.abs().max())
    assert_close(S, expected[:, :-1][:, partition.xi], rtol=1e-7, atol=1e-7 * scale)
    assert_close(rhs, expected[:, -1], rtol=1e-7, atol=1e-7 * scale)
    dx = 1e-3 * torch.tensor(rng.normal(size=n))
    d, fall, quadratic = back_substitute(partition, eliminated, dx[partition.xi])
    step = -(solved[:, :, -1] + solved[:, :, :-1] @ dx)
    assert_close(d, step[:, partition.motion], rtol=1e-6, atol=1e-9)
    full = damped - torch.diag_embed(damping[:, None] * (diagonal + floor))
    curve = 0.5 * torch.einsum("ti,tij,tj->t", step, full, step) + torch.einsum("ti,tij,j->t", step, dense.H_qx, dx)
    change = (step * dense.g_q).sum(1) + dense.g_x @ dx + curve
    assert_close(quadratic, curve, rtol=1e-6, atol=1e-6 * float(curve.abs().max()))
    assert_close(-fall, change, rtol=1e-6, atol=1e-6 * float(change.abs().max()))
    fold = torch.nn.functional.one_hot(layout.entry_xi, n).to(q)
    assert_close(shared_curve(layout, pieces, dx).sum(), 0.5 * dx @ dense.H_xx @ dx, rtol=1e-9, atol=1e-9)
    assert_close(fold.T @ shared_block(layout, pieces) @ fold, dense.H_xx, rtol=1e-12, atol=1e-9)


def test_branches_of_the_whole_body_are_head_arms_and_legs() -> None:
    """The built-in model falls into head, arms and legs around root and trunk."""
    tree = whole_body(1.75, 70.0, "male").tree
    plan = plan_tree(tree)
    found = {frozenset(tree.names[plan.order[k]] for k in bodies) for bodies in plan.branches}
    limbs = {frozenset({"head"})}
    for side in "lr":
        limbs |= {frozenset(f"{part}_{side}" for part in parts)
                  for parts in (("upper_arm", "forearm", "hand"), ("thigh", "shank", "foot"))}  # fmt: skip
    assert found == limbs
