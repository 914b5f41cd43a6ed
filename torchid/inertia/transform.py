"""The ten inertial parameters of a body in other axes, about another origin."""

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.inertia.pseudo import params_to_pseudo, pseudo_to_params


def move_frame(
    phi: Float[Tensor, "bodies 10"], R_BA: Float[Tensor, "bodies 3 3"], p_BA_B: Float[Tensor, "bodies 3"]
) -> Float[Tensor, "bodies 10"]:
    """Parameters given in frames A, expressed in frames B: the pseudo-inertia moves as X_BA P X_BA'.

    Args:
        phi: about the origins and in the axes of A.
        R_BA, p_BA_B: pose of A in B.
    """
    X = torch.zeros(len(phi), 4, 4, dtype=phi.dtype, device=phi.device)
    X[:, :3, :3], X[:, :3, 3], X[:, 3, 3] = R_BA, p_BA_B, 1.0
    return pseudo_to_params(X @ params_to_pseudo(phi) @ X.mT)
