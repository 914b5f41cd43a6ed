"""From an identified body to a verdict, and the model extended by it."""

from collections.abc import Callable
from dataclasses import replace

from torchid.diagnosis.candidates.marker_faults import EXCHANGED
from torchid.diagnosis.diagnose import select_effects
from torchid.diagnosis.verdict.records import Diagnosis
from torchid.extension.diagnosing import diagnose_outcome
from torchid.extension.model_free_checks import with_witnesses
from torchid.extension.other_proofs import marker_faults
from torchid.extension.publishing import publishable
from torchid.extension.statements import panel_of
from torchid.extension.swapped_markers import put_right, swap_causes
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

    def judged(some: Outcome, searching: bool = True) -> Diagnosis | None:
        return diagnose_outcome(some, folder.room, panel_of(some), earlier, searching)

    def put_right_in(some: Outcome) -> tuple[Outcome, Outcome]:
        return put_right(some, judged, folder, key, progress)

    progress("diagnosis", 0.0)
    if _names_told(outcome) and (found := _names_first(outcome, judged, put_right_in, folder, key)) is not None:
        base, relabelled = found
    else:
        verdict = folder.stage("diagnosis", key, lambda: judged(outcome))
        base = relabelled = replace(outcome, diagnosis=verdict)
        if verdict is not None and verdict.causes:
            base, relabelled = put_right_in(base)
    progress("diagnosis", 1.0)
    if base.diagnosis is None or not base.diagnosis.causes:
        return base
    published = publishable(base, relabelled, folder, key, progress)
    assert published.diagnosis is not None
    if published.diagnosis.causes:
        with folder.timed("witnesses"):
            verdict = with_witnesses(outcome, published.diagnosis)
        base = None if published.base is None else replace(published.base, diagnosis=verdict)
        published = replace(published, base=base, diagnosis=verdict)
    return published


def _names_told(outcome: Outcome) -> bool:
    wanted = outcome.config.diagnosis
    if EXCHANGED not in select_effects(wanted.include, wanted.exclude):
        return False
    return any(one.effect is EXCHANGED for one in marker_faults(outcome))


def _names_first(
    outcome: Outcome, judged: Callable[[Outcome, bool], Diagnosis | None],
    put_right_in: Callable[[Outcome], tuple[Outcome, Outcome]], folder: OutputFolder, key: str,
) -> tuple[Outcome, Outcome] | None:  # fmt: skip
    """Names that distances alone tell are put right before anything is searched.

    None where the search behind it takes them back, or names more: all of these are to be put right before it.
    """
    verdict = folder.stage("diagnosis_names", key, lambda: judged(outcome, False))
    if verdict is None:
        return None
    base, relabelled = put_right_in(replace(outcome, diagnosis=verdict))
    assert relabelled.diagnosis is not None
    return None if relabelled is base or swap_causes(relabelled.diagnosis.likely) else (base, relabelled)
