"""Rivals of a cause: what could stand for it, and what could not."""

import math
from dataclasses import replace

import pytest
import torch
from test_doubtful import found as searched
from torch.testing import assert_close

from torchid.diagnosis.candidates.candidate import Candidate, ColumnSource
from torchid.diagnosis.evidence.adequacy import Adequacy
from torchid.diagnosis.evidence.prior import Prior
from torchid.diagnosis.evidence.statistics import Statistics
from torchid.diagnosis.options import NamingOptions
from torchid.diagnosis.search import believed
from torchid.diagnosis.search.estimates import estimate
from torchid.diagnosis.search.result import reduced
from torchid.diagnosis.search.rivals import Rival, Round
from torchid.diagnosis.search.scan import scan_all
from torchid.diagnosis.verdict.causes import cause_of
from torchid.effects.catalogue import effect
from torchid.effects.place import Place
from torchid.effects.session import SESSION

TRIALS = 2
NAMING = NamingOptions()


def scanned(columns: torch.Tensor, rows: torch.Tensor, widths: list[float], name: str = "drag") -> Round:
    """An effect at one place after the other, with priors of these widths, fitted to trials of the same rows."""
    own, n = effect(name), columns.shape[1]
    size = n // len(widths)
    some = []
    for k, width in enumerate(widths):
        place = Place((f"place {k}",))
        source = ColumnSource(own, place, slice(size * k, size * (k + 1)), (0.0,) * size, own.scale(place))
        some.append(Candidate(own, place, source, frozenset(range(TRIALS)), widened=width))
    prior = Prior(torch.zeros(n).double(), torch.eye(0).double(), torch.ones(n).double())
    raw = prior.standard(columns.T @ columns, columns.T @ rows, torch.arange(n))
    return scan_all(Statistics(0, n, (raw,) * TRIALS), some, (), NAMING).round


def by_place(rivals: tuple[Rival, ...]) -> list[Rival]:
    """Not the best first."""
    return sorted(rivals, key=lambda rival: rival.candidate.place.where)


def apart(seed: int, n: int) -> torch.Tensor:
    """Columns of unit variance that have nothing in common."""
    generator = torch.Generator().manual_seed(seed)
    return torch.linalg.qr(torch.randn(400, n, generator=generator, dtype=torch.float64)).Q * 20.0


@pytest.mark.parametrize("size", [0.3, 1.0])
def test_the_width_of_a_prior_names_no_cause(size):
    """Of two that explain alike, the evidence prefers that of the narrow prior; nobody may be sure of it."""
    column, noise = apart(3, 2).T
    round_ = scanned(torch.stack([column, column], 1), size * column + 0.01 * noise, [1.0, 16.0])
    narrow, wide = by_place(round_.rivals)
    assert narrow.score - wide.score > 2.0
    narrow, wide = by_place(round_.compared)
    assert abs(narrow.alike - wide.alike) < 1.0 and abs(narrow.likely - wide.likely) < 1.0


@pytest.mark.parametrize("alike", [True, False])
def test_what_is_there_too_makes_no_name_doubtful(alike):
    """Two that are both there explain as much as each other, and neither can stand for the other."""
    one, other, _ = apart(4, 3).T
    second = one + 0.02 * other if alike else other
    round_ = scanned(torch.stack([one, second], 1), one + 0.998 * second, [1.0, 1.0])
    assert min(r.score for r in round_.rivals) > NAMING.named_nats
    best, rival = by_place(round_.compared)
    assert (abs(rival.alike - best.alike) < NAMING.alike_nats) == alike
    assert (rival.likely > best.likely - NAMING.alike_nats) == alike


def test_what_is_strewn_keeps_its_prior():
    """Of a marker that was moved, what is small is ordinary: it earns nothing by being small."""
    columns = apart(5, 9)
    round_ = scanned(columns, columns @ torch.tensor([1.0, 0.5, 0.2] + [0.05] * 6).double(), [1.0] * 3, "marker_shift")
    assert round_.named is not None and round_.compared == round_.rivals


def test_a_rival_counts_as_unlikely_as_its_place_is():
    """What it adds beside the best counts where it would be believed."""
    candidate = searched(torch.eye(3).double(), torch.ones(3).double()).chosen[0]
    rival = Rival(replace(candidate, odds=1e-3), 11.0, 11.0, 11.0, beside=5.0)
    odds = math.log(1e-3 * NAMING.effect_odds)
    assert rival.alike == pytest.approx(6.0) and rival.likely == pytest.approx(11.0 + odds)
    assert replace(rival, beside=20.0).likely == pytest.approx(-9.0)


def session_search():
    """Three effects, two of them of the session."""
    search = searched(torch.eye(3).double(), torch.ones(3).double())
    names = ("drag", "time_offset", "marker_scale")
    pairs = zip(search.chosen, names, strict=True)
    own = [replace(c, effect=effect(n), place=c.place if n == "drag" else SESSION) for c, n in pairs]
    return replace(search, chosen=tuple(own))


def round_of(*rivals: tuple[Candidate, float, float]) -> Round:
    """Candidates with their scores by which they are named, and those by which they are told apart."""
    strict = tuple(Rival(c, x, x, x) for c, x, _ in rivals)
    compared = tuple(Rival(c, y, y, y) for c, _, y in rivals)
    names = [r.candidate.effect.name for r in strict]
    return Round(strict, dict.fromkeys(names, 9.0), compared=compared)


