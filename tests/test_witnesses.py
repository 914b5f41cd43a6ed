"""Witnesses name what a laboratory did to its recordings, nothing where it did nothing, and contradict the rest."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import torch
from draws import seed_of
from rates import at_least
from small_session import outcome

from torchid.checks.marker_tracks.statement import TrackFault, TrackStatement
from torchid.diagnosis.diagnose import select_effects
from torchid.diagnosis.verdict.records import Cause, Diagnosis, Refuted
from torchid.effects.catalogue import effect
from torchid.effects.place import SESSION, Interval, Place
from torchid.effects.scene import reading
from torchid.extension import verdict
from torchid.extension.correction import extend_outcome
from torchid.extension.diagnosing import plate_frames
from torchid.extension.laboratory import examine, panel_of, read_right, verdict_of
from torchid.extension.model_free_checks import with_witnesses
from torchid.model_free.faults import name_faults, sizes, suspects_of, without
from torchid.model_free.panel import Panel
from torchid.model_free.testimony import Claim, answers, hear
from torchid.model_free.watched import share_load
from torchid.report.decisions import sentence
from torchid.session import Outcome
from torchid.session.fitting import OnStage
from torchid.session.following import Following
from torchid.session.standing import follow_each, standing_weight
from torchid.session.tables import diagnosis_table
from torchid.storage.results import OutputFolder

SEED = seed_of(__name__)
DRAWS, RATE = 10, 0.98
"""Faults of a kind, and the share of them that witnesses bear out and whose opposite they contradict: 90 of 90 here."""


def plates(base: Outcome) -> tuple[str, ...]:
    return tuple(sorted(plate.frame.name for plate in plate_frames(base)[0]))


def drawn(name: str, rng: np.random.Generator, base: Outcome) -> tuple[Place, torch.Tensor]:
    """Place and internal parameters of a fault, well above what laboratories scatter by."""
    sign, size = rng.choice([-1.0, 1.0]), rng.uniform(1.0, 2.0)
    if name == "time_offset":
        return SESSION, torch.tensor([0.03 * sign * size]).double()
    if name == "plate_gain":
        # Much more of it would rather be a wrong record of the mass, which does the same.
        return Place(plates(base)), torch.tensor([0.04 * sign * size**0.5]).double()
    angle = rng.uniform(0.0, 2.0 * np.pi)
    return SESSION, 0.025 * size * torch.tensor([np.cos(angle), np.sin(angle)]).double()


def planted(base: Outcome, name: str, place: Place, theta: torch.Tensor) -> Outcome:
    """The session as a laboratory with a fault would have recorded it; what was followed stays."""
    frames, trials = plate_frames(base)[1], dict(base.session.trials)
    for trial, own in frames.items():
        forces = trials[trial].forces
        assert forces is not None
        watched = next((w for w in panel(base).trials if w.name == trial), None)
        if name in ("gravity_tilt", "body_weight_support") and watched is not None:
            wrench = watched.under(effect(name), place, theta).reading.wrench
        else:
            wrench = effect(name).read(reading(trial, forces, own), place, theta).wrench
        trials[trial] = replace(trials[trial], forces=replace(forces, wrench=wrench))
    return replace(base, session=replace(base.session, trials=trials))


def panel(base: Outcome) -> Panel:
    found = undisturbed() if base is outcome() else panel_of(base)
    assert found is not None
    return found


@cache
def undisturbed() -> Panel | None:
    """Of the session as it is, which most tests ask for several times."""
    return panel_of(outcome())


def both(base: Outcome) -> tuple[Outcome, Panel]:
    return base, panel(base)


def causes(base: Outcome) -> tuple[Cause, ...]:
    return examine(*both(base)).causes


def names(cause: Cause) -> set[str]:
    return {cause.effect, *(twin.effect for twin in cause.indistinguishable)}


def test_nothing_is_named_in_a_clean_session() -> None:
    assert causes(outcome()) == ()


@pytest.mark.parametrize("name", ["time_offset", "plate_gain", "gravity_tilt"])
def test_a_fault_of_the_laboratory_is_named_with_its_size(name: str) -> None:
    base, rng = outcome(), np.random.default_rng(SEED)
    place, theta = drawn(name, rng, base)
    verdict = examine(*both(planted(base, name, place, theta)))
    found = verdict.causes
    assert found and name in names(found[0]), (place, theta, [(c.effect, c.where) for c in found])
    assert len([sentence(step) for step in verdict.trace]) == len(found)  # with numbers that each step has
    if found[0].effect == name:
        torch.testing.assert_close(found[0].theta[0], theta, rtol=0.3, atol=float(0.2 * theta.norm()))


def refuted(base: Outcome) -> tuple[tuple[Cause, ...], tuple[Refuted, ...]]:
    """What witnesses name of a session, and that it has not stood."""
    named = causes(base)
    return named, tuple(Refuted(one.effect, one.where, 0.0, "never_worse", {}) for one in named)


def test_what_is_refuted_is_not_named_again_nor_anything_in_its_place() -> None:
    """Nothing is named of a session in which all that was named has not stood."""
    base, rng = outcome(), np.random.default_rng(SEED)
    session = planted(base, "time_offset", *drawn("time_offset", rng, base))
    named, gone = refuted(session)
    assert named and examine(session, panel(session), gone).causes == ()


def test_what_is_left_beside_a_refuted_fault_has_the_size_that_it_has_alone() -> None:
    """Of a clock and a gain, which a wrong record of the mass is much like, the clock's place alone is barred."""
    base, rng = outcome(), np.random.default_rng(SEED)
    session = planted(base, "plate_gain", *drawn("plate_gain", rng, base))
    heard = panel(planted(session, "time_offset", *drawn("time_offset", rng, base)))
    faults = name_faults(heard, suspects_of(heard, select_effects((), ())))
    alike = ("plate_gain", "body_mass")
    gains = [one for one in faults if one.suspect.effect.name in alike]
    found = {(one.suspect.effect.name, one.suspect.place.where) for one in faults}
    kept = without(heard, faults, {one for one in found if one[0] not in alike})
    assert 0 < len(gains) < len(faults) and all(a.suspect is b.suspect for a, b in zip(kept, gains, strict=True)), found
    alone = sizes(heard, [one.suspect for one in gains])
    for one, size, before in zip(kept, alone, gains, strict=True):
        torch.testing.assert_close(one.size.mean, size.mean)
        torch.testing.assert_close(one.size.covariance, size.covariance)
        assert (one.size.mean - before.size.mean).norm() > 1e-3 * before.size.mean.norm()


