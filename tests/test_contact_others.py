"""Contacts other than feet: when they bear, which plate measures them, what is refused, and hidden ones found again."""

import math
import sys
from dataclasses import replace
from itertools import chain
from pathlib import Path

import pytest
import torch

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "scripts"))

import hidden_contact
import small_session
from rates import at_least

from torchid.checks.plates_against_feet.judge import judge
from torchid.checks.report import Given
from torchid.config import InvalidConfig, load_config
from torchid.config.conditions import Condition
from torchid.contact.contact import Contact, find_contact
from torchid.contact.options import ContactOptions, NearPlace, OtherContact
from torchid.contact.others import Others, feet_alone, find_others, inside
from torchid.contact.sharing.costs import Effort
from torchid.contact.sharing.patches import Patch, axes_about, patch_rows, rest_of
from torchid.contact.sharing.records import Needed, WrenchSource
from torchid.contact.sharing.wrenches import contact_wrenches
from torchid.errors import ConfigError, DataError, OptionError
from torchid.evaluation.torque_shares.back import low_back
from torchid.filters import Smoother
from torchid.geometry.tracking import Tracked
from torchid.io.resample import synchronise
from torchid.kinematics.plan import plan_tree
from torchid.kinematics.recursion import poses
from torchid.motion import Motion
from torchid.recording import Forces, Plate
from torchid.report.contacts import contacts_figure
from torchid.run import sequence
from torchid.run.sequence import _contact_notes
from torchid.run.torque_bands import outcome_draws
from torchid.run.write import motion_dataset
from torchid.session import Followed
from torchid.session.contact_wrenches import sharing_notes, wrenches_under
from torchid.session.following import contact_loads, limb, torques
from torchid.session.opening import on_feet
from torchid.session.other_contacts import check_others, local_points, refuse_unknown_plates

FRAMES, RATE = 100, 100.0
TIME = torch.arange(FRAMES, dtype=torch.float64) / RATE
FLAT = torch.tensor([[0.0, 0.0, 0.01], [0.17, 0.03, 0.01], [0.18, -0.03, 0.01], [0.24, 0.0, 0.01]]).double()
SOLES = {
    name: (FLAT + torch.tensor([0.0, y, 0.0]).double()).expand(FRAMES, -1, -1)
    for name, y in (("foot_l", 0.15), ("foot_r", -0.15))
}
COM = torch.tensor([0.11, 0.0, 1.0]).double().expand(FRAMES, 3)


def acting(at: tuple[float, float, float], force: torch.Tensor) -> torch.Tensor:
    """Wrench (frames, 6) about the origin of forces (frames, 3) at a point."""
    p = torch.tensor(at, dtype=torch.float64).expand(FRAMES, 3)
    return torch.cat([force, torch.linalg.cross(p, force)], dim=1)


def pushing(x: float, y: float, z: float) -> torch.Tensor:
    """A constant force."""
    return torch.tensor([x, y, z], dtype=torch.float64).expand(FRAMES, 3)


FEET = torch.stack([acting((0.11, y, 0.0), pushing(0.0, 0.0, 350.0)) for y in (0.15, -0.15)], dim=1)
BEARS = (TIME > 0.3) & (TIME < 0.7)
HANDLES, REFUSED = 8, 0.7
"""Handles that are drawn, and the share of them that would have the recording refused."""


def square(x: float, y: float, half: float, z: float = 0.0) -> torch.Tensor:
    corners = [(x + a * half, y + b * half, z) for a, b in ((1, 1), (1, -1), (-1, -1), (-1, 1))]
    return torch.tensor(corners, dtype=torch.float64)


def two_plates() -> tuple[Plate, Plate]:
    """One under each foot."""
    return Plate("left", square(0.1, 0.25, 0.24), number=1), Plate("right", square(0.1, -0.25, 0.24), number=2)


def rail(column: int = -1, bearing: torch.Tensor = BEARS) -> Others:
    return Others(("rail",), ("hand_r",), bearing[:, None], (column,))


def seen(forces: Forces, others: Others | None = None, spread: float = 0.0) -> Contact:
    return find_contact(SOLES, forces, torch.ones(FRAMES, dtype=torch.bool), RATE, spread, others=others)


def grip(at: tuple[float, float, float]) -> Patch:
    point = torch.tensor(at, dtype=torch.float64).expand(FRAMES, 1, 3)
    return Patch(point, torch.eye(3, dtype=torch.float64), torch.inf)


def seat(at: tuple[float, float, float]) -> Patch:
    return Patch(square(at[0], at[1], 0.1, at[2]).expand(FRAMES, 4, 3), torch.eye(3, dtype=torch.float64), 1.0)


def need(total: torch.Tensor, sd: float = 1.0) -> Needed:
    return Needed(total, torch.ones(FRAMES, dtype=torch.bool), torch.full((6,), sd).double(), COM)


