"""What effects follow: a coordinate of the model, or the same angle in another order of turns."""

import os
import time as clock

import pytest
import torch
from torch.testing import assert_close

from torchid.effects.angles import BEFORE, bend, lively, readings
from torchid.effects.effect import Planted
from torchid.effects.joints import JointCentreShift
from torchid.effects.place import Place
from torchid.effects.scene import make_scene
from torchid.errors import ConfigError
from torchid.filters import Smoother
from torchid.motion import Motion
from torchid.simulate.options import SimulateOptions
from torchid.simulate.subject import simulate_subject

SEED = int(os.environ.get("TORCHID_SEED", clock.time_ns() % 2**32))
FLEXION, REORDERED = "shoulder_l_flexion", f"shoulder_l_flexion{BEFORE}shoulder_l_adduction"


def moving(**swings: float):
    """A scene in which coordinates of the left shoulder swing by so many radians, each at its own pace."""
    print(f"repeat with TORCHID_SEED={SEED}")  # noqa: T201
    subject = simulate_subject(SimulateOptions(), SEED)
    time = torch.arange(200).double() / 100.0
    q = torch.zeros(200, len(subject.model.tree.dofs)).double()
    for k, (name, swing) in enumerate(swings.items()):
        pace = 1.0 + 0.37 * k
        q[:, subject.model.tree.dof_names.index(f"shoulder_l_{name}")] = swing * torch.sin(6.0 * pace * time)
    still = torch.zeros_like(q)
    motion = Motion(time, q, still, still, Smoother(10.0, 100.0))
    return make_scene("arms", subject.model.tree, subject.geometry, motion, subject.phi)


def pointing(scene) -> torch.Tensor:
    """Angle forward of the vertical at which the arm points, seen from the side of the thorax."""
    thorax, arm = (scene.state.at.R[scene.at(name)] for name in ("thorax", "upper_arm_l"))
    long = -torch.einsum("crt,rt->ct", thorax, arm[2])
    return torch.atan2(long[0], -long[2])


def test_before_abduction_flexion_is_where_the_arm_points():
    """Whatever it turns about itself; the model's own flexion is another angle by then."""
    scene = moving(flexion=1.0, rotation=0.6, adduction=-1.0)
    angle = pointing(scene)
    expected = torch.stack([torch.sin(angle), 1.0 - torch.cos(angle)])
    assert_close(bend(scene, Place(("shoulder_l",), follows=REORDERED)), expected)
    assert float((bend(scene, Place(("shoulder_l",), follows=FLEXION)) - expected).abs().max()) > 0.1


def test_the_models_own_order_is_its_coordinate():
    """Named in full or not."""
    scene = moving(flexion=1.0, rotation=0.6, adduction=-1.0)
    full = Place(("shoulder_l",), follows=f"{FLEXION}{BEFORE}shoulder_l_rotation")
    assert_close(bend(scene, full), bend(scene, Place(("shoulder_l",), follows=FLEXION)))


def test_another_order_is_a_place_only_where_it_is_another_angle():
    """An arm that is only lifted forward has one flexion; a knee has one anyway."""
    forward, both = moving(flexion=1.0), moving(flexion=1.0, rotation=0.6, adduction=-1.0)
    assert readings([forward], FLEXION) == (FLEXION,)
    assert readings([forward, both], FLEXION) == (FLEXION, REORDERED)
    assert readings([both], "shoulder_l_adduction") == ("shoulder_l_adduction",)
    assert readings([both], "knee_l_flexion") == ("knee_l_flexion",)
    assert lively([both], both.tree.index("upper_arm_l"))[0] in (FLEXION, "shoulder_l_adduction")


def test_a_glide_may_follow_either():
    """Bodies beyond the joint move with the angle that is named."""
    scene, theta = moving(flexion=1.0, rotation=0.6, adduction=-1.0), torch.tensor([0.0, 0, 0, 0.01, 0, 0]).double()
    moved = [
        JointCentreShift().move(scene, Place(("shoulder_l",), follows=angle), theta) for angle in (FLEXION, REORDERED)
    ]
    hand = scene.at("hand_l")
    thorax = scene.state.at.R[scene.at("thorax")][0]
    assert_close(moved[1][hand, :3], 0.01 * (1.0 - torch.cos(pointing(scene))) * thorax)
    assert float((moved[0] - moved[1]).abs().max()) > 1e-3
    assert Planted(JointCentreShift(), Place(("shoulder_l",), follows=REORDERED), theta).load(scene).isfinite().all()


@pytest.mark.parametrize("follows", ["shoulder_l_bending", f"{FLEXION}{BEFORE}elbow_l_flexion", f"knee_l{BEFORE}hip"])
def test_an_angle_that_the_model_has_not(follows):
    """It is named in the error."""
    with pytest.raises(ConfigError, match=follows):
        bend(moving(flexion=1.0), Place(("shoulder_l",), follows=follows))
