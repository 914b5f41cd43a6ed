"""The identified person on the plates: one frame, seen from before and above."""

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float
from markupsafe import Markup
from matplotlib.figure import Figure as Canvas
from matplotlib.patches import Polygon
from torch import Tensor

from torchid.recording import Forces
from torchid.report.facts import body_weight, judges
from torchid.report.figure import IDENTIFIED, MEASURED, MUTED, SHADE, draw
from torchid.report.skeleton import chosen_frame
from torchid.report.stick_figure import facing, stick_points, tips
from torchid.session import Outcome
from torchid.wording import clean

TURN, TILT = math.radians(35.0), math.radians(15.0)
"""Choice. Camera to the left of the front, and above it."""
FORCE = "#8f1d14"
"""Colour of forces."""
ARROW = {"arrowstyle": "-|>", "color": FORCE, "linewidth": 2.0, "shrinkA": 0, "shrinkB": 0}
"""Dark red, as in the motion in three dimensions."""
ARROW_M = 0.9
"""Choice. Length of an arrow as long as the body's weight [m]."""
LEAST = 0.02
"""Choice. Part of the body's weight from which on a plate's force is drawn."""
NEAR_M = 1.5
"""Choice. Plates are drawn whose centre is this near to the pelvis, and those that are stood on."""


@dataclass(frozen=True)
class Camera:
    """The camera, which looks at a body."""

    origin: Float[Tensor, " 3"]
    """Point of the floor that is in the middle."""
    axes: Float[Tensor, "3 3"]
    """Forward, left and up, as rows in W."""

    def seen(self, points: Float[Tensor, "*points 3"]) -> Float[Tensor, "*points 2"]:
        """Points of W on the picture, to the right and up [m]."""
        forward, left, up = ((points - self.origin) @ self.axes.T).unbind(-1)
        near, right = forward * math.cos(TURN) - left * math.sin(TURN), forward * math.sin(TURN) + left * math.cos(TURN)
        return torch.stack([right, up * math.cos(TILT) - near * math.sin(TILT)], dim=-1)


@dataclass(frozen=True)
class PersonView:
    """What the camera sees of one frame, to the right and up [m]."""

    trial: str
    """Name of the trial."""
    time: float
    """Of the frame [s]."""
    sticks: tuple[Float[Tensor, "2 2"], ...]
    """Of the body."""
    markers: Float[Tensor, "markers 2"]
    """NaN where they are not seen."""
    plates: tuple[Float[Tensor, "4 2"], ...]
    """Corners."""
    arrows: tuple[Float[Tensor, "2 2"], ...]
    """Forces of the plates, from where they act."""


def person_view(outcome: Outcome) -> PersonView:
    """Return the identified person in the frame that shows most.

    Args:
        outcome: the run.
    """
    trial, frame = shown_frame(outcome)
    fit, tracked, recorded = outcome.fit, outcome.followed[trial].tracked, outcome.session.trials[trial]
    X_WB, sticks = stick_points(fit.model, fit.geometry, tracked.q[frame], tips(fit.model))
    view = Camera(X_WB[0, :3, 3] * X_WB.new_tensor([1.0, 1.0, 0.0]), facing(X_WB[0, :3, :3]))
    markers = recorded.markers.frames(slice(frame, frame + 1)).select(fit.attachment.labels).position[0]
    plates, arrows = [], []
    if recorded.forces is not None:
        plates, arrows = _ground(recorded.forces.samples(slice(frame, frame + 1)), view, body_weight(outcome))
    return PersonView(
        clean(recorded.name), float(tracked.time[frame]), tuple(map(view.seen, sticks)), view.seen(markers),
        tuple(map(view.seen, plates)), tuple(view.seen(torch.stack(one)) for one in arrows),
    )  # fmt: skip


def person_picture(outcome: Outcome) -> tuple[Markup, str]:
    """Return the picture and what it shows.

    Args:
        outcome: the run.
    """
    view = person_view(outcome)

    def paint(canvas: Canvas) -> None:
        panel = canvas.subplots()
        for corners in view.plates:
            panel.add_patch(Polygon(corners.numpy(), closed=True, facecolor=SHADE, edgecolor=MUTED))
        for stick in view.sticks:
            panel.plot(*stick.T, color=IDENTIFIED, linewidth=5.0, solid_capstyle="round", zorder=2)
        panel.scatter(*view.markers.T, s=6, color=MEASURED, linewidths=0, zorder=3)
        for start, end in (arrow.tolist() for arrow in view.arrows):
            panel.annotate("", end, start, arrowprops=ARROW, zorder=4)
            panel.plot(*zip(start, end, strict=True), alpha=0.0)  # the axes do not see arrows
        panel.set_aspect("equal")
        panel.axis("off")

    forces = ", arrows: forces of the plates" if view.arrows else ""
    time = f"{view.trial} at {view.time:.2f} s"
    caption = f"Identified body, dots: markers{forces} ({time})."
    return draw("person", (2.6, 4.0), f"The identified person in {time}", paint), caption


def person_outline(outcome: Outcome) -> dict[str, list[list[int]]]:
    """Return sticks and arrows of the picture as numbers for a small one: x and y of both ends, down the page [cm].

    Args:
        outcome: the run.
    """
    view, down = person_view(outcome), torch.tensor([100.0, -100.0])
    lines = {"sticks": view.sticks, "arrows": view.arrows}
    return {
        name: [(one * down.to(one)).round().int().flatten().tolist() for one in some if bool(one.isfinite().all())]
        for name, some in lines.items()
    }


def shown_frame(outcome: Outcome) -> tuple[str, int]:
    """The frame with most plates loaded in the middle of such frames of a judging trial; without forces the chosen one.

    Args:
        outcome: the run.
    """
    for name in judges(outcome, "inertia").names:
        contact, forces = outcome.followed[name].contact, outcome.session.trials[name].forces
        if contact is None or forces is None or not contact.used.any():
            continue
        frames = contact.used.nonzero()[:, 0]
        loaded = (forces.wrench[frames, :, 2] > LEAST * body_weight(outcome)).sum(dim=1)
        most = frames[loaded == loaded.max()]
        return name, int(most[len(most) // 2])
    return chosen_frame(outcome)


def _ground(
    sample: Forces, view: Camera, weight: float
) -> tuple[list[Float[Tensor, "4 3"]], list[tuple[Float[Tensor, " 3"], Float[Tensor, " 3"]]]]:
    """Corners of plates nearby, and the arrows of those that are stood on."""
    force, pressure = sample.wrench[0, :, :3], sample.centre_of_pressure()[0]
    stood = (force[:, 2] > LEAST * weight) & pressure.isfinite().all(dim=1)
    arrows = [(pressure[k], pressure[k] + ARROW_M / weight * force[k]) for k in stood.nonzero()[:, 0].tolist()]
    near = [
        one.corners for k, one in enumerate(sample.plates)
        if one.corners is not None
        and (stood[k] or float((one.corners.mean(dim=0) - view.origin)[:2].norm()) < NEAR_M)
    ]  # fmt: skip
    return near, arrows
