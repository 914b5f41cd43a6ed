"""Effects that are not linear in their parameters, linearised where they were found.

Columns of a nonlinear effect (``Effect.nonlinear``) times the parameters at which they are taken are all that it does.
An effect that shifts time (``Effect.shifts_time``) adds f(x) = m - m(-x), with m what plates read and m(-x) the same
taken back by x; the slope of f at x is that of a small shift of m(-x). Columns taken about zero would be wrong by the
curvature.
"""

from collections.abc import Sequence
from dataclasses import replace

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchid.diagnosis.candidates.candidate import ColumnSource
from torchid.diagnosis.columns.assemble import retaken
from torchid.diagnosis.columns.design import Columns, Design
from torchid.diagnosis.columns.rate_calibration import calibrated
from torchid.dynamics.equations_of_motion import wrench_about, wrenches_about
from torchid.dynamics.rows import WrenchTrial
from torchid.effects.columns import columns
from torchid.effects.effect import Effect
from torchid.effects.place import Place
from torchid.effects.scene import Reading
from torchid.observation.trial import TrialObservation

MOVED = 0.1
"""Resolution. Part of its parameters by which a nonlinear effect on markers must have moved for its columns to be taken
again: their error is about a tenth of that."""


def relinearised(
    observed: Sequence[TrialObservation], design: Design, theta: Sequence[Float[Tensor, " more"]]
) -> Design:
    """Return a design with columns of nonlinear effects, and of such that shift time, where they were found.

    Args:
        observed: its trials.
        design: design with columns taken anywhere.
        theta: parameters behind the inertia's, trial by trial.
    """
    design = _yielded(observed, design, theta[0])
    trials = zip(observed, design.trials, theta, strict=True)
    return replace(design, trials=tuple(linearised(w, c, design.sources, x) for w, c, x in trials))


def _yielded(observed: Sequence[TrialObservation], design: Design, theta: Float[Tensor, " more"]) -> Design:
    """Return a design with columns of nonlinear effects on markers where they were found, which is the same in all
    trials."""
    sources = tuple(_taken(s, theta[_part(s, design.inertia)]) for s in design.sources)
    others = [new for old, new in zip(design.sources, sources, strict=True) if new.at != old.at]
    if not others:
        return design
    trials = (retaken(w, c, sources, others) for w, c in zip(observed, design.trials, strict=True))
    return replace(design, sources=sources, trials=tuple(trials))


def _taken(source: ColumnSource, theta: Float[Tensor, " own"]) -> ColumnSource:
    """Return a source with its columns where it was found, unless they are taken about there already."""
    if not (source.effect.moves_markers and source.effect.nonlinear):
        return source
    away = theta if source.at is None else theta - theta.new_tensor(source.at)
    return replace(source, at=tuple(theta.tolist())) if bool(away.norm() > MOVED * theta.norm()) else source


def _part(source: ColumnSource, inertia: int) -> slice:
    """Return the columns of a source, counted behind those of the inertia."""
    return slice(source.columns.start - inertia, source.columns.stop - inertia)


def linearised(
    observed: TrialObservation, own: Columns, sources: Sequence[ColumnSource], theta: Float[Tensor, " more"]
) -> Columns:
    """Return a trial's columns with those that plates show of nonlinear effects and of shifts in time taken at
    ``theta``.

    Args:
        observed: the trial.
        own: its columns, with such ones taken anywhere.
        sources: sources of all columns.
        theta: parameters of all columns behind the inertia's.
    """
    first = observed.phi.numel()
    if own.beyond is None and not any(bool(theta[_part(s, first)].any()) for s in sources if _plates_bend(s.effect)):
        return own
    beyond = torch.zeros_like(observed.rows.wrench)
    measured, root = observed.view.measured, observed.rows.motion.q[:, :3]

    def slope(
        effect: Effect, reading: Reading, place: Place, at: Tensor | None = None
    ) -> Float[Tensor, "6 own frames"]:
        return wrenches_about(columns(effect, observed.view.scene, reading, place, at), root.T)

    for source in sources:
        # No trial lacks them: they stand where they do in the design.
        effect, part = source.effect, _part(source, first)
        if effect.nonlinear and not effect.moves_markers and bool(theta[part].any()):
            own = own.replaced(_indices(part), slope(effect, measured, source.place, theta[part]))
        if effect.shifts_time:
            back = effect.undone(measured, source.place, theta[part])
            taken = calibrated(slope(effect, back, source.place), observed.rows, observed.scatter)
            own, line = own.replaced(_indices(part), taken), (theta[part] @ taken).T
            beyond += (measured.total - back.total).T - wrench_about(line, -root)
    return replace(own, beyond=beyond)


def _indices(part: slice) -> Int[Tensor, " own"]:
    return torch.arange(part.start, part.stop)


def _plates_bend(effect: Effect) -> bool:
    """Return whether plates show more of an effect than its columns about zero."""
    return effect.shifts_time or (effect.nonlinear and not effect.moves_markers)


def without_beyond(rows: WrenchTrial, own: Columns) -> WrenchTrial:
    """Return the rows less what columns do not hold of shifts in time, in which those are linear.

    Args:
        rows: motion and measured wrench of a trial.
        own: its columns.
    """
    return rows if own.beyond is None else replace(rows, wrench=rows.wrench - own.beyond)
