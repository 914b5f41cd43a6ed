"""Statements of model-free checks as rows of the linear model, and what sound sessions seem to have of an effect."""

import math

import numpy as np
import pytest
import torch
from batteries.apparent import measured
from draws import seed_of
from harness.command import ROOT
from harness.rows import read_lines
from rates import at_least

from torchid.diagnosis.candidates.candidate import Candidate, ColumnSource
from torchid.diagnosis.evidence.apparent import SHARES, SIZES, apparent_evidence
from torchid.diagnosis.evidence.gains import gains
from torchid.diagnosis.evidence.other_proof import told_nats
from torchid.diagnosis.evidence.posterior import fit
from torchid.diagnosis.evidence.prior import Prior
from torchid.diagnosis.evidence.statistics import Statistics
from torchid.diagnosis.options import NamingOptions
from torchid.diagnosis.search.scan import scan_all
from torchid.effects.catalogue import CATALOGUE, effect
from torchid.effects.place import SESSION
from torchid.effects.traits import Proof
from torchid.observation.statements import Statements

SEED = seed_of(__name__)
DRAWS, RATE = 40, 0.95
"""Draws, and the share of them in which a clock that statements deny is not named, and one that they bear out is."""
PRECISE = 1e4
"""Information of the rows of forces: they are sure, of what is there or of what looks like it."""


def candidate(name: str = "time_offset") -> Candidate:
    """An effect of the session in the only column behind that of the inertia."""
    own = effect(name)
    return Candidate(own, SESSION, ColumnSource(own, SESSION, slice(1, 2), (0.0,), own.scale(SESSION)), frozenset({0}))


def statistics(size: float, said: float | None = None, sd: float = 0.2) -> Statistics:
    """One trial whose rows of forces show a size in units of the prior, and a statement of it with its deviation."""
    gram, moment = torch.zeros(2, 2).double(), torch.zeros(2).double()
    gram[1, 1], moment[1] = PRECISE, PRECISE * size
    stated = None
    if said is not None:
        stated = Statements(
            torch.tensor([1]), torch.full((1, 1), sd**-2).double(), torch.tensor([said / sd**2]).double()
        )
        gram[1, 1] += stated.gram[0, 0]
        moment[1] += stated.moment[0]
    unit = Prior(torch.zeros(2).double(), torch.eye(1).double(), torch.ones(1).double())
    raw = unit.standard(gram, moment, torch.arange(2))
    return Statistics(1, 2, (raw if stated is None else raw.__class__(raw.live, raw.gram, raw.moment, stated),))


def named(size: float, said: float | None = None) -> bool:
    """Whether a clock of such a size is named."""
    found = scan_all(statistics(size, said), [candidate()], [], NamingOptions()).round
    return found.named is not None and not found.ordinary


def test_the_appearance_is_the_mixture_by_quadrature():
    """Normal sizes of each spread, in their shares, integrated numerically."""
    own, size = candidate(), 0.4
    found = statistics(size)
    shares = [(1.0 - own.effect.mistaken) * share for share in SHARES] + [own.effect.mistaken]
    theta = torch.linspace(-8.0, 8.0, 400_001, dtype=torch.float64)
    likelihood = PRECISE * (size * theta - 0.5 * theta.square())
    total = [0.0 + math.log(shares[0])]
    for share, spread in zip(shares[1:], SIZES[1:], strict=True):
        prior = -0.5 * (theta / spread).square() - math.log(spread * math.sqrt(2.0 * math.pi))
        total.append(
            math.log(share) + float(torch.logsumexp(likelihood + prior, 0)) + math.log(float(theta[1] - theta[0]))
        )
    exact = float(torch.logsumexp(torch.tensor(total, dtype=torch.float64), 0))
    assert sum(shares) == pytest.approx(1.0)
    assert apparent_evidence(found, fit(found), [own])[0] == pytest.approx(exact, abs=1e-3)


def test_rows_of_forces_alone_say_no_more_than_sound_sessions_allow():
    """However sure they are, the evidence beyond the appearance ends at the share of sessions that seem to have as
    much."""
    own = candidate()
    for size in (1.0, 2.0, 4.0):
        found = statistics(size)
        beyond = float(gains(found, fit(found), [own])[0, 0]) - apparent_evidence(found, fit(found), [own])[0]
        assert 0.0 < beyond <= -math.log(own.effect.mistaken) + 1e-9


def test_statements_decide():
    """What they bear out is named, what they deny is not, and neither is what sound sessions have."""
    rng = np.random.default_rng(SEED)
    sizes = rng.choice([-1.0, 1.0], DRAWS) * rng.uniform(1.0, 2.0, DRAWS)
    said = rng.normal(0.0, 0.2, DRAWS)
    borne_out = sum(named(size, size + own) for size, own in zip(sizes, said, strict=True))
    denied = sum(not named(size, own) for size, own in zip(sizes, said, strict=True))
    small = sum(not named(0.1 * size, 0.1 * size + own) for size, own in zip(sizes, said, strict=True))
    assert min(borne_out, denied, small) >= at_least(RATE, DRAWS), (borne_out, denied, small)


def test_statements_of_one_design_are_those_of_its_columns_in_a_narrower_one():
    rng = torch.Generator().manual_seed(SEED % 2**31)
    X, Y = (torch.randn(6, 3, generator=rng, dtype=torch.float64) for _ in range(2))
    first = Statements(torch.tensor([1, 4, 6]), X.T @ X, X.T @ X[:, 0])
    other = Statements(torch.tensor([4, 5, 6]), Y.T @ Y, Y.T @ Y[:, 0])
    both = first + other
    assert both.columns.tolist() == [1, 4, 5, 6]
    torch.testing.assert_close(both.gram[1, 3], first.gram[1, 2] + other.gram[0, 2])
    less = both.only(torch.tensor([0, 1, 5, 6]))
    assert less.columns.tolist() == [1, 2, 3]
    torch.testing.assert_close(less.gram, both.gram[[0, 2, 3]][:, [0, 2, 3]])
    torch.testing.assert_close(less.moment, both.moment[[0, 2, 3]])


def test_other_proof_speaks_for_what_it_bears_out_and_against_what_it_does_not():
    """Of effects that it can see; none where it was not asked."""
    own = candidate("filter_lag")
    proof = own.effect.proof
    assert proof is Proof.SMOOTHNESS
    said = [told_nats({proof: lambda _, x=x: x}, own) for x in (-math.inf, -3.0, 0.0, 3.0, math.inf)]
    assert said == sorted(said) and said[0] < -1.0 and said[-1] > 3.0
    assert told_nats({}, own) == told_nats({Proof.DISTANCES: lambda _: math.inf}, own) == 0.0


def test_appearances_are_those_that_were_measured():
    """On the sessions that the command keeps, to the digits that stand in the code."""
    common, each = measured(read_lines(ROOT / "scripts" / "batteries" / "apparent.jsonl"))
    np.testing.assert_allclose(SHARES, common[:-1] / common[:-1].sum(), atol=0.006)
    assert {name for name, one in CATALOGUE.items() if one.mistaken > 0.0 and not one.bodily} == each.keys()
    for name, own in each.items():
        assert effect(name).mistaken == pytest.approx(own[-1], abs=0.015), name
