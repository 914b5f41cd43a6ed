"""The inertial fit: optimality, invariances, certificates and refusals."""

import re
from dataclasses import replace

import numpy as np
import pytest
import torch
from inertia_cases import IDENTITY, bodies, chain_rows, draw, names, prior, relative
from torch import Tensor

from torchid.dynamics.row_equations import NormalEquations
from torchid.errors import ConfigError, DataError
from torchid.inertia import cone
from torchid.inertia.certificate import InertiaStatus, judge
from torchid.inertia.fit import InertiaFit, fit_inertia
from torchid.inertia.options import InertiaOptions
from torchid.model.model import InertialPrior
from torchid.model.pseudo import relative_map, triangle, untriangle

PLAIN = InertiaOptions(prior_weight=1.0, noise="known")


def problem(
    seed: int, count: int = 4, noise: float = 1.0, sd: float = 0.2
) -> tuple[Tensor, Tensor, InertialPrior, Tensor]:
    """Whitened rows, right-hand side, prior and the subject drawn from it."""
    Y, given = chain_rows(count, 60, seed) / noise, prior(bodies(count), sd)
    truth = draw(given)
    return Y, Y @ truth.flatten() + torch.randn(len(Y), dtype=torch.float64), given, truth


def active_problem() -> tuple[Tensor, Tensor, InertialPrior]:
    """Well-conditioned rows of a body whose pseudo-inertia is indefinite, so that its LMI must hold with equality."""
    given = prior(bodies(3), 0.3)
    T = torch.block_diag(*relative_map(given.mean))
    axes = torch.linalg.qr(torch.randn(4, 4, dtype=torch.float64))[0]
    x = IDENTITY.repeat(3, 1)
    x[2] = triangle(axes @ torch.diag(torch.tensor([-0.5, 1, 1, 1], dtype=torch.float64)) @ axes.mT)
    Y = torch.randn(120, 30, dtype=torch.float64) @ torch.linalg.inv(T)
    return Y, Y @ T @ x.flatten() + 0.1 * torch.randn(len(Y), dtype=torch.float64), given


def test_a_seed_repeats_its_rows(seed: int) -> None:
    """The seed that a failure prints is all that the rows depend on, Pinocchio's own generator included."""
    torch.testing.assert_close(chain_rows(3, 4, seed), chain_rows(3, 4, seed), rtol=0, atol=0)
    assert not torch.equal(chain_rows(3, 4, seed), chain_rows(3, 4, seed + 1))


def test_exact_data_return_the_base_parameters(seed: int) -> None:
    """Without noise every identifiable combination is the subject's, whatever the prior says."""
    Y, _, given, truth = problem(seed)
    truth = 0.5 * (truth + given.mean)
    light = InertiaOptions(prior_weight=1e-4, noise="known")
    fit = fit_inertia(NormalEquations.from_rows(Y, Y @ truth.flatten()), given, names(4), light)
    assert fit.base is not None
    prior_distance = fit.base.distance(given.mean, truth, given.covariance)
    assert fit.base.distance(fit.phi, truth, given.covariance) < 0.05 * prior_distance
    torch.testing.assert_close(Y @ fit.phi.flatten(), Y @ truth.flatten(), rtol=1e-3, atol=1e-2)
    assert fit.rank == len(fit.base.names) < 40
    assert fit.status is InertiaStatus.ACCEPTED


def test_free_optimum_is_the_ridge_solution(seed: int) -> None:
    """With inactive constraints the solver returns the solution of the stacked least-squares problem."""
    Y, F, given, _ = problem(seed, sd=0.1)
    factor = torch.linalg.inv(torch.linalg.cholesky(given.covariance))
    total = float(given.mean[:, 0].sum())
    row = torch.zeros(1, 40, dtype=torch.float64)
    row[0, ::10] = 1 / 0.5
    A = torch.cat([Y, factor, row])
    b = torch.cat([F, factor @ given.mean.flatten(), torch.tensor([(total - 0.2) / 0.5])])
    expected = torch.linalg.lstsq(A, b[:, None], driver="gelsd").solution[:, 0]
    fit = fit_inertia(NormalEquations.from_rows(Y, F), given, names(4), PLAIN, mass=(total - 0.2, 0.5))
    assert not fit.certificate.active
    torch.testing.assert_close(fit.phi.flatten(), expected, rtol=1e-6, atol=1e-7)
    torch.testing.assert_close(fit.covariance, torch.linalg.inv(A.mT @ A), rtol=1e-5, atol=1e-9)


