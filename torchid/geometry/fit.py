"""The geometric fit of a subject: static trial first, then all fit trials jointly; and tracking at fixed geometry."""

import logging
from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchid.errors import DataError, Note
from torchid.geometry.arrow import Progress, Solution, solve_arrow
from torchid.geometry.attachment import Attachment
from torchid.geometry.bridge import bridge_gaps
from torchid.geometry.gradient import solve_adam, solve_lbfgs
from torchid.geometry.options import GeometryOptions
from torchid.geometry.problem import MarkerProblem, PosturePrior
from torchid.geometry.start import initial_posture, settle
from torchid.geometry.uncertainty import Uncertainty, estimate_uncertainty, independent_share
from torchid.kinematics.plan import plan_tree
from torchid.model.geometry_prior import group, tie_sides
from torchid.model.model import Geometry, GeometryPrior, Model
from torchid.recording import Markers

log = logging.getLogger(__name__)
LANDMARK_SIGMA = 0.02
"""Scatter of landmark markers about the template's places while only these are followed [m]."""
LIMITLESS = 1e6
COARSE = 1e-4
"""Tolerance of the fits whose residuals only set weights."""
LOOSE = {"thigh": 2.0, "shank": 2.0, "foot": 2.0, "upper": 2.0, "forearm": 2.0, "hand": 2.0}
"""Skin over the limbs' muscles slides about twice as far as over the bony points of pelvis and thorax (Leardini et al.,
Gait & Posture 21, 2005; Peters et al., Gait & Posture 31, 2010); a foot also bends where the model is rigid."""
CHI2_MEDIAN = 2.366
"""Median of the squared length of a vector of three standard normals."""


@dataclass(frozen=True)
class GeometryFit:
    """A subject's geometry and everything needed to track their markers."""

    model: Model
    attachment: Attachment
    prior: GeometryPrior
    """Of the parameters that were free (ties and groups applied)."""
    xi: Float[Tensor, " xi"]
    """Named parameters, then marker places."""
    sigma: Float[Tensor, " markers"]
    """Residual scatter per coordinate [m]."""
    options: GeometryOptions
    uncertainty: Uncertainty | None = None
    solution: Solution | None = None
    notes: tuple[Note, ...] = ()

    @property
    def geometry(self) -> Geometry:
        """Offsets and hinge angles."""
        return self.prior.geometry(self.xi[: len(self.prior.mean)])

    @property
    def place(self) -> Float[Tensor, "markers 3"]:
        """p_BM_B of all markers [m]."""
        return self.xi[len(self.prior.mean) :].reshape(-1, 3)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all entries of xi."""
        return self.prior.names + tuple(f"{label}_{axis}" for label in self.attachment.labels for axis in "xyz")


@dataclass(frozen=True)
class Tracked:
    """Markers followed by the model at fixed geometry."""

    time: Float[Tensor, " frames"]
    q: Float[Tensor, "frames dofs"]
    error: Float[Tensor, "frames markers"]
    """Distance between measured and modelled marker, NaN where missing [m]."""
    p_WM: Float[Tensor, "frames markers 3"]
    """Modelled markers [m]."""
    observable: Bool[Tensor, " frames"]
    """The markers of the frame determine every coordinate."""

    @property
    def rmse(self) -> float:
        """Root mean square of the distances [m]."""
        return float(self.error[torch.isfinite(self.error)].square().mean().sqrt())


def parameters(model: Model, options: GeometryOptions) -> GeometryPrior:
    """Free geometric parameters under the ties and groups of the options."""
    prior = tie_sides(model.geometry) if options.symmetry == "tied" else model.geometry
    for name, members in options.groups.items():
        prior = group(prior, tuple(members), name)
    return prior


def fixed(prior: GeometryPrior) -> GeometryPrior:
    """The same geometry with nothing free, at its mean."""
    constant = prior.constant + prior.map @ prior.mean
    none = prior.mean[:0]
    return GeometryPrior((), (), none, none, prior.map[:, :0], constant, prior.n_hinges)


def fit_geometry(
    model: Model,
    attachment: Attachment,
    trials: dict[str, Markers],
    static: Markers | None,
    options: GeometryOptions = GeometryOptions(),
    free: bool = True,
    progress: Progress | None = None,
) -> GeometryFit:
    """Identify geometry and marker places.

    Args:
        model: template, bodies without markers locked.
        attachment: markers on its bodies.
        trials: fit trials by name.
        static: standing trial in (about) the neutral pose, None if there is none.
        options: see ``GeometryOptions``.
        free: False keeps the template's geometry and finds only where the markers sit (the scaled template).

    Raises:
        DataError: the static trial shows none of the markers.
    """
    fit = start_fit(model, attachment, trials, static, options, free)
    if not free and static is not None:
        return fit
    return _jointly(fit, trials, static, progress)


def start_fit(
    model: Model,
    attachment: Attachment,
    trials: dict[str, Markers],
    static: Markers | None,
    options: GeometryOptions = GeometryOptions(),
    free: bool = True,
) -> GeometryFit:
    """Scale and place the markers once, before any joint fit; arguments and errors as for ``fit_geometry``."""
    prior = parameters(model, options) if free else fixed(model.geometry)
    xi = torch.cat([prior.mean, attachment.mean.reshape(-1)])
    fit = GeometryFit(model, attachment, prior, xi, _sigma(attachment, options), options)
    if static is not None:
        return _from_static(fit, static)
    note = Note("geometry.no_static", "no static trial: scaled and placed from the motion trials")
    return replace(_from_landmarks(fit, trials), notes=(note,))


def track(fit: GeometryFit, markers: Markers, bridge: bool | None = None) -> Tracked:
    """Follow the markers of a trial at the fit's geometry (held-out trials too)."""
    problem = _problem(fit, markers, _posture(fit))
    q = settle(problem, initial_posture(problem, fit.xi, _rest(fit)), fit.xi)
    observable = _observable(problem)
    if (fit.options.temporal if bridge is None else bridge) and not bool((problem.weight > 0).all()):
        q = bridge_gaps(problem, q, fit.xi)
    _, p, residual = problem.residual(q, fit.xi)
    error = torch.where(problem.weight > 0, residual.norm(dim=1), torch.nan)
    return Tracked(markers.time, q.T.contiguous(), error.T, p.permute(2, 0, 1), observable)


