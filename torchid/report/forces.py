"""Measured against predicted ground reaction, trial by trial, and what each step of the method contributed."""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float
from markupsafe import Markup
from matplotlib.figure import Figure as Canvas
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from torch import Tensor

from torchid.report.blocks import Block, Figure, Paragraph, Section, Table
from torchid.report.contacts import contacts_figure
from torchid.report.facts import Judges, Wrenches, body_weight, force_rms, improved, judges, only, some, used_frames
from torchid.report.figure import IDENTIFIED, MEASURED, MUTED, SCALED, SHADE, draw, tidy
from torchid.runs import runs
from torchid.session import Outcome, Residual
from torchid.wording import ABSENT, change, clean, number, percent, plural

PANELS = 4
POINTS = 400
"""Samples drawn per line at most."""
COMPONENTS = ("force along x [N]", "force along y [N]", "vertical force, z [N]",
              "moment about x [N m]", "moment about y [N m]", "moment about z [N m]")  # fmt: skip


@dataclass(frozen=True)
class Score:
    """Residuals of one trial, with the identified inertia and the prior's."""

    name: str
    force: float
    moment: float
    prior_force: float
    prior_moment: float


def forces_section(outcome: Outcome, forces: dict[str, Wrenches]) -> Section | None:
    """The section on forces; None where no trial has any."""
    if not forces:
        return None
    judge = judges(outcome, "inertia")
    tested = some(forces, judge.names)
    if not tested:
        judge, tested = Judges(tuple(forces), "trials with forces, none of them held out", False), forces
    scored = [score(name, trial) for name, trial in tested.items()]
    blocks: list[Block] = [
        Figure(
            _draw_trial(outcome, entry.name, forces[entry.name], f"forces{k}"),
            f"Trial {clean(entry.name)}, {why}: residual {number(entry.force)} N and {number(entry.moment)} N m. "
            "Force and moment of the ground on the subject, laboratory axes (z up), moments about the pelvis' origin.",
        )
        for k, (entry, why) in enumerate(instructive(scored))
    ]
    blocks.append(_trial_table(outcome, forces))
    timeline = contacts_figure(outcome)
    blocks += [] if timeline is None else [timeline]
    blocks += _contributions(outcome)
    return Section("forces", "Forces", _finding(outcome, judge, tested), tuple(blocks))


def _finding(outcome: Outcome, judge: Judges, tested: dict[str, Wrenches]) -> str:
    force, moment = force_rms(tested, "identified")
    used, frames = used_frames(outcome, list(tested))
    kind = "identified" if outcome.identified is not None else "tabulated"
    said = (
        f"Over {used} of {frames} frames of the {judge.words} the {kind} inertia predicts the ground reaction "
        f"to {number(force)} N ({percent(force / body_weight(outcome), 1)} of body weight) and "
        f"{number(moment)} N m RMS"
    )
    if outcome.identified is None:
        return f"{said}."
    scaled_force, scaled_moment = force_rms(tested, "scaled")
    gained = improved(tested)[0]
    return (
        f"{said}. That is {change(scaled_force, force)} and {change(scaled_moment, moment)} against the scaled "
        f"template with tabulated inertia. The force residual is lower in {len(gained)} of "
        f"{plural(len(tested), 'trial')}."
    )


def score(name: str, trial: Wrenches) -> Score:
    """Residuals of one trial [N, N m]."""
    return Score(name, *force_rms({name: trial}, "identified"), *force_rms({name: trial}, "prior"))


def instructive(scores: list[Score]) -> list[tuple[Score, str]]:
    """At most four trials that say most: worst, best, where identification gained and lost most; then by residual."""
    gain = lambda s: s.prior_force - s.force  # noqa: E731
    wanted = [
        (max(scores, key=lambda s: s.force), "the largest force residual"),
        (min(scores, key=lambda s: s.force), "the smallest force residual"),
        (max(scores, key=gain), "where identified inertia gained most over the table"),
        (min(scores, key=gain), "where identified inertia gained least over the table"),
        *((s, "next in force residual") for s in sorted(scores, key=lambda s: -s.force)),
    ]
    found: dict[str, tuple[Score, str]] = {}
    for entry, why in wanted:
        if entry.name in found or len(found) >= PANELS:
            continue
        found[entry.name] = (entry, why if len(scores) > 1 else "the only one with forces")
    return list(found.values())


