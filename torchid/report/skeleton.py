"""The identified skeleton against the scaled template: one frame drawn, and how far markers are from the model."""

import math

import torch
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Canvas
from matplotlib.lines import Line2D
from torch import Tensor

from torchid.geometry.tracking import modelled
from torchid.report.blocks import Details, Embedded, Figure, Section, Table
from torchid.report.facts import judges, marker_rms
from torchid.report.figure import IDENTIFIED, MEASURED, MUTED, SCALED, draw, tidy
from torchid.report.stick_figure import facing, stick_points, tips
from torchid.scene.embedded import EmbeddedPage
from torchid.session import Outcome
from torchid.session.tables import largest, marker_errors
from torchid.wording import ABSENT, change, clean, listing, number, segment

PIECE = 1 << 15
"""Frames whose errors are looked at together."""
NAMED = 3
"""Worst markers that are named in the drawing and in the text."""


def skeleton_section(outcome: Outcome, replay: EmbeddedPage | None = None) -> Section:
    """The section on geometry and markers, with a trial in three dimensions where there is one."""
    judge = judges(outcome)
    trial, frame = chosen_frame(outcome)
    time = float(outcome.followed[trial].tracked.time[frame])
    blocks = (
        Figure(
            _draw_skeleton(outcome, trial, frame),
            f"Trial {clean(trial)} at {time:.2f} s, the frame whose marker error is the trial's median. A line joins "
            "each measured marker with the identified model's; the longest are named.",
        ),
        *_moving(replay),
        _trial_table(outcome),
        _segment_table(outcome),
        Figure(
            _draw_markers(outcome),
            f"RMS distance of every marker on the {judge.words}: bars from the identified model, circles from the "
            "scaled template.",
        ),
    )
    return Section("skeleton", "Skeleton and markers", _finding(outcome), blocks)


def _moving(replay: EmbeddedPage | None) -> tuple[Details, ...]:
    if replay is None:
        return ()
    caption = (
        f"Trial {clean(replay.trial)}, its first {replay.seconds:.0f} s. Segments are solids of their identified "
        "inertia, from pale red (known from the prior alone) to solid green (identified); grey lines: the scaled "
        "template; red arrows: forces measured, blue: of the model, green: of the extended model; ball: centre of mass."
    )
    return (Details("The motion in three dimensions", (Embedded(replay.html, caption),)),)


def _finding(outcome: Outcome) -> str:
    judge = judges(outcome)
    identified, scaled = marker_rms(outcome, judge.names)
    worst = list(per_marker(outcome))[:NAMED]
    return (
        f"On the {judge.words} the markers lie {number(identified)} mm (RMS) from the identified skeleton and "
        f"{number(scaled)} mm from the scaled template ({change(scaled, identified)}); farthest off are "
        f"{listing(worst)}."
    )


def per_marker(outcome: Outcome) -> dict[str, tuple[float, float]]:
    """RMS distance of each marker on the judging trials, identified and scaled [mm], worst first."""
    names, labels = judges(outcome).names, outcome.fit.attachment.labels
    found = {label: marker_rms(outcome, names, torch.tensor([k])) for k, label in enumerate(labels)}
    known = {label: values for label, values in found.items() if math.isfinite(values[0])}
    return dict(sorted(known.items(), key=lambda entry: -entry[1][0]))