def test_a_contact_without_a_plate_takes_its_frames_out_and_no_others():
    """Feet stay supported; the frames in which it bears, and those that the filter reaches from there, do not count."""
    forces = Forces(TIME, FEET, two_plates())
    found = seen(forces, rail(), spread=0.05)
    assert bool(found.supported.all()) and found.excluded == 0
    assert bool((found.measured == ~BEARS).all())
    lost = (~found.used).nonzero()[:, 0]
    assert int(lost[0]) == 31 - 5 and int(lost[-1]) == 69 + 5
    assert bool(found.beside[:, 2].equal(BEARS)) and not bool(found.beside[:, :2].any())
    part = found.frames(slice(30, 80))
    assert part.others is not None and len(part.others.bearing) == 50


def test_a_lack_of_weight_is_the_contacts_where_one_bears():
    """Feet are not taken for being beside the plates because a seat bears a part of the weight."""
    forces = Forces(TIME, FEET, two_plates())
    found = find_contact(
        SOLES, forces, torch.ones(FRAMES, dtype=torch.bool), RATE, 0.0, short=BEARS.clone(), others=rail()
    )
    assert bool(found.supported.all()) and found.short == 0 and bool((found.measured == ~BEARS).all())


@pytest.mark.parametrize("corners", [None, square(0.1, 0.0, 0.5, 0.9)])
def test_a_contact_with_a_plate_keeps_its_frames_and_the_plate_is_no_foots(corners):
    """A handle, with corners above the feet or with none, bears the hand in all frames."""
    hand = acting((0.11, 0.1, 0.9), pushing(10.0, 5.0, 60.0))
    forces = Forces(TIME, torch.cat([FEET, hand[:, None]], dim=1), (*two_plates(), Plate("handle", corners, number=3)))
    found = seen(forces, rail(2))
    assert bool(found.used.all()) and found.plate.unique(dim=0).tolist() == [[0, 1, 2]]
    assert found.floor == (0, 1)
    under = contact_wrenches(found, SOLES, forces, COM, Smoother(10.0, RATE), patches={"rail": grip((0.1, 0.1, 0.9))})
    assert bool((under.source == WrenchSource.MEASURED).all())
    torch.testing.assert_close(under.of("rail"), Smoother(10.0, RATE)(hand), atol=1e-9, rtol=1e-9)


def test_an_unmeasured_hand_is_what_the_body_needs_beyond_the_plates():
    """Its force is found, with a deviation; without the body it is unknown."""
    hand = acting((0.4, -0.3, 1.0), torch.where(BEARS[:, None], pushing(10.0, -15.0, 60.0), 0.0))
    smoother, forces = Smoother(10.0, RATE), Forces(TIME, FEET, two_plates())
    contact, patches = seen(forces, rail()), {"rail": grip((0.4, -0.3, 1.0))}
    blind = contact_wrenches(contact, SOLES, forces, COM, smoother, patches=patches)
    assert bool((blind.source[BEARS, 2] == WrenchSource.UNKNOWN).all()) and bool((blind.source[~BEARS] == 0).all())
    needed = need(smoother(FEET.sum(1) + hand))
    found = contact_wrenches(contact, SOLES, forces, COM, smoother, needed, patches=patches)
    assert found.contacts == ("foot_l", "foot_r", "rail") and found.body[2] == "hand_r"
    assert bool((found.source[BEARS, 2] == WrenchSource.PREDICTED).all())
    inner = (TIME > 0.4) & (TIME < 0.6)
    torch.testing.assert_close(found.of("rail")[inner], smoother(hand)[inner], atol=0.2, rtol=2e-3)
    torch.testing.assert_close(found.wrench[:, :2], smoother(FEET), atol=1e-6, rtol=1e-9)
    sd = found.sd[BEARS, 2, :3]
    assert bool((sd > 0.1).all()) and bool((sd < 1.5).all())
    assert [note.code for note in sharing_notes({"a": found})] == ["contact.predicted"]
    assert "rail" in sharing_notes({"a": found})[0].message


def test_without_plates_a_hand_and_feet_are_predicted_together():
    """Feet and hand add up to what the body needs but for its error."""
    hand = acting((0.4, -0.3, 1.0), torch.where(BEARS[:, None], pushing(0.0, 0.0, 60.0), 0.0))
    none = Forces(TIME, FEET[:, :0], ())
    contact, smoother = seen(none, rail()), Smoother(10.0, RATE)
    assert not bool(contact.untold.any()) and bool(contact.beside[BEARS].all())
    needed = need(smoother(FEET.sum(1) + hand))
    found = contact_wrenches(
        contact, SOLES, none, COM, smoother, needed, patches={"rail": grip((0.4, -0.3, 1.0))}
    )  # fmt: skip
    assert bool((found.source[BEARS] == WrenchSource.PREDICTED).all())
    gap = (found.wrench.sum(1) - needed.wrench)[:, :3]
    assert float(gap.abs().max()) < 5.0


