"""Evidence of other measurements than forces: distances between markers, and how quick they still move."""

import math
from collections.abc import Collection, Mapping
from types import MappingProxyType

from torchid.diagnosis.candidates.candidate import Candidate
from torchid.effects.traits import Proof

Told = Mapping[Proof, Collection[str]]
"""Names of the places that a proof bears out; a proof that was not asked is no key."""
NOTHING_TOLD: Told = MappingProxyType({})
"""No proof was asked."""
SEEN, MISTAKEN = 0.8, 0.02
"""Estimator. Shares of places with such an effect, and of places without, that a proof bears out, a choice: of markers
that moved, one in five is alone on its segment or moved along it; of all others one in fifty says so."""


def told_nats(told: Told, one: Candidate) -> float:
    """Return the log likelihood ratio of what a proof says of a candidate's place [nat]; zero where none was asked.

    Args:
        told: what the proofs bear out.
        one: the candidate.
    """
    if one.effect.bodily or one.effect.proof not in told:
        return 0.0
    if any(name in told[one.effect.proof] for name in one.place.where):
        return math.log(SEEN / MISTAKEN)
    return math.log((1.0 - SEEN) / (1.0 - MISTAKEN))
