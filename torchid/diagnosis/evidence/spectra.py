"""One trial's rows of forces in the frequency domain, and its columns."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.diagnosis.candidates.candidate import Candidate
from torchid.diagnosis.columns.design import Columns, Design, Terms, narrower, positions
from torchid.diagnosis.columns.relinearise import without_beyond
from torchid.diagnosis.evidence.prior import Prior
from torchid.observation.noise_budget import NoiseBudget
from torchid.observation.reliability import Reliability
from torchid.observation.trial import TrialObservation
from torchid.regressor.whitening import BlockSpectrum, column_spectra, spectra


@dataclass(frozen=True)
class TrialSpectra:
    """One trial's rows of forces in the frequency domain, and its columns."""

    forces: tuple[BlockSpectrum, ...]
    terms: Terms
    noise_budget: NoiseBudget | None = None
    """Energy that plates' and markers' noise have in them; None where nobody knows."""


def trial_spectra(observed: TrialObservation, columns: Columns, noisy: Sequence[bool]) -> TrialSpectra:
    """Of one trial, columns shrunk to what is expected of the true motion.

    Args:
        watched: the trial.
        columns: of it.
        noisy: which of them come from accelerations that were found, and hold their noise.
    """
    found = tuple(spectra(without_beyond(observed.rows, columns), columns.extra))
    if observed.noise_budget is None:
        return TrialSpectra(found, columns.terms)
    reliability, phi = observed.noise_budget.reliability, observed.phi.reshape(-1)
    known = [not noisy[k - len(phi)] for k in columns.terms.live[len(phi) :].tolist()]
    return TrialSpectra(
        tuple(_shrunk(block, reliability, phi, known) for block in found), columns.terms, observed.noise_budget
    )


def _shrunk(
    block: BlockSpectrum, reliability: Reliability, phi: Float[Tensor, " params"], known: Sequence[bool]
) -> BlockSpectrum:
    """What the identified body needs is taken off unshrunk: its noise is accounted for, its shrinkage would not be."""
    part = reliability(block.frequency).T
    rest = (1.0 - part) * (phi @ block.Y[:, : len(phi)])
    part = part[:, None].repeat(1, block.Y.shape[1], 1)
    part[:, torch.tensor([False] * (block.Y.shape[1] - len(known)) + list(known))] = 1.0
    return BlockSpectrum(part * block.Y, block.F - rest, block.frequency)


def with_columns(
    rows: TrialSpectra, terms: Terms, observed: TrialObservation, more: Float[Tensor, "6 more frames"], noisy: bool
) -> TrialSpectra:
    """Rows with further columns.

    Args:
        rows: as they are.
        terms: of all columns, further ones behind.
        watched: the trial.
        more: the further ones about the root's origin.
        noisy: whether they come from accelerations that were found.
    """
    blocks = []
    for block, fresh in zip(rows.forces, column_spectra(observed.rows, more), strict=True):
        if noisy and observed.noise_budget is not None:
            fresh = observed.noise_budget.reliability(block.frequency).T[:, None] * fresh
        blocks.append(BlockSpectrum(torch.cat([block.Y, fresh], 1), block.F, block.frequency))
    return TrialSpectra(tuple(blocks), terms, rows.noise_budget)


def narrowed(
    rows: Sequence[TrialSpectra], prior: Prior, design: Design, some: Sequence[Candidate]
) -> tuple[list[TrialSpectra], Prior, Design, tuple[Candidate, ...]]:
    """Everything without the columns of all other candidates."""
    small, own, which = narrower(design, some)
    less = []
    for one in rows:
        at, _ = positions(one.terms.live, which.all)
        blocks = tuple(BlockSpectrum(block.Y[:, at], block.F, block.frequency) for block in one.forces)
        less.append(TrialSpectra(blocks, one.terms.only(which), one.noise_budget))
    return less, prior.widened(small), small, own
