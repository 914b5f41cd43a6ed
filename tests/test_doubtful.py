"""Causes that evidence supports and that are none."""

import pytest
import small_session as small
import torch
from models import model_of

from torchid.diagnosis.candidates.candidate import Candidate, ColumnSource
from torchid.diagnosis.columns.design import Design
from torchid.diagnosis.evidence.gains import gains
from torchid.diagnosis.evidence.per_trial import marginalise_per_trial, trial_posteriors
from torchid.diagnosis.evidence.posterior import fit
from torchid.diagnosis.evidence.prior import Prior
from torchid.diagnosis.evidence.statistics import Statistics
from torchid.diagnosis.search.elimination import (
    SUPPORTED,
    drop_negative,
    drop_surely_negative,
    settle,
)
from torchid.diagnosis.search.result import SearchResult, support
from torchid.effects.catalogue import effect
from torchid.effects.place import Place


def found(columns: torch.Tensor, rows: torch.Tensor) -> SearchResult:
    """Three drags, each with a column of its own, fitted to two trials of the same rows."""
    drag, n = effect("drag"), columns.shape[1]
    sources = [ColumnSource(drag, Place((name,)), slice(k + 1, k + 2), (0.0,), (1.0,)) for k, name in enumerate("abc")]
    chosen = tuple(
        Candidate(drag, s.place, ColumnSource(drag, s.place, s.columns, (0.0,), drag.scale(s.place)), frozenset({0, 1}))
        for s in sources
    )
    every = torch.cat([torch.zeros(len(columns), 1).double(), columns], 1)
    prior = Prior(torch.zeros(n + 1).double(), torch.eye(1).double(), torch.ones(n).double())
    raw = prior.standard(every.T @ every, every.T @ rows, torch.arange(n + 1))
    statistics = Statistics(1, n + 1, (raw, raw))
    model = model_of(Design(1, 1, tuple(sources), chosen, ()), prior, statistics)
    return SearchResult(model, chosen, (), model.fit(chosen))


@pytest.mark.parametrize("gone", [False, True])
def test_what_stood_by_a_cause_goes_with_it(gone):
    """Two that nearly undo each other explain together what neither does alone."""
    one, other, third = torch.linalg.qr(torch.randn(400, 3, generator=torch.Generator().manual_seed(9)).double()).Q.T
    search = found(20.0 * torch.stack([one, 0.1 * other - one, third], 1), 60.0 * third + 10.0 * other)
    chosen = search.chosen[1:] if gone else search.chosen
    search = settle(search.having(chosen), SUPPORTED)
    assert [c.place.where[0] for c in search.chosen] == (["c"] if gone else ["a", "b", "c"])
    assert len(search.posterior.chosen) == len(search.chosen)


def test_what_is_left_is_supported(seed):
    """However one hangs on another: of what a search ends with, nothing falls short of what names it."""
    for k in range(60):
        draw = torch.Generator().manual_seed(seed + k)
        columns = torch.randn(40, 3, generator=draw, dtype=torch.float64) @ torch.randn(3, 3, generator=draw).double()
        search = settle(found(columns, 1.5 * columns @ torch.rand(3, generator=draw).double()), SUPPORTED)
        least = search.options.naming.named_nats
        assert all(support(search.model.statistics, search.chosen, one) >= least for one in search.chosen), k
        left = {step.where[0] for step in search.trace if step.rule in ("unsupported", "negative")}
        assert left == set("abc") - {one.place.where[0] for one in search.chosen}, k


@pytest.mark.parametrize(
    ("softness", "kept"),
    [((3.0, 2.0, -5.0), (True, False)), ((3.0, 2.0, -1.0), (True, True)), ((-1.0, -0.5, -0.2), (False, False))],
)
def test_a_negative_spring_is_none(softness, kept):
    """All of them always; one of many, surely so, when nothing else goes any more."""
    search = springs(torch.tensor(softness).double(), 1e6)
    assert tuple(bool(rule(search).chosen) for rule in (drop_negative, drop_surely_negative)) == kept


def test_springs_that_cannot_be_negative_have_the_evidence_of_half_a_prior():
    """Each for itself: twice the normal prior on its upper side, by quadrature."""
    size = torch.randn(3, generator=torch.Generator().manual_seed(small.SEED), dtype=torch.float64)
    search = springs(size, 1.0)
    theta = torch.linspace(0.0, 12.0, 20001).double()
    weight = (2.0 / (2.0 * torch.pi) ** 0.5) * torch.exp(-0.5 * theta.square())
    likelihood = torch.exp(size[:, None] * theta - 0.5 * theta.square())
    exact = torch.trapezoid(weight * likelihood, theta).log().sum()
    found = gains(search.model.statistics, search.model.fit(), search.chosen)[0, 0]
    torch.testing.assert_close(found, exact, rtol=1e-6, atol=1e-6)


