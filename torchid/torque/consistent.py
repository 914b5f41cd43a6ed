"""The most probable motion given markers and plates: one whose own wrench is the one that plates have measured.

A motion that follows markers needs another wrench than plates measure, by what skin and filter have done to it. Sought
is the smooth change of its postures that is likely under the errors of markers (``posture_errors``) and leaves no more
of the wrench than plates err by: Gauss-Newton on the coefficients of splines, whose matrix is block-tridiagonal. Body,
plates and places of markers stay as they are.

What a change x of the coordinates does to the wrench is linear in the vectors A, B, C of ``effects.displacement``,
(A, B, C) = U x, so that with U' and U'' the rows of x, x' and x'' are those below (``_rows``).
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.conventions import GRAVITY
from torchid.dynamics.equations_of_motion import wrench_about, wrenches_about
from torchid.dynamics.rows import WrenchTrial
from torchid.effects.displacement import coordinate_levers, rate_of
from torchid.effects.scene import Scene, make_scene
from torchid.filters import Smoother
from torchid.geometry.problem import retract
from torchid.motion import Motion, smooth_motion
from torchid.observation.marker_response import MarkerResponse
from torchid.observation.noise_draws import displaced
from torchid.torque.draws import PlateErrors
from torchid.torque.posture_errors import error_penalty, posture_precision
from torchid.torque.seen import TOGETHER
from torchid.torque.spline_system import TOUCHED, BandFactor, BlockBand, Knots

KNOTS_PER_PERIOD = 4.0
"""Resolution. Knots in a period of the cut-off: what splines of these cannot follow, the filter has taken."""
LEAST = 2
"""Resolution. Frames between two knots at least: splines with a knot in every frame have other derivatives than the
course of their values."""
STEPS = 12
"""Resolution. Steps of Gauss-Newton at most."""
GAINED = 1e-3
"""Resolution. Gain of the last step, as a part of what there was to be made small at first."""
TAILS = 4.0
"""Estimator. Degrees of freedom of Student's distribution, the usual for errors of which some are gross (Lange, Little
& Taylor, J Am Stat Assoc 84:881 (1989)): a fault that no motion explains must not bend the body."""
ALIKE = 0.1
"""Resolution. Root mean square change of the rows' weights up to which they are not found anew."""
PROMISED = 0.8
"""Resolution. Part of the gain that a linear system promises below which it is made anew."""
HALVES = 4
"""Resolution. Times that a step is halved that makes things worse."""


@dataclass(frozen=True)
class ConsistentMotion:
    """Motion of a trial that markers and plates agree with."""

    motion: Motion
    """Derivatives are right to first order in the turn of the base; those of ``changed`` are exact."""
    change: Float[Tensor, "frames dofs"]
    """By which the coordinates differ from those that follow markers alone [m, rad]; columns 3 to 5 turn the base in
    W."""
    settled: bool
    """False where the last step still made a difference."""
    trust: Float[Tensor, " frames"]
    """Weight from zero to one that the measured force has in the end, or the moment where that is less: low where they
    are off by more than plates err and motion explains."""
    knots: Knots
    factor: BandFactor
    """Of the inverse covariance of the coefficients of ``change``."""

    def draw(self, count: int, generator: torch.Generator) -> Iterator[tuple[Float[Tensor, "frames dofs"], Motion]]:
        """Draw errors of the coordinates as markers and plates leave them open, with the motions that they make.

        Body and plates are taken for known.
        """
        for some in range(0, count, TOGETHER):
            shape = (self.knots.coefficients, self.change.shape[1], min(TOGETHER, count - some))
            white = torch.randn(*shape, generator=generator, dtype=torch.float64).to(self.change)
            for error in self.knots.course(self.factor.draw(white)).unbind(2):
                yield error, displaced(self.motion, error)


@dataclass(frozen=True)
class Agreement:
    """How far a motion is from what plates and cameras have measured, as root mean squares."""

    force_N: float
    moment_Nm: float
    """About the root's origin."""
    marker_m: float


@dataclass(frozen=True)
class ConsistentTrial:
    """The motion of a trial that obeys its forces, beside the one that follows its markers."""

    motion: Motion
    torque: Float[Tensor, "frames dofs"]
    """Forces of the joints [N m, N], as in ``Outcome.torque``."""
    change: Float[Tensor, "frames dofs"]
    """As in ``ConsistentMotion``."""
    settled: bool
    trusted: float
    """Mean over the used frames of ``ConsistentMotion.trust``."""
    before: Agreement
    after: Agreement
    sd: tuple[Float[Tensor, "frames dofs"], ...] | None = None
    """Standard deviations of q (columns 3 to 5: turn of the base in W), v and a, with body and plates taken for known
    (``torques.draws``); None where nothing was drawn."""


