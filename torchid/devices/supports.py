"""Supports from the ground: their unknown numbers from base rows, together with body and parts."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.devices.base_columns import Acting, about_root, acting, heard, known_external
from torchid.devices.device import Device, Element, SheetValue
from torchid.devices.joint_fit import Considered, Extra, JointFit, fit_jointly
from torchid.devices.laws import Channels
from torchid.devices.options import DeviceOptions
from torchid.devices.parts import PartsPrior
from torchid.devices.result import BodyBelief
from torchid.dynamics.rows import WrenchTrial

PASSES = 3
"""Linearisations of the laws of grounded supports, chosen: a law is piecewise linear, and the third changes nothing."""
Recorded = Mapping[str, Channels]
"""Channels of the device on the frames of each trial, by the trial's name."""


@dataclass(frozen=True)
class KnownParameters:
    """Parameters of elements that were determined, and why others were not."""

    numbers: dict[str, dict[str, SheetValue]]
    """By element and parameter."""
    covariance: dict[str, Tensor]
    keys: dict[str, tuple[str, ...]]
    why: dict[tuple[str, str], str]

    def joined(self, other: "KnownParameters") -> "KnownParameters":
        """Return both together, ``other`` where both tell something."""
        return KnownParameters(
            {**self.numbers, **other.numbers}, {**self.covariance, **other.covariance}, {**self.keys, **other.keys},
            {**self.why, **other.why},
        )  # fmt: skip


def stated(element: Element) -> dict[str, SheetValue]:
    """Return the numbers of an element that its sheet says, by name."""
    return {name: number for name, number in element.numbers() if number is not None}


def fit_by_base_rows(
    device: Device, supports: list[Element], trials: Sequence[WrenchTrial], body: BodyBelief, prior: PartsPrior,
    recorded: Recorded, options: DeviceOptions,
) -> tuple[JointFit, KnownParameters]:  # fmt: skip
    """Fit body, parts and unknown supports together; laws are linearised anew a few times.

    Args:
        device: numbers that sensors told filled in.
        supports: elements that base rows see and whose numbers are unknown.
        body: as trials without the device told it.
    """
    own = [[acting(e, t, recorded.get(t.name, {})) for t in trials] for e in supports]
    names = [(e, name) for e in supports for name in e.unknown]
    start = [_prior_of(one, name, options) for e, one in zip(supports, own, strict=True) for name in e.unknown]
    at = [value.value for value in start]
    known = [known_external(device, t, recorded.get(t.name, {})) for t in trials]
    for _ in range(PASSES if supports else 1):
        moved, columns = _linearised(supports, own, trials, at, known)
        like = body.phi
        miss = [v.value - x for v, x in zip(start, at, strict=True)]
        extra = Extra(like.new_tensor(miss), like.new_tensor([v.sd for v in start]), tuple(columns))
        gain = plate_gain(trials, options)
        fit = fit_jointly(moved, body, prior, extra, considered=gain, weighed=device.mass_kg)
        at = [x + float(step) for x, step in zip(at, fit.extra[: len(at)], strict=True)]
    own_rows = slice(len(fit.covariance) - len(fit.extra), len(fit.covariance) - len(fit.extra) + len(at))
    covariance = fit.covariance[own_rows, own_rows]
    return fit, _told(supports, names, at, covariance, covariance.diagonal(), start, options)


def plate_gain(trials: Sequence[WrenchTrial], options: DeviceOptions) -> Considered:
    """Return the gain of the plates with the device against without: of what they read, F, the part g F is not there.

    Args:
        trials: with the device, as measured.
        options: with its scatter.
    """
    sd = trials[0].wrench.new_tensor([options.plate_gain_sd])
    return Considered(sd, tuple(about_root(trial, trial.wrench)[:, None] for trial in trials))


def _prior_of(own: list[Acting], name: str, options: DeviceOptions) -> SheetValue:
    value = options.unknown[name]
    if name != "rest":
        return value
    return SheetValue(float(torch.cat([one.act.length for one in own]).mean()), value.sd)


def _linearised(
    supports: list[Element], own: list[list[Acting]], trials: Sequence[WrenchTrial], at: list[float],
    known: list[Tensor],
) -> tuple[list[WrenchTrial], list[Float[Tensor, "6 extra frames"]]]:  # fmt: skip
    """Trials with what supports carry at ``at`` added to their wrench, and columns of small changes of it."""
    moved, columns = [], []
    for k, trial in enumerate(trials):
        total, some, first = known[k], [], 0
        for element, acts in zip(supports, own, strict=True):
            values = dict(zip(element.unknown, (SheetValue(x) for x in at[first:]), strict=False))
            first += len(element.unknown)
            full = {**stated(element), **values}
            force = acts[k].force(full)
            for unit in acts[k].act.ground.values():
                total = total + (unit * force).T
            some.append(-acts[k].act.unit[None, :6] * acts[k].slopes(full, element.unknown)[:, None])
        moved.append(replace(heard(trial, total), wrench=torch.nan_to_num(trial.wrench + total)))
        empty = trial.wrench.new_zeros(6, 0, len(trial.wrench))
        columns.append(torch.cat(some).movedim(0, 1) if some else empty)
    return moved, columns


def _told(
    supports: list[Element], names: list[tuple[Element, str]], at: list[float], covariance: Tensor, variance: Tensor,
    start: list[SheetValue], options: DeviceOptions,
) -> KnownParameters:  # fmt: skip
    known = KnownParameters({}, {}, {}, {})
    share = [1.0 - float(v) / s.sd**2 for v, s in zip(variance, start, strict=True)]
    for element in supports:
        rows = [k for k, (e, _) in enumerate(names) if e is element]
        good = [k for k in rows if share[k] >= options.told]
        why = {(element.name, names[k][1]): f"these motions remove {100.0 * max(share[k], 0.0):.0f} % of the variance "
               "that it had before: what is left is the prior" for k in rows if k not in good}  # fmt: skip
        numbers = {names[k][1]: SheetValue(at[k], float(variance[k]) ** 0.5) for k in good}
        keys = tuple(names[k][1] for k in good)
        known = known.joined(
            KnownParameters(
                {element.name: numbers}, {element.name: covariance[good][:, good]}, {element.name: keys}, why
            )
        )
    return known