@pytest.mark.parametrize(("lead", "twin"), [(-1.0, True), (2.0, True), (6.0, False), (-6.0, False)])
def test_a_rival_that_is_likelier_by_far_is_no_twin(lead, twin):
    """The wrong name must not borrow the confidence of the right one."""
    search = session_search()
    drag, clock, _ = search.chosen
    rounds = (round_of((drag, 12.0, 12.0), (clock, 11.0, 12.0 + lead)),)
    said = cause_of(replace(search, rounds=rounds), 0, {}, ("a", "b"))
    own = 1.0 / (1.0 + math.exp(lead))
    assert [t.effect for t in said.indistinguishable] == ["time_offset"] * twin
    assert said.confidence == pytest.approx(1.0 if twin else own, abs=1e-3)
    assert said.scaled(0.5).confidence == pytest.approx(0.5 * said.confidence)
    assert [t.confidence for t in said.scaled(0.5).indistinguishable] == [
        0.5 * t.confidence for t in said.indistinguishable
    ]


@pytest.mark.parametrize("lead", [0.0, 6.0])
def test_a_twin_is_told_with_its_size(lead):
    """As the model has it that has the twin instead; a likelier rival is none."""
    search = searched(torch.eye(3).double(), torch.tensor([3.0, 2.0, 1.0]).double())
    own, other, third = search.chosen
    rounds = [round_of((own, 12.0, 12.0), (other, 11.0, 12.0 - lead)), round_of((third, 9.0, 9.0))]
    found = reduced(search.model, [own, third], rounds, search.options, ())
    said = cause_of(found, 0, {}, ("a", "b"))
    assert len(found.twins) == len(said.indistinguishable) == (lead == 0.0)
    for twin in said.indistinguishable:
        assert twin.where == twin.place.where == other.place.where
        (key,) = twin.parameters
        chosen = (*found.twins, found.chosen[1])
        wanted = estimate(found.having(chosen), 0)[key]
        assert_close((twin.parameters[key]["value"], twin.parameters[key]["sd"]), wanted)


def test_causes_of_the_session_are_not_taken_for_each_other():
    """They share their place: each has the rivals of its own round."""
    search = session_search()
    _, clock, scale = search.chosen
    rounds = [round_of((clock, 30.0, 30.0), (scale, 10.0, 10.0)), round_of((scale, 12.0, 12.0))]
    said = cause_of(replace(search, rounds=tuple(rounds)), 2, {}, ("a", "b"))
    assert said.effect == "marker_scale" and said.confidence == pytest.approx(1.0, abs=1e-3)
    assert not said.indistinguishable


def test_what_all_places_have_and_what_sound_sessions_have_are_not_both_taken_off():
    """Of a marker that moved far, evidence beyond the likelier of the two is what it is beyond its appearance."""
    columns = apart(7, 27)
    sizes = torch.tensor([2.0] * 3 + [0.05] * 24).double()
    round_ = scanned(columns, columns @ sizes, [1.0] * 9, "marker_shift")
    best = round_.rivals[0]
    beyond = best.evidence - best.ordinary - (round_.appearance - math.log(best.candidate.odds))
    assert best.ordinary > 10.0 and 0.0 < beyond <= -math.log(best.candidate.effect.mistaken) + 1e-9


@pytest.mark.parametrize(
    ("nats", "left", "limit", "named"),
    [
        (9.0, 0.3, 4, True),
        (4.0, 0.5, 4, False),  # chance
        (9.0, 0.005, 4, True),  # hardly more than noise
        (9.0, 1e-9, 4, False),  # bodies leave as much
        (9.0, math.nan, 4, False),
        (9.0, 0.3, 1, False),  # another force is named
    ],
)
def test_what_is_ordinary_is_named_where_it_leaves_nothing_but_noise(monkeypatch, nats, left, limit, named):
    """No body imitates an effect where columns know all that the plates read."""
    search = session_search()
    first, clock, scale = search.chosen
    rounds = (replace(round_of((clock, 30.0, 30.0), (scale, 10.0, 10.0)), appearance=29.0),)
    found = replace(search, chosen=(first, replace(clock, ordinary=True), scale), rounds=rounds)
    share = 0.9 if left < 1e-6 else 0.3
    rest = Adequacy(share > found.options.adequacy.band_part, left, share, "")
    monkeypatch.setattr(believed, "support", lambda statistics, chosen, one: nats)
    monkeypatch.setattr(believed, "residuals", lambda observed, model, posterior: ())
    monkeypatch.setattr(believed, "assess_adequacy", lambda observed, left, options: rest)
    after = believed.believed(found, (), limit)
    assert [one.ordinary for one in after.chosen] == [False, not named, False]
    assert [(s.rule, s.effect) for s in after.trace] == ([("nothing_left", "time_offset")] if named else [])
    assert cause_of(after, 1, {}, ("a", "b")).confidence == pytest.approx(1.0 if named else 0.0, abs=0.3)


@pytest.mark.parametrize(("left", "sure"), [(0.3, True), (1e-9, False)])
def test_what_was_named_is_not_doubted_for_its_appearance_where_nothing_but_noise_is_left(monkeypatch, left, sure):
    """What barely stands out from sound sessions would be less certain than what does not, which is named above."""
    search = session_search()
    first, clock, scale = search.chosen
    found = replace(search, rounds=(replace(round_of((clock, 30.0, 30.0), (scale, 10.0, 10.0)), appearance=27.0),))
    share = 0.9 if left < 1e-6 else 0.3
    rest = Adequacy(share > found.options.adequacy.band_part, left, share, "")
    monkeypatch.setattr(believed, "support", lambda statistics, chosen, one: 30.0)
    monkeypatch.setattr(believed, "residuals", lambda observed, model, posterior: ())
    monkeypatch.setattr(believed, "assess_adequacy", lambda observed, left, options: rest)
    after = believed.believed(found, (), 4)
    assert after.chosen == found.chosen and bool(after.trace) == sure
    confidence = cause_of(after, 1, {}, ("a", "b")).confidence
    assert confidence > 0.99 if sure else confidence < 0.9
