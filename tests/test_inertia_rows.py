"""The inertial fit from rows of one's own: against direct conic programs, its options, and every refusal."""

import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch
from rows_problem import RowsProblem, direct, human, pseudo, small

import torchid
from torchid.conventions import INERTIAL_NAMES
from torchid.dynamics.row_equations import NormalEquations
from torchid.errors import ConfigError, DataError, TorchidError
from torchid.inertia import cone, entropic
from torchid.inertia.certificate import InertiaStatus
from torchid.inertia.linear import ellipsoid_matrix
from torchid.inertia.rows_input import Limits, RowsPrior
from torchid.inertia.rows_result import RowsFit
from torchid.model.pseudo import params_to_pseudo

KINDS = ("euclidean", "pullback", "entropic")
SCALE = {"euclidean": 0.01, "pullback": 0.3, "entropic": 0.3}
EQUAL = 1e-6
LEE = ("m", "mc_x", "mc_y", "mc_z", "Ixx", "Iyy", "Izz", "Ixy", "Iyz", "Ixz")
"""Order of Lee, Wensing & Park's published code."""
PAGE = Path(__file__).resolve().parents[1] / "docs" / "rows.md"


def prior_of(problem: RowsProblem, kind: str) -> RowsPrior:
    return RowsPrior(problem.mean, kind, SCALE[kind])


def difference(phi: np.ndarray, other: np.ndarray) -> float:
    """Largest difference of pseudo-inertias relative to ``other``'s own, over all bodies."""
    apart = []
    for one, two in zip(phi, other, strict=True):
        apart.append(np.abs(pseudo(one) - pseudo(two)).max() / np.abs(pseudo(two)).max())
    return float(max(apart))


@pytest.mark.parametrize("kind", KINDS)
def test_each_prior_equals_the_direct_program(kind: str) -> None:
    """With ellipsoids, some of which hold with equality, the fit is that of a program on the uncompressed rows."""
    problem = human()
    fit = torchid.fit_inertia_rows(
        (problem.Y, problem.F), prior_of(problem, kind), weight=2.0, limits=Limits(ellipsoids=problem.Q)
    )
    expected = direct(problem, kind, SCALE[kind], weight=2.0)
    apart = difference(fit.phi.numpy(), expected)
    print(f"{kind}: max relative difference {apart:.1e}")  # noqa: T201
    assert apart < EQUAL
    assert sum(limit.startswith("ellipsoid") for limit in fit.at_limit) >= 3
    assert difference(problem.mean, expected) > 0.05


@pytest.mark.parametrize("kind", KINDS)
def test_an_error_bound_holds_with_equality(kind: str) -> None:
    """Under a bound tighter than the weighed fit's residual, rows meet it exactly with the weight that it implies."""
    problem = human() if kind == "pullback" else small()
    limits, prior, data = Limits(ellipsoids=problem.Q), prior_of(problem, kind), (problem.Y, problem.F)
    loose = torchid.fit_inertia_rows(data, prior, weight=50.0, limits=limits)
    bound = 0.99 * loose.residual_rms
    fit = torchid.fit_inertia_rows(data, prior, rms_bound=bound, limits=limits)
    np.testing.assert_allclose(fit.residual_rms, bound, rtol=1e-8)
    assert fit.noise_sd == pytest.approx(bound) and 0 < fit.weight < 50.0 / bound**2
    again = torchid.fit_inertia_rows(data, prior, weight=fit.weight, noise_sd=fit.noise_sd, limits=limits)
    assert difference(fit.phi.numpy(), again.phi.numpy()) < EQUAL
    assert fit.phi_sd is not None and again.phi_sd is not None
    torch.testing.assert_close(fit.phi_sd, again.phi_sd, rtol=1e-5, atol=0.0)


