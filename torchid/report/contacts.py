"""Which contact is on which plate, frame by frame, and which wrenches are shared or predicted."""

from collections.abc import Iterator
from typing import Any

import torch
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Canvas
from matplotlib.patches import Patch
from torch import Tensor

from torchid.contact.contact import Contact
from torchid.contact.sharing.records import WrenchSource
from torchid.report.blocks import Figure
from torchid.report.figure import IDENTIFIED, MUTED, SCALED, SHADE, draw, tidy
from torchid.runs import runs
from torchid.session import Followed, Outcome
from torchid.wording import clean, plural

LOOKS: dict[WrenchSource, tuple[str, dict[str, Any]]] = {
    WrenchSource.MEASURED: ("alone on a plate", {"facecolor": IDENTIFIED, "edgecolor": IDENTIFIED}),
    WrenchSource.SHARED: ("shares a plate", {"facecolor": "#ffffff", "edgecolor": IDENTIFIED, "hatch": "////"}),
    WrenchSource.PREDICTED: ("predicted by the body", {"facecolor": SCALED, "edgecolor": SCALED}),
    WrenchSource.UNKNOWN: ("touches, not known", {"facecolor": SHADE, "edgecolor": MUTED}),
}
HEIGHT = 0.7
"""Of a bar, in lines."""


def contacts_figure(outcome: Outcome) -> Figure | None:
    """Return the timeline of the trial with most frames that no plate measures alone; None where feet are not known."""
    told = {name: found for name, found in outcome.under.items() if outcome.followed[name].contact is not None}
    if not told:
        return None
    name = max(told, key=lambda n: int((told[n].source != WrenchSource.MEASURED).sum()))
    found = told[name]
    shared, predicted = (
        int((found.source == s).any(dim=1).sum()) for s in (WrenchSource.SHARED, WrenchSource.PREDICTED)
    )
    said = (
        f"Trial {clean(name)}: what each plate bears. {plural(shared, 'frame')} with a plate that contacts share, "
        f"{plural(predicted, 'frame')} with a contact whose force is predicted; torques of their limbs rest on "
        "estimates."
    )
    return Figure(_draw(outcome, name), said)


def _lines(outcome: Outcome, name: str) -> Iterator[tuple[str, list[tuple[WrenchSource, Tensor]]]]:
    """Label and frames of each line, from the top: every contact on every plate that bears it, then beside them."""
    one: Followed = outcome.followed[name]
    trial, found = outcome.session.trials[name], outcome.under[name]
    assert one.contact is not None and trial.forces is not None
    for k, foot in enumerate(found.contacts):
        # A contact that has a plate for itself is on it whether it bears or not.
        bears = one.contact.bearing[:, k] if k >= len(one.contact.feet) else torch.ones_like(one.contact.used)
        source = found.source[:, k]
        for p, plate in enumerate(trial.forces.plates):
            mine = one.contact.plate[:, p]
            own = (mine == k) & (source == WrenchSource.MEASURED) & bears
            shared = (source == WrenchSource.SHARED) & (mine != -1) & may_be_on(one.contact, k, p)
            if bool((own | shared).any()):
                yield f"{foot} on {clean(plate.name)}", [(WrenchSource.MEASURED, own), (WrenchSource.SHARED, shared)]
        beside = [(s, source == s) for s in (WrenchSource.PREDICTED, WrenchSource.UNKNOWN)]
        if any(bool(frames.any()) for _, frames in beside):
            yield f"{foot} beside plates", beside


def may_be_on(contact: Contact, k: int, plate: int) -> bool:
    """Return whether a contact is ever looked for on a plate: feet on those of the floor, others on their own.

    Args:
        k: number of the contact, feet first.
    """
    if contact.others is not None and k >= len(contact.feet):
        return contact.others.column[k - len(contact.feet)] == plate
    return contact.floor is None or plate in contact.floor


def _draw(outcome: Outcome, name: str) -> Markup:
    time, lines = outcome.followed[name].motion.time, list(_lines(outcome, name))
    step = float(time[1] - time[0]) if len(time) > 1 else 0.0

    def paint(canvas: Canvas) -> None:
        axes = canvas.subplots()
        for row, (_, parts) in enumerate(lines):
            for source, frames in parts:
                _bars(axes, row, source, frames, time, step)
        axes.set_yticks(range(len(lines)), [label for label, _ in lines])
        axes.set_ylim(len(lines) - 0.4, -0.6)
        axes.set_xlim(float(time[0]), float(time[-1]))
        axes.set_xlabel("time [s]")
        tidy(axes, "x")
        kinds = dict.fromkeys(s for _, parts in lines for s, frames in parts if bool(frames.any()))
        legend = [Patch(label=LOOKS[s][0], linewidth=0.6, **LOOKS[s][1]) for s in kinds]
        if legend:
            canvas.legend(handles=legend, loc="outside lower center", ncols=4)

    return draw("contacts", (7.5, 1.3 + 0.3 * len(lines)), f"Contacts in trial {clean(name)}", paint)


def _bars(axes: Axes, row: int, source: WrenchSource, frames: Tensor, time: Tensor, step: float) -> None:
    spans = [(float(time[a]), float(time[b - 1] - time[a]) + step) for a, b in runs(frames)]
    if spans:
        axes.broken_barh(spans, (row - HEIGHT / 2, HEIGHT), linewidth=0.6, **LOOKS[source][1])
