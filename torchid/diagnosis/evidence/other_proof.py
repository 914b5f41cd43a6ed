"""Evidence of other measurements than forces: distances between markers, and how quick they still move."""

import math
from collections.abc import Callable, Mapping
from types import MappingProxyType

from torchid.diagnosis.candidates.candidate import Candidate
from torchid.effects.place import Place
from torchid.effects.traits import Proof

Told = Mapping[Proof, Callable[[Place], float]]
"""Log Bayes factor of a place by each proof [nat]: infinite where it simply says yes or no, zero where it says nothing;
a proof that was not asked is no key."""
NOTHING_TOLD: Told = MappingProxyType({})
"""No proof was asked."""
SEEN = 0.8
"""Estimator. Share of places with such an effect that a proof bears out: of markers moved by 15 to 25 mm on segments
with four or more in ten people's recordings (docs/decisions.md)."""
MISTAKEN = {Proof.DISTANCES: 0.002, Proof.SMOOTHNESS: 0.02}
"""Estimator. Share of places without it that a proof bears out; of smoothness a choice, of distances by all other
markers of these recordings."""
LARGE = 100.0
"""Resolution. Evidence beyond which a proof is as good as certain [nat]: e^-100 is nothing beside one."""


def told_nats(told: Told, one: Candidate) -> float:
    """Return the log likelihood ratio of what a proof says of a candidate's place [nat]; zero where none was asked.

    Args:
        told: what the proofs say.
        one: the candidate.
    """
    if one.effect.bodily or one.effect.proof not in told:
        return 0.0
    return borne_out(told[one.effect.proof](one.place), one.effect.proof)


def borne_out(nats: float, proof: Proof) -> float:
    """Return the log likelihood ratio that the answer of a proof is worth [nat].

    What it measures may not be what it is there for: however sure it is of itself, it is as right as on recordings of
    which the truth is known.

    Args:
        nats: log Bayes factor by what it measures.
        proof: the proof.
    """
    yes = 1.0 / (1.0 + math.exp(-min(max(nats, -LARGE), LARGE)))
    wrong = MISTAKEN[proof]
    return math.log((SEEN * yes + (1.0 - SEEN) * (1.0 - yes)) / (wrong * yes + (1.0 - wrong) * (1.0 - yes)))