@pytest.mark.parametrize("kind", KINDS)
def test_an_error_bound_equals_the_direct_program(kind: str) -> None:
    """The bound as a second-order cone over uncompressed rows leads to the same bodies, total mass held exactly."""
    problem, scale = small(), 0.3
    total = float(problem.truth[:, 0].sum()) * 1.01
    expected = direct(problem, kind, scale, rms_bound=1.1, mass=total)
    limits = Limits(ellipsoids=problem.Q, total_mass=total)
    fit = torchid.fit_inertia_rows(
        (problem.Y, problem.F),
        RowsPrior(problem.mean, kind, scale),
        rms_bound=1.1,
        limits=limits,
    )
    np.testing.assert_allclose(fit.residual_rms, 1.1, rtol=1e-8)
    np.testing.assert_allclose(fit.total_mass, total, rtol=1e-9)
    apart = difference(fit.phi.numpy(), expected)
    print(f"{kind} under an error bound: max relative difference {apart:.1e}")  # noqa: T201
    assert apart < EQUAL
    assert difference(fit.phi.numpy(), problem.mean) > 0.05


def small_fit(problem: RowsProblem | None = None, prior: RowsPrior | None = None, **options: Any) -> RowsFit:
    """Fit of the three limbs with a pull-back prior of weight 1, unless other options are given."""
    problem = problem or small()
    if "rms_bound" not in options:
        options = {"weight": 1.0, **options}
    data = options.pop("data", (problem.Y, problem.F))
    return torchid.fit_inertia_rows(data, prior or RowsPrior(problem.mean, "pullback", 0.3), **options)


def test_a_loose_bound_returns_the_prior() -> None:
    """Where the prior mean meets the bound, nothing moves, and there is no standard deviation to state."""
    fit = small_fit(rms_bound=1e4)
    assert difference(fit.phi.numpy(), small().mean) < 1e-7
    assert fit.phi_sd is None and fit.covariance is None and fit.weight == float("inf")
    assert fit.bodies["body_0"].mass_sd is None
    assert [note.code for note in fit.notes] == ["rows.bound_inactive"]


@pytest.mark.parametrize("kind", ["pullback", "entropic"])
def test_a_bound_out_of_reach_says_what_can_be_reached(kind: str) -> None:
    """A bound between what free and what constrained parameters reach is refused, with a figure that can be met."""
    problem = small()
    heavy = Limits(total_mass=2.0 * float(problem.mean[:, 0].sum()))
    prior = RowsPrior(problem.mean, kind, 0.3)
    free = np.linalg.lstsq(problem.Y, problem.F, rcond=None)[0]
    reachable = float(np.sqrt(np.mean((problem.Y @ free - problem.F) ** 2)))
    small_fit(prior=prior, rms_bound=1.01 * max(reachable, 0.9))
    with pytest.raises(DataError, match=r"rows\.bound_out_of_reach") as caught:
        small_fit(prior=prior, rms_bound=1.01 * max(reachable, 0.9), limits=heavy)
    said = float(re.search(r"reach about ([\d.]+)", str(caught.value))[1])  # type: ignore[index]
    assert said > 1.5
    assert small_fit(prior=prior, rms_bound=1.01 * said, limits=heavy).status is InertiaStatus.ACCEPTED
    with pytest.raises(DataError, match=r"rows\.bound_out_of_reach"):
        small_fit(prior=prior, rms_bound=0.5 * reachable)


def in_order(problem: RowsProblem, order: tuple[str, ...]) -> tuple[np.ndarray, np.ndarray]:
    """The problem's rows and prior mean with every body's ten columns in another order."""
    one = [INERTIAL_NAMES.index(name) for name in order]
    columns = (10 * np.arange(len(problem.mean))[:, None] + one).ravel()
    return problem.Y[:, columns], problem.mean[:, one]


