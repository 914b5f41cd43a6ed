"""Options of the solver of shared contact."""

from dataclasses import dataclass

from torchid.bounds import Count, NonNegative, Positive


@dataclass(frozen=True)
class SolverOptions:
    """How finely, and what the constraints weigh; lengths and forces as parts of the largest total."""

    tolerance: Positive = 1e-5
    """Residuals at which it ends, as a part of the largest total force."""
    iterations: Count = 4000
    penalty: Positive = 1e3
    """Of the first iterations: between the ridge and the cost of a point force as large as the largest total, which is
    1e4 to 1e5 for a foot whose centre of pressure is known to 15 mm."""
    ridge: Positive = 1e-2
    """Cost of a point force as large as the largest total: spreads pressure where nothing else tells."""
    give: NonNegative = 1e4
    """Cost of leaving the cones by a force as large as the largest total; exact above the largest multiplier."""
