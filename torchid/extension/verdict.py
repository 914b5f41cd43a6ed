"""From an identified body to a verdict, and the model extended by it."""

from dataclasses import replace

from torchid.diagnosis.verdict.records import Diagnosis
from torchid.extension.diagnosing import diagnose_outcome
from torchid.extension.model_free_checks import with_witnesses
from torchid.extension.publishing import publishable
from torchid.extension.statements import panel_of
from torchid.extension.swapped_markers import put_right
from torchid.session import Outcome
from torchid.session.fitting import OnStage
from torchid.session.laboratory import earlier_sessions
from torchid.storage.results import OutputFolder


def with_verdict(outcome: Outcome, folder: OutputFolder, key: str, progress: OnStage) -> Outcome:
    """Return the outcome with its verdict, and the model extended by it.

    Args:
        outcome: up to the inertia.
        folder: for stages.
        key: of all that these depend on.
        progress: called with stages and fractions.

    Raises:
        ConfigError: ``diagnosis.include`` or ``exclude`` names no effect.
        InputError: ``laboratory.unreadable``, ``form``, ``one_session`` or ``other_plates``: what ``laboratory``
            names says nothing of this session.
    """

    earlier = earlier_sessions(outcome.config.laboratory, outcome.session)

    def judged(some: Outcome) -> Diagnosis | None:
        return diagnose_outcome(some, folder.room, panel_of(some), earlier)

    progress("diagnosis", 0.0)
    verdict = folder.stage("diagnosis", key, lambda: judged(outcome))
    progress("diagnosis", 1.0)
    published = replace(outcome, diagnosis=verdict)
    if verdict is None or not verdict.causes:
        return published
    published = publishable(*put_right(published, judged, folder, key, progress), folder, key, progress)
    assert published.diagnosis is not None
    if published.diagnosis.causes:
        with folder.timed("witnesses"):
            verdict = with_witnesses(outcome, published.diagnosis)
        base = None if published.base is None else replace(published.base, diagnosis=verdict)
        published = replace(published, base=base, diagnosis=verdict)
    return published
