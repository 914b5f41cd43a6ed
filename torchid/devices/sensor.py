"""Parameters of an element from the device's own sensor, with errors in both the force and the length.

Minimised is the sum of r^2 / (s_f^2 + f'(x)^2 s_x^2) with r the measured force less the law's (the effective variance
of Orear, Am J Phys 50:912 (1982), which for a straight line is Deming's regression): s_f is the sensor's noise, s_x the
error of the length that the residuals then ask for. Residuals that go on for a second count once (``sandwich``).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from scipy.optimize import least_squares
from torch import Tensor

from torchid.devices.base_columns import SCALE
from torchid.devices.device import SheetValue
from torchid.devices.forces import smoothed
from torchid.devices.measured import MeasuredElement
from torchid.devices.options import DeviceOptions
from torchid.devices.sandwich import sandwich
from torchid.dynamics.whitening import white_scatter

ROUNDS = 4
"""Of law and error of the length, chosen: the fourth changes neither by a hundredth."""
STARTS = (0.02, 0.2, 0.4, 0.6, 0.8)
"""Quantiles of the length at which a law may begin, chosen: a kink has minima of its own."""
LEAST_NOISE = 1e-3
"""Least noise of a sensor relative to the scatter of its force, chosen: a good one has 0.1 %."""
LEAST_COURSE = 1e-3
"""Scatter of an angle below which it stands still [rad], chosen: nothing is told of a stiffness then anyway."""
SECANT = 1.0
"""Half width of secants in standard deviations, chosen: a law's kink is smooth on this scale."""
ALIKE = 1e-6
"""Singular value of the scaled derivatives, relative to the largest, below which parameters act alike, chosen."""


@dataclass(frozen=True)
class LawFit:
    """Parameters of one element from its sensor."""

    names: tuple[str, ...]
    value: Float[np.ndarray, " params"]
    covariance: Float[np.ndarray, "params params"]
    alike: tuple[str, ...]
    """Parameters that these recordings cannot tell from one another."""
    force_sd: float
    """Noise of the sensor."""
    length_sd: float
    """Error of the length that the residuals ask for."""
    residual: float
    """RMS of measured less fitted force."""

    @property
    def sd(self) -> Float[np.ndarray, " params"]:
        """Return the standard deviations."""
        return np.sqrt(np.clip(np.diagonal(self.covariance), 0.0, None))


def fit_law(
    measured: Sequence[MeasuredElement], names: tuple[str, ...], numbers: dict[str, SheetValue], options: DeviceOptions
) -> LawFit:
    """Fit some parameters of an element to its sensor.

    Args:
        names: parameters that are fitted.
        numbers: values of all others.
    """
    noise = _sensor_noise(measured)
    length_sd, best = 0.0, _start(measured, names, numbers)
    tries = _starts(measured, names, best)
    for _ in range(ROUNDS):
        best = min((_minimise(measured, names, numbers, noise, length_sd, x) for x in tries), key=lambda o: o[1])[0]
        length_sd, tries = _length_error(measured, names, numbers, best, noise), [best]
    return _judged(measured, names, numbers, best, noise, length_sd, options)


def _sensor_noise(measured: Sequence[MeasuredElement]) -> float:
    """Noise of the force after the filter that kinematics have gone through."""
    found = []
    for one in measured:
        smoother = one.acting.trial.motion.smoother
        sd = one.acting.element.sensor.force_sd
        if sd is None:
            # A frame that is filled smoothly holds no noise.
            raw = torch.where(one.known, one.raw, torch.nan_to_num(one.force))
            share = float(one.known.double().mean())
            sd = float(white_scatter(raw.to(torch.float64)[:, None])[0]) / share**0.5
        found.append((sd * min(1.0, 2.0 * smoother.cutoff_hz / smoother.rate_hz) ** 0.5) ** 2)
    scatter = float(torch.cat([one.read for one in measured]).std())
    return max(float(np.mean(found)) ** 0.5, LEAST_NOISE * scatter, 1e-12)


def _values(names: tuple[str, ...], x: np.ndarray, numbers: dict[str, SheetValue]) -> dict[str, SheetValue]:
    return {**numbers, **{name: SheetValue(float(v)) for name, v in zip(names, x, strict=True)}}


def _start(measured: Sequence[MeasuredElement], names: tuple[str, ...], numbers: dict[str, SheetValue]) -> np.ndarray:
    force, length = (torch.cat(x) for x in ([m.read for m in measured], [m.length for m in measured]))
    slope = float((force.max() - force.min()) / (length.max() - length.min()).clamp_min(1e-9))
    first = {"stiffness": slope, "rest": float(length.median()), "gain": 1.0, "damping": 0.0}
    return np.array([numbers[n].value if n in numbers else first.get(n, 0.0) for n in names])


def _starts(measured: Sequence[MeasuredElement], names: tuple[str, ...], start: np.ndarray) -> list[np.ndarray]:
    if "rest" not in names:
        return [start]
    length = torch.cat([m.length for m in measured])
    found = []
    for share in STARTS:
        x = start.copy()
        x[names.index("rest")] = float(torch.quantile(length, share))
        found.append(x)
    return found


def _residual(one: MeasuredElement, numbers: dict[str, SheetValue]) -> Tensor:
    """Measured less fitted force, both through the filter: a kink has frequencies that no filtered motion has."""
    law, force = one.acting.element.law, one.acting.force(numbers)
    bent = law is not None and (law.tension_only or bool(law.table) or numbers["free_play"].value > 0.0)
    return one.left(smoothed(force, one.acting.trial.motion) if bent else force)


