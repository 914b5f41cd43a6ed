"""One trial's cycles as rows of measures and as normalised courses, with one body and with the draws about it."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.cycles.cycles import Cycle, normalise
from torchid.cycles.measures import (
    STANCE,
    WHOLE,
    measure,
    stance_values,
    stride_values,
    trapezoid,
    whole_values,
)
from torchid.evaluation.cycle_measures.layout import MeasureLayout
from torchid.evaluation.torque_shares.back import LowBack
from torchid.evaluation.torque_shares.shares import Shares
from torchid.evaluation.trials import ConditionTrial


@dataclass(frozen=True)
class CycleRows:
    """What the cycles of one trial, or of all, say."""

    values: Float[Tensor, "cycles columns"]
    draws: Float[Tensor, "draws cycles columns"] | None
    human: Float[Tensor, "cycles points courses"]
    """Torques of the human share [N m], extension moment [N m] and compression [N] of the low back."""
    demand: Float[Tensor, "cycles points courses"]
    device: Float[Tensor, "cycles points courses"]
    human_draws: Float[Tensor, "draws cycles points courses"] | None
    angle: Float[Tensor, "cycles points coordinates"]
    """Coordinates [rad]."""
    device_load: Float[Tensor, "cycles coordinates"]
    """Cumulative load that the device takes, the integral of |demand| minus that of |human| [N m s]."""


@dataclass(frozen=True)
class RowScene:
    """What rows of one trial are made of besides torques."""

    trial: ConditionTrial
    cycles: tuple[Cycle, ...]
    heels: dict[str, Float[Tensor, "frames 3"]]
    levers: Float[Tensor, " draws"]
    """Lever arms of the back muscle, one for each draw, the same in all trials [m]."""
    lever_m: float
    """The middle one."""
    mass_kg: float | None
    """Divides torques where that is wanted."""


def cycle_rows(
    scene: RowScene,
    layout: MeasureLayout,
    own: Shares,
    deviations: Float[Tensor, "draws frames dofs"] | None,
    points: int,
) -> CycleRows:
    """Measures and courses of the cycles of one trial.

    Args:
        own: shares of the torques.
        deviations: torques with other bodies minus those of ``own``; None for none.
        points: of a normalised course.
    """
    sign = own.q.new_tensor(layout.signs)
    q, v = (x[:, list(layout.rows)] * sign for x in (own.q, own.v))
    step = float(scene.trial.followed.motion.time[1] - scene.trial.followed.motion.time[0])
    human, demand, device = (_courses(x, layout, own.back, sign, scene) for x in (own.human, own.demand, own.device))
    if layout.back:
        device[..., -1] = demand[..., -1] - human[..., -1]  # compression is no linear function of torque
    drawn = None
    if deviations is not None:
        drawn = _courses(own.human + deviations, layout, own.back, sign, scene, scene.levers)
    wholes = _wholes(scene, layout, own, step)
    cut = [normalise(x, c, points) for x in (human, demand, device, q) for c in scene.cycles]
    count = len(scene.cycles)
    human_c, demand_c, device_c, angle = (
        torch.stack(cut[k * count : (k + 1) * count]) if count else x.new_zeros(0, points, x.shape[-1])
        for k, x in enumerate((human, demand, device, q))
    )
    draws = None if drawn is None else _rows(drawn, q, v, scene, layout, step, wholes)
    drawn_c = None
    if drawn is not None and count:
        drawn_c = torch.stack([normalise(drawn, c, points) for c in scene.cycles], dim=1)
    load = _device_load(human, demand, scene.cycles, len(layout.rows), step)
    return CycleRows(
        _rows(human, q, v, scene, layout, step, wholes), draws, human_c, demand_c, device_c, drawn_c, angle, load
    )


def _courses(
    tau: Float[Tensor, "*draws frames dofs"],
    layout: MeasureLayout,
    back: LowBack | None,
    sign: Tensor,
    scene: RowScene,
    levers: Tensor | None = None,
) -> Float[Tensor, "*draws frames courses"]:
    """Torques of the chosen coordinates, then the low back's extension moment and compression."""
    own = tau[..., list(layout.rows)] * sign
    if not layout.back or back is None:
        return own if scene.mass_kg is None else own / scene.mass_kg
    moment = back.moment(tau)[..., :1]
    arm = own.new_tensor(scene.lever_m) if levers is None else levers
    press = back.compression(tau, arm)[..., None]
    if scene.mass_kg is not None:
        own, moment = own / scene.mass_kg, moment / scene.mass_kg  # compression is judged against a limit in newtons
    return torch.cat([own, moment, press], dim=-1)


