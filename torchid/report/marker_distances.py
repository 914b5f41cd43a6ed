"""How well markers are followed before and after named causes were taken out."""

import math

from markupsafe import Markup
from matplotlib.figure import Figure as Canvas
from matplotlib.lines import Line2D
from torch import Tensor

from torchid.report.figure import IDENTIFIED, SCALED, draw, tidy
from torchid.session import Outcome
from torchid.session.tables import rms
from torchid.wording import clean, number

POINTS = 600
"""Samples drawn per line at most."""


def marker_error(outcome: Outcome, name: str, labels: tuple[str, ...] = ()) -> float:
    """RMS distance of some markers (none given: all) from the model in a trial [mm]."""
    error, known = outcome.followed[name].tracked.error, outcome.fit.attachment.labels
    columns = [known.index(label) for label in labels if label in known]
    return 1e3 * rms(error[:, columns] if labels else error)


def marker_cells(outcome: Outcome, name: str, labels: tuple[str, ...]) -> tuple[str, str]:
    """Marker error before and after [mm], as it is printed; no labels: all markers."""
    assert outcome.base is not None
    before, after = (marker_error(o, name, labels) for o in (outcome.base, outcome))
    return number(before, 2), number(after, 2)


def telling_markers(outcome: Outcome) -> list[tuple[str, str]]:
    """Trial and label where the distance of a marker changes most, in held-out trials and in fit trials."""
    return [_telling(outcome, names) for role in ("heldout", "fit") if (names := list(outcome.session.role(role)))]


def _telling(outcome: Outcome, names: list[str]) -> tuple[str, str]:
    assert outcome.base is not None
    moved = {
        (name, label): abs(marker_error(outcome, name, (label,)) - marker_error(outcome.base, name, (label,)))
        for name in names
        for label in outcome.fit.attachment.labels
    }
    return max(moved, key=lambda key: moved[key] if math.isfinite(moved[key]) else -1.0)


def draw_markers(outcome: Outcome) -> Markup:
    """Distance of the most changed markers from the model over time, before and after."""
    base, chosen = outcome.base, telling_markers(outcome)
    assert base is not None

    def paint(canvas: Canvas) -> None:
        # An axis of its own for each: in the trial of a swap it is 130 mm, in a held-out one 2 mm.
        panels = canvas.subplots(1, len(chosen), squeeze=False)[0]
        for axes, (name, label) in zip(panels, chosen, strict=True):
            time = outcome.followed[name].motion.time
            step = max(1, -(-len(time) // POINTS))
            for one, look in ((base, {"color": SCALED}), (outcome, {"color": IDENTIFIED})):
                axes.plot(time[::step], 1e3 * _distance(one, name, label)[::step], linewidth=1.2, **look)
            axes.set_title(f"{clean(label, 24)} in {clean(name, 24)} [mm]")
            axes.set_xlabel("time [s]")
            axes.set_ylim(bottom=0.0)
            axes.margins(x=0.0)
            tidy(axes)
        handles = [
            Line2D([], [], color=SCALED, label="base model"),
            Line2D([], [], color=IDENTIFIED, label="extended model"),
        ]
        canvas.legend(handles=handles, loc="outside lower center", ncols=2)

    return draw("followed", (7.5, 2.5), "Distance of markers from the model over time, before and after", paint)


def _distance(outcome: Outcome, name: str, label: str) -> Tensor:
    return outcome.followed[name].tracked.error[:, outcome.fit.attachment.labels.index(label)]
