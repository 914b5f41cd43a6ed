"""Arrow, Adam and LBFGS minimise one and the same cost."""

from dataclasses import replace

import pytest
import torch
from torch.testing import assert_close
from trees import BASE

from torchid.geometry import gradient_solvers
from torchid.geometry.arrow.inverse_kinematics import solve_poses
from torchid.geometry.arrow.solver import solve_arrow
from torchid.geometry.gradient_solvers import accumulate_gradients, solve_adam, solve_lbfgs
from torchid.geometry.problem import MarkerProblem, PosturePrior
from torchid.kinematics.plan import plan_tree
from torchid.model.model import GeometryPrior
from torchid.model.tree import Body, Dof, Tree, Turn

FRAMES = 10
SIGMA, LOOSE = 0.002, 0.003


def leg() -> tuple[Tree, GeometryPrior]:
    """A pelvis and a leg of three segments, with lengths, hip and the lean of the knee's axis unknown."""
    dofs = BASE + tuple(Dof(name, "rad", -2.0, 2.0) for name in ("flexion", "adduction", "rotation", "knee", "ankle"))
    lean = (Turn(2, 0, moving=False), Turn(1, 9), Turn(2, 0, moving=False, sign=-1.0))
    bodies = (
        Body("pelvis", -1),
        Body("thigh", 0, (Turn(1, 6), Turn(0, 7), Turn(2, 8))),
        Body("shank", 1, lean),
        Body("foot", 2, (Turn(1, 10),)),
    )
    mean = torch.tensor([0.0, -0.09, -0.02, 0.42, 0.40, 0.0], dtype=torch.float64)
    sd = torch.tensor([0.01, 0.01, 0.01, 0.02, 0.02, 0.1], dtype=torch.float64)
    matrix = torch.zeros(13, 6, dtype=torch.float64)
    for row, column, sign in ((3, 0, 1.0), (4, 1, 1.0), (5, 2, 1.0), (8, 3, -1.0), (11, 4, -1.0), (12, 5, 1.0)):
        matrix[row, column] = sign
    names, units = ("hip_x", "hip_y", "hip_z", "thigh", "shank", "lean"), ("m",) * 5 + ("rad",)
    return Tree(bodies, dofs, ("lean",)), GeometryPrior(names, units, mean, sd, matrix, torch.zeros(13).double(), 1)


@pytest.fixture
def problem(seed: int) -> tuple[MarkerProblem, torch.Tensor, torch.Tensor]:
    """Four noisy markers a segment; the problem, the true coordinates and the true geometry."""
    return marked_leg(FRAMES)


def marked_leg(frames: int) -> tuple[MarkerProblem, torch.Tensor, torch.Tensor]:
    """The same in so many frames."""
    tree, prior = leg()
    plan = plan_tree(tree)
    body = torch.arange(4).repeat_interleave(4)
    place = 0.08 * torch.randn(16, 3, dtype=torch.float64)
    q = 0.4 * torch.randn(len(tree.dofs), frames, dtype=torch.float64)
    xi = torch.cat([prior.mean + prior.sd * torch.randn(6).double(), place.reshape(-1)])
    nothing = q.new_zeros(len(tree.dofs), 1)
    made = MarkerProblem(
        plan=plan,
        geometry=prior,
        body=torch.tensor(plan.position)[body],
        target=q.new_zeros(16, 3, frames),
        weight=q.new_full((16, frames), SIGMA**-2),
        place=place + LOOSE * torch.randn(16, 3).double(),
        place_sd=torch.full((16, 3), LOOSE, dtype=torch.float64),
        free=torch.arange(16),
        posture=PosturePrior(nothing, nothing, nothing - 9.0, nothing + 9.0, 0.0),
    )
    _, p, _ = made.residual(q, xi)
    return replace(made, target=p + SIGMA * torch.randn(p.shape, dtype=p.dtype)), q, xi


