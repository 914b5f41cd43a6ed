"""Axis values that follow coordinates by functions: their derivatives are those of forward mode."""

import numpy as np
import pytest
import torch
from torch.testing import assert_close

from torchid.model.coupling import CoupledAxis, Coupling
from torchid.model.opensim.functions import (
    Constant,
    Function,
    LinearFunction,
    PiecewiseCubic,
    Polynomial,
    ScaledFunction,
    Sine,
    broken_line,
    simm_spline,
)


def functions(rng: np.random.Generator) -> dict[str, Function]:
    """One of every kind, numbers drawn."""
    x = torch.tensor(np.sort(rng.uniform(-1.0, 1.0, size=6)))
    y, few = torch.tensor(rng.normal(size=6)), torch.tensor(rng.normal(size=2))
    return {
        "constant": Constant(float(rng.normal())), "linear": LinearFunction(few, float(rng.normal())),
        "polynomial": Polynomial(torch.tensor(rng.normal(size=5))),
        "scaled": ScaledFunction(Polynomial(torch.tensor(rng.normal(size=3))), float(rng.normal())),
        "sine": Sine(*map(float, rng.normal(size=4))),
        "pieces": PiecewiseCubic(x, torch.tensor(rng.normal(size=(6, 4)))),
        "linear pieces": broken_line(x, y), "spline": simm_spline(x, y),
    }  # fmt: skip


KINDS = tuple(functions(np.random.default_rng(0)))


@pytest.mark.parametrize("kind", KINDS)
def test_slopes_are_forward_derivatives(kind: str, seed: int) -> None:
    """By every argument, before the first knot and behind the last too."""
    rng = np.random.default_rng(seed)
    function = functions(rng)[kind]
    count = max(1, function.n_arguments)
    x = torch.tensor(rng.uniform(-2.0, 2.0, size=(40, count)))
    for k in range(count):
        along = torch.zeros_like(x)
        along[:, k] = 1.0
        assert_close(function.slopes(x)[:, k], torch.func.jvp(function, (x,), (along,))[1], rtol=1e-12, atol=1e-12)


def test_followers_of_followers_have_the_derivatives_of_forward_mode(seed: int) -> None:
    """Jacobian, rates, and what is folded, over a chain in which a follower takes another follower and a coordinate."""
    rng = np.random.default_rng(seed)
    own = functions(rng)
    chain = (
        CoupledAxis("a", (1,), own["polynomial"]), CoupledAxis("b", (3, 0), own["linear"]),
        CoupledAxis("c", (4,), own["sine"]),
        CoupledAxis("d", (), own["constant"]), CoupledAxis("e", (5, 5), own["linear"]),
    )  # fmt: skip
    coupling = Coupling("chain", 3, chain)
    q, v, x = (torch.tensor(rng.normal(size=(n, 4))) for n in (3, 3, 8))
    J = coupling.jacobian(q)
    for k in range(3):
        along = torch.zeros_like(q)
        along[k] = 1.0
        assert_close(J[:, k], torch.func.jvp(coupling.axes, (q,), (along,))[1][3:], rtol=1e-12, atol=1e-12)
    rate, acceleration = coupling.rates(q, v, torch.zeros_like(v))
    assert_close(rate[3:], torch.einsum("kdt,dt->kt", J, v))

    def once(at: torch.Tensor) -> torch.Tensor:
        return torch.func.jvp(coupling.axes, (at,), (v,))[1]

    assert_close(acceleration, torch.func.jvp(once, (q,), (v,))[1], rtol=1e-10, atol=1e-10)
    assert_close(coupling.fold(q, x), x[:3] + torch.einsum("kdt,kt->dt", J, x[3:]))
