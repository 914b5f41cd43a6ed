"""What competes in one scan of the catalogue, and what cannot be told apart there."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch

from torchid.diagnosis.candidates.candidate import Candidate

NAMED = 2.5
"""Nats that name an effect: odds of 12 to one. In sessions that hide nothing
``scripts/battery`` prints the best score that any effect had: 2.0 in 62."""
ALIKE = 3.0
"""Nats within which a rival cannot be told apart, see ``Rival.alike``."""
OUT_OF_SIGHT = 10.0
"""Nats behind the best at which nothing matters to it."""
CHANCE, PART = 1.0, 0.1
"""Nats, or part of the evidence, by which trials may be predicted worse for a cause that they say nothing of, such as a
wrong record: a hidden load of 4.8 kg, 103 nats against the recorded mass, was dropped for 1.7 nats."""
TWINS = 2
"""Rivals that cannot be told from a cause that are named with it, at most."""


@dataclass(frozen=True)
class Rival:
    """A candidate and what the data say for it."""

    candidate: Candidate
    evidence: float
    """Log evidence gained over the model without it [nat]."""
    crossed: float
    """The same, each trial predicted from the others; far behind the best, where nobody asks, the evidence itself."""
    explained: float
    """Half the whitened energy that it takes away, less what as many columns of no meaning would [nat]."""
    ordinary: float = 0.0
    """Log evidence of what all places have some of, over nothing; at least zero [nat]."""
    beside: float = 0.0
    """Log evidence that it adds even beside the best, however large that may be; none if negative [nat]."""

    @property
    def score(self) -> float:
        """What counts: an effect that does not carry over to other trials is none.

        Not the lesser of both: what only the prior contradicts, such as a wrong recorded mass, each trial predicts from
        the others without the effect as well.
        """
        carried = self.crossed > -max(CHANCE, PART * self.evidence)
        return (self.evidence if carried else min(self.evidence, self.crossed)) - self.ordinary

    @property
    def weighed(self) -> float:
        """The score with the odds of the place."""
        return self.score + math.log(self.candidate.odds)

    @property
    def alike(self) -> float:
        """The score of standing for the best, not beside it."""
        return self.score - max(self.beside, 0.0)

    def likely(self, families: int) -> float:
        """Log odds that it is there in place of the best; what is there too makes no name doubtful."""
        odds = math.log(self.candidate.odds / families)
        return odds + self.score - max(odds + self.beside, 0.0)


@dataclass(frozen=True)
class Round:
    """One scan of the catalogue, best first."""

    rivals: tuple[Rival, ...]
    families: dict[str, float]
    """Score of each effect, averaged over its places: what was searched is paid for."""
    compared: tuple[Rival, ...] = ()
    """The same rivals where none is known to be large, against the best.

    The width of a prior names no cause: a pull of 2 N at the pelvis explained as much as a tilt of gravity did, and its
    prior of 20 N alone had made the tilt 0.99 certain.
    """

    @property
    def named(self) -> Rival | None:
        """The best, if its effect is supported."""
        best = self.rivals[0] if self.rivals else None
        return None if best is None or self.families[best.candidate.effect.name] < NAMED else best

    @property
    def weights(self) -> list[float]:
        """Posterior probabilities of ``compared`` and, implied, of none: families alike, places by their odds."""
        log = torch.tensor([r.likely(len(self.families)) for r in self.compared], dtype=torch.float64)
        return torch.softmax(torch.cat([log, torch.zeros(1, dtype=torch.float64)]), 0)[:-1].tolist()


@dataclass(frozen=True)
class Share:
    """What an effect at a place has of the probability, all intervals and grid values together."""

    rival: Rival
    """The likeliest of them."""
    weight: float
    near: bool
    """It cannot be told from the cause."""


def shares(scan: Round, one: Candidate) -> tuple[Share, list[Share]]:
    """Of a cause, and of everything that it competes with, the likeliest first."""
    best = next(r for r in scan.compared if same(r.candidate, one))
    groups: dict[tuple[str, tuple[str, ...]], list[tuple[float, Rival]]] = {}
    for rival, weight in zip(scan.compared, scan.weights, strict=True):
        groups.setdefault((rival.candidate.effect.name, rival.candidate.place.where), []).append((weight, rival))
    found = {key: _share(some, best) for key, some in groups.items()}
    own = found.pop((one.effect.name, one.place.where))
    return own, sorted(found.values(), key=lambda share: -share.weight)


def _share(some: Sequence[tuple[float, Rival]], best: Rival) -> Share:
    near = any(abs(rival.alike - best.alike) < ALIKE for _, rival in some)
    return Share(max(some, key=lambda both: both[0])[1], sum(weight for weight, _ in some), near)


def twins(others: Sequence[Share]) -> list[Share]:
    """Those that cannot be told from the cause."""
    return [share for share in others if share.near][:TWINS]


def named_in(rounds: Sequence[Round], one: Candidate) -> Round:
    """The scan that an effect came out best of."""
    return next(r for r in rounds if r.rivals and same(r.rivals[0].candidate, one))


def same(scanned: Candidate, one: Candidate) -> bool:
    """Whether it is a scan's, whatever was left out of the design since."""
    return scanned.effect.name == one.effect.name and scanned.place is (one.proposed or one.place)
