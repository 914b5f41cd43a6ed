"""Model-free checks of the causes, as a table: what is measured beside what is expected with and without the cause."""

from collections.abc import Sequence

from torchid.diagnosis.verdict.records import Cause
from torchid.model_free.testimony import CheckAnswer
from torchid.report.blocks import Block, Details, Table
from torchid.report.cause_sentences import name
from torchid.wording import clean, decimals, number

LISTED = 6
"""Checks that are listed of a cause; all are in diagnosis.json."""
WORDS = {
    "mass": "weight that plates bear, beyond the record",
    "gain": "weight on one plate, beyond its part of that on the other",
    "clock_vertical": "forces behind the motion, vertical",
    "clock_horizontal": "forces behind the motion, horizontal",
    "lean": "lean of the weight",
    "zero": "reading while nothing is on the plate",
    "pressure_lateral": "centre of pressure beside the sole, across",
    "pressure_along": "centre of pressure beside the sole, along",
    "marker_distances": "distances to other markers of the segment, off by",
    "marker_quickness": "motion of markers at 12 to 20 Hz",
}
UNITS = {"s": (1e3, "ms"), "m": (1e3, "mm"), "part": (1e2, "%")}
"""Factors of units that are easier to read."""


def witness_table(causes: Sequence[Cause]) -> list[Block]:
    """Nothing where no check tells of any cause."""
    rows = tuple(_row(cause, one) for cause in causes for one in cause.witnesses[:LISTED])
    if not rows:
        return []
    head = ("Cause", "Model-free check", "In", "Measured", "Expected with the cause", "Expected without a fault", "")
    caption = "Statistics that need almost no body model; the spread is that between sessions without a fault"
    return [Details("Model-free checks of each cause", (Table(caption, head, rows, text=3, wrap=True),))]


def _row(cause: Cause, one: CheckAnswer) -> tuple[str, ...]:
    factor, unit = UNITS.get(one.unit, (1.0, one.unit))
    digits = decimals(factor * one.sd)
    value, sd, expected, usual = (number(factor * x, digits) for x in (one.value, one.sd, one.expected, one.usual))
    place = ", ".join(filter(None, (one.trial, one.where)))
    return (name(cause), _words(one.name), clean(place), f"{value} ± {sd} {unit}", f"{expected} {unit}",
            f"{usual} {unit}", _verdict(one))  # fmt: skip


def _verdict(one: CheckAnswer) -> str:
    """In a word or two; another size than that of the cause is no denial of it."""
    if one.agrees:
        return "agrees"
    nearer = abs(one.value - one.expected) < abs(one.value - one.usual)
    return "another size" if one.contradicts and nearer else "contradicts" if one.contradicts else "cannot tell"


def _words(kind: str) -> str:
    """Of a kind of check, axes told apart by their letters."""
    first, _, axis = kind.partition("_")
    return WORDS[kind] if kind in WORDS else f"{WORDS[first]}, {axis}"
