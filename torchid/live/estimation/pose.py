"""The posture of every frame as it comes, found from the one before it."""

import math
from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchid.geometry.arrow.inverse_kinematics import prepare, solve_poses
from torchid.geometry.posture.initial_posture import hold
from torchid.geometry.problem import MarkerProblem
from torchid.geometry.result import GeometryFit
from torchid.geometry.trial_problem import posture_prior, settled, trial_problem
from torchid.kinematics.recursion import lengths, points, poses
from torchid.recording import Markers

TOLERANCE = 1e-2
"""Choice. Relative fall of the cost at which a posture is found: what is left then is a twentieth of this, which moves
a coordinate by three hundredths of its standard deviation."""
STEPS = 6
"""Choice. Most steps of a frame from the posture before it: on recordings three are enough from frame to frame."""
MENDING_TOLERANCE, MENDING_STEPS = 1e-4, 40
"""Choice. The same where many frames are solved at once, and nobody waits: as for a recording but for what masses do
not show."""
ASTRAY_SD, ASTRAY_M = 6.0, 0.05
"""Choice. Distance from the model beyond which a marker is no witness of the posture: in the scatter of its fit, and at
least as far as skin slides where a standing trial alone has told the geometry."""
SPARED = 1
"""Choice. Markers of a body that may be astray in a frame whose posture counts: one is outvoted by the others, two that
are exchanged turn the body."""
FEWEST = 6
"""Choice. Markers that must be seen for a posture to be known at all."""
AHEAD_S = 0.1
"""Choice. How far a posture is thought on at the rate of the last two: it takes a step less from there."""
STALE_S = 0.5
"""Choice. After so long without a posture the next is looked for from rest, and again after as long."""


@dataclass(frozen=True)
class Postures:
    """Postures of some frames."""

    q: Float[Tensor, "frames dofs"]
    """Coordinates [m or rad]; the last ones known where nothing is."""
    error: Float[Tensor, "frames markers"]
    """Distance between measured and modelled marker, NaN where missing and where a frame is not known [m]."""

    @property
    def known(self) -> Bool[Tensor, " frames"]:
        """Return whether the markers of a frame agree with its posture."""
        return torch.isfinite(self.error).any(1)


def too_far(fit: GeometryFit) -> Float[Tensor, " markers"]:
    """Return the distance from the model beyond which each marker is astray [m].

    Args:
        fit: with the scatter of its markers.
    """
    return (ASTRAY_SD * fit.sigma).clamp(min=ASTRAY_M)


