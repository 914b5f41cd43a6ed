"""What model-free checks state bears out what a laboratory did to a session, in one search with the body model."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import torch
from draws import seed_of
from small_session import outcome

from torchid.checks.marker_tracks.statement import TrackFault, TrackStatement
from torchid.diagnosis.evidence.adequacy import Adequacy
from torchid.diagnosis.testing.heldout import Errors
from torchid.diagnosis.verdict.records import Cause, Diagnosis
from torchid.effects.catalogue import effect
from torchid.effects.place import SESSION, Interval, Place
from torchid.effects.scene import reading
from torchid.extension.correction import extend_outcome
from torchid.extension.diagnosing import diagnose_outcome
from torchid.extension.model_free_checks import with_witnesses
from torchid.extension.statements import panel_of
from torchid.model_free.panel import Panel
from torchid.model_free.testimony import Claim, answers
from torchid.model_free.watched import shares, watch
from torchid.session import Outcome
from torchid.session.fitting import identify
from torchid.session.following import Following
from torchid.session.laboratory import earlier_sessions
from torchid.session.plates import session_plates
from torchid.session.standing import follow_each, standing_weight
from torchid.session.tables import diagnosis_table
from torchid.storage.results import OutputFolder

SEED = seed_of(__name__)


def plates(base: Outcome) -> tuple[str, ...]:
    return tuple(sorted(plate.frame.name for plate in session_plates(base.session)[0]))


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
    frames, trials = session_plates(base.session)[1], dict(base.session.trials)
    for trial, own in frames.items():
        forces = trials[trial].forces
        assert forces is not None
        watched = next((w for w in panel(base).trials if w.name == trial), None)
        if name in ("gravity_tilt", "body_weight_support") and watched is None:
            del trials[trial]  # held-out: what bears the load there is not at hand
            continue
        if name in ("gravity_tilt", "body_weight_support"):
            assert watched is not None
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


ASKED = ("time_offset", "body_lag", "plate_gain", "plate_offset", "plate_pose", "plate_assignment", "gravity_tilt",
         "body_mass", "payload", "body_weight_support")  # fmt: skip
"""Effects that are asked about: those that are planted, and what they could be taken for."""


def diagnosed(wrong: Outcome) -> Diagnosis:
    """The verdict on a session, followed and identified as it is recorded."""
    asked = Following.of(wrong.config, wrong.cutoff_hz)
    followed = {one.name: one for one in follow_each(wrong.fit, wrong.session, wrong.tracked, asked, wrong.prior)}
    config = wrong.config.model_copy(update={"diagnosis": wrong.config.diagnosis.model_copy(update={"include": ASKED})})
    found = replace(wrong, followed=followed, config=config)
    found = replace(found, identified=identify(config.inertia, config.subject, found, lambda stage, fraction: None))
    verdict = diagnose_outcome(
        found, panel=panel_of(found), earlier=earlier_sessions(found.config.laboratory, found.session)
    )
    assert verdict is not None
    return verdict


def of_measuring(found: Diagnosis) -> list[Cause]:
    """Causes that are errors of measuring or of a record, not of bodies."""
    return [one for one in found.causes if not effect(one.effect).bodily]


def names(cause: Cause) -> set[str]:
    return {cause.effect, *(twin.effect for twin in cause.indistinguishable)}


@pytest.mark.slow
def test_nothing_is_named_in_a_clean_session() -> None:
    assert of_measuring(diagnosed(outcome())) == []


@pytest.mark.slow
@pytest.mark.parametrize("name", ["time_offset", "plate_gain", "gravity_tilt"])
def test_a_fault_of_the_laboratory_is_named_with_its_size(name: str) -> None:
    base, rng = outcome(), np.random.default_rng(SEED)
    place, theta = drawn(name, rng, base)
    found = of_measuring(diagnosed(planted(base, name, place, theta)))
    assert found and name in names(found[0]), (place, theta, [(c.effect, c.where) for c in found])
    if found[0].effect == name:
        torch.testing.assert_close(found[0].theta[0], theta, rtol=0.3, atol=float(0.2 * theta.norm()))


@pytest.mark.slow
def test_a_wrong_record_is_named() -> None:
    base, rng = outcome(), np.random.default_rng(SEED)
    off = rng.choice([-1.0, 1.0]) * rng.uniform(0.08, 0.15)
    found = of_measuring(diagnosed(replace(base, prior=replace(base.prior, mean=(1.0 + off) * base.prior.mean))))
    assert found and "body_mass" in names(found[0]), (off, found)


@pytest.mark.slow
def test_a_harness_is_no_wrong_record() -> None:
    """Plates miss a quarter of the weight: no record is so wrong."""
    base, rng = outcome(), np.random.default_rng(SEED)
    places = effect("body_weight_support").places([one.view for one in panel(base).trials])
    place = places[rng.integers(len(places))]
    force = float(rng.uniform(150.0, 250.0))
    found = of_measuring(diagnosed(planted(base, "body_weight_support", place, torch.tensor([force]).double())))
    assert found and "body_weight_support" in names(found[0]), (place, force, found)


@pytest.mark.slow
def test_exchanged_cables_are_no_pair_of_moved_plates() -> None:
    base = outcome()
    place, theta = exchanged(base)
    found = of_measuring(diagnosed(planted(base, "plate_assignment", place, theta)))
    assert [(one.effect, one.where) for one in found[:1]] == [("plate_assignment", place.where)], found


UNASKED = Adequacy(False, torch.nan, torch.nan, "")


def verdict_of(causes: Sequence[Cause]) -> Diagnosis:
    """A verdict of these causes and nothing else."""
    nothing = Errors(torch.nan, torch.nan)
    return Diagnosis((), nothing, nothing, tuple(causes), UNASKED)


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
    shared = read.wrench + shares(read) @ torch.tensor([0.0, 0.0, 0.0, roll, 0.0, 0.0]).double()
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


def test_a_foot_that_no_plate_reads_leaves_the_other_ones_pressure_untold() -> None:
    """Both feet on one plate: its pressure is between them, whatever it is nearer to."""
    base = outcome()
    seen = next(one for one in panel(base).trials if one.foot_on is not None and bool((one.foot_on == 0).any()))
    contact = base.followed[seen.name].contact
    assert contact is not None and seen.soles is not None
    bears = (contact.plate == 0).any(1)
    both = replace(
        contact, touching=torch.ones_like(contact.touching), supported=torch.ones_like(contact.supported),
        plate=torch.where(contact.plate == 0, 0, -1),
    )  # fmt: skip
    soles = {foot: seen.soles[k] for k, foot in enumerate(seen.feet)}
    one_alone = replace(both, touching=contact.touching & (torch.arange(len(contact.feet)) == 0))
    told = watch(seen.scene, seen.reading, seen.measured, soles, one_alone)
    untold = watch(seen.scene, seen.reading, seen.measured, soles, both)
    assert told.foot_on is not None and untold.foot_on is not None
    assert bool(((told.foot_on == 0).any(1) == bears).all()) and not bool((untold.foot_on == 0).any())