def test_a_hand_does_not_bear_the_bodys_error(seed: int):
    """A moment that a hand cannot exert is left, and the hand's force is better than the force that is missing."""
    generator = torch.Generator().manual_seed(seed)
    hand = acting((0.4, -0.3, 1.0), pushing(0.0, 0.0, 60.0))
    smoother, forces = Smoother(10.0, RATE), Forces(TIME, FEET, two_plates())
    sd = torch.tensor([8.0, 8.0, 8.0, 2.0, 2.0, 2.0]).double()
    error = smoother(3.0 * torch.randn(FRAMES, 6, generator=generator).double()) * sd
    error[:, 3:] += torch.linalg.cross(COM, error[:, :3])
    always = torch.ones(FRAMES, dtype=torch.bool)
    contact = seen(forces, rail(bearing=always))
    needed = Needed(smoother(FEET.sum(1) + hand) + error, always, sd, COM)
    found = contact_wrenches(contact, SOLES, forces, COM, smoother, needed, patches={"rail": grip((0.4, -0.3, 1.0))})
    gap = (found.of("rail") - smoother(hand))[:, :3]
    assert float(gap.square().mean()) < 0.9 * float(error[:, :3].square().mean())


def test_a_seat_pushes_only_up():
    """Where the body seems to need a pull, a seat gives none; where it needs a push, it is found."""
    course = torch.where(TIME < 0.5, 200.0, -30.0)
    load = acting((-0.05, 0.0, 0.5), course[:, None] * pushing(0.0, 0.0, 1.0))
    smoother, forces = Smoother(10.0, RATE), Forces(TIME, FEET, two_plates())
    always = torch.ones(FRAMES, dtype=torch.bool)
    others = Others(("seat",), ("pelvis",), always[:, None], (-1,))
    found = contact_wrenches(
        seen(forces, others), SOLES, forces, COM, smoother, need(smoother(FEET.sum(1) + load), 5.0),
        patches={"seat": seat((0.0, 0.0, 0.5))},
    )  # fmt: skip
    own = found.of("seat")
    assert float((own[TIME < 0.4, 2] - 200.0).abs().max()) < 5.0
    assert float(own[TIME > 0.6, 2].abs().max()) < 3.0


def test_seat_and_feet_on_one_plate_are_shared():
    """A stool on the feet's plate: the three add up to the plate, and each is near what it bears."""
    load = acting((-0.35, 0.0, 0.45), torch.where(BEARS[:, None], pushing(0.0, 0.0, 400.0), 0.0))
    every = FEET * torch.where(BEARS, 0.4, 1.0)[:, None, None]
    forces = Forces(TIME, (every.sum(1) + load)[:, None], (Plate("only", square(0.0, 0.0, 0.8), number=1),))
    others = Others(("seat",), ("pelvis",), BEARS[:, None], (0,))
    contact, smoother = seen(forces, others), Smoother(10.0, RATE)
    assert bool(contact.used.all()) and bool((contact.plate == -2).all())
    found = contact_wrenches(
        contact, SOLES, forces, COM, smoother, patches={"seat": seat((-0.35, 0.0, 0.45))},
    )  # fmt: skip
    assert bool((found.source[BEARS] == WrenchSource.SHARED).all()) and bool(
        (found.source[:5, 2] == WrenchSource.MEASURED).all()
    )
    torch.testing.assert_close(found.wrench.sum(1), smoother(forces.total), atol=1e-5, rtol=1e-9)
    inner = (TIME > 0.4) & (TIME < 0.6)
    assert float((found.of("seat") - smoother(load))[inner, 2].abs().max()) < 40.0
    left = contact_wrenches(
        contact, SOLES, forces, COM, smoother, options=ContactOptions(torques="measured"),
        patches={"seat": seat((-0.35, 0.0, 0.45))},
    )  # fmt: skip
    assert bool((left.source[BEARS] == WrenchSource.UNKNOWN).all())


def test_hands_on_one_rail_share_it_beside_feet_that_share_a_plate():
    """Each plate is summed by its own contacts."""
    hands = [acting((0.5, y, 0.9), pushing(0.0, 0.0, fz)) for y, fz in ((0.3, 40.0), (-0.3, 80.0))]
    wrench = torch.stack([FEET.sum(1), hands[0] + hands[1]], dim=1)
    forces = Forces(TIME, wrench, (Plate("only", square(0.0, 0.0, 0.8), number=1), Plate("rail", None, number=2)))
    always = torch.ones(FRAMES, 2, dtype=torch.bool)
    contact = seen(forces, Others(("left", "right"), ("hand_l", "hand_r"), always, (1, 1)))
    smoother = Smoother(10.0, RATE)
    patches = {"left": grip((0.5, 0.3, 0.9)), "right": grip((0.5, -0.3, 0.9))}
    found = contact_wrenches(contact, SOLES, forces, COM, smoother, patches=patches)
    assert bool((found.source == WrenchSource.SHARED).all())
    torch.testing.assert_close(found.wrench[:, :2].sum(1), smoother(wrench[:, 0]), atol=1e-5, rtol=1e-9)
    for k, hand in enumerate(hands):
        torch.testing.assert_close(found.wrench[:, 2 + k, :3], smoother(hand)[:, :3], atol=1.0, rtol=0.02)


