"""This module keeps what one session says of its laboratory's instruments, with all that is a person's integrated out.

Instruments that a laboratory owns (plates, the clock between them and the cameras, the calibration of these) err alike
in all of its sessions. So information and moment of their faults (the information form of a normal distribution) add up
over sessions, and are all that has to be kept of one.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchid.diagnosis.candidates.candidate import Candidate
from torchid.diagnosis.evidence.detectable import has_size
from torchid.diagnosis.evidence.joint_information import joint_information
from torchid.diagnosis.evidence.per_trial import marginalise_per_trial
from torchid.diagnosis.evidence.posterior import fit
from torchid.diagnosis.evidence.statistics import Statistics
from torchid.effects.effect import Effect
from torchid.effects.instrument_faults import FAULTS
from torchid.effects.traits import Proof

Fault = tuple[str, tuple[str, ...]]
"""Effect, and names of its place."""


@dataclass(frozen=True)
class LaboratoryEvidence:
    """Information that a session, or several, hold of lasting faults of instruments."""

    faults: tuple[Fault, ...]
    """Effect and names of the place of each fault."""
    sizes: tuple[int, ...]
    """Number of parameters of each fault."""
    information: Float[Tensor, "all all"]
    """Information of all parameters, in units of the effects' priors."""
    moment: Float[Tensor, " all"]
    """Moment of the data: the parameters would be estimated as the information's inverse times it."""
    stated_information: Float[Tensor, "all all"]
    """Share of the information that statements have which need no body model."""
    stated_moment: Float[Tensor, " all"]
    """Share of the moment that these have."""

    @property
    def at(self) -> dict[Fault, Int[Tensor, " _"]]:
        """Indices of the parameters of each fault."""
        parts = torch.arange(sum(self.sizes)).split(list(self.sizes)) if self.sizes else ()
        return dict(zip(self.faults, parts, strict=True))


def lasts(effect: Effect) -> bool:
    """Return whether an effect is a fault of an instrument that something in a laboratory's sessions bears out: what
    nothing can, such as a scale of the cameras, stays what bodies imitate.

    Args:
        effect: the effect.
    """
    return effect.name in FAULTS and has_size(effect) and effect.proof is Proof.FORCES


def lasting(one: Candidate) -> bool:
    """Return whether a candidate is a fault of an instrument that all sessions of a laboratory would share.

    Args:
        one: the candidate.
    """
    _, trials = one.effect.source(one.place)
    return lasts(one.effect) and trials is None


def laboratory_evidence(
    statistics: Statistics, others: Sequence[Candidate], asked: Sequence[Candidate]
) -> LaboratoryEvidence:
    """Return what a session says of lasting faults of instruments, beside the other effects that its model has.

    A lag of the body is not beside them: it is a clock's to these rows, and what bodies' lags are like is for all
    sessions together to weigh.

    Args:
        statistics: statistics of all trials.
        others: effects that the model has, lasting faults and lags aside.
        asked: lasting faults, of the same design.
    """
    whole, bare = (
        joint_information(some, fit(some, kept), asked)
        for some, kept in (marginalise_per_trial(raw, others) for raw in (statistics, statistics.unstated))
    )
    return LaboratoryEvidence(
        tuple((one.effect.name, one.place.where) for one in whole.candidates),
        tuple(len(at) for at in whole.at),
        whole.value, whole.moment, whole.value - bare.value, whole.moment - bare.moment,
    )  # fmt: skip