def started(problem: MarkerProblem, q: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Prior mean, and postures at some distance from the truth."""
    xi = problem.xi_mean
    return solve_poses(problem, q + 0.1, xi)[0], xi


def test_arrow_and_lbfgs_meet_at_one_optimum(problem):
    """LBFGS removes nearly all of the excess cost, and from the arrow's end it finds nothing better."""
    given, q, _ = problem
    q, xi = started(given, q)
    arrow, lbfgs = solve_arrow(given, q, xi), solve_lbfgs(given, q, xi, 300)
    assert arrow.cost * (1 - 1e-6) <= lbfgs.cost
    assert arrow.trace[0] - lbfgs.cost > 0.95 * (arrow.trace[0] - arrow.cost)
    assert solve_lbfgs(given, arrow.q, arrow.xi, 60).cost > arrow.cost * (1 - 1e-4)


def test_adam_comes_close(problem):
    """Adam removes most of the excess cost in a few hundred steps, and never goes below the arrow's optimum."""
    given, q, _ = problem
    q, xi = started(given, q)
    arrow, adam = solve_arrow(given, q, xi), solve_adam(given, q, xi, 400)
    assert arrow.trace[0] > 4.0 * arrow.cost
    assert arrow.cost * (1 - 1e-6) <= adam.cost
    assert arrow.trace[0] - adam.cost > 0.6 * (arrow.trace[0] - arrow.cost)


def test_gradient_of_the_chain_vanishes_where_the_arrow_stops(problem):
    """At the arrow's optimum the pytorch-kinematics chain, an independent path, sees no slope left."""
    given, q, _ = problem
    q, xi = started(given, q)
    found = solve_arrow(given, q, xi, tolerance=1e-10)
    slopes = []
    for at_q, at_xi in ((q, xi), (found.q, found.xi)):
        leaves = at_q.clone().requires_grad_(), at_xi.clone().requires_grad_()
        accumulate_gradients(given, *leaves)
        slopes.append(torch.cat([leaf.grad.flatten() for leaf in leaves]).norm())
    assert slopes[1] < 1e-5 * slopes[0]
    assert found.converged and all(b <= a for a, b in zip(found.trace, found.trace[1:], strict=False))


def test_gradients_do_not_depend_on_the_chunks(problem, monkeypatch):
    """Frames in chunks of three give the cost and the gradients of all frames at once."""
    given, q, _ = problem
    found = []
    for chunk in (FRAMES, 3):
        monkeypatch.setattr(gradient_solvers, "CHUNK", chunk)
        leaves = q.clone().requires_grad_(), given.xi_mean.clone().requires_grad_()
        found.append((accumulate_gradients(given, *leaves), *(leaf.grad for leaf in leaves)))
    assert_close(found[1], found[0])


def test_robust_loss_forgets_outliers(problem):
    """With swapped-like outliers, the robust fit stays nearer to the truth than least squares."""
    given, q, truth = problem
    target = given.target.clone()
    target[::5, :, ::4] += 0.3
    spoilt = replace(given, target=target)
    errors = []
    for robust in (None, 4.0):
        found = solve_arrow(replace(spoilt, robust=robust), q, truth, 100)
        errors.append(float((found.xi - truth).norm()))
    assert errors[1] < 0.5 * errors[0]


def test_frames_do_not_mix_at_fixed_geometry(problem):
    """Inverse kinematics of a few frames gives what it gives among others, but for a step that rounding decides."""
    given, q, xi = problem
    index = torch.tensor([1, 4, 8])
    alone = solve_poses(given.frames(index), q[:, index] + 0.05, xi)[0]
    assert_close(alone, solve_poses(given, q + 0.05, xi)[0][:, index], rtol=0, atol=1e-4)


def test_a_missing_marker_has_no_say(problem):
    """Where the weight is zero the target may be anything."""
    given, q, xi = problem
    weight, target = given.weight.clone(), given.target.clone()
    weight[3, 5], weight[7] = 0.0, 0.0
    target[3, :, 5], target[7] = 1e3, -1e3
    hidden = replace(given, weight=weight)
    one, other = (solve_arrow(p, q, xi) for p in (hidden, replace(hidden, target=target)))
    assert_close(other.xi, one.xi)
    assert_close(other.q, one.q)
