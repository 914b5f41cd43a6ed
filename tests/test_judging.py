"""Figures of a run beside their norms: which decides, and how they are said."""

from dataclasses import replace

import pytest
import torch
from report_run import TRIAL, Run, figure, finished_run

from torchid.session.judging import quality_of
from torchid.session.outcome import Quality, QualityLevel


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