def test_order_and_sums_do_not_matter() -> None:
    """Columns in the order of another program, as rows, tensors or sums, give the same bodies and covariance."""
    problem, own = small(), small_fit()
    Y, mean = in_order(problem, LEE)
    square = float(problem.F @ problem.F)
    sums = NormalEquations.from_rows(torch.from_numpy(problem.Y), torch.from_numpy(problem.F))
    one = [INERTIAL_NAMES.index(name) for name in LEE]
    for data in ((Y, problem.F), (Y.T @ Y, Y.T @ problem.F, square, len(Y)), (torch.from_numpy(Y), problem.F.tolist())):
        fit = small_fit(prior=RowsPrior(mean, "pullback", 0.3), data=data, order=LEE)
        torch.testing.assert_close(fit.phi, own.phi[:, one], rtol=1e-7, atol=1e-10)
        assert fit.phi_sd is not None and own.phi_sd is not None
        torch.testing.assert_close(fit.phi_sd, own.phi_sd[:, one], rtol=1e-6, atol=0.0)
        torch.testing.assert_close(fit.bodies["body_2"].inertia, own.bodies["body_2"].inertia, rtol=1e-7, atol=1e-10)
        np.testing.assert_allclose(fit.residual_rms, own.residual_rms, rtol=1e-9)
    torch.testing.assert_close(small_fit(data=sums).phi, own.phi)
    assert not np.array_equal(Y, problem.Y)


def test_covariance_of_the_prior_is_permuted_with_the_columns() -> None:
    """A Euclidean covariance in the caller's order means the same prior."""
    problem = small()
    factor = np.random.default_rng(1).normal(size=(30, 30)) * 0.1 * (np.abs(problem.mean).ravel()[:, None] + 1e-3)
    covariance = factor @ factor.T
    Y, mean = in_order(problem, LEE)
    one = [INERTIAL_NAMES.index(name) for name in LEE]
    columns = (10 * np.arange(3)[:, None] + one).ravel()
    own = small_fit(prior=RowsPrior(problem.mean, "euclidean", covariance=covariance))
    turned = RowsPrior(mean, "euclidean", covariance=covariance[columns][:, columns])
    fit = small_fit(prior=turned, data=(Y, problem.F), order=LEE)
    torch.testing.assert_close(fit.phi, own.phi[:, one], rtol=1e-6, atol=1e-9)
    expected = np.linalg.inv(problem.Y.T @ problem.Y + np.linalg.inv(covariance))
    assert own.phi_sd is not None
    np.testing.assert_allclose(own.phi_sd.flatten(), np.sqrt(np.diag(expected)), rtol=1e-5)


@pytest.mark.parametrize("kind", ["pullback", "entropic"])
def test_total_mass_exact_and_weighed(kind: str) -> None:
    """An exact mass is met and has no deviation; a weighed one tends to it as its deviation shrinks."""
    prior, total = RowsPrior(small().mean, kind, 0.3), 1.1 * float(small().truth[:, 0].sum())
    free = small_fit(prior=prior)
    exact = small_fit(prior=prior, limits=Limits(total_mass=total))
    weak, strong = (small_fit(prior=prior, limits=Limits(total_mass=(total, sd))) for sd in (0.3, 1e-4))
    assert free.total_mass < weak.total_mass < total
    np.testing.assert_allclose(exact.total_mass, total, rtol=1e-10)
    assert difference(strong.phi.numpy(), exact.phi.numpy()) < 1e-4
    assert difference(free.phi.numpy(), exact.phi.numpy()) > 1e-2
    assert exact.covariance is not None and strong.covariance is not None
    assert float(exact.covariance[::10, ::10].sum()) < 1e-8 < float(free.covariance[::10, ::10].sum())  # type: ignore[index]
    torch.testing.assert_close(exact.phi_sd, strong.phi_sd, rtol=1e-3, atol=1e-5)


def test_noise_scales_the_rows() -> None:
    """Rows in other units with their noise stated are the whitened rows; the evidence finds the noise itself."""
    problem, own = small(), small_fit()
    data = 50 * problem.Y, 50 * problem.F
    fit = small_fit(data=data, noise_sd=50.0)
    torch.testing.assert_close(fit.phi, own.phi, rtol=1e-8, atol=1e-11)
    torch.testing.assert_close(fit.phi_sd, own.phi_sd, rtol=1e-8, atol=0.0)
    np.testing.assert_allclose(fit.residual_rms, 50 * own.residual_rms, rtol=1e-8)
    found = small_fit(data=data, noise_sd="estimated", weight="evidence")
    assert 35.0 < found.noise_sd < 70.0 and 0.1 < found.weight < 100.0
    held = small_fit(data=data, noise_sd=50.0, weight="evidence", limits=Limits(total_mass=own.total_mass))
    assert 0.1 < held.weight < 100.0


