"""Effects that shift readings in time, linearised where they were found.

With m what plates read and m(-x) the same taken back by x, the effect adds f(x) = m - m(-x), whose slope at x is that
of a small shift of m(-x). Linear about zero, 30 ms came out as 27 ms, and three bodies were found to wobble.
"""

from collections.abc import Sequence
from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.diagnosis.design import Columns, Source
from torchid.diagnosis.rates import calibrated
from torchid.diagnosis.watched import Watched
from torchid.dynamics import wrench_about
from torchid.effects.effect import columns
from torchid.regressor.rows import WrenchTrial


def linearised(watched: Watched, own: Columns, sources: Sequence[Source], theta: Float[Tensor, " more"]) -> Columns:
    """Columns of a trial with those of late effects taken at ``theta``.

    Args:
        watched: the trial.
        own: its columns, wherever late ones were taken.
        sources: of all columns.
        theta: parameters of all columns.
    """
    extra, beyond, first = own.extra.clone(), torch.zeros_like(watched.rows.wrench), watched.phi.numel()
    measured, root = watched.view.measured, watched.rows.motion.q[:, :3]
    for source in sources:
        if not source.effect.late:
            continue
        # No trial lacks them: they stand where they do in the design.
        part = slice(source.columns.start - first, source.columns.stop - first)
        back = source.effect.undone(measured, source.place, theta[part])
        slope = columns(source.effect, watched.view.scene, back, source.place).permute(1, 2, 0)
        slope = wrench_about(slope, root.expand(len(slope), -1, -1)).permute(2, 0, 1)
        extra[:, part] = calibrated(slope, watched.rows, watched.scatter)
        line = torch.einsum("ipt,p->ti", extra[:, part], theta[part])
        beyond += (measured.total - back.total).T - wrench_about(line, -root)
    return replace(own, extra=extra, beyond=beyond)


def without_beyond(rows: WrenchTrial, own: Columns) -> WrenchTrial:
    """Rows that columns are linear in."""
    return rows if own.beyond is None else replace(rows, wrench=rows.wrench - own.beyond)
