"""Contact is geometry: who stands where decides which frames the plates measure completely."""

import pytest
import torch

from torchid.contact.contact import find_contact
from torchid.contact.options import ContactOptions
from torchid.conventions import GRAVITY
from torchid.filters import Smoother
from torchid.geometry.tracking import Tracked
from torchid.motion import Motion
from torchid.recording import Forces, Plate
from torchid.run.sequence import _contact_notes
from torchid.session import Followed
from torchid.session.standing import Weight, falls_short

FRAMES, RATE = 100, 100.0
TIME = torch.arange(FRAMES, dtype=torch.float64) / RATE
ALL = torch.ones(FRAMES, dtype=torch.bool)


def foot(x: float, y: float, lift: slice | None = None) -> torch.Tensor:
    """Heel, ball and toes of a flat foot whose heel is at (x, y); lifted and moving within ``lift``."""
    flat = torch.tensor([[0.0, 0.0, 0.01], [0.17, 0.03, 0.01], [0.18, -0.03, 0.01], [0.24, 0.0, 0.01]]).double()
    points = (flat + torch.tensor([x, y, 0.0]).double()).expand(FRAMES, -1, -1).clone()
    if lift is not None:
        points[lift, :, 2] += 0.2
    return points


def plate(name: str, x: float, y: float, corners: bool = True) -> Plate:
    """0.6 m by 0.4 m about (x, y)."""
    square = [(x + a * 0.3, y + b * 0.2, 0.0) for a, b in ((1, 1), (1, -1), (-1, -1), (-1, 1))]
    return Plate(name, torch.tensor(square, dtype=torch.float64) if corners else None)


def pressing(*loads: tuple[float, float, float]) -> torch.Tensor:
    """Wrench of plates that bear a vertical force at (x, y) each."""
    columns = []
    for x, y, fz in loads:
        p, f = torch.tensor([x, y, 0.0]).double(), torch.tensor([0.0, 0.0, fz]).double()
        columns.append(torch.cat([f, torch.linalg.cross(p, f)]))
    return torch.stack(columns).expand(FRAMES, -1, -1).clone()


def two_plates(corners: bool = True) -> tuple[Plate, Plate]:
    return plate("left", 0.1, 0.21, corners), plate("right", 0.1, -0.21, corners)


def judge(feet: dict[str, torch.Tensor], wrench: torch.Tensor, plates: tuple[Plate, ...], seen=ALL, spread=0.0):
    return find_contact(feet, Forces(TIME, wrench, plates), seen, RATE, spread)


BOTH = {"foot_l": foot(0.0, 0.15), "foot_r": foot(0.0, -0.15)}
LOADED = pressing((0.1, 0.15, 350.0), (0.1, -0.15, 350.0))


@pytest.mark.parametrize("corners", [True, False])
def test_each_foot_on_its_plate(corners):
    """Two feet on two plates: all frames count and each plate carries its foot, with corners or without."""
    found = judge(BOTH, LOADED, two_plates(corners))
    assert bool(found.touching.all() and found.supported.all() and found.used.all())
    assert found.plate.unique(dim=0).tolist() == [[0, 1]] and found.excluded == 0


@pytest.mark.parametrize("corners", [True, False])
def test_a_foot_beside_the_plates_takes_its_frames_out(corners):
    """A foot that stands beside the plates is not supported; the other one is; no frame counts."""
    feet = {"foot_l": foot(0.0, 0.15), "foot_r": foot(1.2, -0.15)}
    found = judge(feet, pressing((0.1, 0.15, 350.0), (0.1, -0.15, 0.0)), two_plates(corners))
    assert bool(found.supported[:, 0].all()) and not bool(found.supported[:, 1].any())
    assert not bool(found.used.any()) and found.excluded == FRAMES


