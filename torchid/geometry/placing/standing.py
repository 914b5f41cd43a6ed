"""This module tells which landmarks a standing person's markers are on, by their places alone.

The template stands among the markers in several headings and postures of the arms, whole or without parts of the body
that nobody has put markers on. Markers and landmarks are matched one to one, softly at first: places that fit both ways
pull the template towards them, with a scatter that falls step by step. An unmatched marker has its price, and so has an
unmatched landmark of a part that is there.

Reference: Gold, Rangarajan, Lu, Pappu, Mjolsness, Pattern Recognition 31:1019 (1998): softassign and annealing.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from torchid.geometry.arrow.inverse_kinematics import solve_poses
from torchid.geometry.placing.matching import (
    LONE_LANDMARK,
    LONE_MARKER,
    NEVER,
    allowed,
    bodies,
    matched,
    places,
    variance,
)
from torchid.geometry.problem import MarkerProblem, PosturePrior
from torchid.geometry.trial_problem import LIMITLESS
from torchid.kinematics.plan import Plan, plan_tree
from torchid.kinematics.recursion import points, poses
from torchid.model.marker_set import MarkerSpec
from torchid.model.model import Model
from torchid.model.tree import BASE_DOFS

SCHEDULES = (
    (0.12, 0.10, 0.08, 0.065, 0.05, 0.04, 0.03, 0.025, 0.02),
    (0.08, 0.07, 0.06, 0.05, 0.04, 0.03, 0.025, 0.02),
)
"""Scatters of markers about the landmarks of the template, beside the landmarks' own, step by step [m]; chosen. A wide
beginning finds arms that are held apart, a narrow one is not drawn to clusters of markers; the better match counts."""
HEADINGS = 8
"""Headings that the template starts in, evenly about the circle; chosen."""
ARMS = ((0.0, 0.1, 0.1), (0.0, 1.4, 0.0), (0.0, 0.7, 0.3), (0.8, 0.2, 1.4), (0.3, 0.2, 0.6))
"""Shoulder flexion, shoulder abduction and elbow flexion that it starts in [rad]; chosen."""
WITHOUT = ((), ("head",), ("head", "upper_arm_l", "upper_arm_r"), ("abdomen",))
"""Parts of the body, each with all beyond it, that a laboratory leaves without markers; chosen."""
ARMLESS = 2
"""Wording. Index of the first of them that has no arms: their postures do not matter."""
TILT_SD, HEIGHT_SD = 0.15, 0.06
"""Scatter of a standing pelvis's tilt [rad] and height [m]; chosen."""
STIFF, STIFFNESS = ("spine", "neck", "wrist"), 4.0
"""Joints that hardly bend in one who stands, and how much less they scatter in variance; chosen."""
LIMIT_SD = 0.03
"""Softness of joint limits [rad]; chosen."""
SWEEPS, POSE_STEPS, ROUNDS = 8, 5, 2
"""Resolution. Normalisations of a match but the last; steps of poses between matches; rounds at a scatter."""
FOLLOWED = 0.25
"""Resolution. Share of the hypotheses that are followed beyond the middle of a schedule: the best."""
OTHERWISE = 1.0
"""Headings that differ by more than this are other hypotheses [rad]; chosen."""
MOST_HYPOTHESES = 3
"""Hypotheses that are returned; chosen."""


@dataclass(frozen=True)
class Standing:
    """One way in which a person may stand among markers."""

    match: Float[Tensor, "markers landmarks"]
    """Probability that a marker is on a landmark."""
    score: float
    """Log odds against a match of nothing."""
    heading: float
    """Heading of the pelvis, about the vertical [rad]."""
    absent: frozenset[str]
    """Segments without markers."""


@dataclass(frozen=True)
class _Starts:
    """Hypotheses side by side."""

    q: Float[Tensor, "dofs starts"]
    frame: Int[Tensor, " starts"]
    """The frame that each stands in."""
    without: Int[Tensor, " starts"]
    """Index among ``WITHOUT``."""


