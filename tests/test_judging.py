"""Figures of a run beside their norms: which decides, and how they are said."""

from dataclasses import replace

import pytest
import torch
from report_run import TRIAL, Run, figure, finished_run

from torchid.report.glance import mass_words
from torchid.session.judging import masses, quality_of
from torchid.session.outcome import Quality, QualityLevel
from torchid.session.people import subject_prior


@pytest.fixture(scope="session")
def run(tmp_path_factory) -> Run:
    """A tiny simulated session with hostile names, identified into a folder."""
    return finished_run(tmp_path_factory.getbasetemp() / "report")


def test_the_figure_that_is_the_most_times_its_norm_decides():
    """Of the worst level; a failure and what nobody saw go before all figures, what has no figure behind them."""
    small, large = figure("moment", 0.011, 0.01), figure("force_template", 0.41, 0.08)
    none = figure("heldout", float("nan"), float("nan"))
    level = QualityLevel.UNUSABLE
    assert Quality((none, small, large)).deciding is large
    unseen = figure("unseen", 0.4, 0.35)
    assert Quality((large, unseen)).deciding is unseen
    assert Quality((none,)).deciding is none and Quality(()).deciding is None
    worse = replace(small, level=level)
    assert Quality((large, worse)).deciding is worse
    failure = figure("result.mass", float("nan"), float("nan"), level)
    assert Quality((worse, failure)).deciding is failure
    assert Quality((figure("markers", 90.0, 40.0, QualityLevel.GOOD), small)).deciding is small


def test_the_farthest_marker_is_named_with_its_trial(run):
    """Held-out trials alone; a marker that is lost is none."""
    item = run.outcome.followed[TRIAL]
    error, label = item.tracked.error.clone(), run.outcome.fit.attachment.labels[3]
    error[7, 3], error[8, 4] = 0.09, torch.nan
    far = replace(item, tracked=replace(item.tracked, error=error))
    quality = quality_of(replace(run.outcome, followed={**run.outcome.followed, TRIAL: far}))
    (shown,) = [one.shown for one in quality.criteria if one.name == "marker_max"]
    assert shown == f"held-out marker {label} 90 mm from the model in {TRIAL}"


def test_a_better_prediction_than_with_tables_is_called_better(run):
    """Held against the same model with its masses ten times those of tables."""
    prior = replace(run.outcome.prior_scaled, mean=10.0 * run.outcome.prior_scaled.mean)
    quality = quality_of(replace(run.outcome, prior_scaled=prior))
    shown = {one.name: one.words for one in quality.criteria}
    assert "% better than with a scaled model and masses of tables (norm 8 % worse" in shown["force_template"]
    assert shown["moment_template"].startswith("held-out moments are predicted ")


def test_a_mass_that_nothing_bears_out_is_held_against_tables(run):
    """Without a record and without standing: what is nobody's of that stature is said, with what tells it."""
    who = run.outcome.config.subject.model_copy(update={"mass_kg": None, "height_m": 1.75})
    session = replace(
        run.outcome.session,
        trials={name: trial for name, trial in run.outcome.session.trials.items() if trial.role != "static"},
    )
    bare = replace(run.outcome, config=run.outcome.config.model_copy(update={"subject": who}), session=session)
    bare = replace(bare, followed={name: bare.followed[name] for name in session.trials})
    bare = replace(bare, prior=subject_prior("whole_body", who, bare.fit))
    own = masses(bare)
    assert own.tables is not None and own.tables.value == pytest.approx(23.0 * 1.75**2) and own.tables.sd > 10.0
    assert masses(run.outcome).tables is None
    (usual,) = [one for one in quality_of(bare).criteria if one.name == "mass_tables"]
    assert usual.level is QualityLevel.GOOD
    identified = bare.identified
    assert identified is not None and own.identified is not None
    third = replace(identified, fit=replace(identified.fit, phi=0.35 * identified.fit.phi))
    (light,) = [c for c in quality_of(replace(bare, identified=third)).criteria if c.name == "mass_tables"]
    assert light.level is QualityLevel.CARE and "height and age" in light.remedy
    assert "tables have 70 ± 12 kg" in mass_words(masses(replace(bare, identified=third)), True)