def springs(softness: torch.Tensor, scale: float) -> SearchResult:
    """Of three segments, each measured once with an error of one."""
    flesh, at = effect("skin_lag"), Place(("pelvis", "thigh_l", "thigh_r"))
    source = ColumnSource(flesh, at, slice(1, 4), (0.0,), flesh.scale(at))
    columns = torch.cat([torch.zeros(4, 1), torch.eye(4, 3)], 1).double()
    prior = Prior(torch.zeros(4).double(), torch.eye(1).double(), scale * torch.ones(3).double())
    moment = columns.T @ torch.cat([softness, torch.zeros(1).double()])
    raw = prior.standard(columns.T @ columns, moment, torch.arange(4))
    chosen = (Candidate(flesh, at, source, frozenset({0})),)
    model = model_of(Design(1, 1, (source,), chosen, ()), prior, Statistics(1, 4, (raw,)))
    return SearchResult(model, chosen, (), model.fit(chosen))


def test_what_shares_a_column_with_a_nuisance_adds_to_it():
    """The mean over a design's columns holds a plate's usual offset and the one that was found, both."""
    generator = torch.Generator().manual_seed(6)
    column = torch.randn(400, 1, generator=generator, dtype=torch.float64)
    unit = Prior(torch.zeros(1).double(), torch.zeros(0, 0).double(), torch.ones(1).double())
    raw = unit.standard(column.T @ column, column.T @ (9.0 * column[:, 0]), torch.arange(1))
    source = ColumnSource(effect("drag"), Place(("a",)), slice(0, 1), (0.0,), (1.0,))
    found = fit(Statistics(1, 1, (raw,)), [Candidate(effect("drag"), source.place, source, frozenset({0}))])
    assert float(found.z(1, 0)[0]) == pytest.approx(9.0, rel=0.01)


def test_columns_of_one_trial_are_nothing_in_the_others():
    """Sums over trials of which one alone has some columns are those of matrices with zeros in their place."""
    generator, n, shared = torch.Generator().manual_seed(7), 6, 3
    prior = Prior(torch.zeros(n).double(), torch.eye(1).double(), torch.ones(n - 1).double())
    lives, whole, trials = ([0, 1, 2, 3, 5], [0, 1, 2, 4]), [], []
    for live in lives:
        rows, right = torch.randn(40, n, generator=generator).double(), torch.randn(40, generator=generator).double()
        dense = torch.zeros_like(rows)
        dense[:, live] = rows[:, live]
        whole.append((dense.T @ dense, dense.T @ right))
        own = rows[:, live]
        trials.append(prior.standard(own.T @ own, own.T @ right, torch.tensor(live)))
    statistics = Statistics(shared, shared, tuple(trials))
    which = torch.tensor([1, 3, 4])
    for seen in (frozenset({0}), frozenset({1})):
        (k,) = seen
        torch.testing.assert_close(statistics.block(which, which, seen), whole[k][0][which][:, which])
        torch.testing.assert_close(statistics.moment(which, seen), whole[k][1][which])
    both = torch.tensor([2, 0])
    torch.testing.assert_close(
        statistics.block(slice(3), both, statistics.all), (whole[0][0] + whole[1][0])[:3][:, both]
    )
    less = trials[0].only(torch.tensor([0, 2, 4, 5]))
    assert less.live.tolist() == [0, 1, 3]
    torch.testing.assert_close(less.gram[:-1, :-1], whole[0][0][[0, 2, 5]][:, [0, 2, 5]])


def test_what_is_anew_in_every_trial_may_be_left_out_first():
    """Integrated out trial by trial or fitted jointly: the same evidence, the same mean, in every trial."""

    class Gust(type(effect("drag"))):
        per_trial = True

    gust, generator, n = Gust(), torch.Generator().manual_seed(8), 6
    prior = Prior(torch.zeros(n).double(), torch.eye(2).double(), torch.ones(n - 2).double())
    trials = []
    for live in ([0, 1, 2, 3, 4], [0, 1, 2, 3, 5]):
        rows, right = torch.randn(50, 5, generator=generator).double(), torch.randn(50, generator=generator).double()
        trials.append(prior.standard(rows.T @ rows, rows.T @ right, torch.tensor(live)))
    statistics, place = Statistics(3, 4, tuple(trials)), Place(("a",))
    one = Candidate(gust, place, ColumnSource(gust, place, slice(3, 4), (0.0,), gust.scale(place)), frozenset({0, 1}))
    less, rest = marginalise_per_trial(statistics, [one])
    jointly = fit(statistics, [one])
    assert not rest
    assert fit(less).log_evidence + less.constant == pytest.approx(jointly.log_evidence)
    for k, each in enumerate(trial_posteriors(statistics, [one])):
        torch.testing.assert_close(each.z(n), jointly.z(n, k))
