"""Columns of a trial in memory or in a file, some of them replaced."""

import pytest
import torch
from draws import seed_of
from torch.testing import assert_close

from torchid.diagnosis.columns.design import Columns, Terms
from torchid.storage.snapshot import swap_out

SEED = seed_of(__name__)


@pytest.mark.parametrize("stored", [False, True])
def test_replaced_columns_stand_where_others_did(tmp_path, stored):
    """In place, behind all, and again in place of those; the wide ones stay as they are, wherever they lie."""
    draw = torch.Generator().manual_seed(SEED)

    def drawn(columns: int) -> torch.Tensor:
        return torch.randn(6, columns, 5, generator=draw, dtype=torch.float64)

    wide = drawn(7)
    with (tmp_path / "wide").open("w+b") as file:
        found = Columns(swap_out(wide, file) if stored else wide, Terms(torch.arange(9), None))
    wanted = wide.clone()
    for at in ([4, 1], [7, 8, 9], [8, 1, 0], []):
        by, which = drawn(len(at)), torch.tensor(at, dtype=torch.long)
        found = found.replaced(which, by)
        wanted = torch.cat([wanted, wanted.new_zeros(6, max(0, max(at, default=0) + 1 - wanted.shape[1]), 5)], 1)
        wanted[:, which] = by
        theta = torch.randn(wanted.shape[1], generator=draw, dtype=torch.float64)
        theta[torch.rand(len(theta), generator=draw) < 0.4] = 0.0
        assert_close(found.extra, wanted, rtol=0.0, atol=0.0)
        assert_close(found.during(slice(1, 4)), wanted[:, :, 1:4], rtol=0.0, atol=0.0)
        assert_close(found.added(theta), torch.einsum("p,ipt->ti", theta, wanted))
    assert found.wide.equal(wide)
