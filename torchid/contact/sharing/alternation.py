"""Alternating directions over all frames at once: dense blocks per frame, a cosine transform along them.

    minimise   1/2 |R w(x) - y|^2 + 1/2 |D2 f(x) / s|^2 + ridge/2 |x|^2 + give dist(x, cones)
    so that    the wrenches w(x) of each group sum to its total

x are the point forces. A copy z of x goes to the cones, a copy s of the contacts' forces f(x) is made smooth; both are
drawn together by multipliers (Boyd et al., Found Trends Mach Learn 3(1), 2011, section 3; step sizes as Stellato et
al., Math Prog Comp 12, 2020, section 5.2). The sums hold in every iteration, since x is found under them.
"""

import math
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchid.contact.options import SolverOptions
from torchid.contact.sharing.problem import SharingProblem, drawn_to_cones, grasp, moved_rows, summed
from torchid.dynamics.equations_of_motion import wrench_about

RELAXATION = 1.6
"""Over-relaxation; cited: 1.5 to 1.8 (Boyd et al. 2011, section 3.4.3)."""
EVERY = 10
"""Iterations from one look at the residuals to the next; chosen: a look costs as much as an iteration."""
ADAPT = 20
"""Iterations from one change of the penalty to the next; chosen: a change costs as much as some five iterations."""
UNBALANCED = 3.0
"""Ratio of the residuals from which on the penalty changes; chosen, as OSQP's 5 for its root."""
BALANCED = 3
"""Corrections of the sums at the end; chosen: each leaves a hundredth of what ``TINY`` and rounding did at worst."""
TINY = 1e-12
"""Part of its size that a matrix of totals is lifted by: totals that nobody bears have no rank."""


@dataclass(frozen=True)
class FrameBlocks:
    """Sought frames, forces as parts of the largest total, about a point of each frame."""

    W: Float[Tensor, "forces columns"]
    """From point forces to the contacts' forces, the same in every frame."""
    active: Float[Tensor, "sought columns"]
    """One for point forces of contacts that bear, else zero."""
    R: Float[Tensor, "sought rows columns"]
    y: Float[Tensor, "sought rows"]
    E: Float[Tensor, "sought totals columns"]
    b: Float[Tensor, "sought totals"]
    friction: Float[Tensor, " points"]


@dataclass(frozen=True)
class Bending:
    """Where the sought frames lie among all, and how stiff forces are along them."""

    sought: Bool[Tensor, " frames"]
    given: Float[Tensor, "frames contacts 3"]
    """Forces of the other frames, NaN where nobody knows them."""
    stiffness: Float[Tensor, "3"]

    def gain(self, penalty: float) -> Float[Tensor, "frequencies 1 3"]:
        """Return what ``smooth`` leaves of every frequency: penalty / (penalty + stiffness (2 - 2 cos)^2)."""
        frames = len(self.given)
        angle = math.pi / frames * torch.arange(frames + 1, device=self.given.device, dtype=self.given.dtype)
        bend = (2.0 - 2.0 * torch.cos(angle)).square()
        return (penalty / (penalty + bend[:, None] * self.stiffness))[:, None]

    def smooth(
        self, wanted: Float[Tensor, "frames contacts 3"], gain: Float[Tensor, "frequencies 1 3"]
    ) -> Float[Tensor, "frames contacts 3"]:
        """Return argmin 1/2 stiffness |D2 s|^2 + penalty/2 |s - wanted|^2, by the transform that diagonalises D2'D2.

        Beyond both ends the forces are mirrored, of which the cosine transform is made (Strang, SIAM Review 41, 1999).
        """
        both = torch.fft.rfft(torch.cat([wanted, wanted.flip(0)]), dim=0)
        return torch.fft.irfft(both * gain, n=2 * len(wanted), dim=0)[: len(wanted)]

    def course(self, forces: Float[Tensor, "sought forces"], last: Tensor) -> Float[Tensor, "frames contacts 3"]:
        """Return forces of all frames: the sought ones, those given, and the last ones where nobody knows them."""
        out = torch.where(torch.isnan(self.given), last, self.given)
        out[self.sought] = forces.view(-1, *out.shape[1:])
        return out


def frame_blocks(own: SharingProblem, about: Float[Tensor, "frames 3"], size: float) -> FrameBlocks:
    """Return the matrices of sought frames.

    Args:
        own: the problem of these frames alone.
        about: point that moments are taken about [m].
        size: force that everything is a part of [N].
    """
    G = grasp(own, about)
    R = torch.einsum("trcw,tcwn->trn", moved_rows(own.rows, about), G)
    E = torch.einsum("gc,tcwn->tgwn", summed(own), G).flatten(1, 2)
    b = wrench_about(own.total, about[:, None].expand(-1, own.total.shape[1], -1)).flatten(1)
    turned = torch.block_diag(*own.axes.mT.to(R))
    same = torch.nn.functional.one_hot(own.owner, own.contacts).to(R)
    W = torch.kron(same.T.contiguous(), torch.eye(3).to(R)) @ turned
    active = own.bearing[:, own.owner].to(R).repeat_interleave(3, dim=1)
    return FrameBlocks(W, active, R * size, own.aim, E, b / size, own.friction)


