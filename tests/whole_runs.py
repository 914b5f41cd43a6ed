"""This module is what whole runs leave out in tests that do not read it."""

import pytest


def leave_out_report(patch: pytest.MonkeyPatch) -> None:
    """Runs write no report, and make no replay for it: a quarter of a small run.

    Args:
        patch: as long as it holds.
    """
    patch.setattr("torchid.run.sequence.write_report", lambda *_: None)
    patch.setattr("torchid.run.sequence._replay", lambda *_: None)


def write_tables_alone(patch: pytest.MonkeyPatch) -> None:
    """Runs write no report and no series of their trials, another eighth: what they found is in tables and outcome.

    Args:
        patch: as long as it holds.
    """
    leave_out_report(patch)
    patch.setattr("torchid.run.write._write_trial", lambda *_: None)
