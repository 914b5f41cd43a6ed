"""What model-free checks say of the causes of a verdict: forces, distances between markers, and their quick motion."""

from collections.abc import Callable, Sequence
from dataclasses import replace

from torch import Tensor

from torchid.checks.marker_tracks.statement import TrackFault, TrackStatement
from torchid.diagnosis.verdict.records import Cause, Diagnosis
from torchid.effects.catalogue import effect
from torchid.effects.traits import Correction, Proof
from torchid.extension.correction import correction
from torchid.extension.statements import panel_of
from torchid.model_free.smoothness import MOVING_MM, RECORDED_MM, SMOOTH_MM, quickness
from torchid.model_free.testimony import CONTRADICTS_SD, CheckAnswer, Claim, answers
from torchid.session import Outcome


def with_witnesses(outcome: Outcome, found: Diagnosis) -> Diagnosis:
    """The verdict, each of its causes with what the checks say of it, those that are only possible last.

    Args:
        outcome: up to the inertia, from the recordings as they are.
        found: what was found wrong with them.
    """
    forces = _of_forces(outcome, found.causes)
    others = {Proof.DISTANCES: _of_distances, Proof.SMOOTHNESS: _of_smoothness}
    causes = []
    for k, cause in enumerate(found.causes):
        own = others.get(effect(cause.effect).proof)
        causes.append(replace(cause, witnesses=forces.get(k, ()) if own is None else own(outcome, cause)))
    # Only here: what is read wrong is put right in the order in which it was found.
    ordered = replace(found, causes=tuple(causes))
    return replace(ordered, causes=(*ordered.likely, *ordered.possible))


def _of_forces(outcome: Outcome, causes: Sequence[Cause]) -> dict[int, tuple[CheckAnswer, ...]]:
    """What plates and the way of the centre of mass say of causes that move no marker."""
    asked = [k for k, cause in enumerate(causes) if not effect(cause.effect).moves_markers]
    panel = panel_of(outcome) if asked else None
    if panel is None:
        return {}
    claims = [Claim(effect(causes[k].effect), causes[k].place, _acting(causes[k])) for k in asked]
    return dict(zip(asked, answers(panel, claims), strict=True))


def _acting(cause: Cause) -> Callable[[str], Tensor | None]:
    def theta(trial: str) -> Tensor | None:
        planted = cause.on(trial)
        return None if planted is None else planted.theta

    return theta


def _of_distances(outcome: Outcome, cause: Cause) -> tuple[CheckAnswer, ...]:
    """What distances between the markers of a segment say of one that moved, or of two whose names are exchanged."""
    # Of several markers, one of which has moved, distances tell a change of theirs, and no shift.
    some = [one for one in outcome.session.tracking if set(one.labels) == set(cause.where)]
    if correction(cause) is Correction.LABELS:
        told = [one for one in some if one.kind is TrackFault.EXCHANGED and cause.on(one.trial) is not None]
    else:  # any trial, for a marker that moved between two sits elsewhere in either
        told = [one for one in some if one.kind is TrackFault.MOVED]
    return tuple(
        CheckAnswer("marker_distances", one.trial, ", ".join(one.labels), one.size_mm, one.sd_mm,
        _expected_mm(one, cause),
               0.0, "mm")
        for one in told
    )  # fmt: skip


def _expected_mm(one: TrackStatement, cause: Cause) -> float:
    """How far off distances would be: by all that exchanging names takes away, or by the length of the shift."""
    shift = cause.parameters.get("shift_seg_m")
    return one.size_mm - one.left_mm if shift is None else 1e3 * float(shift["value"].norm())


def _of_smoothness(outcome: Outcome, cause: Cause) -> tuple[CheckAnswer, ...]:
    """What moving markers still show of quick motion; where they were filtered, next to nothing."""
    shown = {name: quickness(trial.markers) for name, trial in outcome.session.role("fit").items()}
    return tuple(
        CheckAnswer("marker_quickness", name, "", content, SMOOTH_MM / CONTRADICTS_SD, 0.0, RECORDED_MM, "mm")
        for name, (moving, content) in shown.items()
        if moving > MOVING_MM
    )