@pytest.mark.parametrize(
    ("when", "expected"),
    [
        ("always", torch.ones(FRAMES, dtype=torch.bool)),
        ({"walk": ((0.1, 0.2), (0.5, 0.6))}, ((TIME >= 0.1) & (TIME <= 0.2)) | ((TIME >= 0.5) & (TIME <= 0.6))),
        ({"other": ((0.1, 0.2),)}, torch.zeros(FRAMES, dtype=torch.bool)),
        (NearPlace((0.0, 0.0, 1.0)), (TIME < 0.305)),
        ("loaded", TIME > 0.8),
    ],
)
def test_when_a_contact_bears(when, expected):
    """Always, in intervals of its trial, near a place for a while but not in passing, or while its plate is loaded."""
    x = torch.where(TIME < 0.305, 0.0, torch.where((TIME > 0.5) & (TIME < 0.55), 0.02, 0.3))
    middle = torch.stack([x, torch.zeros_like(x), torch.ones_like(x)], dim=1)
    handle = torch.where((TIME > 0.8)[:, None, None], 30.0, 3.0).expand(FRAMES, 1, 6).double().clone()
    forces = Forces(TIME, handle, (Plate("handle", None, number=3),))
    options = ContactOptions(others={"rail": OtherContact("hand_r", when, plate=3)})
    found = find_others(options, {"rail": middle}, "walk", TIME, forces)
    assert found is not None and found.column == (0,)
    torch.testing.assert_close(found.bearing[:, 0], expected)
    assert find_others(ContactOptions(), {}, "walk", TIME, forces) is None


def test_feet_answer_for_their_own_forces_alone():
    """Plates of other contacts, and frames in which an unmeasured one bears, are not held against feet."""
    forces = Forces(TIME, FEET, two_plates())
    named = ContactOptions(others={"rail": OtherContact("hand_r", plate=2)})
    left = feet_alone(named, "walk", forces)
    assert left is not None and [p.name for p in left.plates] == ["left"]
    part = ContactOptions(others={"rail": OtherContact("hand_r", {"walk": ((0.3, 0.7),)})})
    left = feet_alone(part, "walk", forces)
    assert left is not None and int(torch.isnan(left.wrench[:, 0, 0]).sum()) == 41
    assert feet_alone(ContactOptions(others={"rail": OtherContact("hand_r", "always")}), "walk", forces) is None


def test_rows_of_patches_are_zero_for_what_they_expect(seed: int):
    """A force through the middle of a patch along its normal costs nothing, another one what it deviates."""
    generator = torch.Generator().manual_seed(seed)
    axes = axes_about(torch.randn(3, generator=generator, dtype=torch.float64))
    torch.testing.assert_close(axes @ axes.T, torch.eye(3, dtype=torch.float64))
    assert float(torch.linalg.det(axes)) == pytest.approx(1.0)
    middle = torch.randn(3, generator=generator, dtype=torch.float64)
    corners = torch.stack([middle + a * 0.1 * axes[0] + b * 0.05 * axes[1] for a in (-1, 1) for b in (-1, 1)])
    patch = Patch(corners[None], axes, 1.0)
    rows = patch_rows(patch, torch.tensor([200.0]).double())[0]

    def costs(at: torch.Tensor, force: torch.Tensor) -> torch.Tensor:
        return rows @ torch.cat([force, torch.linalg.cross(at, force)])

    torch.testing.assert_close(costs(middle, 200.0 * axes[2]), torch.zeros(5).double(), atol=1e-9, rtol=0.0)
    off = costs(middle + 0.1 * axes[0], 200.0 * axes[2])
    torch.testing.assert_close(off.abs(), torch.tensor([0.0, math.sqrt(3.0), 0.0, 0.0, 0.0]).double())
    leaning = costs(middle, 200.0 * axes[2] + 40.0 * axes[1])
    torch.testing.assert_close(leaning.abs(), torch.tensor([0.0, 0.0, 0.0, 0.0, 1.0]).double(), atol=1e-9, rtol=1e-9)


def test_the_rest_is_as_unlikely_as_the_error_of_the_need():
    """A wrench of one standard deviation about the body costs one."""
    sd = torch.tensor([5.0, 5.0, 5.0, 2.0, 2.0, 2.0]).double()
    rest = rest_of(Needed(torch.zeros(FRAMES, 6).double(), torch.ones(FRAMES, dtype=torch.bool), sd, COM))
    wrench = torch.cat([pushing(5.0, 0.0, 0.0), torch.linalg.cross(COM, pushing(5.0, 0.0, 0.0))], dim=1)
    costs = (rest.rows @ wrench[..., None])[..., 0]
    torch.testing.assert_close(costs, torch.tensor([1.0, 0, 0, 0, 0, 0]).double().expand(FRAMES, 6), atol=1e-9, rtol=0)


