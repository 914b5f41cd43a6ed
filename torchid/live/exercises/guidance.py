"""What every exercise is expected to tell of a subject, and how much of it is not yet known.

A motion that an exercise may turn out to be goes through the rows of a run. Of whitened rows Y the information is the
sum of Y' Y, so that after T more seconds of an exercise of I_e per second the covariance C becomes
(C^-1 + T I_e)^-1: nobody has to see the forces for that. Exciting motions have been sought so off-line (Bonnet et al.,
IEEE Transactions on Robotics 32(5), 2016); here they are chosen from a library while the parameters come.
"""

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchid.dynamics.rows import WrenchTrial
from torchid.dynamics.whitening import BlockSpectrum, Whitening, accumulate, block_spectrum
from torchid.errors import ConfigError
from torchid.filters import FilterKind, Smoother
from torchid.geometry.result import GeometryFit
from torchid.inertia.linear import total_mass_row
from torchid.inertia.posterior import body_blocks
from torchid.inertia.spectrum import cholesky
from torchid.live.exercises.exercises import RATE_HZ, Exercise, Possibilities, allowed, extremes, perform, stand_in
from torchid.model.model import Geometry, InertialPrior
from torchid.model.tree import Tree
from torchid.motion import Motion, smooth_motion
from torchid.simulate.subject import SimulatedSubject

log = logging.getLogger(__name__)
SEEDS = 2
"""Choice. Motions of an exercise over which its information is averaged."""
GOAL = 0.9
"""Choice. Share of its prior variance that must be gone before something counts as known."""
SESSION_S = 600.0
"""Choice. A parameter is determined if so long a session of all exercises alike would make it known: nobody is asked to
move for longer, and every segment then has one."""


@dataclass(frozen=True)
class Rehearsal:
    """An exercise as this subject is likely to do it."""

    exercise: Exercise
    postures: Float[Tensor, "postures dofs"]
    """What it looks like, for a drawing."""
    blocks: tuple[BlockSpectrum, ...]
    """Rows of a second each; their right-hand sides are zero."""

    def information(self, whitening: Whitening, rate_hz: float) -> Float[Tensor, "params params"]:
        """Return the information that a second of it is expected to bring.

        Args:
            whitening: noise of a cosine coefficient of the stream.
            rate_hz: frames per second of the stream, with the root of which its coefficients grow.
        """
        return accumulate(self.blocks, whitening).gram * (rate_hz / RATE_HZ / len(self.blocks))


@dataclass(frozen=True)
class Knowledge:
    """What is known, in axes in which every body's own ten parameters are white before any row."""

    unit: Float[Tensor, "params params"]
    """Parameters of these axes: one block for each body."""
    before: Float[Tensor, "params params"]
    """Precision before any row."""
    precision: Float[Tensor, "params params"]
    """Precision now."""

    @staticmethod
    def begin(prior: InertialPrior, mass: tuple[float, float] | None, omega_2: float = 1.0) -> "Knowledge":
        """Return what is known before any row.

        Args:
            mass: total mass and its standard deviation [kg].
            omega_2: factor on the prior's precision, as the fit has chosen it.
        """
        precision = omega_2 * torch.cholesky_inverse(cholesky(prior.covariance))
        if mass is not None:
            row = total_mass_row(len(prior.mean), prior.mean) / mass[1]
            precision = precision + torch.outer(row, row)
        own = body_blocks(torch.cholesky_inverse(torch.linalg.cholesky(precision)))
        unit = torch.block_diag(*torch.linalg.cholesky(own))
        before = unit.mT @ precision @ unit
        return Knowledge(unit, before, before)

    def after(self, information: Float[Tensor, "params params"]) -> "Knowledge":
        """Return what is known with more rows.

        Args:
            information: sum of the products of the whitened rows.
        """
        return replace(self, precision=self.precision + self.unit.mT @ information @ self.unit)

    def left(self, axes: Float[Tensor, "params some"] | None = None) -> Float[Tensor, " some"]:
        """Return the variance that is left along some axes of unit length, by default along all.

        Args:
            axes: in the columns.
        """
        axes = torch.eye(len(self.precision), dtype=self.precision.dtype) if axes is None else axes
        factor = torch.linalg.cholesky(self.precision)
        return torch.linalg.solve_triangular(factor, axes, upper=False).square().sum(0)

    @property
    def progress(self) -> Float[Tensor, " bodies"]:
        """Return the share of each body's uncertainty that the rows removed, as ``posterior.Progress.segment``."""
        return 1.0 - self.left().reshape(-1, 10).mean(1)

    @property
    def nats(self) -> float:
        """Return the information that all rows have brought [nat]."""
        return 0.5 * float(torch.logdet(self.precision) - torch.logdet(self.before))


