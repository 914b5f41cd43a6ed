"""The centre of mass against forces that are integrated twice: mass, gains, clocks and leaning forces of one trial.

Over a second the position of the centre of mass answers to forces alone, whatever the limbs do; where the body began
and how fast it was are free. All of these are linear in one regression, so that a gain does not pass for a lag:

    c(t) - t^2/2 g = sum_k (b + d_k) J_k(t) + l J'(t) + e_k J_kz(t) + c0 + v0 t,

with J_k the twice integrated force of plate k, b one over the mass, d_k of a gain of plate k against the first, l of a
lag (apart for the vertical and the horizontal), e_k of a share of the vertical force that a horizontal channel reads.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.conventions import GRAVITY, LOADED_N
from torchid.model_free.options import WitnessOptions
from torchid.model_free.statements import CheckSubject
from torchid.model_free.watched import Watched
from torchid.runs import runs

AXES = [2, 0, 1]
"""The vertical, then the two horizontal axes."""
UNSEEN = 1e-12
"""Resolution. Part of the largest eigenvalue below which a combination of columns is not there."""
UNDERSTATED = 1.4
"""Calibrated. Standard deviations of least squares are multiplied by it: errors of a centre of mass move as the body
does, and columns take part of them. Statements of clean simulated sessions scatter by 1.4 of it."""


@dataclass(frozen=True)
class _Window:
    """Rows of one window, an axis after the other, free of where the body began and how fast it was."""

    columns: Float[Tensor, "rows columns"]
    target: Float[Tensor, " rows"]


@dataclass(frozen=True)
class Balance:
    """Mass, gains, clocks and leaning forces of one trial; a ``Witness``."""

    about: tuple[CheckSubject, ...]
    covariance: Float[Tensor, "some some"]
    bearing: tuple[tuple[int, ...], ...]
    """Plates that speak together."""
    parts: tuple[slice, ...]
    """Windows."""

    def value(self, watched: Watched) -> Float[Tensor, " some"]:
        """Return logarithm of the mass over the recorded one, relative gains, lags [s] and shares of the vertical.

        All of plates that bear nothing is NaN, as another reading may have it.

        Args:
            watched: the trial.
        """
        x = _solved(_windows(watched, self.parts, self.bearing))
        vertical = watched.reading.wrench[watched.measured][..., 2].mean(0)
        bears = torch.stack([vertical[list(some)].sum() > LOADED_N for some in self.bearing])
        one = bears.new_ones(1)
        told = torch.cat([one, bears[1:], one, one, bears, bears])
        return torch.where(told, _stated(watched, len(self.bearing), x)[0], math.nan)


def balance(watched: Watched, options: WitnessOptions) -> Balance | None:
    """Return the witness of a trial's balance; None where no window is long enough.

    Args:
        watched: the trial.
        options: lengths of windows.
    """
    bearing, parts = _bearing(watched, options), tuple(_parts(watched, options))
    if not parts or not bearing:
        return None
    windows = _windows(watched, parts, bearing)
    kept = _closed(windows, options)
    windows, parts = [windows[k] for k in kept], tuple(parts[k] for k in kept)
    x = _solved(windows)
    _, J = _stated(watched, len(bearing), x)
    plates = ["+".join(watched.reading.frames[k].name for k in some) for some in bearing]
    return Balance(_about(watched.name, plates), UNDERSTATED**2 * J @ _scatter(windows, x) @ J.T, bearing, parts)


def _about(trial: str, plates: Sequence[str]) -> tuple[CheckSubject, ...]:
    """Return what the numbers are about, in the order of the columns."""
    gains = [CheckSubject("gain", trial, f"{plate}/{plates[0]}") for plate in plates[1:]]
    lean = [CheckSubject(f"lean_{axis}", trial, plate) for axis in "xy" for plate in plates]
    clocks = [CheckSubject("clock_vertical", trial), CheckSubject("clock_horizontal", trial)]
    return (CheckSubject("mass", trial), *gains, *clocks, *lean)


def _bearing(watched: Watched, options: WitnessOptions) -> tuple[tuple[int, ...], ...]:
    """Return the plates that bear more than a little of the weight: each apart if weight moves between them, else all
    together, for which the first speaks."""
    vertical = watched.reading.wrench[watched.measured][..., 2].clamp(min=0.0)
    if not len(vertical):
        return ()
    share = vertical / vertical.sum(1, keepdim=True).clamp(min=LOADED_N)
    some = (share.mean(0) > options.least_share).nonzero()[:, 0].tolist()
    if len(some) > 1 and bool((share[:, some].std(0) < options.least_shift).any()):
        return (tuple(some),)
    return tuple((k,) for k in some)


def _parts(watched: Watched, options: WitnessOptions) -> Iterator[slice]:
    """Yield windows: runs of measured frames, cut evenly."""
    least, most = options.shortest_s * watched.rate, options.longest_s * watched.rate
    for start, stop in runs(watched.measured):
        pieces = max(1, -(-(stop - start) // int(most)))
        edges = [start + round(k * (stop - start) / pieces) for k in range(pieces + 1)]
        yield from (slice(a, b) for a, b in zip(edges, edges[1:], strict=False) if b - a >= least)


def _windows(watched: Watched, parts: Sequence[slice], bearing: tuple[tuple[int, ...], ...]) -> list[_Window]:
    """Return the rows of all windows, of the vertical, then of the two horizontal axes.

    Forces are integrated from the first frame of the trial on: where a window begins changes only what its rows are
    free of.
    """
    dt = 1.0 / watched.rate
    t = dt * torch.arange(len(watched.centre), dtype=watched.centre.dtype, device=watched.centre.device)
    force = watched.reading.wrench[:, :, :3].nan_to_num()
    once = _integral(force.flatten(1), dt)
    both = (x.unflatten(1, force.shape[1:]) for x in (once, _integral(once, dt)))
    once, twice = (_joined(x, bearing) for x in both)
    columns = torch.stack([_row(once, twice, axis) for axis in AXES], 1)
    falling = torch.stack([0.5 * GRAVITY * t.square() if axis == 2 else torch.zeros_like(t) for axis in AXES], 1)
    rows = torch.cat([columns, (watched.centre[:, AXES] + falling)[..., None]], 2)
    return [_window(rows[part], t[part]) for part in parts]


def _window(rows: Float[Tensor, "frames 3 columns"], t: Float[Tensor, " frames"]) -> _Window:
    """Return a window free of any line in time; the last column is the target."""
    basis = torch.linalg.qr(torch.stack([torch.ones_like(t), t - t.mean()], 1)).Q
    flat = rows.flatten(1)
    free = (flat - basis @ (basis.T @ flat)).unflatten(1, rows.shape[1:]).transpose(0, 1).flatten(0, 1)
    return _Window(free[:, :-1], free[:, -1])


def _joined(
    x: Float[Tensor, "frames plates 3"], bearing: tuple[tuple[int, ...], ...]
) -> Float[Tensor, "frames groups 3"]:
    """Return the sums over the plates that speak together; those that bear little go with the first."""
    apart = [x[:, some].sum(1) for some in bearing[1:]]
    return torch.stack([x.sum(1) - sum(apart, start=torch.zeros_like(x[:, 0])), *apart], 1)


def _row(once: Tensor, twice: Tensor, axis: int) -> Float[Tensor, "frames columns"]:
    """Columns of one axis: mass, gains of further plates, two lags, and the leaning of each plate in x and in y."""
    zero = torch.zeros_like(twice[:, 0, 0])
    vertical = axis == 2
    plates = range(twice.shape[1])
    gains = [twice[:, k, axis] if vertical else zero for k in plates[1:]]
    lag = once[:, :, axis].sum(1)
    lags = [lag, zero] if vertical else [zero, lag]
    lean = [twice[:, k, 2] if axis == own else zero for own in (0, 1) for k in plates]
    return torch.stack([twice[:, :, axis].sum(1), *gains, *lags, *lean], 1)


def _integral(x: Float[Tensor, "frames some"], dt: float) -> Float[Tensor, "frames some"]:
    """Return the integral from the first frame on, by trapezia."""
    return torch.nn.functional.pad(torch.cumulative_trapezoid(x, dx=dt, dim=0), (0, 0, 1, 0))


def _closed(windows: Sequence[_Window], options: WitnessOptions) -> list[int]:
    """Return the windows that close as well as the others: one contact beside a plate spoils all the rest."""
    x = _solved(windows)
    left = torch.stack([(w.target - w.columns @ x).square().mean().sqrt() for w in windows])
    return (left <= options.open_ratio * left.median()).nonzero()[:, 0].tolist()


def _solved(windows: Sequence[_Window]) -> Float[Tensor, " columns"]:
    """Return least squares of all windows; a column that nothing shows is zero."""
    A, y = torch.cat([w.columns for w in windows]), torch.cat([w.target for w in windows])
    size = A.square().sum(0).sqrt().clamp(min=1e-12)
    scaled = (A / size).detach()
    values, V = torch.linalg.eigh(scaled.T @ scaled)
    half = V * torch.where(values > UNSEEN * values[-1], values.rsqrt(), 0.0) / size.detach()[:, None]
    x = half @ (half.T @ (A.T @ y).detach())
    # A step of refinement adds nothing but the derivatives, which those of an eigenvalue would not survive.
    return x + half @ (half.T @ (A.T @ (y - A @ x)))


def _scatter(windows: Sequence[_Window], x: Float[Tensor, " columns"]) -> Float[Tensor, "columns columns"]:
    """Return the covariance of least squares, by what they leave and how long that is alike."""
    A, error = torch.cat([w.columns for w in windows]), [w.target - w.columns @ x for w in windows]
    alike = _alike([one.unflatten(0, (3, -1)) for one in error])
    left = torch.cat(error).square().sum() / max(len(A) / alike - A.shape[1], 1.0)
    size = A.square().sum(0).sqrt().clamp(min=1e-12)
    values, V = torch.linalg.eigh((A / size).T @ (A / size))
    half = V * values.clamp(min=UNSEEN * float(values[-1])).rsqrt() / size[:, None]
    return left * half @ half.T


def _alike(errors: Sequence[Float[Tensor, "3 _"]]) -> float:
    """Return the number of frames that say no more than one: the integral of the errors' autocorrelation up to its
    first zero."""
    longest = max(one.shape[1] for one in errors)
    spectra = [torch.fft.rfft(one, 2 * longest).abs().square() for one in errors]
    correlation = torch.fft.irfft(torch.cat(spectra).sum(0), 2 * longest)[:longest]
    positive = int((correlation > 0.0).long().cumprod(0).sum())
    return float(2.0 * correlation[:positive].sum() / correlation[0].clamp(min=1e-300) - 1.0)


def _stated(
    watched: Watched, plates: int, x: Float[Tensor, " columns"]
) -> tuple[Float[Tensor, " columns"], Float[Tensor, "columns columns"]]:
    """Return the numbers that the coefficients amount to, and their derivatives."""
    value, J = x / x[0], torch.eye(len(x), dtype=x.dtype, device=x.device) / x[0]
    J[1:, 0] = -value[1:] / x[0]
    J[0, 0] = -1.0 / x[0]
    value[0] = -(x[0] * watched.scene.recorded_kg).log()
    sign = torch.ones_like(value)
    sign[1:plates] = -1.0
    return sign * value, sign[:, None] * J
