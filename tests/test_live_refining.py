"""Geometry is found while the subject moves, and what was identified by another one is identified anew."""

import functools
from dataclasses import replace

import numpy as np
import pytest
import small_session
import torch
from test_live import RATE, moving, subject

from torchid.geometry.result import GeometryFit
from torchid.live.estimation import refining
from torchid.live.estimation.identifier import LiveSubject
from torchid.live.estimation.pose import PostureFollower
from torchid.live.estimation.refining import MessagePiece, Refining
from torchid.live.sources.intake import Intake
from torchid.live.sources.stream import Replay
from torchid.session.people import subject_prior


def standing(fit: GeometryFit, seed: int) -> LiveSubject:
    """The small session's subject, with joints and markers some millimetres beside their places."""
    who, (static,) = subject(), [t for t in small_session.outcome().session.trials.values() if t.role == "static"]
    rough = replace(fit, xi=fit.xi + 0.006 * torch.from_numpy(np.random.default_rng(seed).normal(size=len(fit.xi))))
    return replace(
        who, fit=rough, prior=subject_prior(who.config.model, who.config.subject, rough), static=static.markers
    )


def pieces(fit: GeometryFit) -> list[MessagePiece]:
    """A trial as a stream, followed by a geometry."""
    source, follower, found = Replay(moving(), float("inf")), PostureFollower(fit, moving().markers.labels), []
    intake = Intake(RATE, source.force_rate_hz, 0.5)
    while (packet := source.take()) is not None:
        placed = intake.place(packet)
        postures = follower(placed.markers)
        found.append(MessagePiece(placed.index, placed.markers.position, postures, placed.sample, placed.wrench))
    return found


def refiner(who: LiveSubject) -> Refining:
    source = Replay(moving(), float("inf"))
    return Refining(who, source.labels, RATE, source.plates, source.force_rate_hz)


def worked_off(own: Refining, some: list[MessagePiece]) -> None:
    for piece in some:
        own.put(piece)
        own.work()
    while own.busy:
        own.work()


def off_m(own: Refining) -> float:
    """Distance of the trial's markers from the model [m]."""
    errors = torch.cat([piece.postures.error for piece in pieces(own.subject.fit)])
    return float(errors[torch.isfinite(errors)].square().mean().sqrt())


@functools.cache
def right_m() -> float:
    """The same by the geometry of a run."""
    return off_m(refiner(subject()))


@pytest.fixture
def early(monkeypatch):
    """A trial of few seconds is long enough."""
    monkeypatch.setattr(refining, "FIRST_S", 1.5)


@pytest.mark.slow
def test_geometry_that_standing_has_left_wrong_is_mended_by_motion(seed, early):
    """All that came before is identified anew, once by the geometry of the first seconds and once by that of all."""
    who = standing(subject().fit, seed)
    own, some = refiner(who), pieces(who.fit)
    wrong_m = off_m(own)
    worked_off(own, some[: len(some) // 2])
    assert own.version == 1 and off_m(own) < 0.6 * wrong_m
    worked_off(own, some[len(some) // 2 :])  # followed by the old geometry, as a stream is until it hears of another
    found = own.finish()
    assert own.identifier.newest == len(moving().markers.time) - 1
    assert own.version > 1 and off_m(own) < 1.15 * right_m()
    again = refiner(replace(own.subject, static=None))
    worked_off(again, pieces(own.subject.fit))
    assert float(((found.fit.mass - again.finish().fit.mass).abs() / found.fit.sd.phi[:, 0]).max()) < 0.2


@pytest.mark.slow
def test_a_geometry_that_is_no_better_is_dropped(seed, early, monkeypatch):
    """Without a standing trial there is none, and one that takes the markers away does not come."""
    who = standing(subject().fit, seed)
    some = pieces(subject().fit)
    alone = refiner(replace(who, static=None))
    worked_off(alone, some)
    assert alone.version == 0 and not alone.busy
    monkeypatch.setattr(refining, "refined", lambda *_: who)
    own = refiner(replace(subject(), static=who.static))
    worked_off(own, some)
    found = own.finish()
    assert own.version == 0 and own.subject.fit is not who.fit
    kept = refiner(subject())
    worked_off(kept, some)
    assert torch.equal(found.fit.phi, kept.finish().fit.phi)
