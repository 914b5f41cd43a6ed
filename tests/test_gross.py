"""Weight that something beside the plates bears is seen by its size, where it is borne and when."""

from dataclasses import replace

import numpy as np
import pytest
import small_session as small
import torch
from draws import seed_of
from torch.testing import assert_close

from torchid.diagnosis.candidates.missing_weight import find_missing_weight, set_aside
from torchid.diagnosis.options import MissingWeightOptions
from torchid.effects.place import Interval, Place, within
from torchid.effects.scene import at_origin
from torchid.observation.trial import TrialObservation
from torchid.recording import Forces

pytestmark = pytest.mark.slow

SEED = seed_of(__name__)


@pytest.fixture
def trial() -> TrialObservation:
    return small.observed()["squats"]


def seen(trial: TrialObservation, forces: Forces):
    item = small.outcome().followed[trial.rows.name]
    assert item.contact is not None
    return find_missing_weight(trial, forces, item.contact, item.tracked.observable)


def plates(trial: TrialObservation) -> Forces:
    forces = small.outcome().session.trials[trial.rows.name].forces
    assert forces is not None
    return forces


def centre(trial: TrialObservation, segment: str) -> torch.Tensor:
    scene = trial.view.scene
    return scene.point(segment, scene.centre(segment)).p


def interval(trial: TrialObservation, rng: np.random.Generator) -> Interval:
    time = trial.rows.motion.time
    length = rng.uniform(0.6, 1.2)
    t0 = float(time[0]) + rng.uniform(0.4, float(time[-1] - time[0]) - length - 0.4)
    return Interval(trial.rows.name, t0, t0 + length)


def test_a_seat_is_found_where_and_when_it_bears(trial):
    """A third to two thirds of the weight on a segment that is not above the feet."""
    rng = np.random.default_rng(SEED)
    own, scene = interval(trial, rng), trial.view.scene
    shape = within(Place(("session",), (own,)), trial.rows.name, scene.time)
    between = 0.5 * (centre(trial, "foot_l") + centre(trial, "foot_r"))
    away = {n: float((centre(trial, n) - between)[:2, shape > 0.0].norm(dim=0).min()) for n in scene.tree.names}
    segment = max((n for n in away if not n.startswith("foot")), key=lambda n: away[n])
    assert away[segment] > MissingWeightOptions().reach_m
    weight = 9.81 * float(trial.phi[:, 0].sum())
    force = torch.tensor([rng.normal(0.0, 0.02), rng.normal(0.0, 0.02), rng.uniform(0.33, 0.67)]) * weight
    less = at_origin(centre(trial, segment), force[:, None] * shape)
    forces = plates(trial)
    wrench = forces.wrench.clone()
    wrench[:, 0] -= less.T
    found = seen(trial, replace(forces, wrench=wrench))
    assert found is not None and found.place.where == (segment,), (segment, found and found.odds)
    (when,) = found.place.when
    assert abs(when.t0 - own.t0) < 0.15 and abs(when.t1 - own.t1) < 0.15
    named = sum(found.theta.view(-1, 3)[1:-1]) / (len(found.theta) // 3 - 2)
    assert_close(named, force.to(named), rtol=0.0, atol=0.1 * weight)
    assert found.gain["force_rmse_pct"] > 50.0
    used = set_aside(trial, found.aside).rows.used
    inside = (scene.time >= own.t0) & (scene.time <= own.t1)
    assert not bool(used[inside].any()) and bool((used == trial.rows.used)[~inside].float().mean() > 0.5)


def test_plates_that_read_too_little_are_no_seat(trial):
    rng = np.random.default_rng(SEED)
    own = interval(trial, rng)
    shape = within(Place(("session",), (own,)), trial.rows.name, trial.view.scene.time)
    forces = plates(trial)
    part = 1.0 - rng.uniform(0.35, 0.7) * shape
    assert seen(trial, replace(forces, wrench=part[:, None, None] * forces.wrench)) is None


def test_a_plain_recording_has_none():
    for role in ("fit", "heldout"):
        for trial in small.observed(role).values():
            assert seen(trial, plates(trial)) is None