def refused(text: str, tmp_path: Path) -> InvalidConfig:
    """What a config says whose contacts are these."""
    path = tmp_path / "config.yaml"
    path.write_text(
        "subject: {name: a}\nmarkers: simulated\ntrials: [{name: walk, file: walk.c3d}]\n"
        f"contact: {{others: {{rail: {text}}}}}\n"
    )
    with pytest.raises(InvalidConfig) as refusal:
        load_config(path)
    return refusal.value


@pytest.mark.parametrize(
    ("text", "code", "said"),
    [
        ("{segment: hand_r}", "contact.when", "when: always"),
        ("{segment: hand_r, when: {walk: [[2, 1]]}}", "contact.interval", "2.0 to 1.0 s"),
        ("{segment: hand_r, when: {wlak: [[1, 2]]}}", "config.unknown_trial", "wlak"),
        ("{segment: hand_r, when: always, push: [0, 0, 0]}", "contact.push", "forward"),
        ("{segment: hand_r, when: always, push: left}", "config.unknown_value", "'up', 'forward' or 'free'"),
        ("{segmnt: hand_r, when: always}", "config.missing_key", "Did you mean 'segment'?"),
        ("{segment: hand_r, when: {at_m: [0, 0]}}", "config.missing_key", "at_m"),
        ("{segment: hand_r, when: always, friction: 0}", "config.invalid_value", "greater than 0"),
    ],
)
def test_configs_of_contacts_are_refused_with_a_remedy(text: str, code: str, said: str, tmp_path: Path):
    """Each says where, what was found and what to do."""
    error = refused(text, tmp_path)
    assert error.problems[0].code == code and said in str(error)
    assert all(problem.place.startswith("contact.others.rail") or problem.place == "" for problem in error.problems)


def test_an_option_of_a_contact_is_refused_without_a_config_too():
    """The same as an error of its own."""
    with pytest.raises(OptionError) as refusal:
        OtherContact("hand_r")
    assert refusal.value.code == "contact.when"


@pytest.mark.parametrize(
    ("name", "contact", "code", "said"),
    [
        ("rail", OtherContact("hand", "always"), "contact.segment", "hand_r"),
        ("hand_r", OtherContact("hand_r", "always"), "contact.name", "rail or seat"),
        ("rail", OtherContact("hand_r", "always", ("LFIN",)), "contact.points", "RFIN"),
        ("rail", OtherContact("shank_r", "always"), "contact.push", "up, forward, free"),
        ("rail", OtherContact("hand_r", plate=9), "contact.plate", "1, 2, 3, 4"),
        ("rail", OtherContact("hand_r", {"arms": ((50.0, 51.0),)}), "contact.interval", "The trial is from 0.00"),
    ],
)
def test_contacts_that_the_session_does_not_have_are_refused(name: str, contact: OtherContact, code: str, said: str):
    """Segment, marker, plate and interval are looked up in the session."""
    trials = {item.trial.name: item.trial for item in small_session.session().trials}
    config = load_config(small_session.config())
    config = config.model_copy(update={"contact": ContactOptions(others={name: contact})})
    with pytest.raises((ConfigError, DataError)) as refusal:
        check_others(config.contact, small_session.assignment(), trials)
        refuse_unknown_plates(config.contact, trials.values())
    assert refusal.value.code == code and said in refusal.value.remedy