def projected_gradient(x: Tensor, hessian: Tensor, free: Tensor, floor: float) -> Tensor:
    """FISTA with restart: gradient steps, then eigenvalues clipped at the floor; no solver involved."""
    values = torch.linalg.eigvalsh(hessian)
    step, momentum, look = 1 / values[-1], 1.0, x
    for _ in range(3_000):
        moved = look - step * (hessian @ (look - free).flatten()).reshape(x.shape)
        eigenvalues, vectors = torch.linalg.eigh(untriangle(moved))
        new = triangle(vectors @ torch.diag_embed(eigenvalues.clamp_min(floor)) @ vectors.mT)
        if float(((look - new) * (new - x)).sum()) > 0:
            momentum = 1.0
        following = (1 + (1 + 4 * momentum**2) ** 0.5) / 2
        look, x, momentum = new + (momentum - 1) / following * (new - x), new, following
    return x


def test_active_constraints_agree_with_projected_gradient(seed: int) -> None:
    """Where LMIs bind, an independent first-order method finds the same objective and the certificate holds."""
    Y, F, given = active_problem()
    equations = NormalEquations.from_rows(Y, F)
    fit = fit_inertia(equations, given, names(3), replace(PLAIN, refuse=False))
    assert "body_2" in fit.certificate.active
    assert any(note.code == "inertia.lmi_active" for note in fit.notes)
    optimality = fit.certificate.optimality
    assert max(optimality.primal, optimality.dual, optimality.gap) < 1e-8
    T = torch.block_diag(*relative_map(given.mean))
    precision = torch.linalg.inv(given.covariance)
    hessian = T.mT @ (equations.gram + precision) @ T
    free = torch.linalg.solve(hessian, T.mT @ (equations.moment + precision @ given.mean.flatten())).reshape(3, 10)
    found = projected_gradient(relative(given.mean, given.mean), hessian, free, PLAIN.floor)
    ours, theirs = (
        ((x - free).flatten() @ hessian @ (x - free).flatten()) for x in (relative(fit.phi, given.mean), found)
    )
    torch.testing.assert_close(ours, theirs, rtol=1e-6, atol=1e-8)


