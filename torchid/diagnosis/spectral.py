"""One trial's rows of forces in the frequency domain, and its columns."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.diagnosis.belief import Belief
from torchid.diagnosis.design import Candidate, Columns, Design, Terms, narrower, positions
from torchid.diagnosis.expected import Expected
from torchid.diagnosis.linearised import without_beyond
from torchid.diagnosis.sums import Prior
from torchid.diagnosis.watched import Watched
from torchid.regressor.whitening import Spectrum, column_spectra, spectra


@dataclass(frozen=True)
class Rows:
    """One trial's rows of forces in the frequency domain, and its columns."""

    forces: tuple[Spectrum, ...]
    terms: Terms
    expected: Expected | None = None
    """Energy that plates' and markers' noise have in them; None where nobody knows."""


def rows_of(watched: Watched, columns: Columns, noisy: Sequence[bool]) -> Rows:
    """Of one trial, columns shrunk to what is expected of the true motion.

    Args:
        watched: the trial.
        columns: of it.
        noisy: which of them come from accelerations that were found, and hold their noise.
    """
    found = tuple(spectra(without_beyond(watched.rows, columns), columns.extra))
    if watched.expected is None:
        return Rows(found, columns.terms)
    believed, phi = watched.expected.believed, watched.phi.reshape(-1)
    known = [not noisy[k - len(phi)] for k in columns.terms.live[len(phi) :].tolist()]
    return Rows(tuple(_shrunk(block, believed, phi, known) for block in found), columns.terms, watched.expected)


def _shrunk(block: Spectrum, believed: Belief, phi: Float[Tensor, " params"], known: Sequence[bool]) -> Spectrum:
    """What the identified body needs is taken off unshrunk: its noise is accounted for, its shrinkage would not be."""
    part = believed(block.frequency).T
    rest = (1.0 - part) * (phi @ block.Y[:, : len(phi)])
    part = part[:, None].repeat(1, block.Y.shape[1], 1)
    part[:, torch.tensor([False] * (block.Y.shape[1] - len(known)) + list(known))] = 1.0
    return Spectrum(part * block.Y, block.F - rest, block.frequency)


def with_columns(rows: Rows, terms: Terms, watched: Watched, more: Float[Tensor, "6 more frames"], noisy: bool) -> Rows:
    """Rows with further columns.

    Args:
        rows: as they are.
        terms: of all columns, further ones behind.
        watched: the trial.
        more: the further ones about the root's origin.
        noisy: whether they come from accelerations that were found.
    """
    blocks = []
    for block, fresh in zip(rows.forces, column_spectra(watched.rows, more), strict=True):
        if noisy and watched.expected is not None:
            fresh = watched.expected.believed(block.frequency).T[:, None] * fresh
        blocks.append(Spectrum(torch.cat([block.Y, fresh], 1), block.F, block.frequency))
    return Rows(tuple(blocks), terms, rows.expected)


def narrowed(
    rows: Sequence[Rows], prior: Prior, design: Design, some: Sequence[Candidate]
) -> tuple[list[Rows], Prior, Design, tuple[Candidate, ...]]:
    """Everything without the columns of all other candidates."""
    small, own, which = narrower(design, some)
    less = []
    for one in rows:
        at, _ = positions(one.terms.live, which.all)
        blocks = tuple(Spectrum(block.Y[:, at], block.F, block.frequency) for block in one.forces)
        less.append(Rows(blocks, one.terms.only(which), one.expected))
    return less, prior.widened(small), small, own
