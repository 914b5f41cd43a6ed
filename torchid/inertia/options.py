"""Options of the inertial fit."""

from dataclasses import dataclass, fields
from typing import Literal

from torchid.conventions import Positive, Share
from torchid.errors import OptionError


@dataclass(frozen=True)
class IdentifyOptions:
    """How data and prior are weighed and what the result must fulfil, of rows that are whitened by their own noise."""

    lmi: bool = True
    """Every pseudo-inertia positive definite."""
    prior: Literal["quadratic", "entropic"] = "quadratic"
    """Distance to the prior mean: Mahalanobis, or the log-det divergence of pseudo-inertias."""
    prior_weight: Literal["evidence", "cross_validation"] | Positive = 1.0
    """omega_2, the factor on the prior's precision: a number, or how to choose it. One takes the tables' scatter as it
    is: a factor that evidence chooses for all parameters together makes some of them far surer than they are."""
    floor: Positive = 1e-6
    """Smallest eigenvalue of a pseudo-inertia relative to that of the prior mean (see ``relative_map``)."""
    prior_weight_range: tuple[Positive, Positive] = (1.0, 1e3)
    """Where omega_2 is looked for: a body is at least as close to the tables as their scatter says. Below one, errors
    that one kind of motion repeats (skin that slides alike in every step) buy masses that no person has: on real walks
    with 0.5, the pelvis gained 0.7 kg for 0.6 N of held-out residual, and with 0.02 it took 20 of 63 kg."""
    base_parameters: bool = True
    """Whether to work out the identifiable combinations."""
    rank_tolerance: Positive = 1e-6
    """Singular value of the regressor with unit columns, relative to the largest, that counts as zero."""
    gap_limit: Positive = 1e-6
    """Largest relative gap, primal and dual residual of an accepted result."""
    mass_ratio: tuple[Positive, Positive] = (0.5, 2.0)
    """Total mass that the data ask for over that of the prior: outside, the plates are at fault."""
    explained_limit: Share = 0.5
    """Smallest share of the squared wrench that an accepted result explains."""
    refuse: bool = True
    """Raise DataError where the result is not accepted; otherwise return it with its status."""

    def __post_init__(self) -> None:
        positive = {"floor": self.floor, "rank_tolerance": self.rank_tolerance, "gap_limit": self.gap_limit}
        if not isinstance(self.prior_weight, str):
            positive["prior_weight"] = self.prior_weight
        for name, value in positive.items():
            if not 0 < value < float("inf"):
                raise OptionError(
                    "inertia.option", "must be a positive number", place=name, found=str(value),
                    remedy=f"The default is {type(self).__dataclass_fields__[name].default}",
                )  # fmt: skip
        if not 0 < self.prior_weight_range[0] <= self.prior_weight_range[1]:
            found = str(self.prior_weight_range)
            raise OptionError(
                "inertia.option", "must be (low, high)", place="prior_weight_range", found=found,
                remedy="Give two positive numbers, the smaller one first",
            )  # fmt: skip


@dataclass(frozen=True)
class InertiaOptions(IdentifyOptions):
    """The options of one fit, whose rows may be whitened or not."""

    noise: Literal["estimated", "known"] = "estimated"
    """omega_1: estimated from the residual, or 1 because the rows are truly whitened."""


def of_whitened_rows(options: IdentifyOptions) -> InertiaOptions:
    """The options of a fit of rows that their own noise has whitened."""
    shared = {own.name: getattr(options, own.name) for own in fields(IdentifyOptions)}
    return InertiaOptions(**shared, noise="known")
