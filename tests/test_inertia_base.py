"""Base parameters: what the data determine."""

import torch
from inertia_cases import bodies, chain_rows, names, prior

from torchid.dynamics.row_equations import NormalEquations
from torchid.inertia.base_parameters import base_parameters, structure


def test_base_parameters_reproduce_the_regressor(seed: int) -> None:
    """Y phi equals Y_base phi_base for any phi, and there are as many as the rank of Y."""
    Y, phi = chain_rows(5, 120, seed), bodies(5)
    given = prior(phi, 0.2)
    data = structure(NormalEquations.from_rows(Y, Y @ phi.flatten()), 1e-6)
    base = base_parameters(data, names(5), phi, given.covariance)
    assert data.rank == int(torch.linalg.matrix_rank(Y / Y.norm(dim=0).clamp_min(1e-300), rtol=1e-9))
    assert data.rank < 50
    other = torch.randn_like(phi)
    expected = Y @ other.flatten()
    torch.testing.assert_close(Y[:, base.independent] @ base.project(other), expected, rtol=1e-7, atol=1e-6)


def test_names_spell_the_matrix(seed: int) -> None:
    """Every name starts with its independent parameter, and short names give the combination's value."""
    Y, phi = chain_rows(2, 60, seed), bodies(2)
    data = structure(NormalEquations.from_rows(Y, Y @ phi.flatten()), 1e-6)
    base = base_parameters(data, ("shank_l", "foot_l"), phi, prior(phi, 0.2).covariance)
    labels = [f"{p}({b})" for b in ("shank_l", "foot_l") for p in "m mc_x mc_y mc_z Ixx Ixy Iyy Ixz Iyz Izz".split()]
    for k, name in enumerate(base.names):
        lead, *rest = name.replace(" - ", " + -").split(" + ")
        assert lead == labels[int(base.independent[k])]
        row = torch.zeros(20, dtype=torch.float64)
        row[labels.index(lead)] = 1
        for term in rest:
            if not term.endswith("more"):
                factor, parameter = term.split("*")
                row[labels.index(parameter)] = float(factor)
        if "more" not in name:
            shown = torch.where(base.weight[k].abs() > 1e-3, base.matrix[k], 0.0)
            torch.testing.assert_close(row, shown, rtol=6e-3, atol=1e-12)


def test_distance_counts_identifiable_differences_only(seed: int) -> None:
    """Moving phi within the null space of the data leaves the base parameters where they were."""
    Y, phi = chain_rows(4, 100, seed), bodies(4)
    given = prior(phi, 0.2)
    equations = NormalEquations.from_rows(Y, Y @ phi.flatten())
    base = base_parameters(structure(equations, 1e-6), names(4), phi, given.covariance)
    null = torch.linalg.svd(base.matrix)[2][len(base.matrix) :].sum(0).reshape(phi.shape)
    assert base.distance(phi + null, phi, given.covariance) < 1e-6 * base.distance(phi + 1, phi, given.covariance)
    assert base.distance(2 * phi, phi, given.covariance) > 1