def test_without_limits_the_fit_is_least_squares() -> None:
    """With neither LMI nor ellipsoids the Euclidean fit is the ridge solution, physical or not."""
    problem = small()
    prior = RowsPrior(problem.mean, "euclidean", 0.3)
    stacked = np.vstack([problem.Y, np.eye(30) / 0.3])
    target = np.concatenate([problem.F, problem.mean.ravel() / 0.3])
    expected = np.linalg.lstsq(stacked, target, rcond=None)[0]
    fit = small_fit(prior=prior, limits=Limits(lmi=False))
    np.testing.assert_allclose(fit.phi.flatten(), expected, rtol=1e-6, atol=1e-8)


def test_limits_hold_and_are_named() -> None:
    """A box and an ellipsoid that exclude the free optimum hold with equality; a prior outside them is noted."""
    free = small_fit()
    centres = torch.stack([body.com for body in free.bodies.values()])
    box = torch.stack([centres - 0.2, centres + 0.2], dim=1)
    box[1, 0, 2] = centres[1, 2] + 0.004
    Q = ellipsoid_matrix(centres + torch.tensor([0.0, 0.0, 0.0]).double(), torch.full((3, 3), torch.inf).double())
    Q[2] = torch.from_numpy(small().Q[2])
    Q[2, 3, 3] -= 0.3
    fit = small_fit(limits=Limits(com_box=box, ellipsoids=Q), names=("thigh", "shank", "foot"))
    assert fit.at_limit == ("com_box(shank)", "ellipsoid(foot)")
    np.testing.assert_allclose(float(fit.bodies["shank"].com[2]), float(box[1, 0, 2]), atol=1e-8)
    held = float((params_to_pseudo(fit.phi[2]) * Q[2]).sum())
    assert abs(held) < 1e-8 < abs(float((params_to_pseudo(free.phi[2]) * Q[2]).sum()))
    assert [note.code for note in fit.notes] == ["rows.prior_outside_limits"]
    assert free.at_limit == () and free.notes == ()


def test_bodies_by_name() -> None:
    """Mass, centre of mass and inertia by name agree with the parameters; the tensor about the origin is Steiner's."""
    fit = small_fit(names=("thigh", "shank", "foot"))
    for k, (name, body) in enumerate(fit.bodies.items()):
        P = pseudo(fit.phi[k].numpy())
        second = P[:3, :3] - P[3, 3] * np.outer(body.com, body.com)
        np.testing.assert_allclose(body.inertia_com, np.trace(second) * np.eye(3) - second, rtol=1e-9, atol=1e-15)
        np.testing.assert_allclose(body.mass, P[3, 3])
        np.testing.assert_allclose(body.mass * body.com, P[:3, 3], atol=1e-15)
        np.testing.assert_allclose(body.inertia[0, 2], fit.phi[k, 7], rtol=1e-12)
        assert body.mass_sd == pytest.approx(float(fit.phi_sd[k, 0]))  # type: ignore[index]
        assert bool((body.com_sd > 0).all()) and name == ("thigh", "shank", "foot")[k]  # type: ignore[operator]
    assert fit.certificate.solver == "Solved" and fit.status is InertiaStatus.ACCEPTED


def test_ellipsoid_matrix() -> None:
    """The form is 1 at the centre, 0 at the ends of the axes; a uniform ellipsoid leaves two fifths of its mass."""
    R = torch.linalg.qr(torch.from_numpy(np.random.default_rng(2).normal(size=(3, 3))))[0]
    centre, axes = torch.tensor([0.1, -0.2, 0.3]).double(), torch.tensor([0.1, 0.2, 0.4]).double()
    Q = ellipsoid_matrix(centre, axes, R)

    def form(x: torch.Tensor) -> float:
        point = torch.cat([x, torch.ones(1).double()])
        return float(point @ Q @ point)

    assert form(centre) == pytest.approx(1.0)
    for k in range(3):
        assert form(centre + axes[k] * R[:, k]) == pytest.approx(0.0, abs=1e-12)
    point = torch.cat([centre, torch.ones(1).double()])
    P = torch.outer(point, point)
    P[:3, :3] += R @ torch.diag(axes**2 / 5) @ R.mT
    assert float((P * Q).sum()) == pytest.approx(0.4)


