"""The page of a cohort: how many are done, who stands out, what recurs, and a sortable row for everybody."""

import math
import statistics
from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from markupsafe import Markup, escape

from torchid.cohort.members import LABELS
from torchid.cohort.one_run import Row
from torchid.cohort.table import COLUMNS, cells
from torchid.report.blocks import Block, Details, Items, Paragraph, Section, Table
from torchid.report.figure import IDENTIFIED
from torchid.report.page import render_page
from torchid.report.picture import FORCE
from torchid.session.outcome import QualityLevel
from torchid.wording import ABSENT, clean, listing, number, plural

OUTLYING = 3.5
"""Multiples of 1.4826 times the median deviation from the median from which on a figure stands out (Iglewicz &
Hoaglin, How to Detect and Handle Outliers, 1993, have 3.5 for their modified z-score)."""
NORMAL = 1.4826
"""Standard deviation of a normal distribution over the median deviation from its median."""
FEWEST = 5
"""Subjects from which on somebody can stand out among them; chosen."""
RECURS = 2
"""Subjects from which on a cause recurs; derived: one is no other."""
VIEW_CM = (110, 190, 30)
"""Choice. What a thumbnail shows: its width, and how far above and below the floor under the pelvis [cm]."""
SORTER = (
    'for(const table of document.querySelectorAll("#subjects table"))table.querySelectorAll("thead th").forEach('
    '(head,k)=>{head.tabIndex=0;head.style.cursor="pointer";const sort=()=>{'
    'const up=head.getAttribute("aria-sort")!=="ascending",body=table.tBodies[0],'
    "key=row=>row.cells[k].textContent.trim(),figure=text=>parseFloat(text.replace(/\\u2212/g,'-'));"
    'table.querySelectorAll("thead th").forEach(other=>other.removeAttribute("aria-sort"));'
    'head.setAttribute("aria-sort",up?"ascending":"descending");'
    "[...body.rows].sort((a,b)=>{const[s,t]=[key(a),key(b)],[x,y]=[figure(s),figure(t)],"
    "by=isNaN(x)?s.localeCompare(t):x-y;return isNaN(x)!==isNaN(y)?isNaN(x)-isNaN(y):up?by:-by}).forEach("
    'row=>body.append(row))};head.addEventListener("click",sort);'
    'head.addEventListener("keydown",event=>{if(event.key==="Enter")sort()})})'
)
"""Script of the page: a click on a head sorts by its column, numbers as numbers, and what is missing last."""


class Measure(NamedTuple):
    """A figure by which subjects are compared."""

    key: str
    head: str
    digits: int


MEASURES = (
    Measure("excess", "mass over record [%]", 1),
    Measure("marker_rmse_mm", "markers [mm]", 1),
    Measure("heldout_force", "held-out force [% of weight]", 1),
    Measure("heldout_moment_Nm", "held-out moment [N m]", 1),
)


def render_cohort(rows: Sequence[Row], out: Path, together: Sequence[Section | None] = ()) -> str:
    """Return the page as text.

    Args:
        rows: of all members, in their order.
        out: folder of the cohort, from which the page links to reports.
        together: what sessions on the same plates, and all people, say together.
    """
    chapters = [_head(rows), _aside(rows), *together, _outliers(rows), _causes(rows), _subjects(rows, out)]
    title = f"{clean(out.name)}: {plural(len(rows), 'subject')}"
    return render_page(title, [one for one in chapters if one is not None], script=SORTER)


def figure_of(row: Row, key: str) -> float:
    """Return a figure of a row; NaN where it has none.

    Args:
        row: of a member.
        key: of ``MEASURES``, or of the row itself.
    """
    value, weight = row.get(key), row.get("mass_kg")
    if key == "excess":
        recorded = row.get("recorded_kg")
        value = 100.0 * (weight / recorded - 1.0) if weight and recorded else None
    elif key == "heldout_force":
        force = row.get("heldout_force_N")
        value = 100.0 * force / (9.81 * weight) if weight and force is not None else None
    return math.nan if value is None else float(value)


def outliers(rows: Sequence[Row]) -> Iterator[tuple[Row, Measure, float, float]]:
    """Who stands out among the others in a figure: row, figure, its value, the median.

    Args:
        rows: of all members.
    """
    for measure in MEASURES:
        known = [(row, value) for row in rows if math.isfinite(value := figure_of(row, measure.key))]
        if len(known) < FEWEST:
            continue
        middle = statistics.median(value for _, value in known)
        spread = NORMAL * statistics.median(abs(value - middle) for _, value in known)
        for row, value in known:
            if spread > 0.0 and abs(value - middle) > OUTLYING * spread:
                yield row, measure, value, middle


def _done(rows: Sequence[Row]) -> list[Row]:
    return [row for row in rows if row["status"] == "done"]


