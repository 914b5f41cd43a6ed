"""What naming causes changed: residuals before and after, over time, by frequency and by trial."""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Canvas
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from torch import Tensor

from torchid.dynamics.rows import WrenchTrial, measured, predict
from torchid.dynamics.whitening import BAND_EDGES_HZ, BEYOND, band_of, cosine_matrix, frequencies
from torchid.report.facts import only
from torchid.report.figure import IDENTIFIED, MEASURED, MUTED, SCALED, draw, tidy
from torchid.report.marker_distances import marker_cells
from torchid.session import Outcome
from torchid.wording import clean, number

POINTS = 600
"""Samples drawn per line at most."""
WINDOW_S = 12.0
"""Longest stretch of a trial that is drawn."""
NEAR = 0.3
"""A held-out trial is drawn if the extension changes its residual at least this part as much as any trial's."""
SEEN = 0.1
"""Change of a residual, as part of it, that can be seen in a drawing."""
KINDS = (("force", "N", slice(0, 3)), ("moment", "N m", slice(3, 6)))
COMPONENTS = ("force along x [N]", "force along y [N]", "vertical force [N]",
              "moment about x [N m]", "moment about y [N m]", "moment about z [N m]")  # fmt: skip
BEFORE: dict = {"color": SCALED, "linestyle": (0, (3, 1.5)), "linewidth": 1.3}
AFTER: dict = {"color": IDENTIFIED, "linewidth": 1.3}


@dataclass(frozen=True)
class Sides:
    """One trial with forces under the base model and under the extended one, about the pelvis' origin."""

    name: str
    time: Float[Tensor, " frames"]
    measured: Float[Tensor, "frames 6"]
    before: Float[Tensor, "frames 6"]
    """Residual of the base model."""
    after: Float[Tensor, "frames 6"]
    used: Bool[Tensor, " frames"]
    """Of the base model."""
    trials: tuple[WrenchTrial, WrenchTrial]

    def change(self, axes: slice) -> float:
        """RMS of what the extension changed in the residual."""
        return _norm((self.before - self.after)[self.used][:, axes])


def sides(outcome: Outcome) -> dict[str, Sides]:
    """All trials whose forces a base and an extended model explain; static ones are no test and stay out."""
    base, found = outcome.base, {}
    if base is None:
        return {}
    for role in ("heldout", "fit"):
        for name in outcome.session.part(role, "inertia"):
            old, new = base.followed[name].wrench, outcome.followed[name].wrench
            if old is not None and new is not None and bool(old.used.any()):
                read = measured(old)
                before, after = read - predict(old, base.phi), measured(new) - predict(new, outcome.phi)
                found[name] = Sides(name, old.motion.time, read, before, after, old.used, (old, new))
    return found


def telling_trial(outcome: Outcome, found: dict[str, Sides]) -> Sides | None:
    """The trial whose residual the extension changes most; a held-out one if it changes there nearly as much.

    None where it changes forces nowhere.
    """
    scale = [max(_norm(torch.cat([s.before[s.used][:, axes] for s in found.values()])), 1e-9) for *_, axes in KINDS]
    moved = {
        name: max(side.change(axes) / unit for (*_, axes), unit in zip(KINDS, scale, strict=True))
        for name, side in found.items()
    }
    if max(moved.values()) < SEEN:
        return None
    unseen = [name for name in outcome.session.part("heldout", "inertia") if name in found]
    unseen = [name for name in unseen if moved[name] >= NEAR * max(moved.values())]
    return found[max(unseen or moved, key=lambda name: moved[name])]


def draw_curves(side: Sides) -> Markup:
    """Measured, base and extended over time, and the residuals, of the two components that change most."""
    scale = torch.cat([_axis_scale(side, axes) for *_, axes in KINDS])
    moved = ((side.before - side.after)[side.used].square().mean(0).sqrt() / scale).tolist()
    first, second = sorted(sorted(range(6), key=lambda k: -moved[k])[:2])
    part = _window(side, [first, second])

    def paint(canvas: Canvas) -> None:
        panels = canvas.subplots(2, 2, sharex=True, height_ratios=(1.0, 1.1))
        for column, k in enumerate((first, second)):
            _paint_curves(panels[0, column], side, part, k)
            _paint_residual(panels[1, column], side, part, k)
        for axes in panels[1]:
            axes.set_xlabel("time [s]")
        handles = [
            Line2D([], [], color=MEASURED, linewidth=2.4, alpha=0.45, label="measured"),
            Line2D([], [], label="base model", **BEFORE),
            Line2D([], [], label="extended model", **AFTER),
            Line2D([], [], color=SCALED, linewidth=2.4, alpha=0.55, label="left by base model"),
        ]
        canvas.legend(handles=handles, loc="outside lower center", ncols=4)

    described = f"Measured, base and extended forces over time in trial {clean(side.name)}, and their residuals"
    return draw("extension", (7.5, 4.3), described, paint)


def _axis_scale(side: Sides, axes: slice) -> Tensor:
    return torch.full((3,), max(_norm(side.before[side.used][:, axes]), 1e-9), dtype=side.before.dtype)


