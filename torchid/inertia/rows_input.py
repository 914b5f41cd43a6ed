"""The arguments of ``fit_inertia_rows``, checked and put in torchid's order, float64.

Arrays may be NumPy arrays, tensors or nested sequences of numbers. Every check raises an error that names the argument
at fault, what was found there and what to do.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from torchid.conventions import INERTIAL_NAMES
from torchid.dynamics.row_equations import NormalEquations
from torchid.errors import ConfigError, DataError
from torchid.inertia.linear import check_boxes_meet, check_ellipsoids
from torchid.model.model import InertialPrior
from torchid.model.pseudo import params_to_pseudo, relative_map

Numbers = np.ndarray | Tensor | Sequence[Any]
"""An array in any form that NumPy understands."""
PRIOR_KINDS = ("euclidean", "pullback", "entropic")
_ASYMMETRY = 1e-9
"""Relative difference of a covariance and its transpose that still counts as rounding."""


@dataclass(frozen=True)
class RowsPrior:
    """Parameters before any row is seen, and the distance d(phi) from them (docs/rows.md, "Priors")."""

    mean: Numbers
    """Ten parameters of each body, shape (bodies, 10), in the order of the rows [kg, kg m, kg m^2]."""
    kind: str
    """The distance: "euclidean" (squared differences of parameters), "pullback" (squared differences of
    pseudo-inertias relative to the mean's) or "entropic" (twice the log-det divergence)."""
    scale: float | Numbers = 1.0
    """Standard deviation s in d(phi) / s^2, one for all bodies or one for each: a share of the body for "pullback" and
    "entropic", in the parameters' own units for "euclidean"."""
    covariance: Numbers | None = None
    """Covariance of all parameters in place of ``scale``, shape (10 bodies, 10 bodies), for "euclidean" only."""


@dataclass(frozen=True)
class Limits:
    """Conditions that the parameters must fulfil besides the rows."""

    total_mass: float | tuple[float, float] | None = None
    """Mass of all bodies [kg]: a number holds exactly, a number with its standard deviation is weighed."""
    com_box: Numbers | None = None
    """Lower and upper corner of the box that holds each centre of mass, shape (bodies, 2, 3), body axes [m]."""
    ellipsoids: Numbers | None = None
    """Matrix Q of each body's bounding ellipsoid {x : [x; 1]' Q [x; 1] >= 0}, shape (bodies, 4, 4), body axes, about
    the body's origin (see ``torchid.inertia.linear.ellipsoid_matrix``); diag(0, 0, 0, 1) bounds nothing."""
    lmi: bool = True
    """Every pseudo-inertia must be positive semidefinite if true; the entropic prior makes it so in any case."""
    floor: float = 1e-6
    """Smallest eigenvalue of a pseudo-inertia relative to the prior mean's, so that the result can be inverted."""


def column_order(order: Sequence[str], bodies: int) -> Tensor:
    """Return the caller's column of each of torchid's parameters.

    Raises:
        ConfigError: ``order`` is no permutation of the ten names.
    """
    if sorted(order) != sorted(INERTIAL_NAMES):
        raise ConfigError(
            "rows.order", "the order of parameters must hold each of the ten names once", place="order",
            found=", ".join(map(str, order)), remedy=f"Use a permutation of {', '.join(INERTIAL_NAMES)}",
        )  # fmt: skip
    one = torch.tensor([list(order).index(name) for name in INERTIAL_NAMES])
    return (10 * torch.arange(bodies)[:, None] + one).flatten()


def array(value: object, place: str, shape: tuple[int | None, ...], meaning: str) -> Tensor:
    """Return a float64 tensor on the CPU; None in ``shape`` stands for any size.

    Raises:
        ConfigError: the value is no array of numbers or has another shape.
        DataError: it holds NaN or infinity.
    """
    try:
        plain = value.detach().cpu().numpy() if isinstance(value, Tensor) else value
        found = torch.from_numpy(np.array(plain, dtype=float))
    except (TypeError, ValueError) as error:
        raise ConfigError("rows.array", "no array of numbers", place=place, found=str(error), remedy=meaning) from error
    if found.ndim != len(shape) or any(n is not None and n != k for n, k in zip(shape, found.shape, strict=True)):
        wanted = ", ".join("n" if n is None else str(n) for n in shape)
        raise ConfigError(
            "rows.shape", f"the array needs shape ({wanted})", place=place, found=str(tuple(found.shape)),
            remedy=meaning,
        )  # fmt: skip
    finite = torch.isfinite(found)
    if not bool(finite.all()):
        first = tuple((~finite).nonzero()[0].tolist())
        raise DataError(
            "rows.not_finite", "the array holds NaN or infinity", place=place,
            found=f"{int((~finite).sum())} entries, the first at {first}", remedy="Leave these rows or values out",
        )  # fmt: skip
    return found


def read_prior(prior: RowsPrior, columns: Tensor, names: tuple[str, ...]) -> InertialPrior:
    """Return the prior as mean and covariance in torchid's order.

    The covariance of "pullback" and "entropic" is that of the Gaussian with the distance's curvature at the mean.

    Raises:
        ConfigError: the kind is unknown, a mean is no physical inertia, or scale or covariance cannot be.
        DataError: a value is NaN or infinite.
    """
    if prior.kind not in PRIOR_KINDS:
        raise ConfigError(
            "rows.prior", "the kind of prior is unknown", place="prior.kind", found=str(prior.kind),
            remedy="Use euclidean, pullback or entropic",
        )  # fmt: skip
    bodies = len(names)
    mean = array(prior.mean, "prior.mean", (bodies, 10), "Give ten parameters of each body")
    mean = mean.flatten()[columns].reshape(bodies, 10)
    _check_physical(mean, names)
    if prior.covariance is not None:
        return InertialPrior(mean, _covariance(prior, columns))
    variance = _variance(prior, bodies)
    T = torch.eye(10, dtype=torch.float64).expand(bodies, 10, 10) if prior.kind == "euclidean" else relative_map(mean)
    return InertialPrior(mean, torch.block_diag(*(variance[:, None, None] * T @ T.mT)))


def _check_physical(mean: Float[Tensor, "bodies 10"], names: tuple[str, ...]) -> None:
    for name, phi, low in zip(names, mean, torch.linalg.eigvalsh(params_to_pseudo(mean))[:, 0].tolist(), strict=True):
        if float(phi[0]) <= 0 or low <= 0:
            raise ConfigError(
                "rows.prior_not_physical", "no mass distribution has the parameters of the prior mean",
                place=f"prior.mean, body {name}",
                found=f"mass {float(phi[0]):.4g} kg, smallest eigenvalue of the pseudo-inertia {low:.2g}",
                remedy="Check order and units, and that inertias are about the body's origin, not its centre of mass",
            )  # fmt: skip


def _variance(prior: RowsPrior, bodies: int) -> Float[Tensor, " bodies"]:
    shape = (bodies,) if np.ndim(prior.scale) else ()
    scale = array(prior.scale, "prior.scale", shape, "Give one number, or one for each body")
    if not bool((scale > 0).all()):
        raise ConfigError("rows.prior_scale", "a standard deviation must be above 0", place="prior.scale",
                          found=f"{float(scale.min()):g}", remedy="Give a share such as 0.3")  # fmt: skip
    return scale.square().expand(bodies)


def _covariance(prior: RowsPrior, columns: Tensor) -> Float[Tensor, "params params"]:
    if prior.kind != "euclidean":
        raise ConfigError("rows.prior_covariance", "only the Euclidean prior takes a covariance",
                          place="prior.covariance", found=f"kind {prior.kind}", remedy="Give scale")  # fmt: skip
    n = len(columns)
    given = array(prior.covariance, "prior.covariance", (n, n), "Give the covariance of all parameters")
    asymmetry = float((given - given.mT).abs().max() / given.abs().max())
    if not asymmetry <= _ASYMMETRY:
        raise ConfigError("rows.prior_covariance", "a covariance is symmetric", place="prior.covariance",
                          found=f"relative asymmetry {asymmetry:.1e}", remedy="Check how it was built")  # fmt: skip
    return given[columns][:, columns]


def read_data(data: tuple[Any, ...] | NormalEquations, columns: Tensor) -> NormalEquations:
    """Return the sums of the rows in torchid's order.

    Raises:
        ConfigError: ``data`` is neither (Y, F) nor (gram, moment, square, count), or a shape is wrong.
        DataError: a value is NaN or infinite, or the sums cannot come from one set of rows.
    """
    if isinstance(data, NormalEquations):
        data = (data.gram, data.moment, data.square, data.rows)
    n = len(columns)
    if len(data) == 2:
        Y = array(data[0], "data, Y", (None, n), f"Give one row per equation and 10 columns per body, {n} here")
        F = array(data[1], "data, F", (len(Y),), "Give one right-hand side per row of Y")
        equations = NormalEquations.from_rows(Y[:, columns], F)
    elif len(data) == 4:
        gram = array(data[0], "data, gram", (n, n), "Give Y' Y")
        moment = array(data[1], "data, moment", (n,), "Give Y' F")
        square = array(data[2], "data, square", (), "Give F' F")
        count = array(data[3], "data, count", (), "Give the number of rows")
        equations = NormalEquations(gram[columns][:, columns], moment[columns], float(square), float(count))
    else:
        raise ConfigError("rows.data", "the data are (Y, F) or (gram, moment, square, count)", place="data",
                          found=f"{len(data)} items", remedy="Give one of the two")  # fmt: skip
    if not equations.rows > 0:
        raise DataError("rows.empty", "there are no rows", place="data", found=f"{equations.rows:g} rows",
                        remedy="Give at least one row")  # fmt: skip
    equations.check()
    return equations


@dataclass(frozen=True)
class CheckedLimits:
    """Limits as tensors."""

    mass: tuple[float, float] | None
    exact_mass: float | None
    com_box: Float[Tensor, "bodies 2 3"] | None
    ellipsoids: Float[Tensor, "bodies 4 4"] | None


def read_limits(limits: Limits, names: tuple[str, ...]) -> CheckedLimits:
    """Return the limits as tensors.

    Raises:
        ConfigError: a mass, box or ellipsoid cannot be, or a body's box does not meet its ellipsoid.
        DataError: a value is NaN or infinite.
    """
    mass, exact = limits.total_mass, None
    if isinstance(mass, int | float):
        mass, exact = None, float(mass)
    value, sd = mass or (exact, 1.0)
    if value is not None and not (0 < value < float("inf") and 0 < sd < float("inf")):
        raise ConfigError("rows.total_mass", "the total mass and its standard deviation must be above 0",
                          place="limits.total_mass", found=str(limits.total_mass),
                          remedy="Give kg; a number without standard deviation holds exactly")  # fmt: skip
    bodies, box, ellipsoids = len(names), limits.com_box, limits.ellipsoids
    box = None if box is None else array(box, "limits.com_box", (bodies, 2, 3), "Give two corners for each body")
    if box is not None and not bool((box[:, 0] < box[:, 1]).all()):
        name = names[int((box[:, 0] >= box[:, 1]).any(dim=1).nonzero()[0])]
        raise ConfigError("rows.com_box", "a lower corner is not below its upper corner",
                          place=f"limits.com_box, body {name}", found="corners in the wrong order",
                          remedy="Give (low, high) for each body")  # fmt: skip
    if ellipsoids is not None:
        ellipsoids = array(ellipsoids, "limits.ellipsoids", (bodies, 4, 4), "Give one matrix Q for each body")
        check_ellipsoids(ellipsoids, names)
        if box is not None:
            check_boxes_meet(box, ellipsoids, names)
    return CheckedLimits(mass, exact, box, ellipsoids)