def stand(
    model: Model,
    position: Float[Tensor, "frames markers 3"],
    known: Mapping[int, MarkerSpec] = {},
    schedules: Sequence[Sequence[float]] = SCHEDULES,
) -> tuple[Standing, ...]:
    """Return the likeliest ways in which a person stands among markers, the best first.

    Args:
        model: template with landmarks.
        position: of the markers in a frame of standing, or in several of motion of which one is nearly so; NaN where
            missing [m].
        known: segments of some markers, and landmarks where they are known, by the markers' indices.
        schedules: scatters, step by step; the best match of all is taken.
    """
    starts = _starts(model, position)
    there = _there(model, starts)
    may = allowed(model, position.shape[1], known)[:, :, None] & there[None]
    target = position[starts.frame].permute(1, 2, 0)
    body = torch.tensor(plan_tree(model.tree).position)[bodies(model)]
    prior = _prior(model, _ground(model, position))
    fit = _Fit(model, plan_tree(model.tree), body, target, may, prior)
    every = [fit.annealed(starts.q, schedule) for schedule in schedules]
    kept, q, match, score = (torch.cat(parts, dim=-1) for parts in zip(*every, strict=True))
    return tuple(_distinct(model, starts.without[kept], q, match, score))


@dataclass(frozen=True)
class _Fit:
    """Markers of all hypotheses and the template that is matched with them."""

    model: Model
    plan: Plan
    body: Int[Tensor, " landmarks"]
    target: Float[Tensor, "markers 3 starts"]
    allowed: Bool[Tensor, "markers landmarks starts"]
    prior: PosturePrior

    def annealed(
        self, q: Float[Tensor, "dofs starts"], schedule: Sequence[float]
    ) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Indices of the hypotheses that were followed to the end, their coordinates, matches and log odds."""
        fit, kept = self, torch.arange(q.shape[1])
        for step, scatter in enumerate(schedule):
            for _ in range(ROUNDS):
                q = fit.posed(q, matched(fit.odds(q, scatter), SWEEPS), scatter)
            if step == len(schedule) // 2:
                kept = fit.judged(q, scatter)[1].topk(math.ceil(FOLLOWED * q.shape[1])).indices
                fit, q = fit.some(kept), q[:, kept]
        return kept, q, *fit.judged(q, schedule[-1])

    def judged(self, q: Float[Tensor, "dofs starts"], scatter: float) -> tuple[Tensor, Float[Tensor, " starts"]]:
        """Matches, and their log odds against a match of nothing."""
        odds = self.odds(q, scatter)
        match = matched(odds)
        gain = (match * (odds - LONE_MARKER - LONE_LANDMARK).clamp(min=-1e3)).sum((0, 1))
        return match, gain - self.prior.cost(q).sum(0) + LONE_LANDMARK * self.allowed.any(0).sum(0)

    def some(self, index: Int[Tensor, " starts"]) -> "_Fit":
        """Return some of the hypotheses."""
        return replace(self, target=self.target[:, :, index], allowed=self.allowed[:, :, index])

    def odds(self, q: Float[Tensor, "dofs starts"], scatter: float) -> Float[Tensor, "markers landmarks starts"]:
        """Log odds of every pair by its distance."""
        xi = self.model.geometry.mean
        p = points(poses(self.plan, q, self.model.geometry.geometry(xi)), self.body, places(self.model))
        square = (self.target[:, None] - p[None]).square().sum(2)
        return torch.where(
            self.allowed & square.isfinite(), -0.5 * square / variance(self.model, scatter)[None, :, None], NEVER
        )

    def posed(self, q: Float[Tensor, "dofs starts"], match: Tensor, scatter: float) -> Float[Tensor, "dofs starts"]:
        """Coordinates after some steps towards the matched markers."""
        share = match.sum(0)
        target = torch.einsum("msh,mxh->sxh", match, self.target.nan_to_num()) / share.clamp(min=1e-9)[:, None]
        weight = share / variance(self.model, scatter)[:, None]
        place, none = places(self.model), torch.arange(0)  # places on the bodies are known
        problem = MarkerProblem(
            self.plan, self.model.geometry, self.body, target, weight, place, torch.ones_like(place), none, self.prior
        )
        return solve_poses(problem, q, self.model.geometry.mean, iterations=POSE_STEPS)[0]


def _starts(model: Model, position: Float[Tensor, "frames markers 3"]) -> _Starts:
    """Every frame, heading, posture of the arms and part of the body left out."""
    names = model.tree.dof_names
    rest = torch.tensor([dof.rest for dof in model.tree.dofs], dtype=torch.float64)
    middle, floor = position.nanmedian(dim=1).values, _ground(model, position)
    found: list[tuple[Tensor, int, int]] = []
    for without, parts in enumerate(WITHOUT):
        if not set(parts) <= set(model.tree.names):
            continue
        for frame in range(len(position)):
            for k in range(HEADINGS):
                for arms in ARMS if without < ARMLESS else ARMS[:1]:
                    q = rest.clone()
                    q[:2], q[2] = middle[frame, :2], rest[2] + floor
                    q[5] = math.remainder(2.0 * math.pi * k / HEADINGS, 2.0 * math.pi)
                    _raise_arms(q, names, arms)
                    found.append((q, frame, without))
    q, frame, without = zip(*found, strict=True)
    return _Starts(torch.stack(q, dim=1), torch.tensor(frame), torch.tensor(without))


def _ground(model: Model, position: Float[Tensor, "frames markers 3"]) -> float:
    """Return how much higher the root stands than at rest, so that the lowest marker is on the lowest landmark [m]."""
    rest = torch.tensor([[dof.rest] for dof in model.tree.dofs], dtype=torch.float64)
    geometry, plan = model.geometry.geometry(model.geometry.mean), plan_tree(model.tree)
    body = torch.tensor(plan.position)[bodies(model)]
    lowest = points(poses(plan, rest, geometry), body, places(model))[:, 2].min()
    return float(position[..., 2].nan_to_num(math.inf).min() - lowest)


def _raise_arms(q: Float[Tensor, " dofs"], names: Sequence[str], arms: tuple[float, float, float]) -> None:
    """Put the arms into a posture, where the model has these joints."""
    flexion, abduction, elbow = arms
    for side in "lr":
        angles = {"shoulder_{}_flexion": flexion, "shoulder_{}_adduction": -abduction, "elbow_{}_flexion": elbow}
        for name, angle in angles.items():
            if name.format(side) in names:
                q[names.index(name.format(side))] = angle


def _absent(model: Model, without: int) -> frozenset[str]:
    """Segments of the parts that are left out."""
    tree = model.tree
    return frozenset(tree.names[k] for part in WITHOUT[without] for k in tree.subtree(tree.index(part)))


def _there(model: Model, starts: _Starts) -> Bool[Tensor, "landmarks starts"]:
    """Return whether a landmark's part of the body bears markers, for every hypothesis."""
    missing = [_absent(model, k) if set(parts) <= set(model.tree.names) else () for k, parts in enumerate(WITHOUT)]
    kinds = torch.tensor([[one.segment not in gone for gone in missing] for one in model.landmarks.values()])
    return kinds[:, starts.without]