def test_two_feet_on_one_plate_count_but_cannot_be_told_apart():
    """The total is measured although the plate belongs to neither foot."""
    feet = {"foot_l": foot(0.0, 0.09), "foot_r": foot(0.0, -0.09)}
    found = judge(feet, pressing((0.1, 0.0, 700.0)), (plate("one", 0.1, 0.0),))
    assert bool(found.used.all()) and bool((found.plate < 0).all())


def test_flight_is_measured():
    """In the air nothing touches and the plates' silence is the truth."""
    air = slice(40, 60)
    feet = {name: foot(0.0, y, air) for name, y in (("foot_l", 0.15), ("foot_r", -0.15))}
    wrench = LOADED.clone()
    wrench[air] = 0.0
    found = judge(feet, wrench, two_plates())
    assert not bool(found.touching[45:55].any()) and bool(found.used.all())


@pytest.mark.parametrize(
    ("silent", "out"), [(slice(50, 54), 0), (slice(50, 75), 25), (slice(0, 4), 4), (slice(96, 100), 4)]
)
def test_short_silences_are_the_plates_threshold(silent, out):
    """Silent for 40 ms, a plate without corners was below its threshold; longer, or cut by an end, it was not."""
    wrench = LOADED.clone()
    wrench[silent, 1] = 0.0
    found = judge(BOTH, wrench, two_plates(corners=False))
    assert found.excluded == out
    assert bool((found.used == found.supported.all(dim=1)).all())


def test_missing_forces_spread_as_far_as_the_filter_carries_them():
    """Frames without forces, and those within the spread of them, do not count."""
    wrench = LOADED.clone()
    wrench[50:53] = torch.nan
    found = judge(BOTH, wrench, two_plates(), spread=0.05)
    assert (~found.measured).nonzero()[:, 0].tolist() == [50, 51, 52]
    assert (~found.used).nonzero()[:, 0].tolist() == list(range(45, 58))


def test_unseen_motion_is_not_used_but_stays_measured():
    """Without markers the plates still measure."""
    seen = ALL.clone()
    seen[:10] = False
    found = judge(BOTH, LOADED, two_plates(), seen=seen)
    assert bool(found.measured.all()) and int(found.used.sum()) == FRAMES - 10


def test_edge_of_a_plate_has_a_margin():
    """Toes over the edge by less than the margin still stand on the plate; by more they do not."""
    feet = lambda over: {"foot_l": foot(0.4 - 0.24 + over, 0.15), "foot_r": foot(0.0, -0.15)}  # noqa: E731
    margin = ContactOptions().margin_m
    assert bool(judge(feet(0.5 * margin), LOADED, two_plates()).used.all())
    assert not bool(judge(feet(2.0 * margin), LOADED, two_plates()).used.any())


def test_toes_push_until_they_leave():
    """A foot beside the plates touches while its toes gather speed near the ground, not only while they are slow."""
    points = foot(1.2, -0.15)
    gathering = 10.0 * (TIME - 0.5).clamp(min=0.0)  # m/s
    points[..., 0] += (gathering.cumsum(0) / RATE)[:, None]
    points[TIME > 0.8, :, 2] += 0.2
    found = judge({"foot_l": BOTH["foot_l"], "foot_r": points}, LOADED, two_plates())
    last = int(found.touching[:, 1].nonzero()[-1])
    assert float(gathering[last]) == pytest.approx(ContactOptions().leaving_m_s, abs=0.15)
    # The same speed without a contact before it is a swing.
    found = judge({"foot_l": BOTH["foot_l"], "foot_r": points.flip(0)}, LOADED, two_plates())
    first = int(found.touching[:, 1].nonzero()[0])
    assert float(gathering.flip(0)[first]) <= ContactOptions().speed_m_s + 0.1


def test_a_lack_of_weight_takes_frames_out():
    """Where the weight is known, frames that miss a share of it do not count, whatever the feet seem to do."""
    short = torch.zeros(FRAMES, dtype=torch.bool)
    short[30:50] = True
    found = find_contact(BOTH, Forces(TIME, LOADED, two_plates()), ALL, RATE, 0.0, short=short)
    assert bool((found.used == ~short).all()) and found.excluded == 0 and found.short == 20


