"""A result that no body could give is refused with a true sentence, and so are recordings that nobody measured."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from small_session import outcome as small_outcome

from torchid.errors import InputError
from torchid.io.missing import frame_repeats
from torchid.report.page import render_report
from torchid.run.acceptance import impossible
from torchid.session import Outcome


def with_subject(outcome: Outcome, **facts: float) -> Outcome:
    subject = outcome.config.subject.model_copy(update=facts)
    return replace(outcome, config=outcome.config.model_copy(update={"subject": subject}))


def with_markers_off(outcome: Outcome, metres: float) -> Outcome:
    followed = {
        name: replace(item, tracked=replace(item.tracked, error=item.tracked.error + metres))
        for name, item in outcome.followed.items()
    }
    return replace(outcome, followed=followed)


def with_forces_times(outcome: Outcome, factor: float) -> Outcome:
    followed = {
        name: item
        if item.wrench is None
        else replace(item, wrench=replace(item.wrench, wrench=item.wrench.wrench * factor))
        for name, item in outcome.followed.items()
    }
    return replace(outcome, followed=followed)


@pytest.mark.slow
def test_only_what_a_body_could_give_is_accepted():
    """A sound result is; markers beside the model, twice the mass and forces that the motion does not need are not."""
    outcome = small_outcome()
    assert impossible(outcome) is None
    mass = float(outcome.phi[:, 0].sum())
    for wrong, code in (
        (with_markers_off(outcome, 0.1), "result.markers"),
        (with_subject(outcome, mass_kg=0.5 * mass), "result.mass"),
        (with_forces_times(outcome, -0.3), "result.residuals"),
    ):
        failure = impossible(wrong)
        assert failure is not None and failure.code == code and failure.exit_code == 3
        assert failure.remedy.startswith("Most likely") and failure.found


@pytest.mark.slow
def test_the_report_does_not_praise_what_it_refuses():
    """Its first sentence says that the result is not to be used."""
    wrong = with_markers_off(small_outcome(), 0.1)
    page = render_report(wrong, impossible(wrong))
    assert "No body could give this result" in page and "times closer" not in page.split("</section>")[0]


def test_copied_frames_are_refused(seed):
    """Every frame twice, and a trial of motion in which nothing moves; noise alone is motion enough."""
    random = np.random.default_rng(seed)
    position = random.normal(size=(60, 8, 3)).cumsum(axis=0)
    frame_repeats(position, "right")
    gaps = np.where(random.uniform(size=(60, 8, 1)) < 0.2, np.nan, position)
    frame_repeats(gaps, "right, with gaps")
    for copied, code in (
        (np.repeat(position, 2, axis=0), "markers.doubled"),
        (position[:1].repeat(60, 0), "markers.still"),
    ):
        with pytest.raises(InputError) as caught:
            frame_repeats(copied, "x")
        assert caught.value.code == code


def test_a_lost_frame_now_and_then_is_no_doubling(seed):
    """A system that holds one frame in ten is left alone."""
    position = torch.randn(100, 8, 3, dtype=torch.float64).numpy().cumsum(axis=0)
    position[10::10] = position[9:-1:10]
    frame_repeats(position, "x")


def test_single_copies_amid_motion_are_said(seed):
    """One to three frames that repeat the one before are named; in slow whole numbers they may be right."""
    random = np.random.default_rng(seed)
    position = np.sin(np.arange(100)[:, None, None] / 20.0 + random.uniform(0.0, 6.0, (1, 8, 3)))
    frames = sorted(random.choice(np.arange(4, 96, 4), int(random.integers(1, 4)), replace=False).tolist())
    for frame in frames:
        position[frame] = position[frame - 1]
    (note,) = frame_repeats(position, "x")
    assert note.code == "markers.repeated" and f"({', '.join(str(k + 1) for k in frames)})" in note.message
    assert frame_repeats(np.round(position, 1), "coarse") == []


def test_a_walk_through_that_is_seen_for_half_the_time_is_no_copy(seed):
    """Frames without any marker say nothing about the others."""
    position = torch.randn(200, 8, 3, dtype=torch.float64).numpy().cumsum(axis=0)
    position[:100] = np.nan
    frame_repeats(position, "x")