def _sigma(attachment: Attachment, options: GeometryOptions) -> Tensor:
    given = options.sigma_mm
    values = [given.get(label, 5.0) if isinstance(given, dict) else given for label in attachment.labels]
    return attachment.mean.new_tensor(values) * 1e-3


def _rest(fit: GeometryFit) -> Tensor:
    return fit.xi.new_tensor([dof.rest for dof in fit.model.tree.dofs])


def _posture(fit: GeometryFit, sd: float | None = None) -> PosturePrior:
    dofs = fit.model.tree.dofs
    precision = fit.xi.new_tensor([(sd or dof.sd) ** -2 for dof in dofs])
    precision[:6] = 0.0
    column = lambda values: fit.xi.new_tensor(values)[:, None].clamp(-LIMITLESS, LIMITLESS)  # noqa: E731
    return PosturePrior(
        mean=_rest(fit)[:, None],
        precision=precision[:, None],
        lower=column([dof.lower for dof in dofs[:0]] + [-LIMITLESS] * 6 + [dof.lower for dof in dofs[6:]]),
        upper=column([LIMITLESS] * 6 + [dof.upper for dof in dofs[6:]]),
        limit_precision=fit.options.limit_sd**-2,
    )


def _problem(fit: GeometryFit, markers: Markers, posture: PosturePrior, index: Tensor | None = None) -> MarkerProblem:
    position = markers.select(fit.attachment.labels).position.to(fit.xi)
    position = position if index is None else position[index]
    seen = torch.isfinite(position).all(dim=2)
    plan = plan_tree(fit.model.tree)
    place = torch.tensor(plan.position, device=fit.xi.device)
    return MarkerProblem(
        plan=plan,
        geometry=fit.prior,
        body=place[fit.attachment.body],
        target=torch.where(seen[..., None], position, 0.0).permute(1, 2, 0).contiguous(),
        weight=(seen / fit.sigma.square()).T.contiguous(),
        place=fit.attachment.mean,
        place_sd=fit.attachment.sd,
        free=torch.arange(len(fit.attachment.labels), device=fit.xi.device),
        posture=posture,
        robust=fit.options.robust,
    )


def _evenly(frames: int, wanted: int) -> Tensor:
    return torch.linspace(0, frames - 1, min(frames, wanted)).round().long()


