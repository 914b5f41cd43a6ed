"""What is open of the geometry is in the deviations of the inertia."""

from dataclasses import replace

import pytest
import small_session as small
import torch
from torch.testing import assert_close

from torchid.diagnosis.columns.design import Design, Terms
from torchid.diagnosis.evidence.model import LinearModel
from torchid.diagnosis.evidence.noise import initial_noise
from torchid.diagnosis.evidence.prior import Prior
from torchid.diagnosis.evidence.spectra import TrialSpectra
from torchid.dynamics.rows import WrenchTrial
from torchid.dynamics.whitening import BlockSpectrum, Whitening, frequencies, initial_whitening
from torchid.extension.open_geometry import open_share, with_open_geometry
from torchid.run.torque_bands import seen_trials
from torchid.torque.bodies import draw_bodies

INERTIAL, NUISANCES, KEPT = 20, 4, 40


@pytest.mark.parametrize(("mass", "noisy"), [(None, False), ((70.0, 0.1), False), (None, True)])
def test_what_nuisances_move_an_estimate_by_is_its_share(seed, mass, noisy):
    """Estimates of rows that each draw of the nuisances has made scatter, noise aside, by the share that is said."""
    generator = torch.Generator().manual_seed(seed)
    normal = lambda *shape: torch.randn(*shape, generator=generator, dtype=torch.float64)  # noqa: E731
    Y, frequency = normal(6, INERTIAL + NUISANCES, KEPT), frequencies(2 * KEPT, KEPT, 20.0)
    factor, scale = torch.linalg.cholesky(torch.eye(INERTIAL).double() + 0.1), 0.1 + normal(NUISANCES).square()
    prior = Prior(torch.zeros(INERTIAL + NUISANCES).double(), factor, scale)
    rows = TrialSpectra((BlockSpectrum(Y, Y[:, 0], frequency),), Terms(torch.arange(INERTIAL + NUISANCES), None))
    whitening = initial_whitening(torch.zeros(()).double())
    design = Design(INERTIAL, INERTIAL + NUISANCES, (), (), ())
    model = LinearModel((rows,), prior, design, initial_noise(whitening, 1))

    white, _ = Whitening(whitening.covariance)(BlockSpectrum(Y, Y[:, 0], frequency))
    R = torch.eye(INERTIAL).double() - (0.3 + 0.1 * normal(INERTIAL, INERTIAL) if noisy else 0.0)
    Y = white[:, :INERTIAL] @ R
    information = Y.T @ Y + torch.linalg.inv(factor @ factor.T)
    if mass is not None:
        lever = torch.zeros(INERTIAL).double()
        lever[::10] = 1.0 / mass[1]
        information = information + lever[:, None] * lever
    drawn = white[:, INERTIAL:] @ (scale * normal(4000, NUISANCES)).T
    moved = torch.linalg.solve(information, Y.T @ drawn)
    found = open_share(model, mass, R if noisy else None)
    twice = replace(model, rows=(replace(rows, forces=2 * rows.forces),))
    assert_close(open_share(model, mass, R if noisy else None, 2.0), open_share(twice, mass, R if noisy else None))
    assert_close(found.diagonal().sqrt(), moved.std(1), rtol=0.08, atol=1e-9)
    spread = found.diagonal().sqrt()
    assert_close(found / spread / spread[:, None], torch.corrcoef(moved), rtol=0.0, atol=0.1)


def test_a_run_says_what_its_geometry_leaves_open():
    """Deviations of a run are those of its rows and more; torques, whose draws move geometry themselves, know both."""
    identified = small.outcome().identified
    assert identified is not None and identified.given_motion is not None
    more = identified.fit.covariance - identified.given_motion
    assert float(torch.linalg.eigvalsh(more)[0]) > -1e-9 * float(more.diagonal().max())
    assert bool((more.diagonal() > 0.0).all())
    assert_close(identified.fit.sd.phi.flatten().square(), identified.fit.covariance.diagonal())
    outcome, generator = small.outcome(), torch.Generator()
    each = [identified, replace(identified, fit=replace(identified.fit, covariance=identified.given_motion))]
    trials = [replace(one, rows=None) for one in seen_trials(outcome, list(outcome.session.fit("inertia")))]
    drawn = [draw_bodies(outcome.fit, one, outcome.phi, trials, 3, generator.manual_seed(1)) for one in each]
    assert_close(drawn[0].phi, drawn[1].phi)


def test_base_parameters_are_as_sure_as_what_they_are_made_of():
    """The sum of all masses, a base parameter, has the deviation of the total mass."""
    identified = small.outcome().identified
    assert identified is not None and identified.fit.base is not None
    fit, base = identified.fit, identified.fit.base
    masses = torch.zeros_like(base.matrix[0])
    masses[::10] = 1.0
    (k,) = (base.matrix - masses).abs().amax(1).lt(1e-6).nonzero()[:, 0].tolist()
    assert float(base.sd[k]) == pytest.approx(fit.sd.total_mass, rel=1e-6)


def test_without_inertia_there_is_nothing_to_widen():
    """An outcome without an identified body, or with rows at the ends of trials alone, stays as it is."""
    outcome = small.outcome()
    bare = replace(outcome, identified=None)
    assert with_open_geometry(bare) is bare
    followed = {name: replace(one, wrench=_begun(one.wrench)) for name, one in outcome.followed.items()}
    short = replace(outcome, followed=followed)
    assert with_open_geometry(short).identified is short.identified


def _begun(rows: WrenchTrial | None) -> WrenchTrial | None:
    """The rows with the first frames alone used."""
    return None if rows is None else replace(rows, used=rows.used & (torch.arange(len(rows.used)) < 16))