def _prior(model: Model, floor: float) -> PosturePrior:
    """Postures of one who stands, about rest; the pelvis anywhere, in any heading."""
    dofs = model.tree.dofs
    precision = torch.tensor([dof.sd**-2 for dof in dofs], dtype=torch.float64)
    precision[[any(word in dof.name for word in STIFF) for dof in dofs]] *= STIFFNESS
    precision[:BASE_DOFS] = torch.tensor([0.0, 0.0, HEIGHT_SD**-2, TILT_SD**-2, TILT_SD**-2, 0.0])
    mean = torch.tensor([dof.rest for dof in dofs], dtype=torch.float64)
    mean[2] += floor
    lower, upper = (
        torch.tensor([getattr(dof, end) for dof in dofs], dtype=torch.float64).clamp(-LIMITLESS, LIMITLESS)[:, None]
        for end in ("lower", "upper")
    )
    return PosturePrior(mean[:, None], precision[:, None], lower, upper, LIMIT_SD**-2)


def _distinct(
    model: Model, without: Int[Tensor, " starts"], q: Tensor, match: Tensor, score: Float[Tensor, " starts"]
) -> list[Standing]:
    """Return the best hypotheses of different headings."""
    found: list[Standing] = []
    for k in score.argsort(descending=True).tolist():
        heading = float(q[5, k])
        if all(abs(math.remainder(heading - one.heading, 2.0 * math.pi)) > OTHERWISE for one in found):
            absent = _absent(model, int(without[k]))
            found.append(Standing(match[:, :, k], float(score[k]), heading, absent))
        if len(found) == MOST_HYPOTHESES:
            break
    return found
