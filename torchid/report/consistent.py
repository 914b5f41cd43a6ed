"""The motion that obeys its forces beside the one that follows its markers: what agrees better, and what moved."""

from collections.abc import Mapping
from math import degrees

import torch
from jaxtyping import Float
from matplotlib.figure import Figure as Canvas
from matplotlib.lines import Line2D
from torch import Tensor

from torchid.report.blocks import Block, Details, Figure, Section, Table
from torchid.report.facts import Judges, judges
from torchid.report.figure import IDENTIFIED, MUTED, SCALED, draw, tidy
from torchid.report.forces import POINTS
from torchid.session import Outcome
from torchid.torque.consistent import ConsistentTrial
from torchid.wording import clean, number

PANELS = 6
"""Coordinates that are drawn: those that changed most."""
COLUMNS = 3
"""Panels of a row."""
COORDINATES = "Change of each coordinate over all trials; the root's three turns are about the laboratory's axes"


def consistent_section(outcome: Outcome) -> Section | None:
    """The section on motion that obeys its forces; None where it was not asked for."""
    found = outcome.consistent
    if not found:
        return None
    judge = judges(outcome, "inertia")
    own = {name: found[name] for name in judge.names if name in found}
    if not own:
        judge, own = Judges(tuple(found), "trials with forces", False), found
    before, after = (_pooled(outcome, own, key) for key in ("before", "after"))
    finding = (
        f"Over the {judge.words}, the most probable motion given markers and plates leaves {number(after[0])} N and "
        f"{number(after[1])} N m of the measured wrench, where the one that follows markers alone leaves "
        f"{number(before[0])} N and {number(before[1])} N m. Markers are {number(after[2])} mm from it, and "
        f"{number(before[2])} mm from that one, both behind the filter."
    )
    shown = max(own, key=lambda name: float(_moved(outcome, found[name]).max()))
    blocks: list[Block] = [*_figure(outcome, shown), _trials(found), Details(COORDINATES, (_changes(outcome),))]
    return Section("consistent", "Motion that obeys its forces", finding, tuple(blocks))


def _pooled(outcome: Outcome, some: Mapping[str, ConsistentTrial], key: str) -> list[float]:
    """Root mean squares of forces [N], moments [N m] and markers [mm] over the used frames of some trials."""
    values, weights = [], []
    for name, one in some.items():
        at, rows = getattr(one, key), outcome.followed[name].wrench
        assert rows is not None
        values.append([at.force_N, at.moment_Nm, 1e3 * at.marker_m])
        weights.append(float(rows.used.sum()))
    square, share = torch.tensor(values).double().square(), torch.tensor(weights).double()
    return (share @ square / share.sum()).sqrt().tolist()


def _shown(outcome: Outcome, x: Float[Tensor, "frames dofs"]) -> Float[Tensor, "frames dofs"]:
    """Coordinates in degrees and millimetres."""
    return x * x.new_tensor([degrees(1.0) if dof.unit == "rad" else 1e3 for dof in outcome.fit.model.tree.dofs])


def _moved(outcome: Outcome, one: ConsistentTrial) -> Float[Tensor, " joints"]:
    """How far each coordinate of a joint went, the root mean square in degrees or millimetres."""
    return _shown(outcome, one.change)[:, 6:].square().mean(0).sqrt()


def _unit(outcome: Outcome, k: int) -> str:
    return "deg" if outcome.fit.model.tree.dofs[k].unit == "rad" else "mm"


def _words(outcome: Outcome, k: int) -> str:
    return clean(outcome.fit.model.tree.dof_names[k].replace("_", " "))


def _figure(outcome: Outcome, name: str) -> list[Block]:
    """The coordinates of a trial that changed most; none of a body without joints."""
    found, plain = outcome.consistent[name], outcome.followed[name].motion
    moved = _moved(outcome, found)
    most = [6 + k for k in sorted(moved.topk(min(PANELS, len(moved))).indices.tolist())]
    if not most:
        return []
    columns = min(COLUMNS, len(most))
    rows = -(-len(most) // columns)
    step = max(1, -(-len(plain.time) // POINTS))
    lines = ((_shown(outcome, plain.q), SCALED, (0, (3, 1.5))), (_shown(outcome, found.motion.q), IDENTIFIED, "-"))

    def paint(canvas: Canvas) -> None:
        panels = canvas.subplots(rows, columns, squeeze=False).ravel()
        for axes in panels[len(most) :]:
            axes.set_visible(False)
        for place, (k, axes) in enumerate(zip(most, panels, strict=False)):
            for q, colour, dashes in lines:
                axes.plot(plain.time[::step], q[::step, k], color=colour, linestyle=dashes)
            axes.set_title(_words(outcome, k))
            axes.set_ylabel(f"[{_unit(outcome, k)}]", color=MUTED)
            if place + columns >= len(most):
                axes.set_xlabel("time [s]")
            axes.margins(x=0.0)
            tidy(axes)
        handles = [Line2D([], [], color=IDENTIFIED, label="obeys its forces"),
                   Line2D([], [], color=SCALED, linestyle=(0, (3, 1.5)), label="follows its markers")]  # fmt: skip
        canvas.legend(handles=handles, loc="outside lower center", ncols=2)

    describe = f"Coordinates of trial {clean(name)} that changed most"
    caption = (
        f"Trial {clean(name)}: the coordinates that changed most. Everything else on this page is of the motion that "
        "follows markers alone."
    )
    return [Figure(draw("consistent", (7.5, 0.8 + 1.6 * rows), describe, paint), caption)]


def _trials(found: Mapping[str, ConsistentTrial]) -> Table:
    """What is left of forces and markers in every trial, before and after."""
    rows = []
    for name, one in found.items():
        cells = [
            number(value) for at in (one.before, one.after) for value in (at.force_N, at.moment_Nm, 1e3 * at.marker_m)
        ]
        rows.append((clean(name), *cells))
    head = ("Trial", *(f"{what}, {of}" for of in ("by markers", "obeying") for what in ("N", "N m", "mm")))
    caption = "What is left of the measured wrench, and distance of the markers; root mean squares"
    return Table(caption, head, tuple(rows))


def _changes(outcome: Outcome) -> Table:
    """How far each coordinate went, over all trials."""
    size, largest, frames = 0.0, torch.zeros(()), 0
    for one in outcome.consistent.values():
        change = _shown(outcome, one.change)
        size, frames = size + change.square().sum(0), frames + len(change)
        largest = torch.maximum(change.abs().amax(0), largest.to(change))
    size = torch.as_tensor(size / frames).sqrt()
    rows = [
        (_words(outcome, k), number(size[k]), number(largest[k]), _unit(outcome, k))
        for k in range(len(outcome.fit.model.tree.dofs))
    ]
    return Table("", ("Coordinate", "RMS", "Largest", "Unit"), tuple(rows))