def test_certificate_refuses_a_wrong_solution(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """A solver that returns a point off the optimum, yet says Solved, is not believed."""
    Y, F, given, _ = problem(seed)
    honest = cone.project

    def dishonest(*args: object, **options: object) -> object:
        solution = honest(*args, **options)
        return replace(solution, x=solution.x * (1 + 1e-4))

    monkeypatch.setattr("torchid.inertia.cone.project", dishonest)
    with pytest.raises(DataError, match="not_optimal"):
        fit_inertia(NormalEquations.from_rows(Y, F), given, names(4), PLAIN)


@pytest.mark.parametrize("kind", ["quadratic", "entropic"])
@pytest.mark.parametrize("power", [-6, -3, 3, 6])
def test_unit_of_the_rows_does_not_matter(seed: int, power: int, kind: str) -> None:
    """Rows and wrenches times 10^k change no identified parameter by more than 1e-6 of its prior scatter."""
    Y, F, given, _ = problem(seed)
    options = InertiaOptions(prior=kind)  # type: ignore[arg-type]
    fits = [fit_inertia(NormalEquations.from_rows(s * Y, s * F), given, names(4), options) for s in (1.0, 10.0**power)]
    scatter = given.covariance.diagonal().sqrt().reshape(-1, 10)
    torch.testing.assert_close(fits[0].phi / scatter, fits[1].phi / scatter, rtol=1e-6, atol=1e-6)


def test_millimetres_do_not_matter(seed: int) -> None:
    """The same problem in millimetres gives the same bodies."""
    Y, F, given, _ = problem(seed)
    unit = torch.tensor([1.0] + [1e3] * 3 + [1e6] * 6, dtype=torch.float64).repeat(4)
    small = InertialPrior((given.mean.flatten() * unit).reshape(-1, 10), unit[:, None] * given.covariance * unit)
    metres = fit_inertia(NormalEquations.from_rows(Y, F), given, names(4))
    millimetres = fit_inertia(NormalEquations.from_rows(Y / unit, F), small, names(4))
    scatter = given.covariance.diagonal().sqrt()
    torch.testing.assert_close(
        millimetres.phi.flatten() / unit / scatter, metres.phi.flatten() / scatter, rtol=1e-6, atol=1e-6
    )


def test_order_of_bodies_does_not_matter(seed: int) -> None:
    """Permuting the bodies permutes the result."""
    Y, F, given, _ = problem(seed)
    order = torch.randperm(4)
    columns = (10 * order[:, None] + torch.arange(10)).flatten()
    shuffled = InertialPrior(given.mean[order], given.covariance[columns][:, columns])
    first = fit_inertia(NormalEquations.from_rows(Y, F), given, names(4), PLAIN)
    second = fit_inertia(NormalEquations.from_rows(Y[:, columns], F), shuffled, names(4), PLAIN)
    torch.testing.assert_close(second.phi, first.phi[order], rtol=1e-6, atol=1e-8)


def test_doubling_the_data_halves_the_covariance(seed: int) -> None:
    """Every trial counted twice doubles the information that the data add to the prior's."""
    Y, F, given, _ = problem(seed)
    equations = NormalEquations.from_rows(Y, F)
    once, twice = (fit_inertia(e, given, names(4), PLAIN) for e in (equations, equations + equations))
    scale = given.covariance.diagonal().sqrt()
    before, first, second = (
        torch.linalg.inv(c / scale[:, None] / scale) for c in (given.covariance, once.covariance, twice.covariance)
    )
    torch.testing.assert_close(second - before, 2 * (first - before), rtol=1e-6, atol=1e-7 * float(first.abs().max()))


def test_sums_are_additive_and_whiten(seed: int) -> None:
    """Sums of parts are sums of the whole; scaling weighs the squared residual."""
    Y, F, _, truth = problem(seed)
    whole = NormalEquations.from_rows(Y, F)
    parts = NormalEquations.from_rows(Y[:100], F[:100]) + NormalEquations.from_rows(Y[100:], F[100:])
    torch.testing.assert_close(parts.gram, whole.gram)
    assert parts.rows == whole.rows
    expected = float((Y @ truth.flatten() - F).square().sum())
    np.testing.assert_allclose(whole.residual_square(truth.flatten()), expected, rtol=1e-6)
    np.testing.assert_allclose(whole.scale(3.0).residual_square(truth.flatten()), 3 * expected, rtol=1e-6)


def test_progress_tells_prior_from_data(seed: int) -> None:
    """No progress without information, nearly full for a parameter that is measured, in between it only grows."""
    Y, F, given, _ = problem(seed)
    equations = NormalEquations.from_rows(Y, F)
    shares = [
        fit_inertia(equations.scale(s), given, names(4), replace(PLAIN, refuse=False)).progress
        for s in (1e-12, 1e-2, 1.0)
    ]
    assert float(shares[0].phi.max()) < 1e-3
    assert bool((shares[2].phi >= shares[1].phi - 1e-9).all())
    assert bool((shares[2].segment >= shares[1].segment - 1e-9).all())
    assert shares[2].total_mass > 0.99


def test_standard_deviations_of_com_and_inertia(seed: int) -> None:
    """Delta-method deviations agree with the scatter of draws from a narrow posterior."""
    Y, F, given, _ = problem(seed, noise=0.2, sd=0.02)
    fit = fit_inertia(NormalEquations.from_rows(Y, F), given, names(4), PLAIN)
    factor = torch.linalg.cholesky(fit.covariance)
    draws = fit.phi + (torch.randn(4000, 40, dtype=torch.float64) @ factor.mT).reshape(-1, 4, 10)
    copies = replace(fit, phi=draws.reshape(-1, 10))
    com, inertia = copies.com.reshape(-1, 4, 3), copies.inertia_com.reshape(-1, 4, 3, 3)
    torch.testing.assert_close(fit.sd.com, com.std(0), rtol=0.15, atol=0)
    torch.testing.assert_close(fit.sd.inertia_com, inertia.std(0), rtol=0.15, atol=0)


def test_entropic_prior_keeps_bodies_inside(seed: int) -> None:
    """The log-det prior satisfies its stationarity condition and keeps definite a body that the data bend."""
    Y, F, given = active_problem()
    options = replace(PLAIN, prior="entropic", refuse=False)
    fit = fit_inertia(NormalEquations.from_rows(Y, F), given, names(3), options)
    assert fit.certificate.optimality.dual < 1e-6
    assert float(fit.certificate.smallest_eigenvalue.min()) > 0
    assert not fit.certificate.active


@pytest.mark.parametrize("kind", ["quadratic", "entropic"])
def test_centre_of_mass_stays_in_its_box(seed: int, kind: str) -> None:
    """A box that excludes the free optimum holds with equality, and the certificate covers its multipliers."""
    Y, F, given, _ = problem(seed, noise=5.0)
    options = replace(PLAIN, prior=kind)
    free = fit_inertia(NormalEquations.from_rows(Y, F), given, names(4), options)
    box = torch.stack([free.com - 0.05, free.com + 0.05], dim=1)
    box[2, 1, 0] = free.com[2, 0] - 0.002
    fit = fit_inertia(NormalEquations.from_rows(Y, F), given, names(4), options, com_box=box)
    np.testing.assert_allclose(float(fit.com[2, 0]), float(box[2, 1, 0]), atol=1e-6)
    assert fit.certificate.optimality.dual < 1e-6
    for bad in (box.flip(1), box[:3]):
        with pytest.raises(ConfigError, match=r"inertia\.com_box") as caught:
            fit_inertia(NormalEquations.from_rows(Y, F), given, names(4), options, com_box=bad)
        assert caught.value.found == str(tuple(bad.shape)) and "(4, 2, 3)" in caught.value.remedy
    box[2, 1, 0] = torch.inf
    with pytest.raises(ConfigError, match=r"infinite \(found: .*\(2, 1, 0\)\).*inertia\.com_box"):
        fit_inertia(NormalEquations.from_rows(Y, F), given, names(4), options, com_box=box)


@pytest.mark.parametrize("away", [10.0, 1e3, 1e8])
@pytest.mark.parametrize("kind", ["quadratic", "entropic"])
def test_boxes_far_from_every_body_are_refused(seed: int, kind: str, away: float) -> None:
    """Boxes that no limb's centre of mass can lie in end as errors, and none is called impossible without proof."""
    Y, F, given, _ = problem(seed)
    centre = given.mean[:, 1:4] / given.mean[:, :1] + away
    box = torch.stack([centre - 0.1, centre + 0.1], dim=1)
    with pytest.raises(DataError) as caught:
        fit_inertia(NormalEquations.from_rows(Y, F), given, names(4), replace(PLAIN, prior=kind), com_box=box)
    error = caught.value
    assert error.code in {"inertia.solver", "inertia.not_optimal", "inertia.unexplained", "inertia.not_physical"}
    infeasible = re.search("(?<!dual)infeasible", error.found.lower()) is not None
    assert ("no inertial parameters" in error.message) == infeasible


def judged(Y: Tensor, F: Tensor, given: InertialPrior) -> InertiaFit:
    """The fit with its status instead of an error."""
    return fit_inertia(NormalEquations.from_rows(Y, F), given, names(4), InertiaOptions(refuse=False))


def test_pathological_data_are_named(seed: int) -> None:
    """Empty, sign-flipped, mis-scaled and unrelated wrenches get their status, and an error by default."""
    Y, F, given, _ = problem(seed)
    conflict, accepted = InertiaStatus.PRIOR_CONFLICT, InertiaStatus.ACCEPTED
    sound = judged(Y, F, given)
    assert sound.status is accepted and "inertia.mass_conflict" not in {note.code for note in sound.notes}
    assert judged(0 * Y, 0 * F, given).status is InertiaStatus.NO_INFORMATION
    for wrench in (-F, 1e-6 * F, 0 * F, 9.81 * F):
        found = judged(Y, wrench, given)
        assert found.status is conflict and "inertia.mass_conflict" in {note.code for note in found.notes}
        with pytest.raises(DataError, match="prior_conflict"):
            fit_inertia(NormalEquations.from_rows(Y, wrench), given, names(4))
    mixed = F.reshape(-1, 6)[:, [1, 2, 0, 4, 5, 3]].flatten()
    assert judged(Y, mixed, given).status in (conflict, InertiaStatus.UNEXPLAINED)


def test_static_pose_is_accepted_and_marked_as_prior(seed: int) -> None:
    """One pose held still determines at most six combinations; all else keeps its prior scatter."""
    Y, _, given, truth = problem(seed)
    still = Y[:6].repeat(100, 1)
    F = still @ truth.flatten() + torch.randn(600, dtype=torch.float64)
    fit = judged(still, F, given)
    assert fit.rank <= 6
    assert float(fit.progress.segment.mean()) < 6 / 40 + 0.01


@pytest.mark.parametrize("value", [torch.nan, torch.inf])
def test_infinite_or_missing_sums_are_refused_before_the_solver(seed: int, value: float) -> None:
    """NaN or infinity in any part of the sums is a DataError with its own code."""
    Y, F, given, _ = problem(seed)
    good = NormalEquations.from_rows(Y, F)
    gram, moment = good.gram.clone(), good.moment.clone()
    gram[3, 5], moment[2] = value, value
    for bad in (replace(good, gram=gram), replace(good, moment=moment), replace(good, square=value)):
        with pytest.raises(DataError, match="equations.not_finite"):
            fit_inertia(bad, given, names(4))


@pytest.mark.parametrize("kind", ["quadratic", "entropic"])
def test_rows_whitened_far_too_small_are_refused(seed: int, kind: str) -> None:
    """Beside rows of 1e-9 of their stated noise, the prior is rounding: the error says so and what to do."""
    Y, F, given, _ = problem(seed, noise=1e-9)
    options = InertiaOptions(prior=kind, noise="known")  # type: ignore[arg-type]
    with pytest.raises(DataError, match=r"not positive definite.*Scale the rows.*\[inertia\.solver\]"):
        fit_inertia(NormalEquations.from_rows(Y, F), given, names(4), options)


def test_what_is_not_a_number_is_not_optimal(seed: int) -> None:
    """NaN in any of a certificate's residuals is no reason to accept."""
    Y, F, given, _ = problem(seed)
    certificate = fit_inertia(NormalEquations.from_rows(Y, F), given, names(4), PLAIN).certificate
    for part in ("primal", "dual", "gap"):
        spoiled = replace(certificate, optimality=replace(certificate.optimality, **{part: torch.nan}))
        assert judge(spoiled, PLAIN) is InertiaStatus.NOT_OPTIMAL


def test_a_retry_does_not_vouch_for_the_certificate(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """The note that the solver needed several settings says how they ended, and leaves the rest to the status."""
    Y, F, given, _ = problem(seed)
    honest = cone.project

    def short(*args: object, **options: object) -> object:
        solution = honest(*args, **options)
        return replace(solution, x=solution.x * (1 + 1e-4), attempts=3, status="AlmostSolved")

    monkeypatch.setattr("torchid.inertia.cone.project", short)
    fit = fit_inertia(NormalEquations.from_rows(Y, F), given, names(4), replace(PLAIN, refuse=False))
    assert fit.status is InertiaStatus.NOT_OPTIMAL
    (said,) = [note.message for note in fit.notes if note.code == "inertia.solver_retry"]
    assert "3 settings" in said and "AlmostSolved" in said and "certificate" not in said


def test_sums_of_different_rows_are_refused(seed: int) -> None:
    """Moment and square that no set of rows can have, float32 sums, and an indefinite Gram matrix are found out."""
    Y, F, given, _ = problem(seed)
    good = NormalEquations.from_rows(Y, F)
    single = NormalEquations.from_rows(Y.float(), F.float())
    bad = [
        replace(good, square=0.1 * good.square),
        replace(good, gram=good.gram - 1e-3 * good.gram.diagonal().diag()),
        replace(good, gram=single.gram.double(), moment=single.moment.double()),
    ]
    for equations in bad:
        with pytest.raises(DataError, match="equations.inconsistent"):
            fit_inertia(equations, given, names(4))


def test_impossible_priors_and_masses_are_config_errors(seed: int) -> None:
    """A prior that is not physical or not definite, a wrong size and a certain mass are the user's to correct."""
    Y, F, given, _ = problem(seed)
    equations = NormalEquations.from_rows(Y, F)
    ghost = given.mean.clone()
    ghost[0, 0] = -1
    singular = given.covariance.clone()
    singular[0], singular[:, 0] = 0, 0
    cases = [
        ("prior.not_physical", InertialPrior(ghost, given.covariance), 4, None, ""),
        ("prior.covariance", InertialPrior(given.mean, singular), 4, None, ""),
        ("inertia.shape", given, 3, None, "40 of 30"),
        *(("inertia.mass", given, 4, mass, str(mass)) for mass in ((70.0, 0.0), (-70.0, 1.0), (70.0, float("inf")))),
    ]
    for code, bad, count, mass, found in cases:
        with pytest.raises(ConfigError) as caught:
            fit_inertia(equations, bad, names(count), mass=mass)
        assert caught.value.code == code and found in caught.value.found and caught.value.remedy