def _steepness(one: MeasuredElement, numbers: dict[str, SheetValue]) -> Tensor:
    """Derivative of the law's force with respect to the length, by the stiffness that acts at each frame."""
    law = one.acting.element.law
    if law is None or "rest" not in numbers:
        return torch.zeros_like(one.read)
    return _slopes(one, numbers, ("rest",))[0]


def _slopes(one: MeasuredElement, numbers: dict[str, SheetValue], names: tuple[str, ...]) -> Tensor:
    """Derivatives of the force in the known frames, 0 where a late command is not known."""
    return torch.nan_to_num(one.acting.slopes(numbers, names))[:, one.known]


def _white(
    measured: Sequence[MeasuredElement], names: tuple[str, ...], numbers: dict[str, SheetValue], noise: float,
    length_sd: float,
    x: np.ndarray,
) -> list[np.ndarray]:  # fmt: skip
    """Residuals by trial over their standard deviation, which the errors of force and length give at these numbers."""
    values, parts = _values(names, x, numbers), []
    for one in measured:
        sd = noise if length_sd == 0.0 else (noise**2 + (_steepness(one, values) * length_sd) ** 2).sqrt()
        parts.append((_residual(one, values) / sd).cpu().numpy())
    return parts


def _minimise(
    measured: Sequence[MeasuredElement], names: tuple[str, ...], numbers: dict[str, SheetValue], noise: float,
    length_sd: float,
    start: np.ndarray,
) -> tuple[np.ndarray, float]:  # fmt: skip
    scale = np.array([SCALE[name] for name in names])

    def white(x: np.ndarray) -> np.ndarray:
        return np.concatenate(_white(measured, names, numbers, noise, length_sd, x * scale))

    found = least_squares(white, start / scale, x_scale="jac", method="trf", max_nfev=60)
    return found.x * scale, float(found.cost)


def _length_error(
    measured: Sequence[MeasuredElement],
    names: tuple[str, ...],
    numbers: dict[str, SheetValue],
    x: np.ndarray,
    noise: float,
) -> float:
    """Error of the length that explains what of the residuals the sensor's noise does not."""
    values = _values(names, x, numbers)
    r, steep = (torch.cat([f(one, values) for one in measured]) for f in (_residual, _steepness))
    weight = steep.square()
    if float(weight.max()) == 0.0:
        return 0.0
    return max(float((weight * (r.square() - noise**2)).sum() / weight.square().sum()), 0.0) ** 0.5


def _judged(
    measured: Sequence[MeasuredElement], names: tuple[str, ...], numbers: dict[str, SheetValue], x: np.ndarray,
    noise: float,
    length_sd: float, options: DeviceOptions,
) -> LawFit:  # fmt: skip
    values = _values(names, x, numbers)
    scale = np.array([SCALE[name] for name in names])
    slopes = []
    for one in measured:
        sd = (noise**2 + (_steepness(one, values) * length_sd) ** 2).sqrt().cpu().numpy()
        slopes.append((_slopes(one, values, names).cpu().numpy() / sd).T * scale)
    bread = sum((J.T @ J for J in slopes), np.zeros((len(names),) * 2))
    alike = _alike(bread, names)
    residual = float(torch.cat([_residual(one, values) for one in measured]).square().mean().sqrt())
    covariance = np.linalg.pinv(bread, rcond=ALIKE**2, hermitian=True)
    if not alike:
        step = SECANT * np.sqrt(np.diagonal(covariance)) * max(1.0, residual / noise)

        def white(move: np.ndarray) -> list[np.ndarray]:
            return _white(measured, names, numbers, noise, length_sd, x + move * scale)

        lags = [round(options.correlation_s * one.acting.trial.rate) for one in measured]
        covariance = sandwich(white, step, lags)
    markers = not all(one.own_length for one in measured)
    spread = _in_proportion(measured, names, x, options, markers)
    return LawFit(names, x, covariance * np.outer(scale, scale) + spread, alike, noise, length_sd, residual)


def _alike(bread: np.ndarray, names: tuple[str, ...]) -> tuple[str, ...]:
    """Parameters that take part in a combination which the derivatives do not see."""
    norm = np.sqrt(np.diagonal(bread))
    lost = [name for name, size in zip(names, norm, strict=True) if not size > 0.0]
    unit = bread / np.outer(norm, norm).clip(1e-300)
    values, vectors = np.linalg.eigh(unit)
    blind = np.abs(vectors[:, values < ALIKE * values.max()])
    return tuple(name for name, row in zip(names, blind, strict=True) if name in lost or (row > 0.1).any())


def _in_proportion(
    measured: Sequence[MeasuredElement], names: tuple[str, ...], x: np.ndarray, options: DeviceOptions, markers: bool
) -> np.ndarray:
    """Covariance from an error of the length that goes with its changes, and from one common to all frames."""
    move = np.zeros((2, len(names)))
    length = torch.cat([m.length for m in measured])
    middle = float(length.median())
    turns = measured[0].acting.element.turns
    by_course = options.angle_course_sd / max(float(length.std()), LEAST_COURSE)
    scale_sd = (by_course if turns else options.length_scale_sd) if markers else 0.0
    for k, name in enumerate(names):
        if name in ("stiffness", "damping"):
            move[0, k] = scale_sd * x[k]
        elif name == "rest":
            move[0, k] = scale_sd * (x[k] - middle)
            move[1, k] = options.angle_sd if turns else options.length_sd
    return move.T @ move