def _draw_trial(outcome: Outcome, name: str, trial: Wrenches, key: str) -> Markup:
    time = trial.time
    step = max(1, -(-len(time) // POINTS))
    lines: list[tuple[Tensor, dict]] = [
        (only(trial.measured, trial.used), {"color": MEASURED, "linewidth": 2.4, "alpha": 0.45}),
        (trial.prior, {"color": SCALED, "linestyle": (0, (1, 1.2)), "linewidth": 1.3}),
    ]
    if outcome.identified is not None:
        lines.append((trial.identified, {"color": IDENTIFIED, "linewidth": 1.2}))
    unused = [(float(time[a * step]), float(time[min(b * step, len(time)) - 1])) for a, b in runs(_gone(trial, step))]

    def paint(canvas: Canvas) -> None:
        panels = canvas.subplots(2, 3, sharex=True)
        for k, (axes, title) in enumerate(zip(panels.flat, COMPONENTS, strict=True)):
            for start, stop in unused:
                axes.axvspan(start, stop, facecolor=SHADE, edgecolor=MUTED, hatch="////", linewidth=0.0)
            for values, look in lines:
                axes.plot(time[::step], values[::step, k], **look)
            axes.set_title(title)
            axes.set_ylim(*_limits([values[trial.used, k] for values, _ in lines]))
            axes.margins(x=0.0)
            tidy(axes)
        for axes in panels[1]:
            axes.set_xlabel("time [s]")
        canvas.legend(
            handles=_legend(bool(unused), outcome.identified is not None), loc="outside lower center", ncols=4
        )

    return draw(
        key, (7.5, 4.0), f"Measured and predicted ground reaction force and moment in trial {clean(name)}", paint
    )


def _gone(trial: Wrenches, step: int) -> Bool[Tensor, " steps"]:
    """Steps of which most frames are left out: of an hour, what a single frame is could not be seen."""
    out = torch.nn.functional.pad((~trial.used).double(), (0, -len(trial.used) % step), value=torch.nan)
    return out.reshape(-1, step).nanmean(dim=1) > 0.5 if step > 1 else ~trial.used


def _limits(parts: list[Tensor]) -> tuple[float, float]:
    """Range of the used frames with a margin: what is left out must not squeeze what counts."""
    values = torch.cat(parts)
    values = values[torch.isfinite(values)]
    low, high = (float(values.min()), float(values.max())) if len(values) else (0.0, 1.0)
    margin = 0.06 * max(high - low, 1.0)
    return low - margin, high + margin


def _legend(unused: bool, identified: bool) -> list[Line2D | Patch]:
    handles: list[Line2D | Patch] = [
        Line2D([], [], color=MEASURED, linewidth=2.4, alpha=0.45, label="measured"),
        Line2D([], [], color=SCALED, linestyle=(0, (1, 1.2)), label="tabulated inertia"),
    ]
    if identified:
        handles.insert(1, Line2D([], [], color=IDENTIFIED, linewidth=1.2, label="identified inertia"))
    if unused:
        handles.append(Patch(facecolor=SHADE, edgecolor=MUTED, hatch="////", linewidth=0.0, label="frames left out"))
    return handles


def _trial_table(outcome: Outcome, forces: dict[str, Wrenches]) -> Table:
    weight, rows = body_weight(outcome), []
    for name, trial in forces.items():
        entry, role = score(name, trial), outcome.session.trials[name].role
        used, frames = used_frames(outcome, [name])
        file = outcome.session.files.get(name)
        fitted = role == "fit" and (file is None or file.inertia) and outcome.identified is not None
        has = outcome.identified is not None
        rows.append((
            clean(name), role.replace("heldout", "held out"), "yes" if fitted else "no", f"{used} of {frames}",
            number(entry.force) if has else ABSENT, percent(entry.force / weight, 1) if has else ABSENT,
            number(entry.moment) if has else ABSENT,
            number(entry.prior_force), number(entry.prior_moment),
        ))  # fmt: skip
    head = ("Trial", "Role", "Inertia fitted to it", "Frames used", "Force, RMS [N]", "of body weight",
            "Moment, RMS [N m]", "Force with tabulated inertia [N]", "Moment with tabulated inertia [N m]")  # fmt: skip
    caption = (
        f"Residuals per trial, identified geometry, both sides filtered at {number(outcome.cutoff_hz)} Hz; moments "
        "about the pelvis' origin"
    )
    return Table(caption, head, tuple(rows), text=3)


def _contributions(outcome: Outcome) -> list[Block]:
    if not outcome.residuals:
        return []
    by_label: dict[str, dict[str, Residual]] = {}
    for residual in outcome.residuals:
        by_label.setdefault(residual.label, {})[residual.role] = residual
    roles = [role for role in ("fit", "heldout") if any(role in found for found in by_label.values())]
    rows = []
    for label, found in by_label.items():
        cells = [
            number(getattr(found[role], field)) if role in found else ABSENT
            for role in roles
            for field in ("force_rmse_N", "moment_rmse_Nm")
        ]
        rows.append((clean(label), *cells))
    words = {"fit": "fit trials", "heldout": "held-out trials"}
    head = ("Step", *(f"{quantity}, {words[role]}" for role in roles for quantity in ("Force [N]", "Moment [N m]")))
    said = Paragraph(
        _contribution_words([found[roles[-1]] for found in by_label.values() if roles[-1] in found], words[roles[-1]])
    )
    return [
        Table("What each step contributes to the residual (each step is added to those above)", head, tuple(rows)),
        said,
    ]


def _contribution_words(steps: list[Residual], where: str) -> str:
    """The contributions on one group of trials as a sentence."""
    parts = [
        f"{after.label.lstrip('+ ')} {change(before.force_rmse_N, after.force_rmse_N)} in force and "
        f"{change(before.moment_rmse_Nm, after.moment_rmse_Nm)} in moment"
        for before, after in zip(steps, steps[1:], strict=False)
    ]
    return f"On the {where}: {'; '.join(parts)}." if parts else ""


def peak(x: Float[Tensor, " frames"]) -> float:
    """Largest magnitude of what is finite."""
    known = x[torch.isfinite(x)].abs()
    return float(known.max()) if len(known) else np.nan
