"""Candidates that compete in one scan of the catalogue, and which of them cannot be told apart there."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch

from torchid.diagnosis.candidates.candidate import Candidate
from torchid.diagnosis.options import NamingOptions


def consented(evidence: float, predicted: float, options: NamingOptions) -> bool:
    """Return whether trials are predicted hardly worse with a cause.

    Args:
        evidence: log evidence for it [nat].
        predicted: log density that it gains where motion is predicted from other motion [nat].
        options: thresholds of consent.
    """
    return predicted > -max(options.consent_nats, options.consent_part * evidence)


@dataclass(frozen=True)
class Rival:
    """A candidate and what the data say for it."""

    candidate: Candidate
    """The candidate."""
    evidence: float
    """Log evidence gained over the model without it [nat]."""
    crossed: float
    """Log evidence gained where each trial is predicted from the others [nat]; far behind the best, ``evidence``
    itself."""
    explained: float
    """Half the whitened energy that it takes away, less what as many columns of no meaning would [nat]."""
    ordinary: float = 0.0
    """Log evidence of what all places have some of, over nothing; at least zero [nat]."""
    beside: float = 0.0
    """Log evidence that it adds even beside the best, however large that may be [nat]; less than zero counts as
    none."""
    options: NamingOptions = NamingOptions()
    """Thresholds of naming."""
    told: float = 0.0
    """Log likelihood ratio of other proof than forces [nat]."""

    @property
    def score(self) -> float:
        """Evidence that counts [nat]: the lesser of evidence and crossed, or the evidence if trials consent, less the
        ordinary, with what other proof says.

        Consent means that trials are predicted hardly worse for it. The lesser of both alone would refuse what only the
        prior contradicts, such as a wrong recorded mass: each trial predicts it from the others without the effect as
        well.
        """
        carried = consented(self.evidence, self.crossed, self.options)
        return (self.evidence if carried else min(self.evidence, self.crossed)) - self.ordinary + self.told

    @property
    def weighed(self) -> float:
        """Score plus the logarithm of the odds of the place [nat]."""
        return self.score + math.log(self.candidate.odds)

    @property
    def alike(self) -> float:
        """Score of standing for the best, not beside it [nat]."""
        return self.score - max(self.beside, 0.0)

    @property
    def likely(self) -> float:
        """Log odds that it is there in place of the best; what is there too makes no name doubtful."""
        odds = math.log(self.candidate.odds * self.options.effect_odds)
        return odds + self.score - max(odds + self.beside, 0.0)


@dataclass(frozen=True)
class Round:
    """One scan of the catalogue, best first."""

    rivals: tuple[Rival, ...]
    """Candidates, best first."""
    families: dict[str, float]
    """Score of each effect [nat], averaged over its places: what was searched is paid for."""
    options: NamingOptions = NamingOptions()
    """Thresholds of naming."""
    appearance: float = 0.0
    """Log evidence of what sessions without the best effect seem to have of it, over what is ordinary [nat], averaged
    over its places."""
    compared: tuple[Rival, ...] = ()
    """Rivals against the best with sizes averaged over orders of magnitude: the width of a prior names no cause."""

    @property
    def named(self) -> Rival | None:
        """The best rival if its effect is supported, else None."""
        best = self.rivals[0] if self.rivals else None
        return None if best is None or self.family(best) < self.options.named_nats else best

    @property
    def ordinary(self) -> bool:
        """True if the best is no more than what sessions without it seem to have of it."""
        best, options = self.rivals[0], self.options
        return self.family(best) - self.appearance < options.named_nats

    def family(self, rival: Rival) -> float:
        """Return the score of a rival's effect [nat].

        Args:
            rival: one of the round's.
        """
        return self.families[rival.candidate.effect.name]

    @property
    def weights(self) -> list[float]:
        """Posterior probabilities of ``compared``; one minus their sum is that of none, or of what the best seems to
        be in sessions without it. Effects are alike, places by odds."""
        log = torch.tensor([r.likely for r in self.compared], dtype=torch.float64)
        none = log.new_tensor([max(self.appearance, 0.0)])
        return torch.softmax(torch.cat([log, none]), 0)[:-1].tolist()


@dataclass(frozen=True)
class RivalShare:
    """Probability that an effect at a place is there, all its intervals and grid values together."""

    rival: Rival
    """The likeliest of them."""
    weight: float
    """Posterior probability."""
    near: bool
    """True if it cannot be told from the cause."""


def shares(scan: Round, one: Candidate) -> tuple[RivalShare, list[RivalShare]]:
    """Return the share of a cause, and those of everything that it competes with, the likeliest first.

    Args:
        scan: round that named the cause.
        one: the cause.
    """
    best = next(r for r in scan.compared if same(r.candidate, one))
    groups: dict[tuple[str, tuple[str, ...]], list[tuple[float, Rival]]] = {}
    for rival, weight in zip(scan.compared, scan.weights, strict=True):
        groups.setdefault((rival.candidate.effect.name, rival.candidate.place.where), []).append((weight, rival))
    found = {key: _share(some, best, scan.options.alike_nats) for key, some in groups.items()}
    own = found.pop((one.effect.name, one.place.where))
    return own, sorted(found.values(), key=lambda share: -share.weight)


def _share(some: Sequence[tuple[float, Rival]], best: Rival, alike_nats: float) -> RivalShare:
    """Return the share of rivals of one effect and place."""
    near = any(abs(rival.alike - best.alike) < alike_nats for _, rival in some)
    return RivalShare(max(some, key=lambda both: both[0])[1], sum(weight for weight, _ in some), near)


def twins(others: Sequence[RivalShare], most: int) -> list[RivalShare]:
    """Return the shares that cannot be told from the cause.

    Args:
        others: shares of what it competes with, the likeliest first.
        most: number of them at most.
    """
    return [share for share in others if share.near][:most]


def named_in(rounds: Sequence[Round], one: Candidate) -> Round:
    """Return the scan that an effect came out best of.

    Args:
        rounds: scans of a search.
        one: the effect.
    """
    return next(r for r in rounds if r.rivals and same(r.rivals[0].candidate, one))


def same(scanned: Candidate, one: Candidate) -> bool:
    """Return whether a scanned candidate is a given one, whatever was left out of the design since.

    Args:
        scanned: candidate of a scan.
        one: candidate of any design.
    """
    return scanned.effect.name == one.effect.name and scanned.place is (one.proposed or one.place)
