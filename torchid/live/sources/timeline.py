"""The newest part of a signal whose samples come in any order."""

import torch
from jaxtyping import Float, Int
from torch import Tensor

GROW = 1024
"""Choice. Samples for which room is made at least."""


class Timeline:
    """Samples by their number; those that have not come are NaN. What is forgotten makes room."""

    def __init__(self, shape: tuple[int, ...]) -> None:
        """Begin empty."""
        self._shape, self.start, self.stop = shape, 0, 0
        self._values = self._missing(0)

    def put(self, index: Int[Tensor, " some"], values: Float[Tensor, "some *shape"]) -> None:
        """Put samples in their places; what lies before ``start`` is forgotten already."""
        recent = index >= self.start
        if not bool(recent.any()):
            return
        place = index[recent] - self.start
        self.stop = max(self.stop, int(index[recent].max()) + 1)
        lacking = self.stop - self.start - len(self._values)
        if lacking > 0:
            self._values = torch.cat([self._values, self._missing(max(lacking, GROW, len(self._values)))])
        self._values[place] = values[recent].to(self._values)

    def get(self, part: slice) -> Float[Tensor, "some *shape"]:
        """Return the samples of a part, also of one that nobody has put yet."""
        found = self._missing(max(0, part.stop - part.start))
        first, stop = max(part.start, self.start), min(part.stop, self.stop)
        if stop > first:
            found[first - part.start : stop - part.start] = self._values[first - self.start : stop - self.start]
        return found

    def forget(self, before: int) -> None:
        """Give up the samples before one.

        Args:
            before: number of the first one that stays.
        """
        gone = min(before, self.stop) - self.start
        if gone > 0:
            self._values = self._values[gone:].clone()
            self.start += gone

    def _missing(self, count: int) -> Tensor:
        return torch.full((count, *self._shape), torch.nan, dtype=torch.float64)