@dataclass(frozen=True)
class Outlook:
    """What a library promises under a noise."""

    information: Float[Tensor, "exercises params params"]
    """Expected of a second of each exercise."""
    axes: Float[Tensor, "params determined"]
    """What can be determined, in the axes of ``Knowledge``."""
    body: Int[Tensor, " determined"]
    """Whose parameters these are."""

    def share(self, known: Knowledge) -> Float[Tensor, " bodies"]:
        """Return how much of each body's determined parameters is known, one where it has none.

        Args:
            known: from the same prior.
        """
        count = torch.bincount(self.body, minlength=len(known.unit) // 10)
        left = known.left(self.axes)
        total = left.new_zeros(len(count)).index_add_(0, self.body, left)
        return 1.0 - total / count.clamp(min=1)


@dataclass(frozen=True)
class Guide:
    """A library as a subject is likely to do it."""

    names: tuple[str, ...]
    """Of the bodies."""
    prior: InertialPrior
    mass: tuple[float, float] | None
    """Total mass and its standard deviation [kg]."""
    rehearsals: tuple[Rehearsal, ...]
    notes: tuple[str, ...] = ()
    """Exercises of the library that are not asked for, or without a part, and why."""

    def information(self, whitening: Whitening, rate_hz: float) -> Float[Tensor, "exercises params params"]:
        """Return what a second of each exercise is expected to bring under the present noise."""
        return torch.stack([one.information(whitening, rate_hz) for one in self.rehearsals])

    def outlook(self, information: Float[Tensor, "exercises params params"], omega_2: float = 1.0) -> Outlook:
        """Return what can be determined by these exercises.

        Args:
            information: of a second of each.
            omega_2: factor on the prior's precision.
        """
        session = Knowledge.begin(self.prior, self.mass, omega_2).after(SESSION_S * information.mean(0))
        covariance = torch.cholesky_inverse(torch.linalg.cholesky(session.precision))
        variance, axes = torch.linalg.eigh(body_blocks(covariance))
        kept = variance < 1.0 - GOAL
        body = kept.nonzero()[:, 0]
        return Outlook(information, torch.block_diag(*axes)[:, kept.flatten()], body)


def make_guide(
    fit: GeometryFit, prior: InertialPrior, mass: tuple[float, float] | None, sex: str, cutoff_hz: float,
    possibilities: Possibilities, kind: FilterKind = "spline",
) -> Guide:  # fmt: skip
    """Rehearse all exercises that a subject can do; takes seconds.

    Args:
        mass: total mass and its standard deviation [kg].

    Raises:
        ConfigError: as ``stand_in`` and ``rehearse``.
    """
    smoother = Smoother(min(cutoff_hz, 0.4 * RATE_HZ), RATE_HZ, kind)
    return rehearse(stand_in(fit, prior.mean, sex), prior, mass, smoother, possibilities)


def rehearse(
    who: SimulatedSubject, prior: InertialPrior, mass: tuple[float, float] | None, smoother: Smoother,
    possibilities: Possibilities,
) -> Guide:  # fmt: skip
    """Let somebody who stands in for the subject do all exercises; arguments are as for ``make_guide``.

    Args:
        who: of the identified geometry.
        mass: total mass and its standard deviation [kg].
        smoother: at ``RATE_HZ``.

    Raises:
        ConfigError: ``guidance.none``, no exercise is possible for the subject.
    """
    found, notes = [], []
    for exercise in allowed(possibilities):
        lacking = exercise.lacking(who.model.tree)
        notes += [_without(exercise, lacking)] if lacking else []
        if lacking and lacking == exercise.joints:
            continue
        drawn = [perform(exercise, who, possibilities, seed) for seed in range(SEEDS)]
        motions = [motion for motion in drawn if motion is not None]
        if motions:
            blocks = [block for one in motions for block in rows_of(who.model.tree, who.geometry, one, smoother)]
            found.append(Rehearsal(exercise, extremes(motions[0]), tuple(blocks)))
        else:
            notes.append(f"{exercise.name} is not asked for: no way was found in which this body does it")
    for note in notes:
        log.warning("advice: %s", note)
    if not found:
        raise ConfigError(
            "guidance.none", "no exercise of the library is possible for this subject", place="guidance",
            found=str(possibilities), remedy="Go on without advice",
        )  # fmt: skip
    return Guide(who.model.tree.names, prior, mass, tuple(found), tuple(notes))


def _without(exercise: Exercise, lacking: Sequence[str]) -> str:
    less = "is not asked for" if tuple(lacking) == exercise.joints else "is rehearsed without a part"
    return f"{exercise.name} {less}: no marker tells how {' and '.join(lacking)} move"


def rows_of(
    tree: Tree, geometry: Geometry, motion: Motion, smoother: Smoother, wrench: Float[Tensor, "frames 6"] | None = None
) -> Sequence[BlockSpectrum]:
    """Return the rows of a motion as a stream's, in blocks of a second.

    Args:
        motion: at the rate of the filter.
        smoother: the filter.
        wrench: measured, about the origin of W; zeros where it does not matter.
    """
    smooth, count = smooth_motion(tree, motion.time, motion.q, smoother), len(motion.q)
    total = motion.q.new_zeros(count, 6) if wrench is None else smoother(wrench)
    used, step = torch.ones(count, dtype=torch.bool), round(smoother.rate_hz)
    rows = WrenchTrial("", tree, geometry, smooth, total, used)
    return [block_spectrum(rows, slice(k, k + step)) for k in range(0, count - step + 1, step)]
