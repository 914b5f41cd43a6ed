"""What is asked of the inertial fit: equations, prior and constraints, checked and in one form."""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.conventions import Inertial
from torchid.errors import ConfigError
from torchid.inertia import entropic
from torchid.inertia.options import InertiaOptions
from torchid.inertia.pseudo import params_to_pseudo, relative_map
from torchid.model.model import InertialPrior
from torchid.regressor.equations import NormalEquations


@dataclass(frozen=True)
class Problem:
    """The fit in its own units, before weights are chosen."""

    equations: NormalEquations
    mean: Float[Tensor, " params"]
    covariance: Float[Tensor, "params params"]
    T: Float[Tensor, "bodies 10 10"]
    mass: tuple[float, float] | None
    boxes: Float[Tensor, "boxes params"]
    divergence: Float[Tensor, " bodies"] | None
    """Weights of the entropic prior, or None for the quadratic one."""

    def data_terms(self, omega_1: float) -> tuple[Float[Tensor, "params params"], Float[Tensor, " params"]]:
        """Half the Hessian and half the slope of everything but the prior."""
        gram, moment = omega_1 * self.equations.gram, omega_1 * self.equations.moment
        if self.mass is not None:
            row = torch.zeros_like(moment)
            row[Inertial.M :: len(Inertial)] = 1 / self.mass[1]
            gram, moment = gram + torch.outer(row, row), moment + self.mass[0] / self.mass[1] * row
        return gram, moment


def pose(
    equations: NormalEquations,
    prior: InertialPrior,
    names: tuple[str, ...],
    options: InertiaOptions,
    mass: tuple[float, float] | None,
    com_box: Tensor | None,
) -> Problem:
    """Check the inputs and put them in the form the passes below share."""
    params = 10 * len(names)
    shapes = {"prior mean": prior.mean.numel(), "Gram matrix": len(equations.gram), "prior": len(prior.covariance)}
    for what, found in shapes.items():
        if found != params:
            raise ConfigError("inertia.shape", f"{what} does not fit {len(names)} bodies", found=f"{found} of {params}")
    equations.check()
    if not bool((torch.linalg.eigvalsh(params_to_pseudo(prior.mean.nan_to_num())) > 0).all()):
        raise ConfigError("prior.not_physical", "the prior mean of a body is no physical inertia")
    if mass is not None and not (mass[0] > 0 and 0 < mass[1] < float("inf")):
        raise ConfigError("inertia.mass", "total mass needs a value and a standard deviation above 0", found=f"{mass}")
    T, covariance, weights = relative_map(prior.mean), prior.covariance, None
    if options.prior == "entropic":
        weights = entropic.body_weights(covariance, T)
        covariance = entropic.curvature_covariance(weights, T)
    boxes = _box_rows(com_box, len(names), prior.mean)
    return Problem(equations, prior.mean.flatten(), covariance, T, mass, boxes, weights)


def _box_rows(com_box: Tensor | None, bodies: int, like: Tensor) -> Float[Tensor, "boxes params"]:
    """Rows C with C phi >= 0: m c - low m and high m - m c, linear in phi."""
    if com_box is None:
        return like.new_zeros((0, 10 * bodies))
    if com_box.shape != (bodies, 2, 3) or not bool((com_box[:, 0] < com_box[:, 1]).all()):
        raise ConfigError("inertia.com_box", "every box needs a lower corner below its upper corner")
    rows = like.new_zeros((bodies, 2, 3, bodies, 10))
    for body in range(bodies):
        for axis in range(3):
            for side, sign in enumerate((1.0, -1.0)):
                rows[body, side, axis, body, Inertial.MCX + axis] = sign
                rows[body, side, axis, body, Inertial.M] = -sign * com_box[body, side, axis]
    return rows.reshape(-1, 10 * bodies)
