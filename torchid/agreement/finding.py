"""What is wrong with the forces of a recording, and the config lines that put it right."""

from dataclasses import dataclass

from torchid.agreement.changes import Change
from torchid.agreement.evidence import Evidence


@dataclass(frozen=True)
class Finding:
    """Forces that do not agree with the feet."""

    what: str
    """What was seen, as a sentence without its end."""
    changes: tuple[Change, ...] = ()
    """Readings under which they agree, the likeliest first; empty where nothing on the list does."""
    instead: str = "forces_as: {use: false}"
    """The line that leaves the forces in question out."""
    removed: bool = False
    """The config says something about these forces already, which the line replaces."""

    def remedy(self, where: str = "to the trial") -> str:
        """What to do, with the config lines; ``where`` they belong."""
        add = f"replace its forces_as and plates, or add {where}:" if self.removed else f"add {where}"
        if not self.changes:
            return f"Nothing on the list of known faults puts it right; to go on without them {add} `{self.instead}`"
        if self.changes == (Change(""),):
            return "They agree as the file has them: remove forces_as and plates"
        if len(self.changes) == 1:
            return f"They agree if {self.changes[0].what}; then {add} `{self.changes[0].line}`"
        several = "; or ".join(f"{change.what}: `{change.line}`" for change in self.changes)
        return f"They agree in several ways ({several}): {add} the one that is true, or `{self.instead}`"


def in_figures(evidence: Evidence, k: int) -> str:
    """The witnesses of one reading, in words."""
    if not bool(evidence.loaded[k] > 0):
        return "nobody stands on it as read"
    return (
        f"pressure {1e3 * float(evidence.pressure[k]):.0f} mm from the nearest foot, force aimed "
        f"{1e3 * float(evidence.aim[k]):.0f} mm beside the body's middle, free moment up to "
        f"{1e3 * float(evidence.free[k]):.3g} mm times the force"
    )