def spoiled(values: np.ndarray, place: tuple[int, ...], value: float) -> np.ndarray:
    """A copy with one entry changed."""
    copy = values.copy()
    copy[place] = value
    return copy


def prior_cases() -> dict[str, tuple[RowsPrior, str, str]]:
    mean = small().mean
    return {
        "kind": (RowsPrior(mean, "riemannian"), "rows.prior", "riemannian"),
        "shape": (RowsPrior(mean[:, :9], "pullback"), "rows.shape", r"\(3, 9\)"),
        "nan": (RowsPrior(spoiled(mean, (1, 4), np.nan), "pullback"), "rows.not_finite", r"\(1, 4\)"),
        "mass": (RowsPrior(spoiled(mean, (1, 0), -2.0), "pullback"), "rows.prior_not_physical", "body_1.*mass -2"),
        "inertia": (RowsPrior(spoiled(mean, (0, 4), 9.0), "pullback"), "rows.prior_not_physical", "body_0"),
        "scale": (RowsPrior(mean, "pullback", 0.0), "rows.prior_scale", "found: 0"),
        "scales": (RowsPrior(mean, "pullback", [1.0, 2.0]), "rows.shape", r"\(2,\)"),
        "covariance": (RowsPrior(mean, "entropic", covariance=np.eye(30)), "rows.prior_covariance", "entropic"),
        "asymmetric": (
            RowsPrior(mean, "euclidean", covariance=spoiled(np.eye(30), (0, 5), 0.5)), "rows.prior_covariance", "asym"
        ),
        "indefinite": (
            RowsPrior(mean, "euclidean", covariance=spoiled(np.eye(30), (3, 3), -1.0)), "prior.covariance", "definite"
        ),
        "text": (RowsPrior([["a"] * 10] * 3, "pullback"), "rows.array", "prior.mean"),
    }  # fmt: skip


@pytest.mark.parametrize("case", prior_cases())
def test_priors_that_cannot_be(case: str) -> None:
    """Each fault of a prior has its code, and the message holds what was found."""
    prior, code, found = prior_cases()[case]
    refused(code, found, prior=prior)


def refused(code: str, found: str, **options: Any) -> TorchidError:
    """The error, after its code and text were checked."""
    with pytest.raises(TorchidError, match=f"(?s){found}") as caught:
        small_fit(**options)
    assert caught.value.code == code
    assert caught.value.remedy or code == "rows.option"
    return caught.value


