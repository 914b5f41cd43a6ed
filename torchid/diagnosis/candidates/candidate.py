"""Effects at places as candidates, and the columns that they have in a design."""

from dataclasses import dataclass, field
from functools import cached_property

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchid.effects.effect import Effect
from torchid.effects.place import Place


@dataclass(frozen=True)
class ColumnSource:
    """Columns that a nuisance or candidates share."""

    effect: Effect
    """Effect whose columns they are."""
    place: Place
    """Place at which they are made."""
    columns: slice
    """Columns of the design."""
    mean: tuple[float, ...]
    """Mean of the prior of its parameters."""
    scale: tuple[float, ...]
    """Standard deviations of the prior of its parameters."""
    trial: str | None = None
    """Name of the only trial that has its columns; None: every trial has them."""
    at: tuple[float, ...] | None = None
    """Parameters at which the columns of a nonlinear effect on markers are taken; None: where it is absent."""


@dataclass(frozen=True)
class Candidate:
    """An effect at a place."""

    effect: Effect
    """The effect."""
    place: Place
    """Place of the effect."""
    source: ColumnSource
    """Source that has its columns."""
    trials: frozenset[int]
    """Indices of the trials in which it could act."""

    odds: float = 1.0
    """Odds of the place among all places of the effect."""
    proposed: Place | None = None
    """Place before the ends of its interval were moved; None if they were not."""
    ordinary: bool = field(default=False, compare=False)
    """True if it is no more than what sessions without it seem to have of it: one more nuisance, never named."""
    widened: float = 1.0
    """Factor on the standard deviations of the effect's prior."""

    @cached_property
    def blocks(self) -> tuple[frozenset[int], ...]:
        """Sets of trials that share parameters."""
        return tuple(frozenset({k}) for k in sorted(self.trials)) if self.effect.per_trial else (self.trials,)

    @property
    def size(self) -> int:
        """Number of parameters, over all blocks."""
        return len(self.columns) * len(self.blocks)

    @cached_property
    def columns(self) -> Int[Tensor, " columns"]:
        """Columns in the design."""
        return torch.arange(self.source.columns.start, self.source.columns.stop)

    @cached_property
    def relative(self) -> Float[Tensor, " columns"]:
        """Prior standard deviations over those of the source."""
        own = torch.tensor(self.effect.scale(self.place), dtype=torch.float64)
        return self.widened * own / torch.tensor(self.source.scale, dtype=torch.float64)