def _from_static(fit: GeometryFit, static: Markers) -> GeometryFit:
    """Scale and place the markers on a standing subject: landmarks first, then everything."""
    index = _evenly(len(static.time), fit.options.static_frames)
    problem = _problem(fit, static, _posture(fit, fit.options.static_posture_sd), index)
    if not bool((problem.weight > 0).any()):
        raise DataError("geometry.static", "the static trial shows none of the subject's markers")
    problem = replace(problem, robust=None, weight=_landmarks_only(fit, problem))
    q = settle(problem, initial_posture(problem, fit.xi, _rest(fit)), fit.xi)
    full = replace(problem, weight=_problem(fit, static, problem.posture, index).weight)
    return replace(fit, xi=solve_arrow(_join([full]), q, _placed(full, q, fit), tolerance=1e-6).xi)


def _landmarks_only(fit: GeometryFit, problem: MarkerProblem) -> Tensor:
    known = fit.attachment.known.to(problem.weight)
    return (problem.weight > 0) * known[:, None] / LANDMARK_SIGMA**2


def _placed(problem: MarkerProblem, q: Tensor, fit: GeometryFit) -> Tensor:
    """xi with every free-standing marker put where the current poses see it on its segment."""
    at, _, _ = problem.residual(q, fit.xi)
    R = torch.stack(at.R, dim=1)[problem.body]
    local = torch.einsum("maxt,mxt->mat", R, problem.target - at.p[problem.body])
    seen = (problem.weight > 0).to(local)
    mean = (local * seen[:, None]).sum(2) / seen.sum(1).clamp(min=1.0)[:, None]
    move = ~fit.attachment.known & (seen.sum(1) > 0)
    place = torch.where(move[:, None], mean, fit.place)
    return torch.cat([fit.xi[: len(fit.prior.mean)], place.reshape(-1)])


def _from_landmarks(fit: GeometryFit, trials: dict[str, Markers]) -> GeometryFit:
    """Without a static trial: follow the landmarks through some frames of motion and place the rest on them."""
    longest = max(trials.values(), key=lambda m: len(m.time))
    problem = _problem(fit, longest, _posture(fit), _evenly(len(longest.time), 4 * fit.options.static_frames))
    following = replace(problem, robust=None, weight=_landmarks_only(fit, problem))
    q = settle(following, initial_posture(following, fit.xi, _rest(fit)), fit.xi)
    return replace(fit, xi=_placed(problem, q, fit))


def _jointly(
    fit: GeometryFit, trials: dict[str, Markers], static: Markers | None, progress: Progress | None
) -> GeometryFit:
    """All fit trials and the static one in one problem; weights from the residuals, then once more.

    A marker weighs 1 / sigma^2 times the share of its frames that count as independent: skin that slides the same way
    for a second is one observation, not a hundred, and would otherwise drag joint centres away from any prior.
    """
    problem, q, lengths = joint_problem(fit, trials, static)
    solution = _solve(fit, replace(problem, robust=None), q, fit.xi, COARSE, progress)
    for tolerance in (COARSE, fit.options.tolerance):
        fit, problem = reweighted(fit, problem, solution, lengths)
        solution = _solve(fit, problem, solution.q, solution.xi, tolerance, progress)
    return finish_fit(fit, problem, solution)


def finish_fit(fit: GeometryFit, problem: MarkerProblem, solution: Solution) -> GeometryFit:
    """The fit at a solution of the joint problem, with its uncertainty from the chain's Jacobians."""
    uncertainty = estimate_uncertainty(problem, solution.q, solution.xi, fit.names)
    return replace(fit, xi=solution.xi, solution=solution, uncertainty=uncertainty)


def reweighted(
    fit: GeometryFit, problem: MarkerProblem, solution: Solution, lengths: tuple[int, ...]
) -> tuple[GeometryFit, MarkerProblem]:
    """Weights that match the residuals of a solution; also the fit with the scatter found.

    Args:
        fit: whose options say whether the scatter is estimated again.
        problem: from ``joint_problem``.
        solution: of that problem.
        lengths: frames of each trial in it.
    """
    _, _, residual = problem.residual(solution.q, solution.xi)
    seen = problem.weight > 0
    share = independent_share(torch.where(seen[:, None], residual, torch.nan), lengths)
    if fit.options.reestimate_sigma:
        fit = replace(fit, sigma=_residual_sigma(fit, seen, residual, lengths))
    return fit, replace(problem, weight=seen * (share / fit.sigma.square())[:, None])


