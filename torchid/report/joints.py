"""Joint moments of one trial with the identified model and with the scaled template."""

import torch
from markupsafe import Markup
from matplotlib.figure import Figure as Canvas
from matplotlib.lines import Line2D
from torch import Tensor

from torchid.report.blocks import Figure, Section, Table
from torchid.report.facts import judges
from torchid.report.figure import IDENTIFIED, MUTED, SCALED, draw, tidy
from torchid.report.forces import POINTS, peak
from torchid.session import Outcome
from torchid.session.tables import rms
from torchid.wording import ABSENT, clean, listing, number, percent

SHOWN = ("hip_{}_flexion", "hip_{}_adduction", "knee_{}_flexion", "ankle_{}_flexion", "shoulder_{}_flexion")
"""Coordinates of the built-in model, left and right."""
ENOUGH = 0.5
"""Share of leg samples with a known wrench from which on a trial is worth showing."""


def joints_section(outcome: Outcome) -> Section | None:
    """The section on joint moments; None where the model has none of these joints or no trial has forces."""
    names = outcome.fit.model.tree.dof_names
    rows = [pair for pair in (tuple(name.format(side) for side in "lr") for name in SHOWN) if set(pair) <= set(names)]
    trial = _trial(outcome, [names.index(name) for pair in rows for name in pair if not name.startswith("shoulder")])
    if not rows or trial is None or set(names) - set(outcome.scaled.model.tree.dof_names):
        return None
    known = torch.isfinite(outcome.torque[trial]).double().mean()
    figure = Figure(
        _draw(outcome, trial, rows),
        f"Net joint moments in trial {clean(trial)}, in the sense of the coordinate (flexion, adduction, dorsiflexion "
        "positive). Blank where a leg's contact is not measured. The scaled template carries tabulated inertia.",
    )
    table, largest = _table(outcome, trial, rows)
    mass = float(outcome.phi[:, 0].sum())
    finding = (
        f"In {clean(trial)} the identified model and the scaled template differ most at the {largest[0]}: by "
        f"{number(largest[1])} N m RMS ({number(largest[1] / mass, 2)} N m/kg), {percent(largest[1] / largest[2])} of "
        f"the peak moment there; {percent(known)} of all samples are known."
    )
    return Section("moments", "Joint moments", finding, (figure, table))


def _trial(outcome: Outcome, rows: list[int]) -> str | None:
    """First judging trial whose legs' moments are mostly known, else the one where most are."""
    share = {}
    for name in judges(outcome).names:
        if outcome.followed[name].wrench is not None and name in outcome.torque:
            share[name] = float(torch.isfinite(outcome.torque[name][:, rows]).double().mean())
    good = [name for name, part in share.items() if part >= ENOUGH]
    if good:
        return good[0]
    known = {name: part for name, part in share.items() if part > 0.0}
    return max(known, key=lambda name: known[name]) if known else None


def _both(outcome: Outcome, trial: str, name: str) -> tuple[Tensor, Tensor]:
    identified = outcome.torque[trial][:, outcome.fit.model.tree.dof_names.index(name)]
    return identified, outcome.torque_scaled[trial][:, outcome.scaled.model.tree.dof_names.index(name)]


def _words(name: str) -> str:
    joint, side, motion = name.split("_", 2)
    return f"{ {'l': 'left', 'r': 'right'}[side] } {joint}, {motion}"


def _draw(outcome: Outcome, trial: str, rows: list[tuple[str, ...]]) -> Markup:
    time = outcome.followed[trial].motion.time
    step = max(1, -(-len(time) // POINTS))

    def paint(canvas: Canvas) -> None:
        panels = canvas.subplots(len(rows), 2, sharex=True, sharey="row", squeeze=False)
        for pair, line in zip(rows, panels, strict=True):
            for name, axes in zip(pair, line, strict=True):
                identified, scaled = _both(outcome, trial, name)
                axes.axhline(0.0, color=MUTED, linewidth=0.6)
                axes.plot(time[::step], scaled[::step], color=SCALED, linestyle=(0, (3, 1.5)), linewidth=1.4)
                axes.plot(time[::step], identified[::step], color=IDENTIFIED, linewidth=1.5)
                axes.set_title(_words(name))
                axes.margins(x=0.0)
                tidy(axes)
            line[0].set_ylabel("[N m]")
        for axes in panels[-1]:
            axes.set_xlabel("time [s]")
        handles = [Line2D([], [], color=IDENTIFIED, linewidth=1.5, label="identified"),
                   Line2D([], [], color=SCALED, linestyle=(0, (3, 1.5)), label="scaled template")]  # fmt: skip
        canvas.legend(handles=handles, loc="outside lower center", ncols=2)

    return draw("joints", (7.5, 0.7 + 1.35 * len(rows)), f"Joint moments over time in trial {clean(trial)}", paint)


def _table(outcome: Outcome, trial: str, rows: list[tuple[str, ...]]) -> tuple[Table, tuple[str, float, float]]:
    """Peaks and differences, and the joint where the two models differ most."""
    cells, largest = [], ("none", 0.0, float("nan"))
    blank = []
    for name in (name for pair in rows for name in pair):
        identified, scaled = _both(outcome, trial, name)
        difference, top = rms(identified - scaled), peak(identified)
        share = percent(torch.isfinite(identified).double().mean())
        if top != top:
            blank.append(_words(name))
        elif difference > largest[1]:
            largest = (_words(name), difference, top)
        cells.append(
            (_words(name), number(top), number(peak(scaled)), number(difference) if top == top else ABSENT, share)
        )
    head = ("Moment", "Identified, peak [N m]", "Scaled, peak [N m]", "Difference, RMS [N m]", "Samples known")
    caption = "Peak magnitudes and differences" + (f"; nothing is known of {listing(blank)}" if blank else "")
    return Table(caption, head, tuple(cells)), largest