def _window(side: Sides, axes: list[int]) -> slice:
    """The stretch in which the residual changes most, every so many frames of it."""
    rate = side.trials[0].rate
    frames = min(len(side.time), max(2, round(WINDOW_S * rate)))
    changed = ((side.before - side.after)[:, axes].square().sum(1) * side.used).cumsum(0)
    gained = changed[frames - 1 :] - torch.nn.functional.pad(changed, (1, 0))[: len(changed) - frames + 1]
    start = int(gained.argmax())
    return slice(start, start + frames, max(1, -(-frames // POINTS)))


def _paint_curves(axes: Axes, side: Sides, part: slice, k: int) -> None:
    time, read = side.time[part], only(side.measured, side.used)[part, k]
    axes.plot(time, read, color=MEASURED, linewidth=2.4, alpha=0.45)
    axes.plot(time, read - side.before[part, k], **BEFORE)
    axes.plot(time, read - side.after[part, k], **AFTER)
    axes.set_title(COMPONENTS[k])
    axes.margins(x=0.0)
    tidy(axes)


def _paint_residual(axes: Axes, side: Sides, part: slice, k: int) -> None:
    time = side.time[part]
    before, after = (only(left, side.used)[part, k] for left in (side.before, side.after))
    axes.axhline(0.0, color=MUTED, linewidth=0.6)
    axes.plot(time, before, color=SCALED, linewidth=2.4, alpha=0.55)
    axes.plot(time, after, **AFTER)
    axes.set_title(f"residual {COMPONENTS[k]}")
    axes.margins(x=0.0)
    tidy(axes)


def spectrum(trials: list[tuple[WrenchTrial, Float[Tensor, "frames 6"]]]) -> Float[Tensor, "kinds bands"]:
    """RMS of the residual in each band [N, N m] over the used frames of all trials: their squares add up."""
    energy, frames = torch.zeros(len(KINDS), len(BAND_EDGES_HZ) + 1, dtype=torch.float64), 0
    for trial, left in trials:
        cutoff = min(trial.motion.smoother.cutoff_hz * BEYOND, 0.5 * trial.rate)
        for part in trial.blocks():
            length = part.stop - part.start
            kept = max(1, min(length, int(2.0 * cutoff * length / trial.rate)))
            square = (cosine_matrix(length, kept) @ left[part].cpu()).square()
            band = band_of(frequencies(length, kept, trial.rate))
            energy.index_add_(1, band, torch.stack([square[:, axes].sum(1) for *_, axes in KINDS]))
            frames += length
    return (energy / max(frames, 1)).sqrt()


def draw_spectrum(found: list[Sides]) -> Markup:
    """Residual force and moment by band, before and after."""
    before = spectrum([(s.trials[0], s.before) for s in found])
    after = spectrum([(s.trials[1], s.after) for s in found])
    last = int((before + after).sum(0).nonzero().max()) + 1
    edges = (0.0, *BAND_EDGES_HZ)
    labels = [f"{low:g}–{high:g}" for low, high in zip(edges, edges[1:], strict=False)] + [f"> {edges[-1]:g}"]

    def paint(canvas: Canvas) -> None:
        panels = canvas.subplots(1, 2)
        rows = torch.arange(last)
        for k, (axes, (kind, unit, _)) in enumerate(zip(panels, KINDS, strict=True)):
            axes.bar(
                (rows - 0.2).tolist(),
                before[k, :last].tolist(),
                0.4,
                color=SCALED,
                hatch="////",
                edgecolor="#ffffff",
                linewidth=0.0,
            )
            axes.bar((rows + 0.2).tolist(), after[k, :last].tolist(), 0.4, color=IDENTIFIED)
            axes.set_xticks(rows.tolist(), labels[:last], rotation=45, ha="right", rotation_mode="anchor")
            axes.set_title(f"residual {kind}, RMS [{unit}]")
            axes.set_xlabel("frequency [Hz]")
            tidy(axes, "y")
        handles = [
            Patch(facecolor=SCALED, hatch="////", edgecolor="#ffffff", linewidth=0.0, label="base model"),
            Patch(facecolor=IDENTIFIED, label="extended model"),
        ]
        canvas.legend(handles=handles, loc="outside lower center", ncols=2)

    return draw("bands", (7.5, 3.0), "Residual force and moment by frequency, before and after", paint)


def trial_rows(
    outcome: Outcome, found: dict[str, Sides], markers: bool, named: tuple[str, ...]
) -> tuple[tuple[str, ...], ...]:
    """Residuals of every trial before and after: force, moment, and where asked for all markers and named ones."""
    return tuple(
        (
            clean(name), outcome.session.trials[name].role.replace("heldout", "held out"),
            *(number(_norm(left[trial.used][:, axes]), digits) for digits, (*_, axes) in enumerate(KINDS, 1)
              for trial, left in zip(side.trials, (side.before, side.after), strict=True)),
            *(marker_cells(outcome, name, ()) if markers else ()),
            *(marker_cells(outcome, name, named) if markers and named else ()),
        )
        for name, side in found.items()
    )  # fmt: skip


def _norm(x: Float[Tensor, "frames axes"]) -> float:
    return float(x.square().sum(1).mean().sqrt())