def _rows(
    courses: Float[Tensor, "*draws frames courses"],
    q: Tensor,
    v: Tensor,
    scene: RowScene,
    layout: MeasureLayout,
    step: float,
    wholes: Float[Tensor, "cycles whole"],
) -> Float[Tensor, "*draws cycles columns"]:
    """Rows of measures of all cycles."""
    batch, joints = courses.shape[:-2], len(layout.rows)
    found = []
    for k, cycle in enumerate(scene.cycles):
        each = measure(layout.measures, cycle, courses[..., :joints], v, q, step)
        for j, side in enumerate(layout.sides):
            if side and cycle.side and side != cycle.side:
                each[..., j, :] = torch.nan
        parts = [each.flatten(-2)]
        if layout.back:
            parts.append(_back(courses[..., joints:], cycle, step))
        found.append(torch.cat([*parts, wholes[k].expand(*batch, -1)], dim=-1))
    columns = len(layout.columns)
    return torch.stack(found, dim=-2) if found else courses.new_zeros(*batch, 0, columns)


def _back(courses: Float[Tensor, "*draws frames 2"], cycle: Cycle, step: float) -> Float[Tensor, "*draws 3"]:
    """Peak and integral of the extension moment's size, and peak compression."""
    own = courses[..., cycle.frames, :]
    moment, press = own[..., 0].abs(), own[..., 1]
    weight = trapezoid(moment.shape[-1], step, moment)
    return torch.stack([moment.amax(-1), (moment * weight).sum(-1), press.amax(-1)], dim=-1)


def _wholes(scene: RowScene, layout: MeasureLayout, own: Shares, step: float) -> Float[Tensor, "cycles whole"]:
    contact, found = scene.trial.followed.contact, []
    for cycle in scene.cycles:
        if layout.whole == WHOLE:
            found.append(whole_values(cycle, own.q[:, 2], step))
        elif contact is None or not scene.heels:
            found.append(own.q.new_full((len(layout.whole),), torch.nan))
        elif layout.whole == STANCE:
            found.append(stance_values(cycle, contact, own.q[:, :3], step))
        else:
            found.append(stride_values(cycle, contact, scene.heels, step))
    return torch.stack(found) if found else own.q.new_zeros(0, len(layout.whole))


def _device_load(
    human: Tensor, demand: Tensor, cycles: Sequence[Cycle], joints: int, step: float
) -> Float[Tensor, "cycles coordinates"]:
    found = []
    for cycle in cycles:
        part = cycle.frames
        less = demand[part, :joints].abs() - human[part, :joints].abs()
        found.append((less * trapezoid(len(less), step, less)[:, None]).sum(0))
    return torch.stack(found) if found else human.new_zeros(0, joints)


def joined(rows: Sequence[CycleRows]) -> CycleRows:
    """The rows of several trials, one after the other.

    Args:
        rows: of every trial; draws are kept where all have some.
    """

    def together(name: str, dim: int = 0) -> Tensor:
        return torch.cat([getattr(one, name) for one in rows], dim=dim)

    def drawn(name: str) -> Tensor | None:
        own = [getattr(one, name) for one in rows if len(one.values)]
        return None if not own or any(x is None for x in own) else torch.cat(own, dim=1)

    return CycleRows(
        together("values"), drawn("draws"), together("human"), together("demand"), together("device"),
        drawn("human_draws"), together("angle"), together("device_load"),
    )  # fmt: skip
