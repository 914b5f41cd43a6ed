"""What is wrong with an instrument: one type for all that say so, and the one place where it becomes a sentence.

Reading, tracks of markers, forces against feet, the watch of a stream and the diagnosis each make ``Finding``; check,
report, page and JSON print them.
"""

from dataclasses import dataclass
from enum import StrEnum

from torchid.errors import Note


class InstrumentFault(StrEnum):
    """What can be wrong with an instrument."""

    CLOCK = "clock"
    """Plates are stamped early or late."""
    GAIN = "gain"
    """A plate reads too much or too little by one factor, or the wrong way round."""
    UNIT = "unit"
    """Forces, moments or lengths are in another unit."""
    SCALE = "scale"
    """Forces or moments are scaled away, or channels are silent."""
    ZERO = "zero"
    """A plate reads something while nobody is on it."""
    DRIFT = "drift"
    """What it reads then changes."""
    LIMIT = "limit"
    """It reads what no plate can, or stays on its largest value."""
    PLACE = "place"
    """A plate lies elsewhere than its file says."""
    TURN = "turn"
    """It is turned on its place, or its corners are in another order."""
    WIRING = "wiring"
    """Its channels are exchanged, or an axis is reversed."""
    CROSSTALK = "crosstalk"
    """Channels leak into each other."""
    EXCHANGE = "exchange"
    """Two plates, or two markers, carry each other's signal."""
    AXES = "axes"
    """Forces and markers have other axes."""
    TILT = "tilt"
    """The vertical is not that of gravity."""
    WEIGHT = "weight"
    """The plates carry another weight than the body's."""
    DISAGREEMENT = "disagreement"
    """Forces do not agree with the feet, and no known fault explains it."""
    JUMP = "jump"
    """A marker leaps."""
    FROZEN = "frozen"
    """A marker stands still while those beside it move."""
    MOVED = "moved"
    """A marker sits elsewhere than in other trials."""
    HIDDEN = "hidden"
    """A marker is not seen."""
    RECORD = "record"
    """The file is damaged, or contradicts itself."""


class Severity(StrEnum):
    """How much it matters."""

    PROBLEM = "problem"
    """Results are wrong with it."""
    WARNING = "warning"
    """Results are right with it, or somebody should look."""


@dataclass(frozen=True)
class Cure:
    """A line of a config, and what is true where it mends."""

    what: str
    """As the end of ``They agree if ...``."""
    config: str
    """The line."""
    hypothesis: str = ""
    """The same as key and value, such as ``turn_deg=180``."""
    plates: tuple[int, ...] = ()
    """Numbers of the plates that it is about; empty: all of a file."""


@dataclass(frozen=True)
class Finding:
    """What is wrong with an instrument."""

    fault: InstrumentFault
    """What it is."""
    code: str
    """Short dotted name, stable across versions."""
    evidence: str
    """What was seen, in figures: a sentence without its end."""
    source: str = ""
    """The file or the trial."""
    place: tuple[str, ...] = ()
    """Plates or markers; empty: the whole recording."""
    size: float | None = None
    """How large the fault is, where that is a number."""
    sd: float | None = None
    """Standard deviation of that."""
    unit: str = ""
    """Of both."""
    cures: tuple[Cure, ...] = ()
    """Lines that mend it, the likeliest first."""
    leave_out: str = ""
    """The line that leaves the instrument out, where that is advised."""
    believe: str = ""
    """The line that takes it as it is all the same."""
    replaces: bool = False
    """Whether the lines replace what the config says already."""
    advice: str = ""
    """What to do where no line of a config does it."""
    severity: Severity = Severity.PROBLEM
    """How much it matters."""

    def remedy(self, where: str = "to the trial in a config") -> str:
        """What to do about it.

        Args:
            where: the place to which a line belongs, as in ``add ... `up: y` ``.
        """
        add = f"instead of what the config says add {where}" if self.replaces else f"add {where}"
        if not self.cures:
            if self.advice or not self.leave_out:
                return self.advice
            return (
                "Nothing on the list of known faults puts it right; to go on without them "
                f"{add} `{self.leave_out}`, or, if they are right all the same, `{self.believe}`"
            )
        if len(self.cures) == 1:
            return f"They agree if {self.cures[0].what}; then {add} `{self.cures[0].config}`"
        several = "; or ".join(f"{c.what}: `{c.config}`" for c in self.cures)
        return f"They agree in several ways ({several}): {add} the one that is true, or `{self.leave_out}`"

    @property
    def config(self) -> str:
        """The line that mends it, where there is just one; else empty."""
        return self.cures[0].config if len(self.cures) == 1 else ""

    @property
    def message(self) -> str:
        """What is said of it: what was seen, and what to do."""
        remedy = self.remedy()
        return f"{self.evidence}. Cure: {remedy}" if remedy else self.evidence

    @property
    def note(self) -> Note:
        """The same as a note."""
        return Note(self.code, self.message, self.source)

    def __str__(self) -> str:
        return str(self.note)


@dataclass(frozen=True)
class FindingRecord:
    """A finding as JSON has it, in ``check --json`` and in ``diagnosis.json``."""

    code: str
    place: str
    """File or trial, then plates or markers."""
    found: str
    """What was seen, in figures."""
    remedy: str
    severity: Severity
    fault: InstrumentFault
    size: float | None
    sd: float | None
    unit: str
    config: str
    """The line that mends it, where there is just one."""
    message: str
    """All of it, as terminal and report have it."""


def record_of(one: Finding) -> FindingRecord:
    """Return the finding as JSON has it.

    Args:
        one: the finding.
    """
    place = ", ".join(filter(None, (one.source, *one.place)))
    return FindingRecord(
        one.code, place, one.evidence, one.remedy(), one.severity, one.fault, one.size, one.sd, one.unit, one.config,
        one.message,
    )  # fmt: skip
