"""Rows of forces of one trial in the frequency domain, and its columns."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.diagnosis.columns.design import Columns, Terms
from torchid.diagnosis.columns.relinearise import without_beyond
from torchid.dynamics.whitening import BlockSpectrum, block_spectrum, column_spectra
from torchid.observation.noise_budget import NoiseBudget
from torchid.observation.reliability import Reliability
from torchid.observation.trial import TrialObservation
from torchid.storage.snapshot import unload


@dataclass(frozen=True)
class TrialSpectra:
    """Rows of forces of one trial in the frequency domain, and its columns."""

    forces: tuple[BlockSpectrum, ...]
    """Cosine coefficients of columns and wrench, block by block of used frames."""
    terms: Terms
    """Terms of the trial that do not come from its rows of forces."""
    noise_budget: NoiseBudget | None = None
    """Energy that plates' and markers' noise have in them; None where nobody knows."""


def trial_spectra(observed: TrialObservation, columns: Columns, noisy: Sequence[bool]) -> TrialSpectra:
    """Return the rows of one trial, columns shrunk to what is expected of the true motion.

    Args:
        observed: the trial.
        columns: columns of the trial.
        noisy: for every column behind the inertia's, True if it holds noise of accelerations that were found.
    """
    rows, budget, phi = without_beyond(observed.rows, columns), observed.noise_budget, observed.phi.reshape(-1)
    found = (block_spectrum(rows, part, columns.during(part)) for part in rows.blocks())
    if budget is not None:
        known = [not noisy[k - len(phi)] for k in columns.terms.live[len(phi) :].tolist()]
        found = (_shrunk(block, budget.reliability, phi, known) for block in found)
    return TrialSpectra(tuple(_away(block, observed.room) for block in found), columns.terms, budget)


def _away(block: BlockSpectrum, room: Callable[[Sequence[int]], Tensor]) -> BlockSpectrum:
    """Return a block whose columns have been put away: they are as many as those of a Gram matrix, in every trial."""
    found = replace(block, Y=room(block.Y.shape).copy_(block.Y))
    unload()
    return found


def _shrunk(
    block: BlockSpectrum, reliability: Reliability, phi: Float[Tensor, " params"], known: Sequence[bool]
) -> BlockSpectrum:
    """Return a block with columns shrunk at each frequency to their reliable part.

    What the identified body needs is taken off unshrunk: its noise is accounted for, its shrinkage would not be.
    """
    part = reliability(block.frequency).T
    rest = (1.0 - part) * (phi @ block.Y[:, : len(phi)])
    part = part[:, None].repeat(1, block.Y.shape[1], 1)
    part[:, torch.tensor([False] * (block.Y.shape[1] - len(known)) + list(known))] = 1.0
    return BlockSpectrum(part * block.Y, block.F - rest, block.frequency)


def with_columns(
    rows: TrialSpectra, terms: Terms, observed: TrialObservation, more: Float[Tensor, "6 more frames"], noisy: bool
) -> TrialSpectra:
    """Return rows with further columns.

    Args:
        rows: rows without them.
        terms: terms of all columns, the further ones behind.
        observed: the trial.
        more: further columns about the root's origin [N, N m per unit parameter].
        noisy: True if they hold noise of accelerations that were found.
    """
    blocks = []
    for block, fresh in zip(rows.forces, column_spectra(observed.rows, more), strict=True):
        if noisy and observed.noise_budget is not None:
            fresh = observed.noise_budget.reliability(block.frequency).T[:, None] * fresh
        blocks.append(_away(replace(block, Y=torch.cat([block.Y, fresh], 1)), observed.room))
    return TrialSpectra(tuple(blocks), terms, rows.noise_budget)