def option_cases() -> dict[str, tuple[dict[str, Any], str, str]]:
    p = small()
    Q, box = p.Q, np.stack([p.mean[:, 1:4] / p.mean[:, :1] + side for side in (-0.1, 0.1)], axis=1)
    gram, moment, square, count = p.sums
    return {
        "neither": ({"weight": None}, "rows.weight_or_bound", "weight None"),
        "both": ({"weight": 1.0, "rms_bound": 1.0}, "rows.weight_or_bound", "rms_bound 1.0"),
        "noise and bound": ({"rms_bound": 1.0, "noise_sd": 2.0}, "rows.noise_with_bound", "noise_sd 2.0"),
        "weight": ({"weight": -1.0}, "rows.option", "weight: must be"),
        "bound": ({"rms_bound": float("nan")}, "rows.option", "rms_bound: must be"),
        "noise": ({"noise_sd": 0.0}, "rows.option", "noise_sd: must be"),
        "order": ({"order": ("m", *INERTIAL_NAMES[:9])}, "rows.order", "m, m, mc_x"),
        "names": ({"names": ("a", "a", "b")}, "rows.names", "a, a, b"),
        "columns": ({"data": (p.Y[:, :20], p.F)}, "rows.shape", r"\(60, 20\)"),
        "rows": ({"data": (p.Y, p.F[1:])}, "rows.shape", r"data, F.*\(59,\)"),
        "nan": ({"data": (spoiled(p.Y, (7, 2), np.inf), p.F)}, "rows.not_finite", r"data, Y.*\(7, 2\)"),
        "right-hand side": ({"data": (p.Y, spoiled(p.F, (4,), np.nan))}, "rows.not_finite", r"data, F.*\(4,\)"),
        "three": ({"data": (gram, moment, square)}, "rows.data", "3 items"),
        "gram": ({"data": (gram[:20, :20], moment, square, count)}, "rows.shape", "data, gram"),
        "square": ({"data": (gram, moment, 0.1 * square, count)}, "equations.inconsistent", "explains"),
        "count": ({"data": (gram, moment, square, 0)}, "rows.empty", "0 rows"),
        "no rows": ({"data": (p.Y[:0], p.F[:0])}, "rows.empty", "0 rows"),
        "zero rows": ({"data": (0 * p.Y, 0 * p.F)}, "rows.no_information", "rank 0"),
        "sign": ({"data": (p.Y, -p.F)}, "rows.prior_conflict", "negative total mass"),
        "too little": ({"data": (p.Y, 0.3 * p.F), "weight": 1e9}, "rows.unexplained", "-[0-9]+ % of F' F"),
        "mass": ({"limits": Limits(total_mass=-70.0)}, "rows.total_mass", "-70"),
        "below the floor": ({"limits": Limits(total_mass=1e-6)}, "inertia.solver", "PrimalInfeasible"),
        "mass sd": ({"limits": Limits(total_mass=(70.0, 0.0))}, "rows.total_mass", "70.0, 0.0"),
        "box": ({"limits": Limits(com_box=box[:, ::-1])}, "rows.com_box", "body_0"),
        "box shape": ({"limits": Limits(com_box=box[:2])}, "rows.shape", r"\(2, 2, 3\)"),
        "ellipsoid": ({"limits": Limits(ellipsoids=spoiled(Q, (1, 3, 3), -9e9))}, "rows.ellipsoid", "body_1"),
        "inside out": ({"limits": Limits(ellipsoids=-Q)}, "rows.ellipsoid", "body_0"),
        "apart": ({"limits": Limits(com_box=box + 1.0, ellipsoids=Q)}, "rows.bounds_conflict", "body_0.*best point"),
        "floor": ({"limits": Limits(floor=0.0)}, "inertia.option", "floor"),
    }


@pytest.mark.parametrize("case", option_cases())
def test_arguments_that_cannot_be(case: str) -> None:
    """Each fault of data, weights and limits has its code, and the message holds what was found."""
    options, code, found = option_cases()[case]
    if "rms_bound" in options:
        options = {"rms_bound": options["rms_bound"], **options}
    if code in ("rows.option", "inertia.option"):
        with pytest.raises(ConfigError, match=found) as caught:
            small_fit(**options)
        assert caught.value.code == code
    else:
        refused(code, found, **options)


def test_box_may_touch_its_ellipsoid() -> None:
    """A box that holds part of the ellipsoid is accepted, however little."""
    Q = ellipsoid_matrix(torch.zeros(3, 3).double(), torch.full((3, 3), 0.5).double())
    box = np.array([[[0.49, -1.0, -1.0], [1.0, 1.0, 1.0]]] * 3)
    fit = small_fit(limits=Limits(com_box=box, ellipsoids=Q), refuse=False)
    assert {f"com_box(body_{k})" for k in range(3)} <= set(fit.at_limit)
    refused("rows.bounds_conflict", "body_0", limits=Limits(com_box=box + np.array([0.02, 0.0, 0.0]), ellipsoids=Q))


