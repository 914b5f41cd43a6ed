"""What is wrong with the forces of a recording, and the config lines that put it right."""

import math
from dataclasses import dataclass
from functools import reduce
from itertools import islice, product
from operator import and_

from torchid.checks.finding import Finding
from torchid.checks.plates_against_feet.changes import Change
from torchid.checks.plates_against_feet.evidence import Evidence
from torchid.io.mend import ForcesAs, PlateAs


def without(*numbers: int) -> Change:
    """The change that leaves plates out, or, without numbers, all forces."""
    if not numbers:
        return Change("they are left out", ForcesAs(use=False))
    named = f"plate{'s' if numbers[1:] else ''} {', '.join(map(str, numbers))}"
    return Change(f"{named} left out", plates={n: PlateAs(use=False) for n in numbers})


@dataclass(frozen=True)
class ForceFinding:
    """Forces that do not agree with the feet."""

    what: str
    """What was seen, as a sentence without its end."""
    changes: tuple[Change, ...] = ()
    """Readings under which they agree, the likeliest first; empty where nothing on the list does."""
    instead: Change = without()
    """What leaves the forces in question out."""
    removed: bool = False
    """The config says something about these forces already, which the line replaces."""
    advice: str = ""
    """What to do where no line mends it and leaving it out is no answer."""

    def lines(self) -> list[str]:
        """The config lines of the changes."""
        return [change.written(self.removed) for change in self.changes]

    def as_finding(self, source: str = "") -> Finding:
        """The same of an instrument.

        Args:
            source: the file.
        """
        first = self.changes[0] if self.changes else Change("")
        return Finding(
            first.fault, "forces.feet", self.what, source, tuple(f"plate {n}" for n in sorted(self.instead.plates)),
            first.size, first.sd, first.unit, tuple(c.as_cure(self.removed) for c in self.changes),
            self.instead.line, BELIEVED, self.removed, self.advice,
        )  # fmt: skip

    def remedy(self, where: str = "to the trial") -> str:
        """What to do, with the config lines; ``where`` they belong."""
        return self.as_finding().remedy(where)


BELIEVED = "forces_as: {believe: true}"
"""The line that takes forces as they are."""
COMBINED = 6
"""So many combinations of what is wrong with several plates are named."""


def together(findings: tuple[ForceFinding, ...]) -> tuple[ForceFinding, ...]:
    """Findings about several plates as one, so that there is one line to add: a config has each key once."""
    if len(findings) < 2:
        return findings
    choices = [f.changes or (f.instead,) for f in findings] if any(f.changes for f in findings) else []
    changes = tuple(reduce(and_, some) for some in islice(product(*choices), COMBINED) if some)
    return (ForceFinding("; ".join(f.what for f in findings), changes, reduce(and_, (f.instead for f in findings))),)


def in_figures(evidence: Evidence, k: int) -> str:
    """The witnesses of one reading, in words."""
    if not bool(evidence.loaded[k] > 0):
        return "nobody stands on it as read"
    aim = float(evidence.aim[k])
    aimed = "" if math.isnan(aim) else f"force aimed {1e3 * aim:.0f} mm beside the body's middle, "
    return (
        f"pressure {1e3 * float(evidence.pressure[k]):.0f} mm from the nearest foot, {aimed}free moment up to "
        f"{1e3 * float(evidence.free[k]):.3g} mm times the force"
    )