@pytest.mark.slow
def test_a_plate_that_no_trial_has_is_refused_before_the_fit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Also where trials with a device on are left to an evaluation, which may be those that have the plate."""
    config = load_config(small_session.config())
    worn = config.trials[-1].model_copy(update={"condition": "on"})
    contact = ContactOptions(others={"rail": OtherContact("hand_r", "loaded", plate=9)})
    conditions = {"without": Condition(reference=True), "on": Condition(device="exo")}
    config = config.model_copy(update={"trials": (*config.trials[:-1], worn), "conditions": conditions,
                                       "contact": contact, "out": tmp_path})  # fmt: skip
    monkeypatch.setattr(sequence, "compute_outcome", lambda *given: pytest.fail("the body was fitted first"))
    with pytest.raises(ConfigError) as refusal:
        sequence.run_experiment(config)
    assert refusal.value.code == "contact.plate" and "1, 2, 3, 4" in refusal.value.remedy


def test_trials_are_read_until_all_plates_are_found():
    """A recording that tells nothing more stays closed."""
    config = load_config(small_session.config())
    config = config.model_copy(update={"contact": ContactOptions(others={"rail": OtherContact("hand_r", plate=2)})})
    (first, *_) = (item.trial for item in small_session.session().trials)
    rest = iter([first, first])
    refuse_unknown_plates(config.contact, chain([first], rest))
    assert len(list(rest)) == 2


def hidden_case(seed: int, seated: bool) -> tuple:
    """The run of the small session, and a contact that is drawn in one of its trials."""
    generator = torch.Generator().manual_seed(seed)
    session, outcome = small_session.session(), small_session.outcome()
    draw = hidden_contact.draw_seat if seated else hidden_contact.draw_hand
    return session, outcome, draw(session, "squats" if seated else "arms", generator), generator


@pytest.mark.slow
@pytest.mark.parametrize("seated", [False, True])
def test_a_hidden_contact_is_found_and_not_taken_for_mass(seated: bool, seed: int):
    """Its force comes out of what the plates lack; masses and torques are as good as if nobody had held on."""
    session, outcome, hidden, _ = hidden_case(seed, seated)
    less = hidden_contact.without(outcome.session.trials[hidden.trial], hidden)
    found = hidden_contact.told(outcome, less, hidden, hidden.contact)
    said = hidden_contact.answers(outcome, found, session, hidden)
    assert said.force_N < 15.0, said
    assert said.torque_Nm < max(said.untold_Nm / 3.0, 1.5 * said.plain_Nm), said
    masses = [hidden_contact.mass_error(one, session) for one in (outcome, found)]
    assert masses[1] < masses[0] + 0.15, masses
    told = found.followed[hidden.trial].contact
    assert told is not None and not bool((told.used & told.unmeasured).any()) and bool(told.supported.all())


@pytest.mark.slow
def test_a_handle_on_its_own_plate_keeps_all_frames(seed: int):
    """Nothing is left out, and the arm's torques are what they are."""
    session, outcome, hidden, generator = hidden_case(seed, False)
    handle = hidden_contact.with_handle(outcome.session.trials[hidden.trial], hidden, generator)
    assert handle.forces is not None
    found = hidden_contact.told(outcome, handle, hidden, hidden.measured(len(handle.forces.plates)))
    said = hidden_contact.answers(outcome, found, session, hidden)
    assert said.force_N < 3.0 and said.torque_Nm < max(3.0, 1.5 * said.plain_Nm), said
    before, now = (one.followed[hidden.trial].contact for one in (outcome, found))
    assert before is not None and now is not None and int(now.used.sum()) >= int(before.used.sum()) - 2


@pytest.mark.slow
def test_what_is_said_of_a_contact_reaches_files_and_figures(seed: int):
    """Names, sources and deviations stand in the motion file; the timeline has a line for the rail."""
    _, outcome, hidden, _ = hidden_case(seed, False)
    less = hidden_contact.without(outcome.session.trials[hidden.trial], hidden)
    found = hidden_contact.told(outcome, less, hidden, hidden.contact)
    item = found.followed[hidden.trial]
    under = wrenches_under(item, found.fit, found.phi, less, found.config.contact)
    assert under is not None
    told = replace(found, under={hidden.trial: under})
    data = motion_dataset(told, hidden.trial)
    assert data["contact"].values.tolist() == ["foot_l", "foot_r", "rail"]
    assert data["contact_body"].values.tolist()[-1] == "hand_r"
    assert item.contact is not None
    bears = item.contact.unmeasured.numpy()
    assert (data["contact_source"].values[bears, 2] == WrenchSource.PREDICTED).all()
    assert (data["contact_wrench_sd"].values[bears, 2, :3] > 0.0).all()
    figure = contacts_figure(told)
    assert figure is not None and "rail beside plates" in figure.svg
    unsaid = replace(found.config.contact, torques="shared")
    blank = torques(
        item, found.fit.model.tree, found.fit.geometry, found.phi, less,
        wrenches_under(item, found.fit, found.phi, less, unsaid),
    )  # fmt: skip
    arm = limb(found.fit.model.tree, "hand_r")
    assert bool(torch.isnan(blank[item.contact.unmeasured][:, arm]).all())
    assert bool(torch.isfinite(blank[item.contact.used][:, arm]).all())
    drawn = outcome_draws(replace(told, torque=outcome.torque), [hidden.trial], 8, seed)
    assert bool((drawn.sd(hidden.trial)[item.contact.unmeasured][:, arm] > 0.0).all())
    tree, motion = found.fit.model.tree, item.motion
    given = tree, found.fit.geometry, found.phi, motion
    with_hand, plain = low_back(*given, contact_loads(item, less, under)), low_back(*given)
    assert with_hand is not None and plain is not None
    at = poses(plan_tree(tree), motion.q.T.contiguous(), found.fit.geometry)
    axis = at.R[plan_tree(tree).position[tree.index("abdomen")], 2].T
    taken = (under.of("rail")[:, :3] * axis).sum(1)
    torch.testing.assert_close(plain.force - with_hand.force, taken, atol=1e-9, rtol=1e-9)


