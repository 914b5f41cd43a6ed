"""Rivals of a cause: what could stand for it, and what could not."""

import pytest
import torch

from torchid.diagnosis.design import Candidate, Source
from torchid.diagnosis.found import ALIKE, NAMED, Rival
from torchid.diagnosis.scan import scan_all
from torchid.diagnosis.sums import Prior, Sums
from torchid.effects.catalogue import effect
from torchid.effects.place import Place

TRIALS = 2


def scanned(columns: torch.Tensor, rows: torch.Tensor, widths: list[float]) -> dict[str, Rival]:
    """Drags, each with a column and the width of its prior, fitted to trials of the same rows."""
    drag, n = effect("drag"), columns.shape[1]
    some = []
    for k, width in enumerate(widths):
        place = Place((f"segment {k}",))
        scale = tuple(s / width for s in drag.scale(place))
        some.append(
            Candidate(drag, place, Source(drag, place, slice(k, k + 1), (0.0,), scale), frozenset(range(TRIALS)))
        )
    prior = Prior(torch.zeros(n).double(), torch.eye(0).double(), torch.ones(n).double())
    raw = prior.standard(columns.T @ columns, columns.T @ rows, torch.arange(n))
    found = scan_all(Sums(0, n, (raw,) * TRIALS), some, ()).round
    return {r.candidate.place.where[0]: r for r in found.rivals}


def apart(seed: int, n: int) -> torch.Tensor:
    """Columns of unit variance that have nothing in common."""
    generator = torch.Generator().manual_seed(seed)
    return torch.linalg.qr(torch.randn(400, n, generator=generator, dtype=torch.float64)).Q * 20.0


@pytest.mark.parametrize("size", [0.3, 1.0])
def test_the_width_of_a_prior_names_no_cause(size):
    """Of two that explain alike, the evidence prefers that of the narrow prior; nobody may be sure of it."""
    column, noise = apart(3, 2).T
    rivals = scanned(torch.stack([column, column], 1), size * column + 0.01 * noise, [1.0, 16.0])
    narrow, wide = rivals["segment 0"], rivals["segment 1"]
    assert narrow.score - wide.score > 2.0
    assert abs(narrow.alike - wide.alike) < 1.0


@pytest.mark.parametrize("alike", [True, False])
def test_what_is_there_too_makes_no_name_doubtful(alike):
    """Two that are both there explain as much as each other, and neither can stand for the other."""
    one, other, _ = apart(4, 3).T
    near = one + 0.02 * other
    rivals = scanned(
        torch.stack([one, near if alike else other], 1), one + (near if alike else 0.998 * other), [1.0, 1.0]
    )
    best, second = rivals["segment 0"], rivals["segment 1"]
    assert min(best.score, second.score) > NAMED and abs(best.score - second.score) < ALIKE
    assert (second.alike > best.alike - ALIKE) == alike