def chosen_frame(outcome: Outcome) -> tuple[str, int]:
    """A judging trial, and in it the frame of median error among those that show the most markers."""
    name = judges(outcome).names[0]
    error = outcome.followed[name].tracked.error
    seen = torch.isfinite(error).sum(dim=1)
    frames = (seen == seen.max()).nonzero()[:, 0]
    level = torch.cat([error[some].square().nanmean(dim=1) for some in frames.split(PIECE)])
    return name, int(frames[torch.nan_to_num(level).argsort()[len(level) // 2]])


def _draw_skeleton(outcome: Outcome, trial: str, frame: int) -> Markup:
    tracked = outcome.followed[trial].tracked
    tip = tips(outcome.fit.model)
    X_WB, solid = stick_points(outcome.fit.model, outcome.fit.geometry, tracked.q[frame], tip)
    q = outcome.followed_scaled[trial].tracked.q[frame]
    _, dashed = stick_points(outcome.scaled.model, outcome.scaled.geometry, q, tip)
    labels = outcome.fit.attachment.labels
    measured = outcome.session.trials[trial].markers.frames(slice(frame, frame + 1)).select(labels).position[0]
    placed = modelled(outcome.fit, tracked.q[frame : frame + 1])[0]
    axes, origin = facing(X_WB[0, :3, :3]), X_WB[0, :3, 3] * X_WB.new_tensor([1.0, 1.0, 0.0])
    turn = lambda points: (points - origin) @ axes.T  # noqa: E731
    points = turn(measured), turn(placed)
    worst = torch.nan_to_num(tracked.error[frame]).argsort(descending=True)[:NAMED].tolist()

    def paint(canvas: Canvas) -> None:
        panels = canvas.subplots(1, 2, sharey=True)
        for panel, across, title in zip(
            panels, (1, 0), ("Front view (left side on the right)", "Side view (forward to the right)"), strict=True
        ):
            _paint_view(panel, [turn(s) for s in solid], [turn(s) for s in dashed], points, across)
            panel.set_title(title)
            panel.set_xlabel(("forward [m]", "left [m]")[across])
            _name_markers(panel, points, across, [(k, clean(labels[k], 20)) for k in worst])
        panels[0].set_ylabel("height [m]")
        canvas.legend(handles=_legend(), loc="outside lower center", ncols=4)

    describe = f"Stick figures of the identified and scaled skeleton and the markers in trial {clean(trial)}"
    return draw("skeleton", (7.5, 6.4), describe, paint)


def _paint_view(
    axes: Axes, solid: list[Tensor], dashed: list[Tensor], points: tuple[Tensor, Tensor], across: int
) -> None:
    for sticks, color, line, width in ((dashed, SCALED, (0, (3, 2)), 1.3), (solid, IDENTIFIED, "-", 1.9)):
        for stick in sticks:
            axes.plot(stick[:, across], stick[:, 2], color=color, linestyle=line, linewidth=width, zorder=2)
    measured, modelled = points
    seen = torch.isfinite(measured).all(dim=1)
    measured, modelled = measured[seen], modelled[seen]
    for a, b in zip(measured.tolist(), modelled.tolist(), strict=True):
        axes.plot([a[across], b[across]], [a[2], b[2]], color=MUTED, linewidth=1.0, zorder=3)
    axes.scatter(
        modelled[:, across], modelled[:, 2], s=22, facecolors="white", edgecolors=IDENTIFIED, linewidths=0.9, zorder=4
    )
    axes.scatter(measured[:, across], measured[:, 2], s=7, color=MEASURED, linewidths=0, zorder=5)
    axes.set_aspect("equal", adjustable="datalim")
    tidy(axes)


def _name_markers(axes: Axes, points: tuple[Tensor, Tensor], across: int, named: list[tuple[int, str]]) -> None:
    for k, label in named:
        place = points[0][k].tolist()
        axes.annotate(label, (place[across], place[2]), xytext=(9, 7), textcoords="offset points", fontsize=8,
                      bbox={"facecolor": "white", "edgecolor": "none", "pad": 0.6, "alpha": 0.8}, zorder=6,
                      arrowprops={"arrowstyle": "-", "linewidth": 0.5, "color": MUTED})  # fmt: skip


def _legend() -> list[Line2D]:
    return [
        Line2D([], [], color=IDENTIFIED, linewidth=1.9, label="identified"),
        Line2D([], [], color=SCALED, linestyle=(0, (3, 2)), linewidth=1.3, label="scaled template"),
        Line2D([], [], color=MEASURED, marker="o", markersize=3, linestyle="none", label="marker measured"),
        Line2D([], [], color=IDENTIFIED, marker="o", markersize=5, markerfacecolor="white", linestyle="none",
               label="marker modelled"),
    ]  # fmt: skip


def _trial_table(outcome: Outcome) -> Table:
    rows = []
    for name in outcome.session.trials:
        errors = marker_errors(outcome, name)
        known = {label: value for label, value in errors["markers"].items() if math.isfinite(value)}
        worst = max(known, key=lambda label: known[label]) if known else ABSENT
        rows.append((clean(name), errors["role"].replace("heldout", "held out"), clean(worst, 30),
                     number(errors["identified"]), number(errors["scaled"]), number(errors["max"], 0)))  # fmt: skip
    caption = "Marker distance per trial, before filtering"
    if outcome.session.static is not None:
        caption += ". The scaled template's markers were placed on the static trial: its figure there is no test"
    head = (
        "Trial",
        "Role",
        "Worst marker (RMS)",
        "Identified, RMS [mm]",
        "Scaled, RMS [mm]",
        "Identified, largest [mm]",
    )
    return Table(caption, head, tuple(rows), text=3)


def _segment_table(outcome: Outcome) -> Table:
    judge, fit, rows = judges(outcome), outcome.fit, []
    for k, name in enumerate(fit.model.tree.names):
        columns = (fit.attachment.body == k).nonzero()[:, 0]
        if not len(columns):
            continue
        identified, scaled = marker_rms(outcome, judge.names, columns)
        errors = (outcome.followed[n].tracked.error[:, columns] for n in judge.names)
        most = 1e3 * largest(*errors) if math.isfinite(identified) else math.nan
        rows.append((segment(name), str(len(columns)), number(identified), number(scaled), number(most, 0)))
    head = ("Segment", "Markers", "Identified, RMS [mm]", "Scaled, RMS [mm]", "Identified, largest [mm]")
    return Table(f"Marker distance per segment, {judge.words}", head, tuple(rows))


def _draw_markers(outcome: Outcome) -> Markup:
    found = per_marker(outcome)
    entries = list(found.items())
    half = max(1, math.ceil(len(entries) / 2))
    most = max((max(v for v in values if math.isfinite(v)) for values in found.values()), default=1.0)

    def paint(canvas: Canvas) -> None:
        for panel, part in zip(canvas.subplots(1, 2, sharex=True), (entries[:half], entries[half:]), strict=True):
            rows = list(range(len(part)))
            panel.barh(
                rows,
                [values[0] for _, values in part],
                height=0.66,
                color="#9fbfdf",
                edgecolor=IDENTIFIED,
                linewidth=0.6,
            )
            panel.plot(
                [values[1] for _, values in part], rows, "o", markersize=4, markerfacecolor="white", color=SCALED
            )
            panel.set_yticks(rows, [clean(label, 22) for label, _ in part])
            panel.set_ylim(half - 0.4, -0.6)
            panel.set_xlim(0.0, 1.05 * most)
            panel.set_xlabel("RMS distance [mm]")
            tidy(panel, "x")
        handles = [Line2D([], [], color="#9fbfdf", linewidth=6, label="identified"),
                   Line2D([], [], color=SCALED, marker="o", markersize=4, markerfacecolor="white", linestyle="none",
                          label="scaled template")]  # fmt: skip
        canvas.legend(handles=handles, loc="outside lower center", ncols=2)

    return draw("markers", (7.5, 1.0 + 0.19 * half), "Bars of the RMS distance of every marker, worst first", paint)
