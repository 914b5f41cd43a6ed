"""Effects that are not linear in their parameters, linearised where they were found.

Those of curved ones (``Effect.curved``) times their parameters are all that they do. Linear about zero, flesh of 3 mm
was 0.3 mm too stiff on all segments, eight standard deviations together. Others shift readings in time: with m what
plates read and m(-x) the same taken back by x, the effect adds f(x) = m - m(-x), whose slope at x is that
of a small shift of m(-x). Linear about zero, 30 ms came out as 27 ms, and three bodies were found to wobble.
"""

from collections.abc import Sequence
from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.diagnosis.candidates.candidate import Source
from torchid.diagnosis.columns.assemble import retaken
from torchid.diagnosis.columns.design import Columns, Design
from torchid.diagnosis.columns.rate_calibration import calibrated
from torchid.dynamics import wrench_about, wrenches_about
from torchid.effects.columns import columns
from torchid.effects.effect import Effect
from torchid.effects.place import Place
from torchid.effects.scene import Reading
from torchid.observation.trial import TrialObservation
from torchid.regressor.rows import WrenchTrial

MOVED = 0.1
"""Part of its parameters by which a curved effect on markers must have moved for its columns to be taken again: their
error is about a tenth of that."""


def relinearised(
    observed: Sequence[TrialObservation], design: Design, theta: Sequence[Float[Tensor, " more"]]
) -> Design:
    """Columns of a design where curved and late effects were found.

    Args:
        watched: its trials.
        design: wherever its columns were taken.
        theta: parameters behind the inertia's, trial by trial.
    """
    design = _yielded(observed, design, theta[0])
    trials = zip(observed, design.trials, theta, strict=True)
    return replace(design, trials=tuple(linearised(w, c, design.sources, x) for w, c, x in trials))


def _yielded(observed: Sequence[TrialObservation], design: Design, theta: Float[Tensor, " more"]) -> Design:
    """With curved effects on markers, which act in all trials alike."""
    sources = tuple(_taken(s, theta[_part(s, design.inertia)]) for s in design.sources)
    others = [new for old, new in zip(design.sources, sources, strict=True) if new.at != old.at]
    if not others:
        return design
    trials = (retaken(w, c, sources, others) for w, c in zip(observed, design.trials, strict=True))
    return replace(design, sources=sources, trials=tuple(trials))


def _taken(source: Source, theta: Float[Tensor, " own"]) -> Source:
    """Where it was found, unless it was about there that it had been taken."""
    if not (source.effect.moves_markers and source.effect.nonlinear):
        return source
    away = theta if source.at is None else theta - theta.new_tensor(source.at)
    return replace(source, at=tuple(theta.tolist())) if bool(away.norm() > MOVED * theta.norm()) else source


def _part(source: Source, inertia: int) -> slice:
    """Of the columns behind those of the inertia."""
    return slice(source.columns.start - inertia, source.columns.stop - inertia)


def linearised(
    observed: TrialObservation, own: Columns, sources: Sequence[Source], theta: Float[Tensor, " more"]
) -> Columns:
    """Columns of a trial with those that plates show of curved and late effects taken at ``theta``.

    Args:
        watched: the trial.
        own: its columns, wherever such ones were taken.
        sources: of all columns.
        theta: parameters of all columns.
    """
    first = observed.phi.numel()
    if own.beyond is None and not any(bool(theta[_part(s, first)].any()) for s in sources if _plates_bend(s.effect)):
        return own
    extra, beyond = own.copied, torch.zeros_like(observed.rows.wrench)
    measured, root = observed.view.measured, observed.rows.motion.q[:, :3]

    def slope(
        effect: Effect, reading: Reading, place: Place, at: Tensor | None = None
    ) -> Float[Tensor, "6 own frames"]:
        return wrenches_about(columns(effect, observed.view.scene, reading, place, at), root.T)

    for source in sources:
        # No trial lacks them: they stand where they do in the design.
        effect, part = source.effect, _part(source, first)
        if effect.nonlinear and not effect.moves_markers and bool(theta[part].any()):
            extra[:, part] = slope(effect, measured, source.place, theta[part])
        if effect.shifts_time:
            back = effect.undone(measured, source.place, theta[part])
            extra[:, part] = calibrated(slope(effect, back, source.place), observed.rows, observed.scatter)
            line = (theta[part] @ extra[:, part]).T
            beyond += (measured.total - back.total).T - wrench_about(line, -root)
    return replace(own, wide=extra, kept=None, beyond=beyond)


def _plates_bend(effect: Effect) -> bool:
    """Whether plates show more of an effect than its columns."""
    return effect.shifts_time or (effect.nonlinear and not effect.moves_markers)


def without_beyond(rows: WrenchTrial, own: Columns) -> WrenchTrial:
    """Rows that columns are linear in."""
    return rows if own.beyond is None else replace(rows, wrench=rows.wrench - own.beyond)
