"""What a subject's mass is said to be: by the record, by standing on plates and by the fit."""

import math
from dataclasses import dataclass

from torchid.model.anthropometry import body_mass
from torchid.session.outcome import Outcome
from torchid.session.standing import standing_weight


@dataclass(frozen=True)
class Mass:
    """One statement of the subject's mass."""

    value: float
    """[kg]"""
    sd: float
    """Standard deviation [kg]."""

    def apart(self, other: "Mass") -> float:
        """Distance from another statement in standard deviations of both, with its sign."""
        return (self.value - other.value) / math.hypot(self.sd, other.sd)


@dataclass(frozen=True)
class Masses:
    """All statements there are; None where nobody made one."""

    identified: Mass | None
    recorded: Mass | None
    standing: Mass | None
    trials: tuple[str, ...] = ()
    """Static trials in which the subject stands on plates."""


def masses(outcome: Outcome) -> Masses:
    """The subject's mass as recorded, as static trials read it, and as it was identified."""
    who, found = outcome.config.subject, outcome.identified
    recorded = standing = None
    if who.mass_kg:
        # The height bears on the mass only where none is recorded.
        recorded = Mass(*body_mass(1.0, who.mass_kg, who.mass_sd_kg))
    weight = standing_weight(outcome.followed.values(), outcome.session, outcome.config.subject.mass_kg)
    if weight is not None:
        standing = Mass(weight.mass, weight.sd)
    identified = None if found is None else Mass(float(found.fit.mass.sum()), float(found.fit.sd.total_mass))
    return Masses(identified, recorded, standing, () if weight is None else weight.trials)
