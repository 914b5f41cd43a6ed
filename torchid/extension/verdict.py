"""From an identified body to a verdict that stands: what was found beside a void correction is asked again."""

from dataclasses import replace

from torchid.diagnosis.verdict.records import Diagnosis, Refuted
from torchid.extension.laboratory import diagnosed, unfounded
from torchid.extension.model_free_checks import with_witnesses
from torchid.extension.publishing import publishable
from torchid.extension.swapped_markers import put_right
from torchid.session import Outcome
from torchid.session.fitting import OnStage
from torchid.storage.provenance import stage_key
from torchid.storage.results import OutputFolder


def with_verdict(
    outcome: Outcome, folder: OutputFolder, key: str, progress: OnStage, refuted: tuple[Refuted, ...] = ()
) -> Outcome:
    """Return the outcome with its verdict, and the model extended by it.

    Where witnesses named a fault that the extended model refutes, all is looked for again without it.

    Args:
        outcome: up to the inertia.
        folder: for stages.
        key: of all that these depend on.
        progress: called with stages and fractions.
        refuted: faults that witnesses named and that did not stand.

    Raises:
        ConfigError: ``diagnosis.include`` or ``exclude`` names no effect.
    """

    def judged(some: Outcome) -> Diagnosis | None:
        return diagnosed(some, folder, progress, refuted)

    progress("diagnosis", 0.0)
    stage, own = "diagnosis", key
    if refuted:
        stage, own = f"diagnosis_{len(refuted)}", stage_key(key=key, refuted=list(refuted))
    verdict = folder.stage(stage, own, lambda: judged(outcome))
    progress("diagnosis", 1.0)
    published = replace(outcome, diagnosis=verdict)
    if verdict is not None and verdict.causes:
        published = publishable(*put_right(published, judged, folder, own, progress), folder, own, progress)
        assert published.diagnosis is not None
        if void := unfounded(published.diagnosis):
            return with_verdict(outcome, folder, key, progress, (*refuted, *void))
    return _with_testimony(outcome, published, refuted, folder)


def _with_testimony(
    outcome: Outcome, published: Outcome, refuted: tuple[Refuted, ...], folder: OutputFolder
) -> Outcome:
    """The published model, on its verdict what witnesses say of every cause, and what had been refuted before."""
    if published.diagnosis is None:
        return published
    verdict = replace(published.diagnosis, refuted=(*refuted, *published.diagnosis.refuted))
    if verdict.causes:
        with folder.timed("witnesses"):
            verdict = with_witnesses(outcome, verdict)
    base = None if published.base is None else replace(published.base, diagnosis=verdict)
    return replace(published, base=base, diagnosis=verdict)
