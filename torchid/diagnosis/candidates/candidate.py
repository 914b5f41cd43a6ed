"""What could be hidden: an effect at a place, and the columns that it has in a design."""

from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchid.effects.effect import Effect
from torchid.effects.place import Place


@dataclass(frozen=True)
class Source:
    """Columns that a nuisance or candidates share."""

    effect: Effect
    place: Place
    columns: slice
    mean: tuple[float, ...]
    scale: tuple[float, ...]
    """Of the prior of its parameters."""
    trial: str | None = None
    """The only one that has its columns; None: every one does."""
    at: tuple[float, ...] | None = None
    """Parameters at which those of a curved effect on markers are taken; None: where it is absent."""


@dataclass(frozen=True)
class Candidate:
    """An effect at a place."""

    effect: Effect
    place: Place
    source: Source
    trials: frozenset[int]
    """In which it could act, by their order."""

    odds: float = 1.0
    """Of the place among all places of the effect."""
    proposed: Place | None = None
    """Before the ends of its interval were moved."""
    widened: float = 1.0
    """Times the prior of the effect."""

    @property
    def blocks(self) -> tuple[frozenset[int], ...]:
        """Trials that share parameters."""
        return tuple(frozenset({k}) for k in sorted(self.trials)) if self.effect.per_trial else (self.trials,)

    @property
    def size(self) -> int:
        """Number of parameters."""
        return len(self.columns) * len(self.blocks)

    @property
    def columns(self) -> Int[Tensor, " columns"]:
        """In the design."""
        return torch.arange(self.source.columns.start, self.source.columns.stop)

    @property
    def relative(self) -> Float[Tensor, " columns"]:
        """Prior standard deviations against those of the source."""
        own = torch.tensor(self.effect.scale(self.place), dtype=torch.float64)
        return self.widened * own / torch.tensor(self.source.scale, dtype=torch.float64)
