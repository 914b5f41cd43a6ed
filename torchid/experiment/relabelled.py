"""Markers that carry each other's name, given back their own, and what is seen then.

Swapped markers bend postures, which no column is linear in, and the geometry: with the swap named, skin slid on that
segment and its joints' centres glided. So all is fitted again with the names put right, and all else looked for then.
"""

from collections.abc import Sequence
from dataclasses import replace

from torchid.config import Config
from torchid.diagnosis.diagnose import after_forces, trust
from torchid.diagnosis.unexplained import Structure
from torchid.diagnosis.verdict import Cause, Diagnosis
from torchid.effects.place import inside_any
from torchid.experiment.fits import fit_session, identify
from torchid.experiment.stages import follow, subject_prior
from torchid.geometry.tracking import track
from torchid.outcome import Outcome
from torchid.recording import Trial

EFFECT = "marker_swap"


def swaps(causes: Sequence[Cause]) -> tuple[Cause, ...]:
    """Those among causes."""
    return tuple(cause for cause in causes if cause.effect == EFFECT)


def relabelled(trial: Trial, causes: Sequence[Cause]) -> Trial:
    """With the names of each swap in the trial exchanged while it lasts."""
    markers = trial.markers
    position = markers.position.clone()
    for cause in causes:
        pair = [markers.labels.index(label) for label in cause.where]
        inside = inside_any(cause.when or (), trial.name, markers.time).nonzero()
        position[inside, pair] = position[inside, pair[::-1]]
    return replace(trial, markers=replace(markers, position=position))


def fitted_anew(config: Config, outcome: Outcome, causes: Sequence[Cause]) -> Outcome:
    """The outcome up to the inertia, from recordings in which swaps are put right.

    Geometry included: a swap of 0.8 s had bent a foot's, and skin that slid by 35 mm made up for it.
    """
    trials = {name: relabelled(trial, causes) for name, trial in outcome.session.trials.items()}
    session = replace(outcome.session, trials=trials)
    fit = fit_session(config, session, True, _silent)
    followed = {
        name: follow(fit, trial, track(fit, trial.markers), outcome.cutoff_hz, config) for name, trial in trials.items()
    }
    found = replace(outcome, session=session, fit=fit, followed=followed, prior=subject_prior(config, fit))
    return replace(found, identified=identify(config, found, _silent))


def _silent(stage: str, fraction: float | None) -> None:
    """The stages of the first time are over."""


def beside(before: Diagnosis, after: Diagnosis, causes: Sequence[Cause]) -> Diagnosis:
    """What was found with the names put right, and the swaps found before; in doubt is what is contradicted now."""
    own = [_doubted(cause, before.unexplained, after.unexplained) for cause in causes]
    found = sorted((*own, *after.causes), key=after_forces)
    return replace(after, baseline=before.baseline, causes=tuple(found))


def _doubted(cause: Cause, before: Structure, after: Structure) -> Cause:
    sure = cause.confidence / trust(before) if cause.doubted else cause.confidence
    confidence = trust(after) * sure if after.significant else sure
    return replace(cause, confidence=confidence, doubted=after.significant)
