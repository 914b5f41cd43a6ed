"""Joint angles, moments and powers over the stride, left and right, as gait laboratories print them."""

import torch
from jaxtyping import Float
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Canvas
from matplotlib.lines import Line2D
from torch import Tensor

from torchid.cycles.measures import STRIDE
from torchid.report.blocks import Figure, Section, Table
from torchid.report.figure import IDENTIFIED, MUTED, SCALED, draw, tidy
from torchid.session.joint_cycles import JointCycles
from torchid.wording import ABSENT, listing, number, plural, spread

SIDES = {"l": ("left", IDENTIFIED, "-"), "r": ("right", SCALED, (0, (4, 1.5)))}
"""Name, colour and line of each leg."""
FEWEST = 3
"""Choice. Strides from which on a standard deviation is drawn."""
STEPS_A_MINUTE = 120.0
"""Derived. Two steps a stride, sixty seconds a minute."""
VALUES = (
    ("Stride time [s]", "stride_time_s", 2, 1.0),
    ("Stride length [m]", "stride_length_m", 2, 1.0),
    ("Speed [m/s]", "speed_m_s", 2, 1.0),
    ("Stance [% of the stride]", "stance_share", 1, 100.0),
    ("Step width [m]", "step_width_m", 2, 1.0),
)
"""Rows of the table: words, value, digits and factor."""


def gait_section(found: JointCycles | None) -> Section | None:
    """Return the section on strides; None where there are none.

    Args:
        found: all strides of the run.
    """
    if found is None:
        return None
    counts = {side: len(found.of(side)) for side in SIDES}
    trials = list(dict.fromkeys(cycle.trial for cycle in found.cycles))
    said = " and ".join(f"{plural(count, 'stride')} of the {SIDES[side][0]} leg" for side, count in counts.items())
    speed = found.values[:, STRIDE.index("speed_m_s")]
    cadence = STEPS_A_MINUTE / found.values[:, STRIDE.index("stride_time_s")]
    finding = (
        f"{said[0].upper()}{said[1:]} in {listing(trials)}, at {number(speed.mean(), 2)} m/s and "
        f"{number(cadence.mean(), 0)} steps a minute."
    )
    caption = (
        "Over the stride, from a strike of the foot to its next: mean of those that are known, band: one standard "
        "deviation where there are three or more; of fewer, every one is drawn. Vertical lines: toe off. Flexion, "
        "adduction, internal rotation and dorsiflexion are positive; moments are the muscles' net ones, per kg of the "
        "model's mass, and blank where the force under the leg is not known. Every stride is in cycles.csv."
    )
    return Section("gait", "Gait", finding, (_table(found), Figure(_draw(found), caption)))


def _table(found: JointCycles) -> Table:
    rows = []
    for words, key, digits, factor in VALUES:
        column = found.values[:, STRIDE.index(key)]
        rows.append((words, *(_spread(column[found.of(side)], digits, factor) for side in SIDES)))
    cadence = STEPS_A_MINUTE / found.values[:, STRIDE.index("stride_time_s")]
    rows.insert(1, ("Cadence [steps/min]", *(_spread(cadence[found.of(side)], 0, 1.0) for side in SIDES)))
    head = ("", *(name.capitalize() for name, *_ in SIDES.values()))
    return Table("How it was walked, mean ± standard deviation of strides", head, tuple(rows))


def _spread(values: Float[Tensor, " strides"], digits: int, factor: float) -> str:
    known = values[values.isfinite()]
    if not len(known):
        return ABSENT
    return number(known[0], digits, factor) if len(known) == 1 else spread(known.mean(), known.std(), digits, factor)


def _draw(found: JointCycles) -> Markup:
    columns = (
        ("angle [°]", found.angle_deg),
        ("moment [N m/kg]", found.moment_Nm / found.mass_kg),
        ("power [W/kg]", found.power_W / found.mass_kg),
    )

    def paint(canvas: Canvas) -> None:
        panels = canvas.subplots(len(found.joints), len(columns), sharex=True, squeeze=False)
        for joint, line in enumerate(panels):
            for (words, courses), axes in zip(columns, line, strict=True):
                axes.axhline(0.0, color=MUTED, linewidth=0.6)
                for side in SIDES:
                    _paint(axes, courses[found.of(side), :, joint], side)
                    _toe_off(axes, found, side)
                axes.set_title(f"{found.joints[joint].replace('_', ' ')}, {words}")
                axes.set_xlim(0.0, 100.0)
                tidy(axes)
        for axes in panels[-1]:
            axes.set_xlabel("stride [%]")
        handles = [Line2D([], [], color=colour, linestyle=line, label=name) for name, colour, line in SIDES.values()]
        canvas.legend(handles=handles, loc="outside lower center", ncols=2)

    describe = "Angles, moments and powers of the legs' joints over the stride, left and right"
    return draw("gait", (7.5, 0.7 + 1.5 * len(found.joints)), describe, paint)


def _paint(axes: Axes, curves: Float[Tensor, "strides points"], side: str) -> None:
    """Mean of the strides known at a point, and a band where these are three or more; of fewer strides each."""
    _, colour, line = SIDES[side]
    percent = torch.linspace(0.0, 100.0, curves.shape[1])
    curves = curves[curves.isfinite().any(dim=1)]
    if len(curves) < FEWEST:
        for curve in curves:
            axes.plot(percent, curve, color=colour, linestyle=line, linewidth=1.2)
        return
    mean, count = curves.nanmean(dim=0), curves.isfinite().sum(dim=0)
    sd = ((curves - mean).square().nansum(dim=0) / (count - 1)).sqrt().where(count >= FEWEST, torch.nan)
    axes.fill_between(percent, mean - sd, mean + sd, color=colour, alpha=0.2, linewidth=0.0)
    axes.plot(percent, mean, color=colour, linestyle=line, linewidth=1.5)


def _toe_off(axes: Axes, found: JointCycles, side: str) -> None:
    share = found.values[found.of(side), STRIDE.index("stance_share")]
    if len(share):
        _, colour, line = SIDES[side]
        axes.axvline(100.0 * float(share.mean()), color=colour, linestyle=line, linewidth=0.7)