def bending(problem: SharingProblem, sought: Bool[Tensor, " frames"], size: float) -> Bending | None:
    """Return what couples the frames; None where nothing does."""
    if problem.bend_sd is None:
        return None
    empty = torch.full_like(problem.rows[:, 0], torch.nan)
    given = (empty if problem.given is None else problem.given)[..., :3] / size
    return Bending(sought, given, (size / problem.bend_sd).square())


def alternate(
    f: FrameBlocks, bend: Bending | None, options: SolverOptions
) -> tuple[Float[Tensor, "sought points 3"], int, float]:
    """Return point forces that keep the sums, how many iterations they took, and the residual that is left."""
    run, residual, k = _Alternation(f, bend, options), math.inf, 0
    for k in range(1, options.iterations + 1):
        primal, dual = run.step(measure := k % EVERY == 0 or k == options.iterations)
        if not measure:
            continue
        residual = max(primal, dual)
        if residual <= options.tolerance:
            break
        if k % ADAPT == 0:
            run.rebalance(primal / max(dual, 1e-300))
    return run.balanced().unflatten(1, (-1, 3)), k, residual


class _Alternation:
    """Copies, multipliers and factors between two iterations."""

    def __init__(self, f: FrameBlocks, bend: Bending | None, options: SolverOptions) -> None:
        self.f, self.bend, self.ridge, self.give = f, bend, options.ridge, options.give
        self.penalty = options.penalty
        self.pull = (f.R.mT @ f.y[..., None])[..., 0]
        self._factor()
        self.x = self._solve(self.pull)
        self.z, self.u = self.x, torch.zeros_like(self.x)
        if bend is not None:
            self.s = bend.course(self._forces(), torch.zeros_like(bend.given))
            self.v = torch.zeros_like(self.s)
            self.free = torch.isnan(bend.given) & ~bend.sought[:, None, None]

    def step(self, measure: bool) -> tuple[float, float]:
        """Go one iteration; the primal and the dual residual as a displacement, where they are asked for."""
        g = self.pull + self.penalty * (self.z - self.u)
        before = self.z
        if self.bend is not None:
            pulled = (self.s - self.v)[self.bend.sought].flatten(1)
            g = g + self.penalty * (pulled @ self.f.W) * self.f.active
        self.x = self._solve(g)
        mixed = RELAXATION * self.x + (1.0 - RELAXATION) * self.z
        cones = (mixed + self.u).unflatten(1, (-1, 3))
        self.z = drawn_to_cones(cones, self.f.friction, self.give / self.penalty).flatten(1)
        self.u = self.u + mixed - self.z
        smooth = (0.0, 0.0) if self.bend is None else self._smooth(self.bend, measure)
        if not measure:
            return math.inf, math.inf
        return max(float((self.x - self.z).abs().max()), smooth[0]), max(
            float((self.z - before).abs().max()), smooth[1]
        )

    def _smooth(self, bend: Bending, measure: bool) -> tuple[float, float]:
        forces, before = self._forces(), self.s
        mixed = RELAXATION * forces + (1.0 - RELAXATION) * before[bend.sought].flatten(1)
        wanted = bend.course(mixed, before)
        self.s = bend.smooth(wanted + self.v, self.gain)
        self.v = torch.where(self.free, 0.0, self.v + wanted - self.s)
        if not measure:
            return math.inf, math.inf
        apart = torch.where(self.free, 0.0, bend.course(forces, self.s) - self.s)
        return float(apart.abs().max()), float((self.s - before).abs().max())

    def rebalance(self, ratio: float) -> None:
        """Change the penalty where one residual is far above the other."""
        if 1.0 / UNBALANCED < ratio < UNBALANCED:
            return
        change = min(max(math.sqrt(ratio), 0.1), 10.0)
        self.penalty, self.u = self.penalty * change, self.u / change
        if self.bend is not None:
            self.v = self.v / change
        self._factor()

    def balanced(self) -> Float[Tensor, "sought columns"]:
        """Return the point forces, their sums corrected for what rounding left."""
        x = self.x
        for _ in range(BALANCED):
            rest = self.f.b - (self.f.E @ x[..., None])[..., 0]
            x = x + (self.K @ rest[..., None])[..., 0]
        return x

    def _factor(self) -> None:
        """x = M g + K b is the minimum of 1/2 x'Hx - g'x under E x = b."""
        f = self.f
        H = f.R.mT @ f.R
        if self.bend is not None:
            H = H + self.penalty * (f.W.mT @ f.W) * f.active[:, None] * f.active[..., None]
            self.gain = self.bend.gain(self.penalty)
        H.diagonal(dim1=1, dim2=2).add_(self.ridge + self.penalty)
        inverse = torch.cholesky_inverse(torch.linalg.cholesky(H))
        EH = f.E @ inverse
        S = EH @ f.E.mT
        S.diagonal(dim1=1, dim2=2).add_(TINY * S.diagonal(dim1=1, dim2=2).amax(dim=1, keepdim=True).clamp(min=1.0))
        self.K = torch.linalg.solve(S, EH).mT
        self.M = inverse - self.K @ EH
        self.Kb = (self.K @ f.b[..., None])[..., 0]

    def _solve(self, g: Tensor) -> Tensor:
        # M is symmetric, and rows times matrices take half as long as matrices times columns.
        return torch.baddbmm(self.Kb[:, None], g[:, None], self.M)[:, 0]

    def _forces(self) -> Tensor:
        return (self.x * self.f.active) @ self.f.W.T
