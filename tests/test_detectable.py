"""Sizes that a session would have shown: planted again and again, they are named as often as is claimed."""

import math
from dataclasses import replace

import pytest
import torch
from rates import at_least

from torchid.diagnosis.candidates.candidate import Candidate, ColumnSource
from torchid.diagnosis.evidence.adequacy import Adequacy
from torchid.diagnosis.evidence.detectable import Detectable, detectable, extremes
from torchid.diagnosis.evidence.planted_rules import CHANCE
from torchid.diagnosis.evidence.prior import Prior
from torchid.diagnosis.evidence.statistics import Statistics, TrialStatistics
from torchid.diagnosis.options import NamingOptions
from torchid.diagnosis.search.scan import scan_all
from torchid.diagnosis.testing.heldout import Errors
from torchid.diagnosis.verdict.records import Diagnosis
from torchid.diagnosis.verdict.table import verdict_table
from torchid.effects.catalogue import effect
from torchid.effects.effect import Effect
from torchid.effects.place import SESSION, Place
from torchid.observation.statements import Statements

DRAWS, BAND, HALF = 100, 0.1, 0.45
"""Sessions drawn for each size; how far the share that is named may lie from ``CHANCE``; the share at half the size."""
NUISANCES, TRIALS, ROWS, STATED = 3, 2, 60, 20
NAMING = NamingOptions()
PLATES = Place(("plate_1",)), Place(("plate_2",))
CASES = [
    ("time_offset", (SESSION,), 3.0, 0.6, "lag_s"),
    ("plate_gain", PLATES, 1.0, 0.0, "gain"),
    ("plate_offset", PLATES[:1], 1.0, 1.0, "force_plate_N"),
    ("drag", (Place(("pelvis",)), Place(("thorax",))), 0.5, 0.2, "coefficient_Ns_m"),
]
"""Effects and places, how much rows of forces and statements hold of them, and the parameter that is planted."""


class Bench:
    """Sessions of one make: nuisances, and an effect with columns of its own at each place, in rows and statements."""

    def __init__(self, own: Effect, places: tuple[Place, ...], forces: float, stated: float, seed: int) -> None:
        self.lot, size = torch.Generator().manual_seed(seed), own.size(places[0])
        self.width = NUISANCES + size * len(places)
        sources = [slice(NUISANCES + k * size, NUISANCES + (k + 1) * size) for k in range(len(places))]
        self.candidates = [
            Candidate(
                own, p, ColumnSource(own, p, s, (0.0,) * size, own.scale(p)), frozenset(range(TRIALS)), 1 / len(places)
            )
            for p, s in zip(places, sources, strict=True)
        ]
        columns = self.normal(TRIALS, ROWS + STATED, self.width)
        columns[:, :ROWS, NUISANCES:] *= forces
        columns[:, ROWS:, NUISANCES:] *= stated / math.sqrt(STATED)
        columns[:, ROWS:, :NUISANCES] = 0.0
        self.columns = columns

    def normal(self, *shape: int) -> torch.Tensor:
        """By lot."""
        return torch.randn(*shape, generator=self.lot, dtype=torch.float64)

    def statistics(self, z: torch.Tensor) -> Statistics:
        """A session with such parameters, in units of their priors, nuisances by lot."""
        z = torch.cat([self.normal(NUISANCES), z])
        every, trials = torch.arange(self.width), []
        unit = Prior(
            torch.zeros(self.width).double(), torch.eye(NUISANCES).double(), torch.ones(self.width - NUISANCES).double()
        )
        for Y in self.columns:
            rows = Y @ z + self.normal(len(Y))
            raw, said = unit.standard(Y.T @ Y, Y.T @ rows, every), Y[ROWS:, NUISANCES:]
            stated = Statements(every[NUISANCES:], said.T @ said, said.T @ rows[ROWS:])
            trials.append(TrialStatistics(raw.live, raw.gram, raw.moment, stated))
        return Statistics(NUISANCES, self.width, tuple(trials))

    def planted(self, key: str, size: float) -> torch.Tensor:
        """The first place's parameters with one key of a size in a direction by lot, in units of their priors."""
        own, place, at = self.candidates[0].effect, self.candidates[0].place, 0
        found = torch.zeros(self.width - NUISANCES).double()
        for one in own.parameters:
            if one.key == key:
                drawn = self.normal(one.size)
                drawn = drawn.abs() if at < own.positives(place) else drawn
                found[at : at + one.size] = size / one.scale * drawn / drawn.norm()
            at += one.size
        return found

    def share(self, key: str, size: float) -> int:
        """Number of sessions in which it is named."""
        rounds = [
            scan_all(self.statistics(self.planted(key, size)), self.candidates, (), NamingOptions()).round
            for _ in range(DRAWS)
        ]
        return sum(r.named is not None and not r.ordinary for r in rounds)

    def sizes(self) -> tuple[Detectable, ...]:
        """What a session with nothing in it would have shown."""
        nothing = torch.zeros(self.width - NUISANCES).double()
        return detectable(self.statistics(nothing), (), self.candidates, NAMING)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "places", "forces", "stated", "key"), CASES)