def _head(rows: Sequence[Row]) -> Section:
    done = _done(rows)
    verdicts = Counter(row["verdict"] for row in done)
    said = [f"{verdicts[level.value]} {level.value}" for level in QualityLevel if verdicts[level.value]]
    aside = len(rows) - len(done)
    finding = f"{len(done)} of {plural(len(rows), 'subject')} done" + (f": {listing(said)}." if said else ".")
    finding += f" {plural(aside, 'subject')} set aside, each with its reason." if aside else ""
    middles = [
        (m.head, number(statistics.median(known), m.digits), str(len(known)))
        for m in MEASURES
        if (known := [v for row in done if math.isfinite(v := figure_of(row, m.key))])
    ]
    table = Table("Medians over subjects.", ("Figure", "median", "subjects"), tuple(middles))
    hours = sum(row.get("seconds", 0.0) for row in rows) / 3600.0
    time = Paragraph(f"Runs took {number(hours, 2)} h, all workers together.")
    return Section("cohort", "Cohort", finding, (table, time) if middles else (time,))


def _aside(rows: Sequence[Row]) -> Section | None:
    left = [row for row in rows if row["status"] != "done"]
    if not left:
        return None
    table = Table(
        "", ("Subject", "Reason"), tuple((clean(r["subject"]), clean(r["reason"], 600)) for r in left), 2, True
    )
    return Section("aside", "Set aside", f"{plural(len(left), 'subject')} could not be used.", (table,), "unusable")


def _outliers(rows: Sequence[Row]) -> Section | None:
    found = list(outliers(_done(rows)))
    if len(_done(rows)) < FEWEST:
        return None
    names = list(dict.fromkeys(clean(row["subject"]) for row, *_ in found))
    finding = f"{listing(names)} stand out." if names else "Nobody stands out."
    lines = tuple(
        f"{clean(row['subject'])}: {measure.head} {number(value, measure.digits)}, median "
        f"{number(middle, measure.digits)}; {clean(row.get('because', '') or 'its verdict is good', 200)}."
        for row, measure, value, middle in found
    )
    blocks: tuple[Block, ...] = (Items(lines),) if lines else ()
    rule = f"A figure stands out that is over {OUTLYING} robust standard deviations from the median."
    return Section("outliers", "Who stands out", finding, (*blocks, Paragraph(rule)), "care" if lines else "")


def _causes(rows: Sequence[Row]) -> Section | None:
    """What the diagnosis finds, and in how many; where laboratories are told, in how many of each."""
    who = defaultdict(list)
    for row in _done(rows):
        for cause in row.get("causes", ()):
            who[cause].append(row)
    if not who:
        return None
    ranked = sorted(who.items(), key=lambda one: -len(one[1]))
    table = Table(
        "What recurs on the same plates is the laboratory's; what does not, a person's or a session's.",
        ("Cause", "Laboratories", "Who", "subjects"),
        tuple(
            (clean(cause), _laboratories(own), clean(listing([r["subject"] for r in own], 4), 200), str(len(own)))
            for cause, own in ranked
        ),
        text=3,
    )
    again = [f"{cause} in {len(own)}" for cause, own in ranked if len(own) >= RECURS]
    finding = f"Recurring: {listing(again, 4)}." if again else "Nothing recurs."
    return Section("causes", "Causes", finding, (table,))


def _laboratories(rows: Sequence[Row]) -> str:
    count = Counter(row.get("laboratory") or ABSENT for row in rows)
    return clean(listing([f"{name}: {n}" if len(count) > 1 else name for name, n in count.items()], 4), 200)


def _subjects(rows: Sequence[Row], out: Path) -> Section:
    used = [name for name in LABELS if any(row.get(name) for row in rows)]
    head = ("Subject", "", *used, "Verdict", "Causes", "mass [kg]", *(m.head for m in MEASURES))
    table = Table("A click on a head sorts.", head, tuple(_line(row, used, out) for row in rows), text=4 + len(used))
    meaning = Details("Columns of cohort.csv", (Table("", ("Column", "Meaning"), tuple(map(tuple, COLUMNS)), 2, True),))
    return Section("subjects", "Subjects", "Each with its report.", (table, meaning))


def _line(row: Row, used: Sequence[str], out: Path) -> tuple[str, ...]:
    report = cells(row, out)[-1]
    name = clean(row["subject"])
    link = Markup('<a href="{}">{}</a>').format(report, name) if report else escape(name)
    figures = (number(figure_of(row, m.key), m.digits) for m in MEASURES)
    verdict = row.get("verdict") or row["status"]
    mass = number(figure_of(row, "mass_kg"), 2)
    causes = clean(listing(list(row.get("causes", ())), 2), 90)
    return (link, _thumbnail(row), *(clean(row.get(one, "")) for one in used), verdict, causes, mass, *figures)


def _thumbnail(row: Row) -> str:
    """The identified body in one frame of the recordings, with the forces of the plates; empty where there is none."""
    outline = row.get("outline") or {}
    paths = [
        Markup('<path d="{}" stroke="{}"/>').format("".join(f"M{a},{b}L{c},{d}" for a, b, c, d in lines), colour)
        for lines, colour in ((outline.get("sticks", ()), IDENTIFIED), (outline.get("arrows", ()), FORCE))
        if lines
    ]
    if not paths:
        return ""
    width, top, bottom = VIEW_CM
    return Markup(
        '<svg viewBox="{} {} {} {}" style="width: 33px; height: 66px" fill="none" stroke-width="7" '
        'stroke-linecap="round" role="img" aria-label="the identified body">{}</svg>'
    ).format(-width // 2, -top, width, top + bottom, Markup("").join(paths))
