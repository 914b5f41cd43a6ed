"""What witnesses say of the causes, as a table: measured without any body model, beside what each cause would have."""

from collections.abc import Sequence

from torchid.diagnosis.verdict.records import Cause
from torchid.report.blocks import Block, Details, Table
from torchid.report.cause_sentences import name
from torchid.witnesses.testimony import CONTRADICTS_SD, Answer
from torchid.wording import clean, number

LISTED = 6
"""Witnesses that are listed of a cause; all are in diagnosis.json."""
WORDS = {
    "mass": "weight that plates bear, over the record",
    "gain": "weight on this plate, over that on the others",
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
    """Nothing where no witness hears any cause."""
    rows = tuple(_row(cause, one) for cause in causes for one in cause.witnesses[:LISTED])
    if not rows:
        return []
    head = ("Cause", "Witness", "In", "Says", "Would say, were it so", "Where nothing is wrong", "")
    caption = "Measured without a body model, with the standard deviation of sessions in which nothing is wrong"
    return [Details("What witnesses say of each cause", (Table(caption, head, rows, text=3, wrap=True),))]


def _row(cause: Cause, one: Answer) -> tuple[str, ...]:
    factor, unit = UNITS.get(one.unit, (1.0, one.unit))
    value, sd, expected, usual = (number(factor * x, 1) for x in (one.value, one.sd, one.expected, one.usual))
    far = abs(one.value - one.expected) > CONTRADICTS_SD * one.sd
    said = "agrees" if one.agrees else "contradicts" if far else "cannot tell"
    place = ", ".join(filter(None, (one.trial, one.where)))
    return (name(cause), _words(one.name), clean(place), f"{value} ± {sd} {unit}", f"{expected} {unit}",
            f"{usual} {unit}", said)  # fmt: skip


def _words(kind: str) -> str:
    """Of a kind of witness, axes told apart by their letters."""
    first, _, axis = kind.partition("_")
    return WORDS[kind] if kind in WORDS else f"{WORDS[first]}, {axis}"