def test_a_handle_is_not_held_against_the_feet(seed: int):
    """What it reads is no foot's, and has most recordings refused: by chance it points at one; declared, nothing is
    said of it."""
    generator = torch.Generator().manual_seed(seed)
    session, config = small_session.session(), load_config(small_session.config())
    refused = 0
    for _ in range(HANDLES):
        hidden = hidden_contact.draw_hand(session, "arms", generator)
        hidden = replace(hidden, wrench=hidden.wrench * 60.0 / float(hidden.wrench[:, 2].abs().max()))
        pushed = replace(hidden, wrench=hidden.wrench * torch.sign(hidden.wrench[:, 2].sum()))
        trial = hidden_contact.with_handle(synchronise(session.trial("arms").trial), pushed, generator)
        assert trial.forces is not None
        options = ContactOptions(others={"rail": hidden.measured(len(trial.forces.plates))})
        left = on_feet(trial, options)
        assert left.forces is not None and len(left.forces.plates) == len(trial.forces.plates) - 1
        assert on_feet(trial, config.contact) is trial and not judge(left)
        refused += bool(judge(trial))
    assert refused >= at_least(REFUSED, HANDLES)


def test_frames_of_an_unmeasured_contact_are_counted_in_a_note():
    """The note names the contact and the trial."""
    contact = seen(Forces(TIME, FEET, two_plates()), rail())
    still = torch.zeros(FRAMES, 6, dtype=torch.float64)
    tracked = Tracked(TIME, still, torch.zeros(FRAMES, 1).double(), torch.ones(FRAMES, dtype=torch.bool))
    motion = Motion(TIME, still, still, still, Smoother(10.0, RATE))
    notes = _contact_notes({"stairs": Followed("stairs", tracked, motion, contact)})
    assert [note.code for note in notes] == ["contact.unmeasured"]
    assert "rail" in notes[0].message and notes[0].source == "stairs" and "39 frames" in notes[0].message


@pytest.mark.parametrize("segment", ["pelvis", "thigh_l", "thorax", "hand_r"])
def test_usual_places_are_where_segments_are_supported(segment: str):
    """Under pelvis and thighs, behind the trunk, at the middle of a hand's markers; markers and points can be named."""
    given, model = small_session.assignment(), small_session.template()
    tree, attachment = model.tree, given.attachment
    offset = model.geometry.geometry(model.geometry.mean).offset
    places = (tree, offset, attachment, attachment.mean)
    points = local_points(OtherContact(segment, "always"), *places)
    middle = points.mean(0)
    if segment == "pelvis":
        assert len(points) == 4 and -0.12 < float(middle[2]) < -0.06 and abs(float(middle[1])) < 1e-9
    elif segment == "thigh_l":
        assert float(middle[0]) < -0.04 and -0.4 < float(points[:, 2].min()) < float(points[:, 2].max()) < 0.0
    elif segment == "thorax":
        shoulder = offset[[tree.index("upper_arm_l"), tree.index("upper_arm_r")]].mean(0)
        assert float(middle[0]) < float(shoulder[0]) - 0.05 and float(points[:, 2].max()) < float(shoulder[2])
    else:
        own = attachment.mean[attachment.body == tree.index(segment)]
        torch.testing.assert_close(points, own.mean(0, keepdim=True))
        named = local_points(OtherContact(segment, "always", ("RFIN", (0.1, 0.0, 0.2))), *places)
        torch.testing.assert_close(named[0], attachment.mean[attachment.labels.index("RFIN")])
        assert named[1].tolist() == [0.1, 0.0, 0.2]


def test_a_trunk_without_arms_has_no_usual_place():
    """Nobody knows how high its shoulders are: points are asked for, and taken where they are given."""
    given, model = small_session.assignment(), small_session.template()
    bodies = tuple(replace(b, name=b.name.replace("upper_arm", "wing")) for b in model.tree.bodies)
    tree = replace(model.tree, bodies=bodies)
    places = (tree, torch.zeros(len(bodies), 3).double(), given.attachment, given.attachment.mean)
    with pytest.raises(ConfigError) as refusal:
        local_points(OtherContact("thorax", "always"), *places)
    assert refusal.value.code == "contact.points" and "points" in refusal.value.remedy and "wing" in refusal.value.found
    assert local_points(OtherContact("thorax", "always", ((-0.1, 0.0, 0.3),)), *places).tolist() == [[-0.1, 0.0, 0.3]]


def held(effort_n: float, column: int) -> Effort:
    """A joint beyond which the second and the last contact are, and which answers for all of their vertical force."""

    def effort(part: slice) -> tuple[torch.Tensor, torch.Tensor]:
        frames = len(TIME[part])
        rows = torch.zeros(frames, 1, column + 1, 6, dtype=torch.float64)
        rows[:, 0, [1, column], 2] = 10.0
        return rows, torch.full((frames, 1), 10.0 * effort_n, dtype=torch.float64)

    return effort