def test_frames_that_contact_takes_out_are_told_with_their_number():
    """By trial and by reason; a trial whose feet are all on plates, or that has none, says nothing."""
    short = torch.zeros(FRAMES, dtype=torch.bool)
    short[30:50] = True
    feet = {"foot_l": foot(0.0, 0.15), "foot_r": foot(1.2, -0.15, slice(0, 60))}
    forces = Forces(TIME, LOADED, two_plates())
    contacts = {
        "sound": judge(BOTH, LOADED, two_plates()),
        "none": None,
        "beside": find_contact(feet, forces, ALL, RATE, 0.0),
        "short": find_contact(BOTH, forces, ALL, RATE, 0.0, short=short),
    }
    row = torch.zeros(FRAMES, 6, dtype=torch.float64)
    tracked, motion = Tracked(TIME, row, row, ALL), Motion(TIME, row, row, row, Smoother(10.0, RATE))
    notes = _contact_notes({name: Followed(name, tracked, motion, contact) for name, contact in contacts.items()})
    assert [(note.code, note.source) for note in notes] == [("contact.beside", "beside"), ("contact.short", "short")]
    beside = contacts["beside"]
    assert beside is not None and 0 < beside.excluded < FRAMES
    assert notes[0].message.startswith(f"{beside.excluded} of {FRAMES} frames") and notes[1].message.startswith("20 ")


def test_a_foot_over_an_edge_counts_while_the_weight_is_there():
    """Toes beyond the plate may bear or not: the balance decides, and without it the frames are left out."""
    over = {**BOTH, "foot_l": foot(0.22, 0.15)}
    wrench = pressing((0.3, 0.15, 350.0), (0.1, -0.15, 350.0))
    assert not judge(over, wrench, two_plates()).used.any()
    none = torch.zeros(FRAMES, dtype=torch.bool)
    assert find_contact(over, Forces(TIME, wrench, two_plates()), ALL, RATE, 0.0, short=none).used.all()


@pytest.mark.parametrize("missing, lasts_s, short", [(0.2, 0.3, True), (0.04, 0.3, False), (0.2, 0.02, False)])
def test_weight_that_is_missing_for_a_while(missing, lasts_s, short):
    """A fifth of the weight is missed, a twenty-fifth and a fiftieth of a second are not."""
    weight = Weight(70.0, 0.3, ("static",))
    needed = torch.full((FRAMES,), GRAVITY * weight.mass).double()
    vertical = needed.clone()
    vertical[30 : 30 + round(lasts_s * RATE)] *= 1.0 - missing
    found = falls_short(vertical, needed, weight, RATE, ContactOptions())
    assert bool(found.any()) == short
    if short:
        assert bool(found[32:58].all()) and not bool(found[:25].any()) and not bool(found[65:].any())


def test_weight_that_is_missing_throughout_is_for_the_diagnosis():
    """A subject who hangs in a harness all along has no contact that comes or goes."""
    weight = Weight(70.0, 0.3, ("static",))
    needed = torch.full((FRAMES,), GRAVITY * weight.mass).double()
    assert not falls_short(0.7 * needed, needed, weight, RATE, ContactOptions()).any()


def test_a_foot_that_swings_past_is_on_no_belt():
    """A foot that passes the other's pressure at 3 m/s for a tenth of a second stands on the floor afterwards."""
    swinging = foot(0.0, -0.1)
    swinging[:30, :, 0] -= torch.linspace(0.9, 0.0, 30).double()[:, None]
    swinging[:5, :, 2] += 0.2
    wrench = pressing((0.1, 0.0, 700.0))
    found = judge({"foot_l": foot(0.0, 0.03), "foot_r": swinging}, wrench, (plate("one", 0.1, 0.05),))
    assert not found.belt.any()
    assert bool(found.touching[40:, 1].all())
