"""What held-out motion says of causes that fit trials named."""

import math
from dataclasses import replace

import pytest
import torch
from models import model_of

from torchid.diagnosis.candidates.candidate import Candidate, ColumnSource
from torchid.diagnosis.columns.design import Design
from torchid.diagnosis.evidence.prior import Prior
from torchid.diagnosis.evidence.statistics import Statistics
from torchid.diagnosis.options import DiagnosisOptions
from torchid.diagnosis.search.result import SearchResult, support
from torchid.diagnosis.search.still_open import open_candidates
from torchid.diagnosis.testing import refutation
from torchid.diagnosis.testing.heldout import HeldOut
from torchid.diagnosis.testing.refutation import HeldOutScores, _leeway, refute, uphold
from torchid.diagnosis.verdict.records import Alternative, Cause
from torchid.effects.catalogue import effect
from torchid.effects.place import Interval, Place

OPTIONS = DiagnosisOptions()
REFUTED = OPTIONS.heldout.refuted_nats


class Told(HeldOut):
    """Two held-out trials of which everything is known already."""

    def __init__(self, names: str, gains: dict[str, float], worse: str = "") -> None:
        chosen = tuple(Candidate(effect("drag"), Place((name,)), ONE, frozenset({0})) for name in names)
        prior = Prior(torch.zeros(1).double(), torch.zeros(0, 0).double(), torch.ones(1).double())
        raw = prior.standard(torch.eye(1).double(), torch.ones(1).double(), torch.arange(1))
        model = model_of(Design(1, 1, (), (), ()), prior, Statistics(1, 1, (raw,)))
        self.found = SearchResult(model, chosen, (), model.fit(), OPTIONS)
        self.trials, self.first, self.share = (None, None), 1, 0.5  # type: ignore[assignment]
        self.gains, self.worse = gains, worse

    def log_errors(self, chosen):
        """Forces and moments that err by a tenth more for some."""
        return torch.full((2,), 0.1 * sum(one.place.where[0] in self.worse for one in chosen))

    def density(self, chosen):
        """Better by far: what a force does to held-out markers is none of its business."""
        return 1e3 * len(chosen) + self.density_of_forces(chosen)

    def density_of_forces(self, chosen):
        """Gains that add up."""
        return sum((self.gains[one.place.where[0]] for one in chosen), 0.0)


ONE = ColumnSource(effect("drag"), Place(("a",)), slice(0, 1), (0.0,), (1.0,))


def names_of(some) -> list[str]:
    """Where effects sit."""
    return [one.place.where[0] for one in some]


@pytest.mark.parametrize(
    ("nats", "leeway", "growth", "said"),
    [
        ((-20.0, -10.0, 5.0), (50.0, 2.0, 2.4), (0.0, 0.0, 0.0), (1, "heldout_density")),
        ((-20.0, 0.9 * -REFUTED), (50.0, 0.0), (0.0, 0.0), None),
        ((6.6, 5.0), (0.0, 0.0), (0.1, 0.0), (0, "heldout_errors")),
        ((50.0, -2.0), (0.0, 0.0), (0.09, 0.26), (1, "heldout_errors")),
        ((6.6, -30.0), (0.0, 0.0), (0.1, 0.04), (0, "heldout_errors")),
        ((), (), (), None),
    ],
)
def test_numbers_alone_refute_a_cause(nats, leeway, growth, said):
    """Much contradiction of what promised much is borne, little of what promised nothing is not; errors come first, and
    of two that make forces err more the less likely goes: the other may be right without it."""
    found = refute(HeldOutScores(nats, leeway, growth), OPTIONS.heldout)
    assert said == (None if found is None else (found.index, found.rule))
    assert found is None or found.numbers["heldout_nats"] == nats[found.index]


@pytest.mark.parametrize(
    ("name", "spared"), [("drag", False), ("body_mass", True), ("moving_ground", True), ("soft_tissue", True)]
)
def test_forces_that_err_more_refute_what_is_no_less_likely(monkeypatch, name, spared):
    """Inertia that fit trials did not tell would make up for anything; not of what it takes on anyway, of what is anew
    in every trial, or of what cameras saw."""
    told = Told("ab", {"a": 6.6, "b": 5.0}, worse="a")
    monkeypatch.setattr(refutation, "support", lambda statistics, some, one: 30.0)
    first, second = told.found.chosen
    upheld = uphold(told, (replace(first, effect=effect(name)), second), OPTIONS.heldout)
    assert names_of(upheld.chosen) == (["a", "b"] if spared else ["b"])
    assert [(step.kind, step.rule) for step in upheld.trace] == ([] if spared else [("refuse", "heldout_errors")])


@pytest.mark.parametrize("name, leeway", [("marker_swap", 10.0), ("drag", 0.0)])
def test_what_cameras_saw_elsewhere_may_cost_a_part_of_what_it_told(name, leeway):
    """Held-out motion may have liked the geometry better that a swap had bent; a force has no such excuse."""
    unit = Prior(torch.zeros(1).double(), torch.zeros(0, 0).double(), torch.ones(1).double())
    raw = unit.standard(torch.eye(1).double(), torch.full((1,), 20.0).double(), torch.arange(1))
    source = ColumnSource(effect(name), Place(("a",)), slice(0, 1), (0.0,), (1.0,))
    here, everywhere = (Candidate(effect(name), source.place, source, frozenset(some)) for some in ({0}, {0, 1}))
    told = HeldOut.__new__(HeldOut)
    statistics = Statistics(0, 1, (raw, raw))
    model = model_of(Design(0, 0, (), (), ()), unit, statistics)
    told.found = SearchResult(model, (here,), (), model.fit())
    told.share = 0.5
    # Of a column of unit prior with a moment b: b^2 / 4 - log(2) / 2.
    assert _leeway(told, [here], here, OPTIONS.heldout) == pytest.approx(leeway, abs=0.05)
    promised = 0.0 if name == "drag" else 0.5 * support(statistics, [everywhere], everywhere)
    assert _leeway(told, [everywhere], everywhere, OPTIONS.heldout) == pytest.approx(math.sqrt(2.0 * promised))


def test_what_lasts_lasts_all_of_a_recording():
    """A marker's shift covers trials whole, however little of them was searched; others keep their intervals."""
    when = (Interval("walk", 10.0, 50.0),)
    for name, shown in (("marker_shift", (-math.inf, math.inf)), ("marker_swap", (10.0, 50.0))):
        place = Place(("LASI", "RASI"), when)
        rivals: tuple[Alternative, ...] = ()
        cause = Cause(name, place.where, when, {}, 1.0, rivals, rivals, {}, place, torch.zeros(1, 3), ("walk",), False)
        planted = cause.on("walk")
        assert planted is not None and planted.place.when is not None
        assert [(w.t0, w.t1) for w in planted.place.when] == [shown]
        assert cause.on("run") is None


def test_a_wrong_record_is_named_beside_as_many_forces_as_may_be():
    """It stands in nobody's way, and nothing in its."""
    source = ColumnSource(effect("drag"), Place(("session",)), slice(0, 1), (0.0,), (1.0,))
    names = ("drag", "tether", "time_offset", "gravity_tilt", "body_mass")
    made = [Candidate(effect(name), source.place, source, frozenset({0})) for name in names]
    design = Design(1, 1, (), tuple(made), ())
    assert open_candidates(design, made[:3], 3) == [made[4]]
    assert open_candidates(design, [*made[:2], made[4]], 3) == made[2:4]