def test_what_is_stated_is_named_as_often_as_claimed(seed, name, places, forces, stated, key):
    """At the stated size four times in five, at half of it seldom."""
    bench = Bench(effect(name), places, forces, stated, seed)
    size = next(one.size for one in bench.sizes() if one.key == key and one.where == places[0].where)
    assert size is not None
    whole, half = bench.share(key, size), bench.share(key, 0.5 * size)
    most = DRAWS - at_least(1.0 - CHANCE - BAND, DRAWS)
    assert at_least(CHANCE - BAND, DRAWS) <= whole <= most, whole
    assert half <= DRAWS - at_least(1.0 - HALF, DRAWS), half


def test_what_only_looks_like_it_can_tell_is_not_testable(seed):
    """Of a clock, rows of forces alone say nothing that sound sessions do not seem to have: no size is stated."""
    sure = Bench(effect("time_offset"), (SESSION,), 100.0, 0.0, seed)
    assert [one.size for one in sure.sizes()] == [None]
    blind = Bench(effect("drag"), (Place(("pelvis",)),), 1e-3, 0.0, seed)
    assert [one.size for one in blind.sizes()] == [None]


def test_what_another_effect_explains_as_well_is_not_testable(seed):
    """All plates that read too much are a body heavier than recorded: columns as good as the same leave no size."""
    one, nothing = Bench(effect("body_mass"), (SESSION,), 3.0, 3.0, seed), torch.zeros(1).double()
    (own,), alone = one.candidates, one.sizes()[0].size
    gain, plates = effect("plate_gain"), Place(("plate_1", "plate_2"))
    other = Candidate(
        gain, plates, ColumnSource(gain, plates, own.source.columns, (0.0,), gain.scale(plates)), own.trials
    )
    both = detectable(one.statistics(nothing), (), (own, other), NAMING)
    assert alone is not None and [found.size for found in both] == [None, None]
    (against,) = detectable(one.statistics(nothing), (), (own,), NAMING, rivals=(other,))
    assert against == both[0], "what is not asked about itself competes as well"


def test_more_rows_show_smaller_sizes(seed):
    """Sizes fall as the noise does; the same session has the same sizes, bit by bit."""
    found = [Bench(effect("plate_gain"), (Place(("plate_1",)),), k, k, seed).sizes()[0].size for k in (0.5, 1.0, 2.0)]
    assert found[0] > 1.5 * found[1] > 2.0 * found[2]
    again = Bench(effect("plate_gain"), (Place(("plate_1",)),), 1.0, 1.0, seed).sizes()[0].size
    assert again == found[1]


def test_without_candidates_nothing_is_stated(seed):
    """Nor where all that is left acts in no trial."""
    one = Bench(effect("drag"), (Place(("pelvis",)),), 1.0, 1.0, seed)
    statistics = one.statistics(torch.zeros(1).double())
    nowhere = replace(one.candidates[0], trials=frozenset())
    assert detectable(statistics, (), (), NAMING) == detectable(statistics, (), (nowhere,), NAMING) == ()


@pytest.mark.parametrize(
    "name", ["marker_swap", "plate_assignment", "moving_ground", "unmeasured_contact", "marker_shift", "filter_lag"]
)
def test_effects_without_one_size_are_left_out(name):
    """What comes and goes, is there or not, is other in every trial, or hangs on other proof."""
    drag = Bench(effect("drag"), (Place(("pelvis",)),), 1.0, 1.0, 0)
    own = effect(name)
    other = Candidate(own, SESSION, drag.candidates[0].source, frozenset({0}))
    nothing = torch.zeros(drag.width - NUISANCES).double()
    found = detectable(drag.statistics(nothing), (), [other, *drag.candidates], NAMING)
    assert [one.effect for one in found] == ["drag"]


def test_the_table_has_a_size_with_its_unit_or_why_there_is_none():
    """And what to record instead."""
    name, none, rest = "plate_gain", Errors(math.nan, math.nan), Adequacy(False, 0.4, 0.1, "")
    some = (Detectable("time_offset", ("session",), "lag_s", 0.009), Detectable(name, ("plate_1",), "gain", None))
    first, second = verdict_table(Diagnosis((), none, none, (), rest, detectable=some))["detectable"]
    assert first == {"effect": "time_offset", "where": ("session",), "parameter": "lag_s", "size": 0.009, "unit": "s",
                     "power": CHANCE}  # fmt: skip
    assert second["record"] == effect(name).advice and second["why"] and "size" not in second


def test_of_many_places_the_least_and_the_largest_are_told():
    """Of segments; of plates all are. What is not testable comes last, a place at its best frequency counts."""
    sizes = {"head": 3.0, "pelvis": None, "thorax": 1.0}
    body = [Detectable("drag", (name,), "coefficient_Ns_m", size) for name, size in sizes.items()]
    slower = Detectable("drag", ("thorax",), "coefficient_Ns_m", None)
    plates = [Detectable("plate_gain", (f"plate_{k}",), "gain", 0.01 * k) for k in (2, 1, 3)]
    found = extremes([*body, slower, *plates])
    assert found == (*plates, body[2], body[1])