def test_a_solver_that_lies_is_not_believed(monkeypatch: pytest.MonkeyPatch) -> None:
    """A point off the optimum that is called solved is refused, or told by the status to who asks."""
    honest = cone.project

    def dishonest(*args: Any, **options: Any) -> cone.ConeSolution:
        solution = honest(*args, **options)
        return replace(solution, x=solution.x * (1 + 1e-3))

    monkeypatch.setattr("torchid.inertia.cone.project", dishonest)
    refused("rows.not_optimal", "residuals")
    assert small_fit(refuse=False).status is InertiaStatus.NOT_OPTIMAL


def test_rows_beyond_what_rounding_carries_are_not_called_fitted() -> None:
    """A weight that drowns the prior leaves the solver short of its tolerance, and that is told."""
    fit = small_fit(weight=1e13, limits=one_tight(), refuse=False)
    assert fit.status is InertiaStatus.NOT_OPTIMAL
    (said,) = [note.message for note in fit.notes if note.code == "inertia.solver_retry"]
    assert "3 settings" in said and "AlmostSolved" in said
    refused("rows.not_optimal", "residuals", weight=1e13, limits=one_tight())


def test_a_program_that_breaks_down_is_not_called_infeasible() -> None:
    """Where Clarabel gives up on the entropic program, the error says that, and not that nothing fulfils the limits."""
    error = refused("inertia.solver", "solver_error", prior=RowsPrior(small().mean, "entropic", 0.3), weight=1e12)
    assert "there may be some" in error.message and "quadratic" in error.remedy


def one_tight() -> Limits:
    """The limbs' ellipsoids, the second so small that it holds with equality."""
    return Limits(ellipsoids=spoiled(small().Q, (1, 3, 3), float(small().Q[1, 3, 3]) - 0.3))


def test_a_bound_is_met_without_the_cone_program(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where the solver breaks down on the second-order cone, steps of the multiplier alone meet the bound."""
    options: dict[str, Any] = {"rms_bound": 2.0, "limits": one_tight()}
    own, honest = small_fit(**options), cone.clarabel_solve

    def breaks(*args: Any) -> Any:
        if "SecondOrder" in str(args[-1]):
            return SimpleNamespace(status="NumericalError"), 3
        return honest(*args)

    monkeypatch.setattr("torchid.inertia.cone.clarabel_solve", breaks)
    fit = small_fit(**options)
    assert own.at_limit and own.weight < float("inf")
    torch.testing.assert_close(fit.phi, own.phi, rtol=1e-7, atol=1e-10)
    np.testing.assert_allclose(fit.residual_rms, 2.0, rtol=1e-8)


def test_a_wrong_guess_of_what_is_touched_is_mended(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever rows the solver's multipliers point at, Newton steps end with those that hold with equality."""
    prior = RowsPrior(small().mean, "entropic", 0.3)
    own, honest = small_fit(prior=prior, limits=one_tight()), entropic.solve_program
    assert 0 < len(own.at_limit) < 3
    for guess in (np.zeros(3), np.ones(3)):

        def guessing(*args: Any, guess: np.ndarray = guess) -> Any:
            return honest(*args)[0], guess

        monkeypatch.setattr("torchid.inertia.entropic.solve_program", guessing)
        fit = small_fit(prior=prior, limits=one_tight())
        assert fit.at_limit == own.at_limit
        torch.testing.assert_close(fit.phi, own.phi, rtol=1e-8, atol=1e-11)
    # With too few rounds to mend the guess, the certificate tells.
    monkeypatch.setattr("torchid.inertia.entropic._ROUNDS", 1)
    refused("rows.not_optimal", "residuals", prior=prior, limits=one_tight())


def test_the_page_runs(capsys: pytest.CaptureFixture[str]) -> None:
    """Every example of the manual runs as printed, and says what the page says that it says."""
    text = PAGE.read_text(encoding="utf-8")
    codes = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    for code in codes:
        exec(compile(code, str(PAGE), "exec"), {})  # the manual's own code, not a user's
    printed = re.findall(r"```text\n(.*?)```", text, re.DOTALL)
    assert codes and capsys.readouterr().out == "".join(printed)
