"""Memory of a diagnosis and of the model that it extends does not grow with the recording."""

from dataclasses import replace

import pytest
import small_session
import torch
from test_effects import options
from torch.testing import assert_close

from torchid.diagnosis.evidence.adequacy import Adequacy
from torchid.diagnosis.testing.heldout import Errors
from torchid.diagnosis.verdict.records import Cause, Diagnosis
from torchid.dynamics.whitening import QUIET, cosine_matrix, white_scatter
from torchid.effects.catalogue import CATALOGUE
from torchid.effects.place import Interval
from torchid.effects.traits import Correction
from torchid.extension import correction, diagnosing, pieces
from torchid.extension.correction import effect_wrenches, extend_session
from torchid.extension.diagnosing import searched, spans
from torchid.observation import trial
from torchid.recording import Trial
from torchid.session import Outcome
from torchid.simulate.planting import planted
from torchid.storage.results import OutputFolder

LOCAL = {name for name, one in CATALOGUE.items() if one.correction is not Correction.RECORD and name != "marker_swap"}
"""Effects that are taken out piece by piece; of records and names, nothing is as long as a recording."""


def test_scatter_of_a_long_recording_is_that_of_its_cosines():
    """As the matrix says, of any number of channels; for an hour, a matrix would have 80 GB."""
    draw = torch.Generator().manual_seed(small_session.SEED)
    x = torch.randn(1201, 2, 3, generator=draw, dtype=torch.float64)
    first, last = (round(2.0 * f * len(x)) for f in QUIET)
    own = cosine_matrix(len(x), last)[first:] @ x.flatten(1)
    assert_close(white_scatter(x), (own.square().median(0).values / 0.4549).sqrt().view(2, 3), rtol=1e-12, atol=0.0)
    long = torch.randn(200_000, 1, generator=draw, dtype=torch.float64)
    assert float(white_scatter(long)) == pytest.approx(1.0, rel=0.02)


@pytest.mark.parametrize("frames", [1, 3, 400, 401, 1000])
def test_pieces_are_all_frames_once(monkeypatch, frames):
    """In order, each with those beside it."""
    monkeypatch.setattr(pieces, "PIECE_S", 2.0)
    monkeypatch.setattr(pieces, "BESIDE_S", 0.5)
    index, seen = torch.arange(frames), []
    for piece in pieces.pieces(index.double() / 100.0):
        assert index[piece.around][piece.inner].equal(index[piece.own])
        assert piece.around.stop - piece.around.start <= 300
        assert piece.around.start == max(0, piece.own.start - 50) and piece.around.stop == min(
            frames, piece.own.stop + 50
        )
        seen.append(index[piece.own])
    assert torch.cat(seen).equal(index)


def verdict(name: str, outcome: Outcome) -> Diagnosis:
    """That an effect, of the size that tests plant, acts in all trials."""
    one = planted(replace(options(name), when=None))
    place = one.place
    if name == "wobbling_mass":
        # Softer ones ring longer than the frames beside these short pieces.
        place = replace(place, grid={"frequency_hz": 7.0, "damping_ratio": 0.3})
    if name == "marker_shift":
        place = replace(place, when=(Interval("squats", 1.0, 3.0), Interval("arms", 0.5, 2.2)))
    if CATALOGUE[name].intermittent:
        place = replace(place, when=(Interval("squats", 1.0, 2.0), Interval("arms", 2.1, 3.0)))
    trials = tuple(outcome.session.trials)
    theta = one.theta.expand(len(trials), -1)
    cause = Cause(name, place.where, place.when, {}, 1.0, (), (), {}, place, theta, trials, True)
    return Diagnosis((), Errors(1.0, 1.0), Errors(1.0, 1.0), (cause,), Adequacy(False, 0.5, 0.1, ""))


def recorded(name: str, trials: dict[str, Trial]) -> dict[str, torch.Tensor]:
    """What of recordings an effect changes: forces, or places of markers."""
    if CATALOGUE[name].correction is Correction.READING:
        return {n: one.forces.wrench for n, one in trials.items() if one.forces is not None}
    return {n: one.markers.position for n, one in trials.items()}


@pytest.mark.parametrize("name", sorted(LOCAL))
def test_what_a_cause_does_is_the_same_in_pieces(tmp_path, monkeypatch, name):
    """Forces and markers as if each recording were looked at as a whole, wherever the search had looked."""
    outcome = replace(small_session.outcome(), diagnosis=verdict(name, small_session.outcome()))
    monkeypatch.setattr(diagnosing, "LONGEST_S", 2.4)
    assert any(part.stop - part.start == 240 for part in spans(outcome).values())
    found, scenes, make = [], [], correction.make_scene
    for module in (correction, trial):
        monkeypatch.setattr(module, "make_scene", lambda *given: scenes.append(len(given[3].time)) or make(*given))
    with OutputFolder(tmp_path) as folder:
        for length, beside in ((100.0, 1.0), (1.3, 1.2)):
            monkeypatch.setattr(pieces, "PIECE_S", length)
            monkeypatch.setattr(pieces, "BESIDE_S", beside)
            scenes.clear()
            if CATALOGUE[name].correction is Correction.WRENCH:
                found.append(effect_wrenches(outcome))
            else:
                found.append(recorded(name, extend_session(outcome, folder).trials))
    whole, parts = found
    reads, forceful = (CATALOGUE[name].correction is one for one in (Correction.READING, Correction.WRENCH))
    assert reads or (scenes and max(scenes) <= 371), "no scene is longer than a piece and what is beside it"
    sizes, as_read = {}, recorded(name, outcome.session.trials)
    for n, own in whole.items():
        before = torch.zeros(()) if forceful else as_read[n]
        sizes[n] = float((own - before).nan_to_num().norm())
        assert float((own - parts[n]).nan_to_num().norm()) <= 1e-5 * sizes[n] + 1e-12
    assert max(sizes.values()) > 0.0


def test_a_drift_counts_from_where_it_was_found(tmp_path, monkeypatch):
    """The part that was searched had no more of it at its first frame than a recording that begins there."""
    outcome = replace(small_session.outcome(), diagnosis=verdict("plate_drift", small_session.outcome()))
    monkeypatch.setattr(diagnosing, "LONGEST_S", 2.4)
    monkeypatch.setattr(pieces, "PIECE_S", 1.3)
    known, before = spans(outcome), recorded("plate_drift", outcome.session.trials)
    with OutputFolder(tmp_path) as folder:
        found = recorded("plate_drift", extend_session(outcome, folder).trials)
    assert found.keys() == before.keys() and len(found) > 1
    for name, wrench in found.items():
        added = before[name] - wrench
        assert float(added[known[name].start].norm()) < 1e-9
        assert float(added[known[name].stop - 1].norm()) > 0.1


def test_the_stretch_with_most_used_frames_is_searched(monkeypatch):
    """The first of those that have as many."""
    monkeypatch.setattr(diagnosing, "LONGEST_S", 1.0)
    (rows, *_) = small_session.true_rows()
    used = torch.rand(len(rows.used), generator=torch.Generator().manual_seed(small_session.SEED)) < 0.6
    part = searched({"a": replace(rows, used=used)})["a"]
    counts = used.long().unfold(0, 100, 1).sum(1)
    assert part.stop - part.start == 100 and int(counts[part.start]) == int(counts.max())