def changed(rows: WrenchTrial, change: Float[Tensor, "frames dofs"]) -> Motion:
    """Return the motion of a trial with changed coordinates, whose derivatives are theirs without another filter.

    Args:
        change: of the coordinates [m, rad]; columns 3 to 5 turn the base in W.
    """
    q = retract(rows.motion.q.T, change.T).T
    found = smooth_motion(rows.tree, rows.motion.time, q, Smoother(rows.rate, rows.rate))
    return replace(found, smoother=rows.motion.smoother)


@dataclass(frozen=True)
class _Problem:
    """What is asked of the motion of one trial."""

    rows: WrenchTrial
    phi: Float[Tensor, "bodies 10"]
    errors: PlateErrors
    knots: Knots
    penalty: BlockBand
    """Inverse covariance of the coefficients under the errors of markers."""
    trust: Float[Tensor, "6 frames"]
    """Weight of each row, from zero to one; zero where plates do not measure everything."""

    @property
    def sd(self) -> Float[Tensor, "6 1"]:
        """Standard deviation of each row: of the weight, where plates bear less, as in flight."""
        borne = self.rows.wrench[self.rows.used, :3].square().sum(1).mean().sqrt().nan_to_num()
        force = torch.maximum(borne, GRAVITY * self.phi[:, 0].sum())
        return torch.stack([self.errors.gain * force] * 3 + [self.errors.place_m * force] * 3)[:, None]

    def trusting(self, left: Float[Tensor, "6 frames"]) -> "_Problem":
        """Return the problem with the weights of Student's distribution, at most one, force by force and moment by
        moment.

        Args:
            left: what is left of them.
        """
        square = left.unflatten(0, (2, 3)).square().sum(1, keepdim=True)
        trust = ((TAILS + 3.0) / (TAILS + square)).clamp(max=1.0).expand(-1, 3, -1).flatten(0, 1)
        return replace(self, trust=trust * self.rows.used)

    @property
    def independent(self) -> float:
        """Independent errors of plates per frame: the filter lets as many pass."""
        return min(1.0, 2.0 * self.rows.motion.smoother.cutoff_hz / self.rows.rate)

    def at(self, x: Float[Tensor, "coefficients dofs"]) -> "_State":
        """Return where a change of the coordinates leads, to first order in the turn of the base."""
        rows, motion = self.rows, displaced(self.rows.motion, self.knots.course(x))
        scene = make_scene(rows.name, rows.tree, rows.geometry, motion, self.phi)
        total = torch.where(rows.used, rows.wrench.T - scene.needed(), 0.0)
        left = wrench_about(total.T, motion.q[:, :3]).T / self.sd
        return _State(x, motion, scene, left, self.cost(x, left))

    def cost(self, x: Float[Tensor, "coefficients dofs"], left: Float[Tensor, "6 frames"]) -> float:
        """Return what is to be made small: squares of what is left, and of the change."""
        return float(self.independent * (self.trust * left.square()).sum() + (x * self.penalty.times(x)).sum())


@dataclass(frozen=True)
class _State:
    """One set of coefficients, and the motion that it makes."""

    x: Float[Tensor, "coefficients dofs"]
    motion: Motion
    scene: Scene
    left: Float[Tensor, "6 frames"]
    """Wrench about the root's origin that plates have measured beyond what the motion needs, in standard deviations."""
    cost: float


