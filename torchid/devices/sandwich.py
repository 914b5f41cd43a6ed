"""Covariance of a least-squares fit whose residuals go on from frame to frame: White's sandwich with Newey & West's sum
over lags (Econometrica 55:703 (1987))."""

from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Float


def sandwich(
    white: Callable[[np.ndarray], list[np.ndarray]], step: np.ndarray, lags: Sequence[int]
) -> Float[np.ndarray, "params params"]:
    """Return the covariance of the minimiser of half the sum of squares, by secants as wide as ``step``.

    The weights follow the parameters, and laws have kinks: scores are secants of each frame's own half square, and the
    curvature is that of the sum.

    Args:
        white: weighted residuals of every series (frames,), of parameters moved by so much from the minimiser.
        step: half width of the secant in each parameter.
        lags: frames over which residuals of each series go on.
    """
    n = len(step)
    moves = np.diag(step)
    ups, downs = ([[0.5 * e**2 for e in white(side * move)] for move in moves] for side in (1.0, -1.0))
    cost = sum(0.5 * float(e @ e) for e in white(np.zeros(n)))
    curvature, meat = np.zeros((n, n)), np.zeros((n, n))
    for i in range(n):
        curvature[i, i] = sum(float(u.sum() + d.sum()) for u, d in zip(ups[i], downs[i], strict=True)) - 2.0 * cost
        for j in range(i):
            corners = [(a * b, white(a * moves[i] + b * moves[j])) for a in (1.0, -1.0) for b in (1.0, -1.0)]
            mixed = sum(sign * sum(0.5 * float(e @ e) for e in parts) for sign, parts in corners)
            curvature[i, j] = curvature[j, i] = 0.25 * mixed
    for k, lag in enumerate(lags):
        scores = np.stack([0.5 * (ups[i][k] - downs[i][k]) for i in range(n)], 1)
        meat += _long_run(scores, lag)
    inverse = np.linalg.pinv(curvature, hermitian=True)
    frames = sum(len(e) for e in ups[0])
    return inverse @ meat @ inverse * np.outer(step, step) * _short(float(np.mean(lags)) / frames)


def _short(b: float) -> float:
    """Factor on a variance so that 1.96 standard deviations cover 95 %, where the lags are a part b of the frames.

    The statistic is then no normal one; its 97.5 % point is that of Kiefer & Vogelsang, Econometric Theory 21:1130
    (2005), table 1, Bartlett's weights.
    """
    b = min(b, 1.0)
    return ((1.96 + 2.9694 * b + 0.4160 * b**2 - 0.5324 * b**3) / 1.96) ** 2


def _long_run(scores: Float[np.ndarray, "frames params"], lags: int) -> np.ndarray:
    """Covariance of the sum of scores, with Bartlett's weights on their lagged products."""
    lags = min(lags, len(scores) // 3)
    centred = scores - scores.mean(0)
    total = centred.T @ centred
    for lag in range(1, lags + 1):
        product = centred[lag:].T @ centred[:-lag]
        total += (1.0 - lag / (lags + 1)) * (product + product.T)
    values, vectors = np.linalg.eigh(total)
    return (vectors * np.clip(values, 0.0, None)) @ vectors.T
