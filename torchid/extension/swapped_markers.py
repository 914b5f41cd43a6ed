"""Markers that carry each other's name, given back their own, and what is seen then.

Swapped markers bend postures, which no column is linear in, and the geometry: with the swap named, skin slid on that
segment and its joints' centres glided. So all is fitted again with the names put right, and all else looked for then.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

from torchid.checks.marker_tracks.statement import TrackFault, TrackStatement
from torchid.diagnosis.options import DiagnosisOptions
from torchid.diagnosis.trace import StepKind, TraceStep
from torchid.diagnosis.verdict.causes import after_forces
from torchid.diagnosis.verdict.confidence import trust
from torchid.diagnosis.verdict.records import Cause, Diagnosis
from torchid.effects.catalogue import effect
from torchid.effects.place import inside_any
from torchid.effects.traits import Correction
from torchid.geometry.tracking import Tracked, track
from torchid.recording import Trial
from torchid.session import Outcome, Session
from torchid.session.fitting import OnStage, fit_session, identify
from torchid.session.following import Following
from torchid.session.people import subject_prior
from torchid.session.standing import follow_session
from torchid.storage.provenance import stage_key
from torchid.storage.results import OutputFolder


def put_right(
    base: Outcome, diagnosed: Callable[[Outcome], Diagnosis | None], folder: OutputFolder, key: str, progress: OnStage
) -> tuple[Outcome, Outcome]:
    """All is looked for anew beside the swaps that a verdict names.

    Args:
        base: with the first verdict on it.
        diagnosed: gives the verdict on an outcome up to the inertia.
        folder: for stages.
        key: of all that these depend on.
        progress: called with stages and fractions.

    Returns:
        The outcome with the whole verdict; and the one with recordings and fits relabelled, its verdict what was found
        in these. Without swaps, or where one would be taken back, ``base`` twice.

    Raises:
        DataError: as ``identify``.
    """
    assert base.diagnosis is not None
    exchanged = swap_causes(base.diagnosis.likely)
    if not exchanged:
        return base, base
    key = stage_key(before=key, swaps=[(one.where, one.when) for one in exchanged])
    again = fitted_anew(base, exchanged, folder, key, progress)
    after = folder.stage("diagnosis_relabelled", key, lambda: diagnosed(again))
    if after is None or any(_overlap(one, other) for one in exchanged for other in swap_causes(after.causes)):
        return base, base
    return replace(base, diagnosis=merged(base.diagnosis, after, exchanged, base.config.diagnosis.thresholds)), replace(
        again, diagnosis=after
    )


def swap_causes(causes: Sequence[Cause]) -> tuple[Cause, ...]:
    """The causes that are corrected by giving markers other labels."""
    return tuple(cause for cause in causes if effect(cause.effect).correction is Correction.LABELS)


def relabel(trial: Trial, causes: Sequence[Cause]) -> Trial:
    """With the names of each swap in the trial exchanged while it lasts."""
    acting = [cause for cause in causes if any(own.trial == trial.name for own in cause.when or ())]
    if not acting:
        return trial
    markers = trial.markers.having(label for cause in acting for label in cause.where)
    position = markers.position.clone()
    for cause in acting:
        pair = [markers.labels.index(label) for label in cause.where]
        inside = inside_any(cause.when or (), trial.name, markers.time).nonzero()
        position[inside, pair] = position[inside, pair[::-1]]
    return replace(trial, markers=replace(markers, position=position))


def fitted_anew(base: Outcome, causes: Sequence[Cause], folder: OutputFolder, key: str, progress: OnStage) -> Outcome:
    """The outcome up to the inertia, from recordings in which swaps are put right.

    Geometry included: a swap of 0.8 s had bent a foot's, and skin that slid by 35 mm made up for it.
    """
    config, trials = base.config, {}
    told, others = _by_distances(base.session, causes)
    session = base.session.with_names(told)
    for name, trial in session.trials.items():
        named = relabel(trial, others)
        trials[name] = trial if named is base.session.trials[name] else folder.aside(named)
    session = replace(session, trials=trials)
    fit = folder.stage("geometry_relabelled", key, lambda: fit_session(config.geometry, session, True, progress))

    def tracked(name: str) -> Tracked:
        # Trials whose markers are as they were are followed from where these led.
        near = base.followed[name].tracked.q if trials[name] is base.session.trials[name] else None
        return folder.stage(f"relabelled_{name}", key, lambda: track(fit, trials[name].markers, near=near))

    prior = subject_prior(config.model, config.subject, fit)
    followed = follow_session(fit, session, tracked, Following.of(config, base.cutoff_hz), prior, folder)
    found = replace(base, session=session, fit=fit, followed=followed, prior=prior)
    return replace(
        found,
        identified=folder.stage(
            "inertia_relabelled", key, lambda: identify(config.inertia, config.subject, found, progress)
        ),
    )


def _by_distances(session: Session, causes: Sequence[Cause]) -> tuple[list[TrackStatement], list[Cause]]:
    """The exchanges among the causes that distances told, whose samples are gaps, and the others."""
    known = {(one.trial, one.labels): one for one in session.tracking if one.kind is TrackFault.EXCHANGED}
    keys = {id(cause): (cause.trials[0] if cause.trials else "", cause.where) for cause in causes}
    told = [known[keys[id(cause)]] for cause in causes if keys[id(cause)] in known]
    return told, [cause for cause in causes if keys[id(cause)] not in known]


def merged(before: Diagnosis, after: Diagnosis, causes: Sequence[Cause], options: DiagnosisOptions) -> Diagnosis:
    """What was found with the names put right, and the swaps found before, with what they gained then.

    Args:
        before: the verdict that named the swaps.
        after: the verdict on the recordings with the names put right; what it contradicts is in doubt.
        causes: the swaps.
        options: thresholds.
    """
    doubted = after.unexplained.significant and not after.unexplained.beyond
    factor, steps = trust(after.unexplained, options) if doubted else 1.0, []
    own = [_doubted(cause, trust(before.unexplained, options), factor, doubted) for cause in causes]
    if doubted:
        numbers = {"factor": factor}
        steps = [TraceStep(StepKind.DISCOUNT, c.effect, c.where, "residual_structure", numbers) for c in causes]
    found = tuple(sorted((*own, *after.causes), key=after_forces))
    return replace(after, baseline=before.baseline, causes=found, trace=(*before.trace, *after.trace, *steps))


def _doubted(cause: Cause, before: float, after: float, doubted: bool) -> Cause:
    """A cause as doubtful as it is after, no longer as it was before."""
    return replace(cause.scaled(after / (before if cause.doubted else 1.0)), doubted=doubted)


def _overlap(one: Cause, other: Cause) -> bool:
    """Whether two swaps are of the same markers at the same time."""
    both = [(a, b) for a in one.when or () for b in other.when or () if a.trial == b.trial]
    return set(one.where) == set(other.where) and any(a.t0 <= b.t1 and b.t0 <= a.t1 for a, b in both)
