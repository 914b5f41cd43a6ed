"""Choice of the weights of data and prior."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from inertia_cases import bodies, chain_rows, draw, names, prior
from rates import leeway
from scipy.stats import multivariate_normal

from torchid.dynamics.row_equations import NormalEquations
from torchid.errors import ConfigError, DataError
from torchid.inertia.fit import fit_inertia
from torchid.inertia.options import InertiaOptions
from torchid.inertia.spectrum import diagonalise
from torchid.inertia.weights import log_evidence, maximise_evidence
from torchid.model.pseudo import pseudo_to_params


def test_log_evidence_is_the_marginal_likelihood(seed: int) -> None:
    """Differences of log evidence equal those of the dense Gaussian density of the rows and the weighed mass."""
    given = prior(bodies(2), 0.2)
    Y = chain_rows(2, 8, seed)
    F = Y @ draw(given).flatten() + torch.randn(len(Y), dtype=torch.float64)
    total = float(given.mean[:, 0].sum())
    spectrum = diagonalise(NormalEquations.from_rows(Y, F), given.mean.flatten(), given.covariance, (total + 1, 0.7))
    row = torch.zeros(1, 20, dtype=torch.float64)
    row[0, ::10] = 1 / 0.7
    rows, values = torch.cat([Y, row]), torch.cat([F, torch.tensor([(total + 1) / 0.7])])

    def dense(omega_1: float, omega_2: float) -> float:
        noise = torch.full((len(rows),), 1 / omega_1, dtype=torch.float64)
        noise[-1] = 1
        covariance = rows @ (given.covariance / omega_2) @ rows.mT + torch.diag(noise)
        return float(multivariate_normal((rows @ given.mean.flatten()).numpy(), covariance.numpy()).logpdf(values))

    points = [(1.0, 1.0), (0.3, 2.0), (2.0, 0.1)]
    ours = np.array([log_evidence(spectrum, *point)[0] for point in points])
    theirs = np.array([dense(*point) for point in points])
    np.testing.assert_allclose(ours - ours[0], theirs - theirs[0], rtol=1e-6, atol=1e-6)


def test_log_evidence_slopes(seed: int) -> None:
    """Analytic slopes equal central differences in log omega."""
    given = prior(bodies(3), 0.2)
    Y = chain_rows(3, 30, seed)
    F = Y @ draw(given).flatten() + torch.randn(len(Y), dtype=torch.float64)
    equations = NormalEquations.from_rows(Y, F)
    spectrum = diagonalise(equations, given.mean.flatten(), given.covariance, (20.0, 0.5))
    point, step = np.log([0.7, 1.8]), 1e-5
    slopes = log_evidence(spectrum, *np.exp(point))[1:]
    for axis in range(2):
        shift = step * np.eye(2)[axis]
        up, down = (log_evidence(spectrum, *np.exp(point + s * shift))[0] for s in (1, -1))
        np.testing.assert_allclose(slopes[axis], (up - down) / (2 * step), rtol=1e-5, atol=1e-4)


def test_evidence_finds_noise_and_scatter_and_intervals_cover(seed: int) -> None:
    """For subjects drawn from a prior twice as tight as stated, both weights are right and 95 % intervals cover."""
    noise, tight, draws = 1.0, 4.0, 80
    Y = chain_rows(4, 60, seed)
    omega_1, omega_2, inside = [], [], []
    for _ in range(draws):
        stated = prior(bodies(4), 0.2)
        truth = draw(prior(stated.mean, 0.2 / tight**0.5))
        F = Y @ truth.flatten() + noise * torch.randn(len(Y), dtype=torch.float64)
        equations = NormalEquations.from_rows(Y, F)
        options = InertiaOptions(prior_weight="evidence", lmi=False, base_parameters=False)
        fit = fit_inertia(equations, stated, names(4), options)
        omega_1.append(fit.omega_1)
        omega_2.append(fit.omega_2)
        inside.append(float(((fit.phi - truth).abs() < 1.96 * fit.sd.phi).double().mean()))
    np.testing.assert_allclose(np.median(omega_1) * noise**2, 1, rtol=0.1)
    # A factor of two, half of what tight is: motions that show few directions tell the scatter from few.
    assert 0.5 < np.median(omega_2) / tight < 2.0
    # Within a subject parameters are right or wrong together: subjects, not parameters, are counted.
    allowed = leeway(inside)
    assert 0.90 - allowed < np.mean(inside) < 0.985 + allowed


def test_cross_validation_trusts_a_right_prior_more_than_a_wrong_one(seed: int) -> None:
    """Over three sessions, the weight chosen across trials is larger for a prior centred on the truth than far off."""
    options = InertiaOptions(prior_weight="cross_validation", prior_weight_range=(1e-3, 1e3), refuse=False)
    ratio = []
    for session in range(3):
        right = prior(bodies(3), 0.1)
        trials = []
        for k in range(4):
            Y = chain_rows(3, 30, seed + 4 * session + k) / 10
            F = Y @ right.mean.flatten() + torch.randn(len(Y), dtype=torch.float64)
            trials.append(NormalEquations.from_rows(Y, F))
        total, wrong = sum(trials[1:], trials[0]), prior(3 * right.mean, 0.1)
        chosen = [fit_inertia(total, given, names(3), options, trials=trials).omega_2 for given in (right, wrong)]
        ratio.append(chosen[0] / chosen[1])
    assert float(np.exp(np.mean(np.log(ratio)))) > 5
    with pytest.raises(ConfigError, match=r"two fit trials.*found: 1\).*inertia\.cross_validation"):
        fit_inertia(total, right, names(3), options, trials=trials[:1])


@pytest.mark.parametrize("square", [0.0, -1e-9])
def test_data_that_equal_the_prediction_give_the_least_noise(seed: int, square: float) -> None:
    """Whatever rounding leaves of the residual at the prior mean, zero and less among it, the noise is its least."""
    given, Y = prior(bodies(3), 0.1), chain_rows(3, 30, seed)
    equations = NormalEquations.from_rows(Y, Y @ given.mean.flatten())
    spectrum = replace(diagonalise(equations, given.mean.flatten(), given.covariance, None), square=square)
    found = maximise_evidence(spectrum, None, None, (1.0, 1e3))
    least = spectrum.rows / spectrum.smallest
    assert 0.1 * least < found.omega_1 <= 1.001 * least and found.omega_2 > 100.0


def test_rows_of_zeros_have_no_noise_to_estimate(seed: int) -> None:
    """Where right-hand sides and predictions are zero, no noise is made up; a noise that is stated does."""
    given = prior(pseudo_to_params(torch.eye(4, dtype=torch.float64)[None]), 0.1)
    Y = torch.zeros(6, 10, dtype=torch.float64)
    Y[:, 1] = torch.randn(6, dtype=torch.float64)  # asks for the centre of mass, which the prior has at the origin
    equations = NormalEquations.from_rows(Y, torch.zeros(6, dtype=torch.float64))
    with pytest.raises(DataError, match=r"cannot be estimated.*6 rows.*inertia\.no_noise"):
        fit_inertia(equations, given, names(1))
    known = InertiaOptions(noise="known", refuse=False)
    torch.testing.assert_close(fit_inertia(equations, given, names(1), known).phi, given.mean)


@pytest.mark.parametrize(("scale", "end"), [(1.0001, 1e2), (3.0, 1e-2)])
def test_a_weight_at_an_end_of_its_range_is_said(seed: int, scale: float, end: float) -> None:
    """Data of the prior's own mean ask for any weight, data far off for none: the range decides, and is named."""
    given, Y = prior(bodies(3), 0.1), chain_rows(3, 30, seed)
    equations = NormalEquations.from_rows(Y, scale * Y @ given.mean.flatten())
    options = InertiaOptions(
        prior_weight="evidence", noise="known", prior_weight_range=(1e-2, 1e2), refuse=False, base_parameters=False
    )
    fit = fit_inertia(equations, given, names(3), options)
    np.testing.assert_allclose(fit.omega_2, end, rtol=1e-3)
    (said,) = [note.message for note in fit.notes if note.code == "inertia.prior_weight_at_bound"]
    assert f"{end:.3g} lies at an end" in said and "(0.01, 100.0)" in said
