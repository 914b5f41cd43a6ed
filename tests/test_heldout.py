"""What held-out motion says of causes that fit trials named."""

import math

import pytest
import torch

from torchid.diagnosis.design import Candidate, Design, Source
from torchid.diagnosis.evidence import Prior, Sums, fit
from torchid.diagnosis.found import Search
from torchid.diagnosis.heldout import REFUTED, HeldOut
from torchid.diagnosis.noise import initial_noise
from torchid.diagnosis.search import open_candidates
from torchid.diagnosis.verdict import Alternative, Cause
from torchid.effects.catalogue import effect
from torchid.effects.effect import Interval, Place
from torchid.regressor.whitening import initial_whitening


class Told(HeldOut):
    """Two held-out trials of which everything is known already."""

    def __init__(self, names: str, gains: dict[str, float], promised: dict[str, float]) -> None:
        one = Source(effect("drag"), Place(("a",)), slice(0, 1), (0.0,), (1.0,))
        chosen = tuple(Candidate(effect("drag"), Place((name,)), one, frozenset({0})) for name in names)
        raw = Prior(torch.zeros(1).double(), torch.zeros(0, 0).double(), torch.ones(1).double()).standard(
            torch.eye(1).double(), torch.ones(1).double(), torch.arange(1)
        )
        sums, prior = Sums(1, 1, (raw,)), Prior(torch.zeros(1).double(), torch.zeros(0, 0), torch.ones(1))
        noise = initial_noise(initial_whitening(torch.ones(2)), 1)
        self.found = Search(Design(1, 1, (), (), ()), prior, noise, chosen, (), sums, fit(sums))
        self.trials, self.first, self.share = (None, None), 1, 0.5  # type: ignore[assignment]
        self.gains, self.promised = gains, promised

    def density(self, chosen):
        """Better by far: what a force does to held-out markers is none of its business."""
        return 1e3 * len(chosen) + self.of_forces(chosen)

    def of_forces(self, chosen):
        """Gains that add up."""
        return sum(self.gains[one.place.where[0]] for one in chosen)

    def _promised(self, chosen, one):
        return self.promised[one.place.where[0]]


def test_each_cause_is_refuted_by_its_own_measure():
    """Much contradiction of what promised much is borne, little of what promised nothing is not."""
    gains = {"a": -20.0, "b": -10.0, "c": 5.0, "d": 0.9 * -REFUTED}
    promised = {"a": 1250.0, "b": 2.0, "c": 3.0, "d": 0.0}
    told = Told("abcd", gains, promised)
    kept, refuted = told.upheld(told.found.chosen)
    assert [one.place.where[0] for one in kept] == ["a", "c", "d"]
    assert [(one.place.where[0], says) for one, says in refuted] == [("b", pytest.approx(-10.0))]


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


def test_a_swap_leaves_no_moved_markers():
    """Its remainder in its own trial; what lasts beyond that is another thing."""
    when = {k: Interval(k, 0.0, 1.0) for k in ("a", "b")}
    source = Source(effect("marker_shift"), Place(("LASI",)), slice(0, 3), (0.0,) * 3, (1.0,) * 3)

    def made(name: str, where: tuple[str, ...], trials: str) -> Candidate:
        place = Place(where, tuple(when[k] for k in trials))
        return Candidate(effect(name), place, source, frozenset("ab".index(k) for k in trials))

    swap = made("marker_swap", ("LASI", "LPSI"), "a")
    there, beyond = made("marker_shift", ("LASI",), "a"), made("marker_shift", ("LASI",), "ab")
    other = made("marker_shift", ("LKNE",), "a")
    design = Design(1, 1, (), (swap, there, beyond, other), ())
    assert open_candidates(design, [swap], 3) == [beyond, other]
    assert open_candidates(design, [other], 3) == [swap, there, beyond]