def joint_problem(
    fit: GeometryFit, trials: dict[str, Markers], static: Markers | None
) -> tuple[MarkerProblem, Tensor, tuple[int, ...]]:
    """All fit trials and the static one as one problem, with postures to start from and the frames of each trial."""
    total = sum(len(m.time) for m in trials.values())
    share = min(1.0, fit.options.max_frames / max(total, 1))
    pieces = []
    for markers in trials.values():
        index = _evenly(len(markers.time), max(2, round(share * len(markers.time))))
        problem = _problem(fit, markers, _posture(fit), index)
        pieces.append((problem, settle(problem, initial_posture(problem, fit.xi, _rest(fit)), fit.xi)))
    if static is not None:
        posture = _posture(fit, fit.options.static_posture_sd)
        problem = _problem(fit, static, posture, _evenly(len(static.time), fit.options.static_frames))
        pieces.append((problem, settle(problem, initial_posture(problem, fit.xi, _rest(fit)), fit.xi)))
    q = torch.cat([piece[1] for piece in pieces], dim=1)
    return _join([piece[0] for piece in pieces]), q, tuple(piece[1].shape[1] for piece in pieces)


def _join(problems: list[MarkerProblem]) -> MarkerProblem:
    """Trials side by side. What is expected of a posture counts once a trial, not once a frame.

    Counted every frame, a thousand weak pulls towards the neutral pose outweigh the priors on joint centres and
    landmarks, which alone say where a segment's axes point.
    """
    lengths = [p.target.shape[2] for p in problems]
    precision = [p.posture.precision.expand(-1, n) / n for p, n in zip(problems, lengths, strict=True)]
    mean = [p.posture.mean.expand(-1, n) for p, n in zip(problems, lengths, strict=True)]
    posture = problems[0].posture
    limit = posture.limit_precision / max(lengths)
    return replace(
        problems[0],
        target=torch.cat([p.target for p in problems], dim=2),
        weight=torch.cat([p.weight for p in problems], dim=1),
        posture=replace(
            posture, mean=torch.cat(mean, dim=1), precision=torch.cat(precision, dim=1), limit_precision=limit
        ),
    )


def _solve(
    fit: GeometryFit, problem: MarkerProblem, q: Tensor, xi: Tensor, tolerance: float, progress: Progress | None
) -> Solution:
    options = fit.options
    if options.solver == "adam":
        return solve_adam(problem, q, xi, options.gradient_iterations, progress)
    if options.solver == "lbfgs":
        return solve_lbfgs(problem, q, xi, options.gradient_iterations, progress)
    return solve_arrow(problem, q, xi, options.iterations, tolerance, progress)


def _residual_sigma(fit: GeometryFit, seen: Tensor, residual: Tensor, lengths: tuple[int, ...]) -> Tensor:
    """Scatter per marker: white noise, the same for all, and skin that slides, in proportion to ``looseness``.

    Half the mean square of successive differences is the white part; what the residuals hold beyond it is skin.
    A scatter of its own for every marker, from its residuals, is a trap: a foot's three markers are fitted by the
    foot's own freedom, seem exact, and lead the pelvis through the leg. On real walks it raised the force residual
    from 25 N to 41 N (with leverage taken into account: 32 N).
    """
    residual = torch.where(seen[:, None], residual, torch.nan)
    lost = len(fit.model.tree.dofs) / (3.0 * seen.sum(0).double().mean())
    steps = torch.cat([torch.diff(piece, dim=2) for piece in residual.split(list(lengths), dim=2)], dim=2)
    total, white = (_median_square(x) / (1.0 - lost).clamp(min=0.2) for x in (residual, steps))
    white = torch.minimum(0.5 * white, total)
    loose = _looseness(fit).square()
    return (white + (total - white) * loose / loose.mean()).sqrt().clamp(min=1e-4)


def _median_square(vectors: Tensor) -> Tensor:
    """Variance per coordinate of (markers, 3, frames), robustly; NaN are passed over."""
    return vectors.square().sum(1).nanmedian() / CHI2_MEDIAN


def _looseness(fit: GeometryFit) -> Tensor:
    """How much more than a trunk marker each marker slides: as configured by label, else by its segment."""
    given, names = fit.options.sigma_mm, fit.model.tree.names
    if isinstance(given, dict):
        return _sigma(fit.attachment, fit.options)
    return fit.xi.new_tensor([LOOSE.get(names[int(body)].split("_")[0], 1.0) for body in fit.attachment.body])


def _observable(problem: MarkerProblem) -> Tensor:
    """Frames in which every body that carries markers shows three, or all it has."""
    seen = (problem.weight > 0).to(torch.float64)
    ok = torch.ones(seen.shape[1], dtype=torch.bool, device=seen.device)
    for body in problem.body.unique():
        of = problem.body == body
        ok &= seen[of].sum(0) >= min(3, int(of.sum()))
    return ok
