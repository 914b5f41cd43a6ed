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
from torchid.diagnosis.search.result import SearchResult
from torchid.diagnosis.search.still_open import open_candidates
from torchid.diagnosis.testing import refutation
from torchid.diagnosis.testing.heldout import HeldOut
from torchid.diagnosis.testing.refutation import HeldOutScore, uphold
from torchid.diagnosis.verdict.records import Alternative, Cause
from torchid.effects.catalogue import effect
from torchid.effects.place import Interval, Place

OPTIONS = DiagnosisOptions()


class Told(HeldOut):
    """Two held-out trials of which everything is known already."""

    def __init__(self, names: str, gains: dict[str, float]) -> None:
        chosen = tuple(Candidate(effect("drag"), Place((name,)), ONE, frozenset({0})) for name in names)
        prior = Prior(torch.zeros(1).double(), torch.zeros(0, 0).double(), torch.ones(1).double())
        raw = prior.standard(torch.eye(1).double(), torch.ones(1).double(), torch.arange(1))
        model = model_of(Design(1, 1, (), (), ()), prior, Statistics(1, 1, (raw,)))
        self.found = SearchResult(model, chosen, (), model.fit(), OPTIONS)
        self.trials, self.first = (None, None), 1  # type: ignore[assignment]
        self.gains = gains

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
    ("evidence", "heldout", "total"),
    [
        (30.0, 5.0, 35.0),
        (60.0, -5.9, 54.1),  # a tenth may be lost
        (60.0, -6.1, -6.1),
        (9.0, -2.9, 6.1),  # three nats may be lost in any case, and count
        (9.0, -3.1, -3.1),
        (4.0, 0.0, 4.0),
    ],
)
def test_held_out_motion_is_one_more_trial(evidence, heldout, total):
    """What it says is added; where it says the contrary, it is believed."""
    assert HeldOutScore(evidence, heldout).total(OPTIONS.naming) == pytest.approx(total)


def test_causes_that_all_trials_together_do_not_support_leave(monkeypatch):
    """The least supported first, as long as there is one; the density of forces alone is asked of forces."""
    monkeypatch.setattr(refutation, "support", lambda statistics, some, one: 30.0)
    told = Told("abc", {"a": 6.6, "b": -30.0, "c": -2.0})
    upheld = uphold(told, told.found.chosen, OPTIONS.naming)
    assert names_of(upheld.chosen) == ["a", "c"] and names_of(one for one, _ in upheld.refuted) == ["b"]
    assert [(step.kind, step.rule) for step in upheld.trace] == [("refuse", "heldout_density")]
    assert upheld.trace[0].numbers == {"evidence_nats": 30.0, "heldout_nats": -30.0, "least_nats": 2.5}
    ordinary = [replace(one, ordinary=True) for one in told.found.chosen]
    silent = uphold(told, ordinary, OPTIONS.naming)
    assert names_of(silent.chosen) == ["a", "c"] and not silent.refuted and not silent.trace


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
