"""The same problem by Clarabel through CVXPY, its cones hard: slow, and what the batched solver is held against."""

import cvxpy
import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from torchid.contact.options import SolverOptions
from torchid.contact.sharing.alternation import frame_blocks
from torchid.contact.sharing.problem import SharingProblem, checked, grasp
from torchid.dynamics.equations_of_motion import wrench_about


def share_by_clarabel(
    problem: SharingProblem, options: SolverOptions | None = None
) -> Float[Tensor, "frames contacts 6"]:
    """Return the wrenches of contacts about the world's origin, of a problem whose frames are all sought.

    Args:
        problem: totals that its contacts can bear, and costs; ``open`` and ``given`` are not read.
        options: the ridge; tolerances are Clarabel's own.

    Raises:
        DataError: what ``problem.checked`` finds.

    Reference:
        Goulart & Chen, Clarabel: an interior-point solver for conic programs (2024), arXiv:2405.12762.
    """
    options, problem = options or SolverOptions(), checked(problem)
    size = float(problem.total[..., :3].norm(dim=-1).max().clamp(min=1.0))
    about = problem.points.mean(1)
    f = frame_blocks(problem, about, size)
    W, active, R, y, E, b, friction = (t.numpy() for t in (f.W, f.active, f.R, f.y, f.E, f.b, f.friction))
    frames, points = len(R), len(friction)
    x = [cvxpy.Variable((points, 3)) for _ in range(frames)]
    flat = [cvxpy.reshape(one, (3 * points,), order="C") for one in x]
    cost, kept = 0.0, []
    for t in range(frames):
        cost += 0.5 * cvxpy.sum_squares(R[t] @ flat[t] - y[t]) + 0.5 * options.ridge * cvxpy.sum_squares(flat[t])
        borne = [row for row in range(len(b[t])) if np.abs(E[t][row]).max() > 0.0]
        kept.append(E[t][borne] @ flat[t] == b[t][borne])
        slips = [k for k in range(points) if np.isfinite(friction[k])]
        kept += [cvxpy.norm(x[t][k, :2]) <= friction[k] * x[t][k, 2] for k in slips]
    if problem.bend_sd is not None:
        stiff = np.tile(size / problem.bend_sd.numpy(), problem.contacts)
        force = cvxpy.vstack([W @ cvxpy.multiply(active[t], flat[t]) for t in range(frames)])
        around = [force[:1], force, force[-1:]]
        mirrored = cvxpy.vstack(around)
        bent = mirrored[2:] - 2.0 * mirrored[1:-1] + mirrored[:-2]
        cost += 0.5 * cvxpy.sum_squares(cvxpy.multiply(bent, np.tile(stiff, (frames, 1))))
    cvxpy.Problem(cvxpy.Minimize(cost), kept).solve(solver=cvxpy.CLARABEL)
    found = torch.as_tensor(np.stack([np.asarray(one.value) for one in x])).to(problem.total)
    wrench = size * (grasp(problem, about) @ found.flatten(1)[:, None, :, None])[..., 0]
    return wrench_about(wrench, -about[:, None].expand(-1, problem.contacts, -1))