def test_what_was_found_beside_a_refuted_fault_is_looked_for_again(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """A model that was extended by a fault of witnesses and refutes it voids what was found with it put right."""
    base, rng = outcome(), np.random.default_rng(SEED)
    session = planted(base, "time_offset", *drawn("time_offset", rng, base))
    named, gone = refuted(session)
    entered = examine(session, panel(session)).trace
    asked = []

    def told(some: Outcome, folder: OutputFolder, progress: OnStage, barred: tuple[Refuted, ...]) -> Diagnosis:
        asked.append(barred)
        return replace(verdict_of(() if barred else named), trace=() if barred else entered)

    def published(whole: Outcome, *rest: object) -> Outcome:
        assert whole.diagnosis is not None
        return replace(whole, diagnosis=replace(whole.diagnosis, causes=(), refuted=gone))

    monkeypatch.setattr(verdict, "diagnosed", told)
    monkeypatch.setattr(verdict, "publishable", published)
    with OutputFolder(tmp_path / "out") as folder:
        found = verdict.with_verdict(session, folder, "key", lambda stage, part: None)
    assert asked == [(), gone]
    assert found.diagnosis is not None and found.diagnosis.refuted == gone and not found.diagnosis.causes


def test_a_wrong_record_is_named() -> None:
    base, rng = outcome(), np.random.default_rng(SEED)
    off = rng.choice([-1.0, 1.0]) * rng.uniform(0.08, 0.15)
    found = causes(replace(base, prior=replace(base.prior, mean=(1.0 + off) * base.prior.mean)))
    assert found and "body_mass" in names(found[0]), (off, found)


def test_a_harness_is_no_wrong_record() -> None:
    """Plates miss a quarter of the weight: no record is so wrong, and where it hangs a body model must tell."""
    base, rng = outcome(), np.random.default_rng(SEED)
    places = effect("body_weight_support").places([one.view for one in panel(base).trials])
    place = places[rng.integers(len(places))]
    force = float(rng.uniform(150.0, 250.0))
    found = causes(planted(base, "body_weight_support", place, torch.tensor([force]).double()))
    assert not {cause.effect for cause in found} & {"body_mass", "plate_gain"}, (place, force, found)


@pytest.mark.parametrize("claimed", ["payload", "body_weight_support"])
def test_a_load_that_no_plate_bore_is_contradicted(claimed: str) -> None:
    base, rng = outcome(), np.random.default_rng(SEED)
    own = effect(claimed)
    place = own.places([one.view for one in panel(base).trials])[0]
    theta = torch.zeros(own.size(place)).double()
    theta[0] = (10.0 if claimed == "payload" else 100.0) * rng.uniform(1.0, 2.0)
    said = hear(panel(base), [Claim(own, place, acting(theta))])[0]
    assert said.nats < -4.5 and said.loudness_sd > 3.0, (place, theta, said)


def acting(theta: torch.Tensor) -> Callable[[str], torch.Tensor]:
    return lambda trial: theta


def test_a_plate_that_is_put_right_weighs_right(tmp_path) -> None:
    """Extended by a gain of all plates, the inertial fit is held to the weight that standing tells without it."""
    base, rng = outcome(), np.random.default_rng(SEED)
    place, theta = drawn("plate_gain", rng, base)
    wrong = planted(base, "plate_gain", place, theta)
    trials = tuple(base.session.trials)
    cause = Cause("plate_gain", place.where, None, {}, 1.0, (), (), {}, place, theta[None], trials, True)
    with OutputFolder(tmp_path) as folder:
        followed = {
            one.name: one
            for one in follow_each(
                base.fit, wrong.session, base.tracked, Following.of(base.config, base.cutoff_hz), base.prior
            )
        }
        wrong = replace(wrong, followed=followed, diagnosis=verdict_of((cause,)))
        right = extend_outcome(wrong, wrong, folder, "key", lambda stage, fraction: None)
    true, found = (
        standing_weight(one.followed.values(), one.session, one.config.subject.mass_kg) for one in (base, right)
    )
    assert true is not None and found is not None
    assert abs(found.mass / true.mass - 1.0) < 0.1 * abs(float(theta[0])), (theta, true, found)


def test_feet_answer_a_pull_as_they_can() -> None:
    """All of a pull is borne, by who bears; a tipping moment goes over from foot to foot and moves no pressure."""
    rng = np.random.default_rng(SEED)
    own, other = 1.0 + rng.random(), 1.0 + rng.random()
    middle = torch.tensor([[0.1, 0.15, 0.0], [0.1, -0.15, 0.0], [1.0, 0.0, 0.0]]).double()
    force = torch.tensor([[0.0, 0.0, 300.0 * own], [0.0, 0.0, 300.0 * other], [0.0, 0.0, 0.0]]).double()
    both = torch.cat([force, torch.linalg.cross(middle, force)], 1)
    alone = torch.stack([both[0], both[2], both[2]])
    first = panel(outcome()).trials[0].reading
    read = replace(first, time=first.time[:2], wrench=torch.stack([both, alone]), frames=first.frames[:3])
    roll = 12.0 * float(rng.uniform(-1.0, 1.0))
    shared = share_load(read, torch.tensor([0.0, 0.0, 0.0, roll, 0.0, 0.0]).double()[:, None].expand(6, 2)).wrench
    torch.testing.assert_close((shared - read.wrench).sum(1)[:, 3], torch.full((2,), roll).double())
    torch.testing.assert_close(shared[1, 1:], read.wrench[1, 1:])
    moved = shared[0, :2, 3] / shared[0, :2, 2] - middle[:2, 1]
    assert moved.abs().max() < 0.3 * abs(roll) / (300.0 * (own + other))
    assert abs(float(shared[0, 0, 2] - both[0, 2]) - roll / 0.3) < 0.2 * abs(roll) / 0.3


def claim(name: str, place: Place, theta: torch.Tensor) -> Claim:
    return Claim(effect(name), place, acting(theta))


def exchanged(base: Outcome) -> tuple[Place, torch.Tensor]:
    """The two plates whose exchanged cables witnesses hear most of: those under the feet."""
    own, heard = effect("plate_assignment"), panel(base)
    places = own.places([one.view for one in heard.trials])
    return max(places, key=lambda one: float(heard.signature(own, one).norm())), torch.ones(1).double()


@pytest.mark.parametrize("name", ["time_offset", "plate_gain", "gravity_tilt"])
def test_witnesses_bear_out_what_is_there_and_contradict_its_opposite(name: str) -> None:
    base, rng, found = outcome(), np.random.default_rng(SEED), []
    for _ in range(DRAWS):
        place, theta = drawn(name, rng, base)
        faulty = panel(planted(base, name, place, theta))
        found.append([hear(faulty, [claim(name, place, way * theta)])[0].nats for way in (1.0, -1.0)])
    assert sum(right > 3.0 and wrong < -4.5 for right, wrong in found) >= at_least(RATE, DRAWS), found


def test_each_witness_answers_for_itself() -> None:
    """A plate's gain is heard by those who weigh, as large as it is; one of the other sign is contradicted."""
    base, rng = outcome(), np.random.default_rng(SEED)
    place, theta = drawn("plate_gain", rng, base)
    faulty = panel(planted(base, "plate_gain", place, theta))
    (right,), (wrong,) = (answers(faulty, [claim("plate_gain", place, way * theta)]) for way in (1.0, -1.0))
    first = right[0]
    assert first.name in ("mass", "gain") and first.unit == "part" and first.agrees, (place, theta, first)
    assert abs(first.value - first.expected) < 3.0 * first.sd < 3.0 * abs(first.expected), (place, theta, first)
    assert not wrong[0].agrees and abs(wrong[0].value - wrong[0].expected) > 3.0 * wrong[0].sd, (place, theta, wrong)


def test_a_fault_makes_no_trial_bad() -> None:
    """However large it is, claims are held against the scatter of sessions in which nothing is wrong."""
    base, rng = outcome(), np.random.default_rng(SEED)
    own, heard = effect("plate_offset"), panel(base)
    places = own.places([one.view for one in heard.trials])
    place = max(places, key=lambda one: float(heard.signature(own, one).norm()))
    theta = torch.zeros(own.size(place)).double()
    theta[2] = float(rng.uniform(30.0, 50.0))
    faulty = panel(planted(base, "plate_offset", place, theta))
    told = [one for one in answers(faulty, [claim("plate_offset", place, theta)])[0] if one.name == "zero_fz"]
    short = [one for one in answers(faulty, [claim("plate_offset", place, 0.6 * theta)])[0] if one.name == "zero_fz"]
    assert told and all(one.agrees and one.sd < 3.0 for one in told), (place, theta, told)
    assert not any(one.agrees for one in short), (place, theta, short)


def test_a_verdict_says_levels_witnesses_and_what_is_published() -> None:
    """Distances that bear out a shift or an exchange, and quick motion, stand beside their causes; the likely first."""
    base = outcome()
    name, (a, b, c) = next(iter(base.session.role("fit"))), base.fit.attachment.labels[:3]
    shift = {"shift_seg_m": {"value": torch.tensor([0.03, 0.0, 0.04]).double(), "sd": torch.zeros(3).double()}}

    smoothed = {"cutoff_hz": {"value": torch.tensor([8.0]).double(), "sd": torch.ones(1).double()}}

    def named(kind: str, where: tuple[str, ...], confidence: float, values: dict) -> Cause:
        when, theta, gain = (Interval(name, 0.0, 1e3),), torch.zeros(1, 3).double(), {"heldout_log_likelihood": 0.0}
        return Cause(kind, where, when, values, confidence, (), (), gain, Place(where, when), theta, (name,), False)

    causes = named("marker_shift", (a,), 0.5, shift), named("marker_swap", (b, c), 0.995, {})
    found = verdict_of((*causes, named("filter_lag", ("session",), 0.6, smoothed)))
    known = (
        TrackStatement(TrackFault.MOVED, name, (a,), (), 47.0, 5.0),
        TrackStatement(TrackFault.MOVED, name, (a, c), (), 47.0, 5.0),
        TrackStatement(TrackFault.EXCHANGED, name, (b, c), (), 60.0, 3.5, 4.0),
        TrackStatement(TrackFault.EXCHANGED, name, (b, a), (), 60.0, 3.5, 4.0),
    )  # fmt: skip
    seen = replace(base, session=replace(base.session, tracking=known))
    table = diagnosis_table(replace(base, diagnosis=with_witnesses(seen, found)))
    heard = {
        one["effect"]: (one["level"], [(w["name"], w["where"], w["agrees"]) for w in one["witnesses"]])
        for one in table["causes"]
    }
    assert table["published"] == "base" and list(heard) == ["marker_swap", "filter_lag", "marker_shift"]
    assert heard["marker_shift"] == ("possible", [("marker_distances", a, True)])
    assert heard["marker_swap"] == ("certain", [("marker_distances", f"{b}, {c}", True)])
    assert heard["filter_lag"][0] == "likely" and {one[0] for one in heard["filter_lag"][1]} <= {"marker_quickness"}


def test_witnesses_bear_out_exchanged_cables() -> None:
    base = outcome()
    place, theta = exchanged(base)
    faulty = panel(planted(base, "plate_assignment", place, theta))
    assert hear(faulty, [claim("plate_assignment", place, theta)])[0].nats > 30.0, place


@pytest.mark.parametrize("name", ["time_offset", "plate_gain", "gravity_tilt"])
def test_nothing_is_left_to_name_once_a_fault_is_put_right(tmp_path, name: str) -> None:
    base, rng = outcome(), np.random.default_rng(SEED)
    faulty = planted(base, name, *drawn(name, rng, base))
    first = causes(faulty)
    with OutputFolder(tmp_path) as folder:
        right = read_right(faulty, first, folder, lambda stage, fraction: None)
    again = panel_of(right, first)
    assert first and again is not None and examine(right, again).causes == ()


def test_no_pair_of_faults_is_named_for_exchanged_cables() -> None:
    """Large ones that nearly cancel leave more than chance does, or need sizes where the exchange needs none."""
    base = outcome()
    place, theta = exchanged(base)
    found = examine(*both(planted(base, "plate_assignment", place, theta)))
    assert found.causes == () and {one.rule for one in found.trace} <= {"witnesses_disagree", "witnesses_outdone"}, (
        place
    )