def consistent_motion(
    response: MarkerResponse,
    rows: WrenchTrial,
    phi: Float[Tensor, "bodies 10"],
    errors: PlateErrors = PlateErrors(),
) -> ConsistentMotion:
    """Find the most probable motion of a trial given its markers and plates.

    Args:
        response: markers, along the motion that follows them.
        rows: this motion and what plates have measured; in frames that are not used markers decide alone.
        phi: inertial parameters of the body.
        errors: what plates in good order err by.

    Returns:
        The motion, on the clock and with the filter of the one before.
    """
    smoother = rows.motion.smoother
    every = max(LEAST, round(smoother.rate_hz / (KNOTS_PER_PERIOD * smoother.cutoff_hz)))
    knots = Knots(len(rows.used), every, smoother.rate_hz)
    penalty, even = _penalty(knots, response, smoother), rows.used.to(rows.wrench).expand(6, -1)
    problem = _Problem(rows, phi, errors, knots, penalty, even)
    state = problem.at(torch.zeros(knots.coefficients, rows.motion.q.shape[1]).to(rows.wrench))
    linear, least, settled = _linearised(problem, state.scene), GAINED * state.cost, False
    for _ in range(STEPS):
        right = linear.right(problem, state)
        step = linear.factor.solve(right)
        hoped = float((step * right).sum())
        better = _searched(problem, state, step)
        told, moved = state.cost - better.cost, problem.trusting(better.left)
        off = (moved.trust - problem.trust).square().sum() / (6 * rows.used.sum()).clamp(min=1)
        alike = float(off.sqrt()) < ALIKE
        state = better
        if settled := alike and hoped <= least:
            break
        if not alike or told < PROMISED * hoped:
            problem, state = moved, replace(state, cost=moved.cost(state.x, state.left))
            linear = _linearised(problem, state.scene)
    return ConsistentMotion(state.motion, knots.course(state.x), settled, problem.trust.amin(0), knots, linear.factor)


@dataclass(frozen=True)
class _Linear:
    """The system of the coefficients' steps, linearised at one motion; close to it, it serves others as well."""

    rows: Float[Tensor, "intervals rows columns"]
    """Change of what is left per unit of each coefficient, in standard deviations; six rows a frame of an interval."""
    factor: BandFactor

    def right(self, problem: _Problem, state: _State) -> Float[Tensor, "coefficients dofs"]:
        """Return the right side of the system: minus half the gradient of the cost."""
        left = problem.knots.by_interval((problem.trust.sqrt() * state.left).T).flatten(1)
        told = (self.rows.mT @ left[..., None]).unflatten(1, (TOUCHED, -1))[..., 0]
        return problem.independent * problem.knots.gathered(told) - problem.penalty.times(state.x)


def _linearised(problem: _Problem, scene: Scene) -> _Linear:
    """The system at a motion."""
    rows, knots = torch.stack(_rows(scene)).mul_((problem.trust.sqrt() / problem.sd)[:, None]), problem.knots
    whole = knots.by_interval(rows.permute(3, 0, 1, 2))
    J = torch.einsum("chp,ihckn->ihkpn", knots.basis(rows), whole).flatten(3).flatten(1, 2)
    band = BlockBand(knots, rows.shape[2], rows)
    band.bands.copy_(problem.penalty.bands)
    blocks = (TOUCHED, rows.shape[2])
    band.add((problem.independent * (J.mT @ J)).unflatten(2, blocks).unflatten(1, blocks))
    return _Linear(J, band.factor())


def _searched(problem: _Problem, state: _State, step: Float[Tensor, "coefficients dofs"]) -> _State:
    """Where a step leads, halved as often as it takes to make things better; where it began if nothing does."""
    for k in range(HALVES):
        found = problem.at(state.x + 0.5**k * step)
        if found.cost <= state.cost:
            return found
    return state


def _penalty(knots: Knots, response: MarkerResponse, smoother: Smoother) -> BlockBand:
    """Inverse covariance of the coefficients of a course of postures under the errors of markers."""
    H, basis = posture_precision(response), knots.basis(response.weight)
    weight = error_penalty(response, smoother)
    pairs = torch.einsum("c,chp,chq->pqh", weight, basis, basis).flatten(0, 1)
    parts = (pairs @ knots.by_interval(H.flatten(1))).unflatten(2, H.shape[1:]).unflatten(1, (TOUCHED, TOUCHED))
    band = BlockBand(knots, H.shape[1], H)
    band.add(parts.permute(0, 1, 3, 2, 4))
    return band


def _rows(scene: Scene) -> list[Float[Tensor, "6 dofs frames"]]:
    """Change of the needed wrench about the root's origin per unit of each coordinate, of its rate and of its
    acceleration."""
    U = coordinate_levers(scene)
    rate = rate_of(U, scene.rate)
    A, B, _ = rate_of(rate, scene.rate).split(3)
    at = torch.cat([A, B + rate[6:]])
    at[3] += GRAVITY * U[1]
    at[4] -= GRAVITY * U[0]
    by_rate = torch.cat([2.0 * rate[:3], 2.0 * rate[3:6] + U[6:]])
    return [wrenches_about(one, scene.q[:3]) for one in (at, by_rate, U[:6])]