class PostureFollower:
    """Inverse kinematics of a stream at fixed geometry, all frames that came together in one batch."""

    def __init__(self, fit: GeometryFit, labels: tuple[str, ...]) -> None:
        """Prepare what all frames share.

        Args:
            fit: geometry, places of the markers and their scatter.
        """
        nothing = Markers(labels, torch.zeros(1), fit.xi.new_full((1, len(labels), 3), torch.nan))
        self._fit, self._problem = fit, trial_problem(fit, nothing, posture_prior(fit))
        self._prepared = prepare(self._problem, fit.xi)
        place = {label: k for k, label in enumerate(labels)}
        self._column = torch.tensor([place.get(label, len(labels)) for label in fit.attachment.labels])
        self._near = fit.xi.new_tensor([dof.rest for dof in fit.model.tree.dofs])
        self._rate = torch.zeros_like(self._near)
        self._held_s, self._sought_s = -math.inf, -math.inf

    def refined(self, fit: GeometryFit, labels: tuple[str, ...]) -> "PostureFollower":
        """Return a follower of the same stream by another geometry, from where this one is.

        Args:
            fit: geometry, places of the markers and their scatter.
        """
        other = PostureFollower(fit, labels)
        other._near, other._rate = self._near, self._rate
        other._held_s, other._sought_s = self._held_s, self._sought_s
        return other

    @torch.inference_mode()  # a fifth of the time of a single frame
    def __call__(self, markers: Markers) -> Postures:
        """Follow some frames.

        Args:
            markers: of the stream, rising in time.
        """
        problem, seen = self._of(markers)
        time = float(markers.time[-1])
        q, cost = solve_poses(problem, self._expected(markers.time), self._fit.xi, STEPS, TOLERANCE, self._prepared)
        if STALE_S < float(markers.time[0]) - self._held_s < math.inf:  # a limb may be elsewhere, and look as good
            other = settled(self._fit, problem)
            q = torch.where(problem.frame_cost(other, self._fit.xi) < cost, other, q)
        error, known = self._judged(problem, q)
        lost = math.isinf(self._held_s) or not bool(known.any())
        if lost and time - max(self._held_s, self._sought_s) > STALE_S and bool((seen.sum(0) >= FEWEST).any()):
            self._sought_s = time
            q = settled(self._fit, problem)
            error, known = self._judged(problem, q)
        if bool(known.any()) and not bool(known.all()):
            q = solve_poses(problem, hold(q, known), self._fit.xi, STEPS, TOLERANCE, self._prepared)[0]
            error, known = self._judged(problem, q)
        if bool(known.any()):
            self._keep(q[:, known], markers.time[known])
        q = torch.where(known, q, self._near[:, None])
        return Postures(q.T, torch.where(known, error, torch.nan).T)

    @torch.inference_mode()
    def mended(self, markers: Markers, q: Float[Tensor, "frames dofs"]) -> Postures:
        """Find postures once more, as a run does: by least squares, then by the robust loss, each to its end.

        From frame to frame a robust loss keeps to the markers that it has given up, and is never quite there.

        Args:
            q: postures that are nearly right.
        """
        problem, found = self._of(markers)[0], q.T.contiguous()
        for loss in (None, problem.robust):
            some = replace(problem, robust=loss)
            found = solve_poses(some, found, self._fit.xi, MENDING_STEPS, MENDING_TOLERANCE, self._prepared)[0]
        error, known = self._judged(problem, found)
        return Postures(torch.where(known, found, q.T).T, torch.where(known, error, torch.nan).T)

    def _expected(self, time: Float[Tensor, " frames"]) -> Float[Tensor, "dofs frames"]:
        """Postures from the last one on, at its rate for as long as that is worth something."""
        follows = float(time[0]) - self._held_s < AHEAD_S  # nobody knows where a pause has led
        ahead = (time - self._held_s).clamp(max=AHEAD_S) if follows else torch.zeros_like(time)
        return torch.addcmul(self._near[:, None], self._rate[:, None], ahead)

    def _keep(self, q: Float[Tensor, "dofs known"], time: Float[Tensor, " known"]) -> None:
        """Remember the newest posture, and the rate from the one before it."""
        before, then_s = (q[:, -2], float(time[-2])) if len(time) > 1 else (self._near, self._held_s)
        elapsed, self._near, self._held_s = float(time[-1]) - then_s, q[:, -1], float(time[-1])
        near = 0.0 < elapsed < AHEAD_S
        self._rate = (self._near - before) / elapsed if near else torch.zeros_like(self._near)

    def _of(self, markers: Markers) -> tuple[MarkerProblem, Bool[Tensor, "markers frames"]]:
        """The problem with measured places of the fit's markers, zero where missing, and where they are seen."""
        lacking = markers.position.new_full((len(markers.time), 1, 3), torch.nan)
        position = torch.cat([markers.position, lacking], 1)[:, self._column].permute(1, 2, 0).to(self._fit.xi)
        seen = torch.isfinite(position).all(1)
        weight = (seen / self._fit.sigma.square()[:, None]).contiguous()
        target = torch.where(seen[:, None], position, 0.0).contiguous()
        return replace(self._problem, target=target, weight=weight), seen

    def _judged(
        self, problem: MarkerProblem, q: Float[Tensor, "dofs frames"]
    ) -> tuple[Float[Tensor, "markers frames"], Bool[Tensor, " frames"]]:
        """Distances of the markers, and which frames are known: no body has two markers that contradict its place."""
        seen, shape = problem.weight > 0, self._prepared.shape
        placed = points(poses(problem.plan, q, shape.joints), problem.body, shape.place)
        error = lengths(placed - problem.target)
        astray = seen & (error > too_far(self._fit)[:, None])
        spoilt = error.new_zeros(len(problem.plan.order), error.shape[1]).index_add_(0, problem.body, astray.to(error))
        known = (spoilt.max(0).values <= SPARED) & (seen.sum(0) >= FEWEST)
        return torch.where(seen, error, torch.nan), known