def test_joints_do_not_answer_twice_for_what_is_measured():
    """What a plate reads of a limb is taken off before its other contacts are told, beside the plates or shared."""
    smoother, always = Smoother(10.0, RATE), torch.ones(FRAMES, 2, dtype=torch.bool)
    handle, elbow = (acting((0.4, -0.3, z), pushing(0.0, 0.0, fz)) for z, fz in ((1.0, 60.0), (1.1, 30.0)))
    forces = Forces(TIME, FEET, two_plates())
    contact = seen(forces, Others(("elbow",), ("ulna_r",), always[:, :1], (-1,)))
    needed, patches = need(smoother(FEET.sum(1) + elbow), 10.0), {"elbow": grip((0.4, -0.3, 1.1))}
    given = contact, SOLES, forces, COM, smoother, needed
    found = contact_wrenches(*given, held(380.0, 2), patches=patches)  # foot_r's 350 N are measured
    assert float((found.of("elbow")[:, 2] - 30.0).abs().max()) < 2.0
    wrench = torch.cat([FEET, (handle + elbow)[:, None]], dim=1)
    forces = Forces(TIME, wrench, (*two_plates(), Plate("rail", None, number=3)))
    contact = seen(forces, Others(("left", "right"), ("hand_l", "hand_r"), always, (2, 2)))
    patches = {"left": grip((0.4, -0.3, 1.0)), "right": grip((0.4, -0.3, 1.1))}
    found = contact_wrenches(contact, SOLES, forces, COM, smoother, None, held(380.0, 3), patches=patches)
    assert float((found.of("right")[:, 2] - 30.0).abs().max()) < 2.0


def test_two_rails_of_a_model_without_soles_are_not_pooled():
    """Each is shared by its own hands, and a floor without feet is nobody's."""
    loads = [
        acting((0.5, y, 0.9), pushing(0.0, 0.0, fz)) for y, fz in ((0.3, 40.0), (0.1, 80.0), (-0.1, 5.0), (-0.3, 9.0))
    ]
    wrench = torch.stack([FEET.sum(1), loads[0] + loads[1], loads[2] + loads[3]], dim=1)
    plates = (Plate("floor", square(0.0, 0.0, 0.8), number=1), Plate("a", None, number=2), Plate("b", None, number=3))
    forces, names = Forces(TIME, wrench, plates), ("a_l", "a_r", "b_l", "b_r")
    always = torch.ones(FRAMES, 4, dtype=torch.bool)
    others = Others(names, ("hand_l", "hand_r", "ulna_l", "ulna_r"), always, (1, 1, 2, 2))
    contact = find_contact({}, forces, always[:, 0], RATE, 0.0, others=others)
    assert contact.floor == () and bool(contact.used.all()) and not bool(contact.untold[:, :0].any())
    patches = {name: grip((0.5, y, 0.9)) for name, y in zip(names, (0.3, 0.1, -0.1, -0.3), strict=True)}
    smoother = Smoother(10.0, RATE)
    found = contact_wrenches(contact, {}, forces, COM, smoother, patches=patches)
    assert bool((found.source == WrenchSource.SHARED).all())
    for first, plate in ((0, 1), (2, 2)):
        own = found.wrench[:, first : first + 2].sum(1)
        torch.testing.assert_close(own, smoother(wrench[:, plate]), atol=1e-5, rtol=1e-9)


def test_a_declared_hand_does_not_tell_of_feet_without_plates():
    """Torques of the legs stay unknown in a trial without plates, those of the arm while it bears.

    The model has no soles: nobody sees its feet touch.
    """
    outcome = small_session.outcome()
    outcome = replace(outcome, fit=replace(outcome.fit, model=replace(outcome.fit.model, landmarks={})))
    item = replace(outcome.followed["arms"], contact=None, wrench=None)
    trial = replace(outcome.session.trials["arms"], forces=None)
    options = ContactOptions(others={"rail": OtherContact("hand_r", {"arms": ((0.5, 1.0),)})})
    tree, time = outcome.fit.model.tree, item.motion.time
    under = wrenches_under(item, outcome.fit, outcome.phi, trial, options)
    found = torques(item, tree, outcome.fit.geometry, outcome.phi, trial, under)
    arm, leg = (found[:, [r for r in limb(tree, body) if r >= 6]] for body in ("hand_r", "foot_l"))
    bears = inside(((0.5, 1.0),), time)
    assert bool(torch.isnan(leg).all())
    assert bool(torch.isnan(arm[bears]).all()) and bool(torch.isfinite(arm[~bears]).all())


def test_a_recording_that_an_interval_covers_is_not_refused():
    """Nothing is left that feet must answer for, and that is no fault of the recording."""
    trial = small_session.session().trial("arms").trial
    config = load_config(small_session.config())
    contact = ContactOptions(others={"rail": OtherContact("hand_r", {"arms": ((-1.0, 1e3),)})})
    config = config.model_copy(update={"contact": contact})
    given = Given("arms", Path("arms.c3d"), on_feet=lambda one: on_feet(one, config.contact))
    assert given.disagreements(trial) == ()
    assert on_feet(synchronise(trial), config.contact).forces is None
