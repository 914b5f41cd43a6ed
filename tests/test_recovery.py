"""From files alone to a subject that is nearer to the truth than the template, every run another one."""

import pytest
import small_session as small
import torch

from torchid.dynamics.rows import residual_rms
from torchid.kinematics.chain import chain_poses

pytestmark = pytest.mark.slow


def test_held_out_residuals_come_near_the_noise():
    """On the held-out trial the force residual falls below the scaled template's, near what the truth itself leaves."""
    found = small.outcome()
    held = {row.label: row for row in found.residuals if row.role == "heldout"}
    scaled, identified = held["+ filter"], held["+ identified inertia"]
    floor, _ = residual_rms(list(small.true_rows("heldout", found.cutoff_hz)), small.session().subject.phi)
    assert identified.force_rmse_N < scaled.force_rmse_N
    assert identified.moment_rmse_Nm < 1.2 * scaled.moment_rmse_Nm
    assert identified.force_rmse_N < 3.0 * floor


def test_joint_centres_are_nearer_than_the_templates():
    """In W, over a held-out trial, joint centres of the identified model are nearer to the true ones."""
    found, item, errors = small.outcome(), small.session().trial("sway_steps"), []
    true = chain_poses(found.fit.model.tree, item.truth.motion.q, small.session().subject.geometry)[..., :3, 3]
    for fit, followed in ((found.fit, found.followed), (found.scaled, found.followed_scaled)):
        q = followed["sway_steps"].tracked.q
        errors.append(float((chain_poses(fit.model.tree, q, fit.geometry)[..., :3, 3] - true).square().mean()) ** 0.5)
    assert errors[0] < 0.7 * errors[1]


def test_total_mass_is_found():
    """The total mass is within four standard deviations, and two percent, of the true one."""
    found = small.outcome().identified
    assert found is not None
    row = torch.zeros(len(found.fit.covariance), dtype=torch.float64)
    row[::10] = 1.0
    sd = float((row @ found.fit.covariance @ row).sqrt())
    off = abs(float(found.fit.mass.sum()) - small.session().subject.mass)
    assert off < 4.0 * sd and off < 0.02 * small.session().subject.mass
