"""Skin that slides with joints' angles: what it does to geometry, and how far it slides where only residuals tell."""

from dataclasses import replace

import pytest
import torch
from rates import at_least
from test_geometry_solvers import marked_leg
from torch import Tensor
from torch.testing import assert_close

from torchid.geometry.arrow.solver import solve_arrow
from torchid.geometry.problem import MarkerProblem
from torchid.geometry.sliding_skin import IN_COMMON, Slides, SlideSums, slid_covariance, slides_of
from torchid.geometry.uncertainty import SAMPLED, _add_frames, estimate_uncertainty

DRAWS, FRAMES = 24, 30
"""Draws, and frames of the leg."""


@pytest.fixture
def leg(seed: int) -> tuple[MarkerProblem, Tensor, Tensor]:
    """A leg whose markers are exactly where the prior has them, its coordinates and its geometry."""
    made, q, xi = marked_leg(FRAMES)
    n = len(made.geometry.mean)
    made = replace(made, geometry=replace(made.geometry, mean=xi[:n]), place=xi[n:].view(-1, 3))
    return replace(made, target=made.residual(q, xi)[1]), q, xi


def summed(problem: MarkerProblem, q: Tensor, xi: Tensor) -> tuple[SlideSums, Tensor]:
    """What all frames say of slides, and the covariance of geometry without them."""
    loose = torch.linspace(0.5, 1.5, len(problem.body)).double()
    body = [problem.plan.order[k] for k in problem.body.tolist()]
    sums = SlideSums.nothing(slides_of(problem.plan.tree, body, q, loose), len(xi))
    halves = torch.arange(FRAMES).split(FRAMES // 2)
    information = sum(_add_frames(problem, q, xi, problem.weight, part, sums) for part in halves)
    return sums, torch.linalg.inv(information + torch.diag(problem.xi_precision))


def slid(problem: MarkerProblem, q: Tensor, xi: Tensor, slides: Slides, c: Tensor) -> MarkerProblem:
    """The problem with every marker moved along its segment's axes in proportion to angles."""
    R_BW = problem.residual(q, xi)[0].R[problem.body]
    frames = q.shape[1]
    along = (
        torch.zeros(3 * len(problem.body), frames)
        .double()
        .index_add_(0, slides.row, c[:, None] * slides.angles[slides.angle])
    )
    return replace(problem, target=problem.target + torch.einsum("maxt,mat->mxt", R_BW, along.view(-1, 3, frames)))


def test_a_slide_moves_geometry_and_cost_as_is_foretold(leg):
    """To first order, by the solver that knows nothing of slides."""
    problem, q, xi = leg
    sums, covariance = summed(problem, q, xi)
    c = 1e-5 * torch.randn(len(sums.slides.row)).double()
    found = solve_arrow(slid(problem, q, xi, sums.slides, c), q, xi, 60, 1e-12)
    assert_close(found.xi - xi, covariance @ sums.scores.T @ c, rtol=1e-2, atol=1e-8)
    left = sums.information - sums.scores @ covariance @ sums.scores.T
    assert float(found.cost) == pytest.approx(0.5 * float(c @ left @ c), rel=1e-2)
    moved = slid(problem, q, xi, sums.slides, c)
    moment = sums.slides.moment(*_seen(moved, found.q, found.xi))
    assert_close(-moment, left @ c, rtol=1e-2, atol=1e-2 * float((left @ c).abs().max()))


def _seen(problem: MarkerProblem, q: Tensor, xi: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    at, _, residual = problem.residual(q, xi)
    return at.R[problem.body], problem.weight, residual


def test_how_far_skin_slides_is_found_and_none_where_there_is_none(leg):
    """From residuals that have all of the noise and what of the slides neither motion nor geometry takes."""
    sums, covariance = summed(*leg)
    root = sums.slides.root()
    left = sums.information - sums.scores @ covariance @ sums.scores.T
    d, Q = torch.linalg.eigh(0.5 * (left + left.T))
    noise, size = Q * d.clamp(min=0.0).sqrt(), 2.0 / float(d.median()) ** 0.5
    near = none = 0
    for _ in range(DRAWS):
        by_noise = noise @ torch.randn(len(d)).double()
        more, found = slid_covariance(sums, by_noise + left @ root @ (size * torch.randn(len(d)).double()), covariance)
        near += size / 1.5 < found < 1.5 * size
        way = covariance @ sums.scores.T @ root
        assert_close(more, found**2 * way @ way.T)
        none += slid_covariance(sums, by_noise, covariance)[1] < size / 3.0
    assert min(near, none) >= at_least(0.9, DRAWS)


def test_deviations_hold_what_slides_do_where_only_some_frames_are_looked_at(seed):
    """Skin that slides by 10 mm with a radian is found from a third of the frames, and is what deviations are of."""
    frames = 3 * SAMPLED
    given, q, xi = marked_leg(frames)
    names = tuple(map(str, range(len(xi))))
    loose = torch.ones(len(given.body)).double()
    body = [given.plan.order[k] for k in given.body.tolist()]
    slides = slides_of(given.plan.tree, body, q, loose)
    c = 0.01 / 3.0**0.5 * slides.root() @ torch.randn(len(slides.row)).double()
    found = {}
    for name, problem in (("still", given), ("sliding", slid(given, q, xi, slides, c))):
        solution = solve_arrow(problem, q, xi)
        found[name] = estimate_uncertainty(problem, solution.q, solution.xi, names, loose)
    still, sliding = found["still"], found["sliding"]
    assert 0.01 / 1.5 < sliding.skin_m_rad < 0.01 * 1.5
    assert still.skin_m_rad < 0.01 / 4.0
    assert float((sliding.sd / still.sd).median()) > 3.0


def test_skin_adds_nothing_where_nothing_turns_or_tells(leg):
    """Without slides, without angles that change, and where all residuals are zero."""
    problem, q, xi = leg
    loose = torch.ones(len(problem.body)).double()
    exact = estimate_uncertainty(problem, q, xi, tuple(map(str, range(len(xi)))), loose)
    standing = q[:, :1].expand(-1, FRAMES)
    still = replace(problem, target=problem.residual(standing, xi)[1] + 1e-3 * torch.randn(16, 3, FRAMES).double())
    assert exact.skin_m_rad < 1e-9
    assert estimate_uncertainty(still, standing, xi, tuple(map(str, range(len(xi)))), loose).skin_m_rad == 0.0
    nothing = SlideSums.nothing(slides_of(problem.plan.tree, [], q, loose[:0]), len(xi))
    eye = torch.eye(len(xi)).double()
    more, size = slid_covariance(nothing, nothing.scores.new_zeros(0), eye)
    assert size == 0.0 and not bool(more.any())


def test_markers_of_a_segment_slide_half_together(leg):
    """Along one axis with one angle; those of other segments, axes and angles on their own."""
    problem, q, xi = leg
    slides = summed(problem, q, xi)[0].slides
    L = slides.root() @ slides.root().T
    scale = slides.loose[:, None] * slides.loose
    same = slides.group[:, None] == slides.group
    expected = torch.where(same, IN_COMMON, 0.0) + (1.0 - IN_COMMON) * torch.eye(len(L)).double()
    assert_close(L / scale, expected.double(), rtol=1e-10, atol=1e-10)
    assert int(same.sum(1).min()) == int(same.sum(1).max()) == 4
    per_marker = torch.bincount(slides.marker) // 3  # pelvis: hip; thigh: hip, knee; shank: knee, ankle; foot: ankle
    assert per_marker.view(4, 4).tolist() == [[3] * 4, [4] * 4, [2] * 4, [1] * 4]
