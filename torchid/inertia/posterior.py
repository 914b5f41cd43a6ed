"""What is known after the fit, and how much of it came from the motion."""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.conventions import Inertial
from torchid.inertia.spectrum import Spectrum
from torchid.model.pseudo import com, inertia_matrix, mass


@dataclass(frozen=True)
class InertiaUncertainty:
    """Standard deviations; Gaussian, without the LMI, quotients linearised (delta method)."""

    phi: Float[Tensor, "bodies 10"]
    com: Float[Tensor, "bodies 3"]
    inertia_com: Float[Tensor, "bodies 3 3"]
    total_mass: float

    @property
    def mass(self) -> Float[Tensor, " bodies"]:
        """Return the standard deviation of each body's mass [kg]."""
        return self.phi[:, Inertial.M]


@dataclass(frozen=True)
class Progress:
    """Share of the prior variance (weighed, and with the given mass) that the motion removed, 0 to 1.

    A segment's figure is the mean over the ten axes in which its prior is white, 1 - tr(C0^-1 C) / 10: a
    determinant would call a segment known as soon as one combination is.
    """

    phi: Float[Tensor, "bodies 10"]
    segment: Float[Tensor, " bodies"]
    total_mass: float

    @property
    def mass(self) -> Float[Tensor, " bodies"]:
        """Return the share of each body's mass."""
        return self.phi[:, Inertial.M]


def body_blocks(covariance: Float[Tensor, "params params"]) -> Float[Tensor, "bodies 10 10"]:
    """Covariance of each body's ten parameters."""
    bodies = len(covariance) // 10
    return covariance.reshape(bodies, 10, bodies, 10).diagonal(dim1=0, dim2=2).movedim(-1, 0)


def _delta_sd(jacobian: Float[Tensor, "bodies out 10"], blocks: Float[Tensor, "bodies 10 10"]) -> Tensor:
    """Standard deviation of a function of each body's parameters, to first order, shape (bodies, out)."""
    return ((jacobian @ blocks) * jacobian).sum(-1).clamp_min(0).sqrt()


def com_jacobian(phi: Float[Tensor, "bodies 10"]) -> Float[Tensor, "bodies 3 10"]:
    """Derivative of ``pseudo.com`` with respect to the parameters."""
    jacobian = phi.new_zeros((len(phi), 3, 10))
    jacobian[:, :, Inertial.M] = -com(phi)
    jacobian[:, :, Inertial.MCX : Inertial.MCZ + 1] = torch.eye(3, dtype=phi.dtype, device=phi.device)
    return jacobian / mass(phi)[:, None, None]


def inertia_com_jacobian(phi: Float[Tensor, "bodies 10"]) -> Float[Tensor, "bodies 3 3 10"]:
    """Derivative of ``pseudo.inertia_com``: of I - (h'h 1 - h h') / m with respect to m, h = m c and I."""
    eye, c = torch.eye(3, dtype=phi.dtype, device=phi.device), com(phi)
    jacobian = (
        inertia_matrix(torch.eye(10, dtype=phi.dtype, device=phi.device)).movedim(0, -1).repeat(len(phi), 1, 1, 1)
    )
    jacobian[..., Inertial.M] = (c * c).sum(-1)[:, None, None] * eye - c[:, :, None] * c[:, None, :]
    mixed = torch.einsum("ki,bj->bijk", eye, c)
    jacobian[..., Inertial.MCX : Inertial.MCZ + 1] = (
        mixed + mixed.transpose(1, 2) - 2 * torch.einsum("ij,bk->bijk", eye, c)
    )
    return jacobian


def uncertainty(phi: Float[Tensor, "bodies 10"], covariance: Float[Tensor, "params params"]) -> InertiaUncertainty:
    """Standard deviations of parameters, centres of mass [m] and inertias about them [kg m^2]."""
    blocks = body_blocks(covariance)
    return InertiaUncertainty(
        phi=covariance.diagonal().clamp_min(0).sqrt().reshape(-1, 10),
        com=_delta_sd(com_jacobian(phi), blocks),
        inertia_com=_delta_sd(inertia_com_jacobian(phi).flatten(1, 2), blocks).unflatten(1, (3, 3)),
        total_mass=float(_mass_variance(covariance) ** 0.5),
    )


def progress(spectrum: Spectrum, covariance: Float[Tensor, "params params"], omega_2: float) -> Progress:
    """Compare ``covariance`` with what prior and mass alone would leave."""
    return progress_from(spectrum.covariance(0.0, omega_2), covariance)


def progress_from(before: Float[Tensor, "params params"], covariance: Float[Tensor, "params params"]) -> Progress:
    """Return how much of a covariance is gone.

    Args:
        before: what prior and mass alone leave.
        covariance: what is left.
    """
    blocks = torch.linalg.solve(body_blocks(before), body_blocks(covariance))
    share = 1 - covariance.diagonal() / before.diagonal()
    return Progress(
        phi=share.clamp(0, 1).reshape(-1, 10),
        segment=(1 - blocks.diagonal(dim1=-2, dim2=-1).sum(-1) / 10).clamp(0, 1),
        total_mass=min(max(1 - _mass_variance(covariance) / _mass_variance(before), 0.0), 1.0),
    )


def _mass_variance(covariance: Float[Tensor, "params params"]) -> float:
    step = len(Inertial)
    return max(float(covariance[Inertial.M :: step, Inertial.M :: step].sum()), 0.0)
