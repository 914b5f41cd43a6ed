"""The segment on which a large force of unknown course acts, and where: as its wrench and the moving bodies tell."""

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchid.contact.contact import Contact
from torchid.diagnosis.options import MissingWeightOptions
from torchid.observation.trial import TrialObservation
from torchid.observation.unloaded_plates import LOWEST

REST_M = 0.1
"""Estimator. Prior standard deviation of where a segment is touched, from its centre of mass [m]: half of a thigh's
depth, a choice."""
BLOCK_S = 0.1
"""Resolution. Time after which a filter leaves frames about independent [s]."""
SCALE_NM = 2.0
"""Estimator. Least error of a moment [N m]: what plates of 2 N leave at the height of a hip."""


def centre_of(observed: TrialObservation, segment: str) -> Float[Tensor, "3 frames"]:
    """Return the centre of mass of a segment in W [m]."""
    scene = observed.view.scene
    return scene.point(segment, scene.centre(segment)).p


def raised(at: Float[Tensor, "3 frames"], options: MissingWeightOptions) -> Bool[Tensor, " frames"]:
    """Return whether a point is above the lowest floor that it reaches."""
    return at[2] - at[2].quantile(LOWEST) > options.raised_m


def touched(
    observed: TrialObservation,
    contact: Contact,
    missing: Float[Tensor, "frames 6"],
    inside: Bool[Tensor, " frames"],
    options: MissingWeightOptions,
) -> tuple[dict[str, float], dict[str, tuple[float, float, float]]]:
    """Return posterior probabilities of the segments, and the point at which each is touched, in its axes [m].

    For a wrench F, M at a point p + R d of a segment, M - p x F is linear in d, whatever the force is. A foot that
    rests on something above the floor, or on a plate that does not read it, needs no search.
    """
    scene, step = observed.view.scene, max(1, round(BLOCK_S * observed.rows.rate))
    some = inside.nonzero()[::step, 0]
    raised = [f for k, f in enumerate(contact.feet) if bool(_on_something(observed, contact, k, options)[some].any())]
    names = raised or [n for n in scene.tree.names if n not in contact.feet]
    pairs = [_levers(observed, name, missing[some], some) for name in names]
    scale = max(SCALE_NM, min(_spread(*pair) for pair in pairs))
    fits = [_rest(left / scale, A / scale) for left, A in pairs]
    odds = torch.softmax(torch.tensor([log for _, log in fits], dtype=torch.float64), 0).tolist()
    points = [tuple((scene.centre(n) + d).tolist()) for n, (d, _) in zip(names, fits, strict=True)]
    return dict(zip(names, odds, strict=True)), dict(zip(names, points, strict=True))


def _on_something(
    observed: TrialObservation, contact: Contact, foot: int, options: MissingWeightOptions
) -> Bool[Tensor, " frames"]:
    """Return frames in which a foot touches something that is no floor, or a plate that does not read it."""
    high = raised(centre_of(observed, contact.feet[foot]), options)
    return (contact.touching[:, foot] & high) | contact.unread[:, foot]


def _levers(
    observed: TrialObservation, segment: str, wrench: Float[Tensor, "some 6"], some: Tensor
) -> tuple[Float[Tensor, " rows"], Float[Tensor, "rows 3"]]:
    """Return the moment about a segment's centre [N m], and its change per place in the segment's axes [N]."""
    scene, force = observed.view.scene, wrench[:, :3]
    left = wrench[:, 3:] - torch.linalg.cross(centre_of(observed, segment)[:, some].T, force)
    axes = scene.state.at.R[scene.at(segment)][..., some].permute(2, 0, 1)
    A = torch.linalg.cross(axes, force[:, None].expand_as(axes), dim=2).mT
    return left.flatten(), A.flatten(0, 1)


def _spread(left: Float[Tensor, " rows"], A: Float[Tensor, "rows 3"]) -> float:
    """Return the RMS of what the best place leaves [N m]."""
    d = torch.linalg.lstsq(A, left[:, None]).solution
    return float((left[:, None] - A @ d).square().mean().sqrt())


def _rest(left: Float[Tensor, " rows"], A: Float[Tensor, "rows 3"]) -> tuple[Float[Tensor, " 3"], float]:
    """Return the place from the centre of mass [m], and the log evidence of rows of unit variance up to what segments
    share."""
    L = torch.linalg.cholesky(A.T @ A + torch.eye(3).to(A) / REST_M**2)
    u = torch.linalg.solve_triangular(L, (A.T @ left)[:, None], upper=False)
    d = torch.linalg.solve_triangular(L.T, u, upper=True)[:, 0]
    return d, float(0.5 * (u.square().sum() - left.square().sum()) - L.diagonal().log().sum())
