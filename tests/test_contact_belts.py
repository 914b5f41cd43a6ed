"""Contact on moving ground: treadmill belts, and which foot a plate carries."""

import pytest
import torch
from torch import Tensor
from torch.testing import assert_close

from torchid.contact.contact import find_contact
from torchid.recording import Forces, Plate

RATE = 100.0
STANCE, SWING = 60, 40
HEEL_TO_TOE = torch.tensor([[0.0, 0.0, 0.0], [0.10, 0.03, 0.0], [0.12, -0.03, 0.0], [0.22, 0.0, 0.0]]).double()


def steps(belt: float, y: float, phase: int, frames: int = 400) -> tuple[Tensor, Tensor]:
    """Sole points (frames, 4, 3) of a foot that rides back with the belt and is carried forward, and its stance."""
    cycle = ((torch.arange(frames) + phase) % (STANCE + SWING)).double()
    stance = cycle < STANCE
    back = -belt * cycle / RATE
    length = belt * STANCE / RATE
    swing = (cycle - STANCE) / SWING
    x = torch.where(stance, back, -length + (length * swing))
    z = torch.where(stance, 0.02, 0.02 + 0.15 * torch.sin(torch.pi * swing.clamp(0.0, 1.0)))
    place = torch.stack([x, torch.full_like(x, y), z], dim=1).double()
    return place[:, None] + HEEL_TO_TOE, stance


def plate_under(points: Tensor, loaded: Tensor) -> Tensor:
    """Wrench (frames, 6) of 700 N up at the middle of the foot while it stands."""
    centre = points.mean(dim=1) * torch.tensor([1.0, 1.0, 0.0]).double()
    force = torch.zeros(len(points), 3).double()
    force[:, 2] = 700.0 * loaded
    return torch.cat([force, torch.linalg.cross(centre, force)], dim=1)


def walk(belt: float) -> tuple[dict[str, Tensor], Forces, Tensor]:
    left, left_down = steps(belt, 0.1, 0)
    right, right_down = steps(belt, -0.1, 50)
    wrench = torch.stack([plate_under(left, left_down), plate_under(right, right_down)], dim=1)
    time = torch.arange(len(left)).double() / RATE
    return {"foot_l": left, "foot_r": right}, Forces(time, wrench, (Plate("l"), Plate("r"))), left_down


@pytest.mark.parametrize("belt", [0.0, 1.3, 4.0])
def test_stance_is_found_at_any_speed_of_the_ground(belt: float) -> None:
    """A foot that rides with the belt touches, whatever the belt's speed, and the belt's velocity is told."""
    soles, forces, stance = walk(belt)
    contact = find_contact(soles, forces, torch.ones(len(stance), dtype=torch.bool), RATE, 0.0)
    assert_close(contact.belt, torch.tensor([[-belt, 0.0]] * 2, dtype=torch.float64), atol=1e-9, rtol=0)
    inside = stance & stance.roll(3) & stance.roll(-3)
    assert bool(contact.touching[inside, 0].all())
    assert bool((contact.plate[inside, 0] == 0).all())
    assert contact.excluded == 0


def test_plate_belongs_to_its_foot_before_the_foot_counts_as_standing() -> None:
    """At strike and push-off a loaded plate is that of the only foot above it, so that no force is lost."""
    soles, forces, stance = walk(1.3)
    contact = find_contact(soles, forces, torch.ones(len(stance), dtype=torch.bool), RATE, 0.0)
    assert bool((contact.plate[stance, 0] == 0).all())
    assert bool((contact.plate[~stance, 0] == -1).all())


def test_plate_between_two_feet_is_shared() -> None:
    """A centre of pressure under neither of two standing feet is nobody's, not unloaded."""
    still = torch.zeros(50, 1, 3).double()
    soles = {
        "foot_l": still + HEEL_TO_TOE + torch.tensor([0, 0.2, 0]),
        "foot_r": still + HEEL_TO_TOE - torch.tensor([0, 0.2, 0]),
    }
    wrench = plate_under(still + HEEL_TO_TOE, torch.ones(50))[:, None]
    forces = Forces(torch.arange(50).double() / RATE, wrench, (Plate("one"),))
    contact = find_contact(soles, forces, torch.ones(50, dtype=torch.bool), RATE, 0.0)
    assert bool((contact.plate == -2).all())
    assert bool(contact.used.all())


def test_model_without_soles_uses_what_is_measured() -> None:
    """Without landmarks on the feet nothing can stand beside a plate, and only missing forces take frames out."""
    _, forces, stance = walk(1.3)
    forces.wrench[100:110] = torch.nan
    contact = find_contact({}, forces, torch.ones(len(stance), dtype=torch.bool), RATE, 0.02)
    assert int((~contact.used).sum()) == 10 + 2 * 2
    assert contact.excluded == 0


def test_foot_that_rests_on_a_box_takes_its_frames_out() -> None:
    """Standing still and flat 0.3 m above the ground is contact that no plate measures; the jump after it is flight."""
    height = torch.cat([torch.full((80,), 0.3), torch.linspace(0.3, 0.0, 25) ** 2 / 0.3, torch.zeros(95)]).double()
    place = torch.nn.functional.pad(height[:, None], (2, 0))[:, None]
    soles = {"foot_l": place + HEEL_TO_TOE, "foot_r": place + HEEL_TO_TOE}
    wrench = plate_under(place + HEEL_TO_TOE, height == 0.0)[:, None]
    forces = Forces(torch.arange(200).double() / RATE, wrench, (Plate("one"),))
    contact = find_contact(soles, forces, torch.ones(200, dtype=torch.bool), RATE, 0.0)
    assert not bool(contact.used[:80].any())
    assert bool(contact.used[90:].all())


def test_foot_that_swings_in_the_air_rests_on_nothing(seed: int) -> None:
    """A leg held up and circled slowly stays in the air, so that one-legged trials keep their frames."""
    turn = torch.linspace(0.0, 4.0 * torch.pi, 400, dtype=torch.float64) + float(torch.rand(1))
    place = torch.stack([0.1 * torch.cos(turn), 0.1 * torch.sin(turn), 0.3 + 0.05 * torch.cos(turn)], dim=1)[:, None]
    place[:40, :, 2] = 0.0
    still = torch.zeros(400, 1, 3).double() + torch.tensor([0.0, 0.3, 0.0])
    soles = {"foot_l": still + HEEL_TO_TOE, "foot_r": place + HEEL_TO_TOE}
    forces = Forces(
        torch.arange(400).double() / RATE, plate_under(still + HEEL_TO_TOE, torch.ones(400))[:, None], (Plate("one"),)
    )
    contact = find_contact(soles, forces, torch.ones(400, dtype=torch.bool), RATE, 0.0)
    assert bool(contact.used[50:].all())
