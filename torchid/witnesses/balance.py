"""The centre of mass against forces that are integrated twice: mass, gains, clocks and leaning forces of one trial.

Over a second the position of the centre of mass answers to forces alone, whatever the limbs do; where the body began
and how fast it was are free. All of these are linear in one regression, so that a gain does not pass for a lag:

    c(t) - t^2/2 g = sum_k (b + d_k) J_k(t) + l J'(t) + e_k J_kz(t) + c0 + v0 t,

with J_k the twice integrated force of plate k, b one over the mass, d_k of a gain of plate k against the first, l of a
lag (apart for the vertical and the horizontal), e_k of a share of the vertical force that a horizontal channel reads.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.conventions import GRAVITY
from torchid.regressor.rows import runs
from torchid.witnesses.options import BalanceOptions
from torchid.witnesses.statements import Statements, Subject
from torchid.witnesses.watched import Watched


@dataclass(frozen=True)
class _Window:
    """Rows of one window, an axis after the other, free of where the body began and how fast it was."""

    columns: Float[Tensor, "rows columns"]
    target: Float[Tensor, " rows"]


def balance(watched: Watched, options: BalanceOptions) -> Statements | None:
    """Return what the balance of a trial says; None where no window is long enough.

    Args:
        watched: the trial.
        options: lengths of windows.
    """
    bearing = _bearing(watched, options)
    windows = [_window(watched, part, bearing) for part in _parts(watched, options)]
    if not windows or not len(bearing):
        return None
    found, spread = _solved(_closed(windows, options))
    samples = max(1.0, options.memory_s * watched.rate)
    covariance = spread * samples
    return _stated(watched, bearing, found, covariance)


def _bearing(watched: Watched, options: BalanceOptions) -> list[int]:
    """Return the plates that bear more than a little of the weight."""
    vertical = watched.reading.wrench[watched.measured][..., 2]
    if not len(vertical):
        return []
    share = vertical.mean(0) / vertical.mean(0).sum()
    return (share > options.least_share).nonzero()[:, 0].tolist()


def _parts(watched: Watched, options: BalanceOptions) -> Iterator[slice]:
    """Yield windows: runs of measured frames, cut evenly."""
    least, most = options.shortest_s * watched.rate, options.longest_s * watched.rate
    for start, stop in runs(watched.measured):
        pieces = max(1, -(-(stop - start) // int(most)))
        edges = [start + round(k * (stop - start) / pieces) for k in range(pieces + 1)]
        yield from (slice(a, b) for a, b in zip(edges, edges[1:], strict=False) if b - a >= least)


def _window(watched: Watched, part: slice, bearing: list[int]) -> _Window:
    """Return the rows of one window: of the vertical, then of the two horizontal axes."""
    n, dt = part.stop - part.start, 1.0 / watched.rate
    t = dt * torch.arange(n, dtype=watched.centre.dtype, device=watched.centre.device)
    force = watched.reading.wrench[part][:, :, :3]
    once = _integral(force.flatten(1), dt)
    twice = _integral(once, dt).unflatten(1, force.shape[1:])
    once = once.unflatten(1, force.shape[1:])
    free = torch.stack([torch.ones_like(t), t], 1)
    basis = torch.linalg.qr(free).Q
    columns, target = [], []
    for axis in (2, 0, 1):
        y = watched.centre[part, axis] + (0.5 * GRAVITY * t.square() if axis == 2 else 0.0)
        own = _row(once, twice, axis, bearing)
        columns.append(own - basis @ (basis.T @ own))
        target.append(y - basis @ (basis.T @ y))
    return _Window(torch.cat(columns), torch.cat(target))


def _row(once: Tensor, twice: Tensor, axis: int, bearing: list[int]) -> Float[Tensor, "frames columns"]:
    """Columns of one axis: mass, gains of further plates, two lags, and the leaning of each plate in x and in y."""
    zero = torch.zeros_like(twice[:, 0, 0])
    vertical = axis == 2
    gains = [twice[:, k, axis] if vertical else zero for k in bearing[1:]]
    lag = once[:, :, axis].sum(1)
    lags = [lag, zero] if vertical else [zero, lag]
    lean = [twice[:, k, 2] if axis == own else zero for own in (0, 1) for k in bearing]
    return torch.stack([twice[:, :, axis].sum(1), *gains, *lags, *lean], 1)


def _integral(x: Float[Tensor, "frames some"], dt: float) -> Float[Tensor, "frames some"]:
    """Return the integral from the first frame on, by trapezia."""
    return torch.nn.functional.pad(torch.cumulative_trapezoid(x, dx=dt, dim=0), (0, 0, 1, 0))


def _closed(windows: list[_Window], options: BalanceOptions) -> list[_Window]:
    """Return the windows that close as well as the others: one contact beside a plate spoils all the rest."""
    x, _ = _solved(windows)
    left = torch.stack([(w.target - w.columns @ x).square().mean().sqrt() for w in windows])
    return [w for w, rms in zip(windows, left, strict=True) if rms <= options.open_ratio * left.median()]


def _solved(windows: list[_Window]) -> tuple[Float[Tensor, " columns"], Float[Tensor, "columns columns"]]:
    """Return least squares of all windows, and their covariance under white residuals."""
    A, y = torch.cat([w.columns for w in windows]), torch.cat([w.target for w in windows])
    size = A.square().sum(0).sqrt().clamp(min=1e-12)
    U, s, V = torch.linalg.svd(A / size, full_matrices=False)
    keep = s > 1e-8 * s[0]
    inverse = torch.where(keep, 1.0 / s, 0.0)
    x = (V.mT * inverse) @ (U.mT @ y) / size
    left = (y - A @ x).square().sum() / max(len(y) - A.shape[1] - 6 * len(windows), 1)
    spread = torch.where(keep, 1.0 / s, 1e6)
    half = V.mT * spread / size[:, None]
    return x, left * half @ half.T


def _stated(
    watched: Watched, bearing: list[int], x: Float[Tensor, " columns"], covariance: Float[Tensor, "columns columns"]
) -> Statements:
    """Return the statements that the coefficients amount to, with their covariance to first order."""
    plates = [watched.reading.frames[k].name for k in bearing]
    names = [Subject("mass", watched.name)]
    names += [Subject("gain", watched.name, f"{plate}/{plates[0]}") for plate in plates[1:]]
    names += [Subject("clock_vertical", watched.name), Subject("clock_horizontal", watched.name)]
    names += [Subject(f"lean_{axis}", watched.name, plate) for axis in "xy" for plate in plates]
    b = x[0]
    value = x / b
    value[0] = -(b * watched.scene.recorded_kg).log()
    J = torch.eye(len(x), dtype=x.dtype, device=x.device) / b
    J[1:, 0] = -value[1:] / b
    J[0, 0] = -1.0 / b
    sign = torch.ones_like(value)
    sign[1 : len(plates)] = -1.0
    return Statements(tuple(names), sign * value, (sign[:, None] * J) @ covariance @ (sign[:, None] * J).T)
