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

from torchid.diagnosis.candidates import trial_columns
from torchid.diagnosis.design import Columns, Source
from torchid.diagnosis.rates import calibrated
from torchid.diagnosis.watched import Watched
from torchid.dynamics import wrench_about
from torchid.effects.columns import columns
from torchid.effects.effect import Effect
from torchid.effects.place import Place
from torchid.effects.scene import Reading
from torchid.regressor.rows import WrenchTrial


def linearised(watched: Watched, own: Columns, sources: Sequence[Source], theta: Float[Tensor, " more"]) -> Columns:
    """Columns of a trial with those of curved and late effects taken at ``theta``.

    Args:
        watched: the trial.
        own: its columns, wherever such ones were taken.
        sources: of all columns.
        theta: parameters of all columns.
    """
    first = watched.phi.numel()
    if any(_yields(s, theta[_part(s, first)]) for s in sources):
        own = trial_columns(watched, [_taken(s, theta[_part(s, first)]) for s in sources])
    extra, beyond = own.extra.clone(), torch.zeros_like(watched.rows.wrench)
    measured, root = watched.view.measured, watched.rows.motion.q[:, :3]

    def slope(
        effect: Effect, reading: Reading, place: Place, at: Tensor | None = None
    ) -> Float[Tensor, "6 own frames"]:
        found = columns(effect, watched.view.scene, reading, place, at).permute(1, 2, 0)
        return wrench_about(found, root.expand(len(found), -1, -1)).permute(2, 0, 1)

    for source in sources:
        # No trial lacks them: they stand where they do in the design.
        effect, part = source.effect, _part(source, first)
        if effect.curved and not effect.kinematic and bool(theta[part].any()):
            extra[:, part] = slope(effect, measured, source.place, theta[part])
        if effect.late:
            back = effect.undone(measured, source.place, theta[part])
            extra[:, part] = calibrated(slope(effect, back, source.place), watched.rows, watched.scatter)
            line = torch.einsum("ipt,p->ti", extra[:, part], theta[part])
            beyond += (measured.total - back.total).T - wrench_about(line, -root)
    return replace(own, extra=extra, beyond=beyond)


def _part(source: Source, first: int) -> slice:
    """Of the columns behind those of the inertia."""
    return slice(source.columns.start - first, source.columns.stop - first)


def _yields(source: Source, theta: Float[Tensor, " own"]) -> bool:
    """Whether cameras see other columns of it where it is."""
    return source.effect.kinematic and source.effect.curved and bool(theta.any())


def _taken(source: Source, theta: Float[Tensor, " own"]) -> Source:
    return replace(source, at=tuple(theta.tolist())) if _yields(source, theta) else source


def without_beyond(rows: WrenchTrial, own: Columns) -> WrenchTrial:
    """Rows that columns are linear in."""
    return rows if own.beyond is None else replace(rows, wrench=rows.wrench - own.beyond)
