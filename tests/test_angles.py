"""What effects follow: a coordinate of the model, or the same angle in another order of turns."""

from dataclasses import replace

import pytest
import torch
from draws import seed_of
from torch.testing import assert_close

from torchid.effects.effect import Planted
from torchid.effects.joint_angles import bend, lively, orders
from torchid.effects.joint_centre import JointCentreShift
from torchid.effects.place import Angle, Place, parse_angle
from torchid.effects.scene import make_scene
from torchid.errors import ConfigError
from torchid.filters import Smoother
from torchid.motion import Motion
from torchid.simulate.options import SimulateOptions
from torchid.simulate.subject import simulate_subject

SEED = seed_of(__name__)
FLEXION = Angle("shoulder_l_flexion")
REORDERED = Angle("shoulder_l_flexion", "shoulder_l_adduction")


def moving(frames: int = 200, **swings: float):
    """A scene in which coordinates of the left shoulder swing by so many radians, each at its own pace."""
    subject = simulate_subject(SimulateOptions(), SEED)
    time = torch.linspace(0.0, 2.0, frames).double()
    q = torch.zeros(frames, len(subject.model.tree.dofs)).double()
    for k, (name, swing) in enumerate(swings.items()):
        pace = 1.0 + 0.37 * k
        q[:, subject.model.tree.dof_names.index(f"shoulder_l_{name}")] = swing * torch.sin(6.0 * pace * time)
    still = torch.zeros_like(q)
    motion = Motion(time, q, still, still, Smoother(10.0, frames / 2.0))
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
    full = Place(("shoulder_l",), follows=Angle("shoulder_l_flexion", "shoulder_l_rotation"))
    assert_close(bend(scene, full), bend(scene, Place(("shoulder_l",), follows=FLEXION)))


def test_another_order_is_a_place_only_where_it_is_another_angle():
    """An arm that is only lifted forward has one flexion; a knee has one anyway."""
    forward, both = moving(flexion=1.0), moving(flexion=1.0, rotation=0.6, adduction=-1.0)
    assert orders([forward], FLEXION.dof) == (FLEXION,)
    assert orders([forward, both], FLEXION.dof) == (FLEXION, REORDERED)
    for other in ("shoulder_l_adduction", "knee_l_flexion"):
        assert orders([both], other) == (Angle(other),)
    assert set(lively([both], both.tree.index("upper_arm_l"))) == {
        f"shoulder_l_{name}" for name in ("flexion", "rotation", "adduction")
    }


def test_an_arm_that_is_lifted_past_the_horizontal():
    """The angle goes on smoothly from frame to frame, but passes where it means little: it is offered nowhere."""
    scene = moving(4000, flexion=0.3, rotation=0.2, adduction=-1.9)
    course = bend(scene, Place(("shoulder_l",), follows=REORDERED))
    assert float(torch.diff(course).abs().max()) < 0.5
    assert orders([scene], FLEXION.dof) == (FLEXION,)


def test_it_counts_from_the_rest():
    """Of all three coordinates: a joint that rests bent is at zero there."""
    scene = moving(flexion=0.0, rotation=0.0, adduction=0.0)
    rests = {"shoulder_l_flexion": 0.3, "shoulder_l_rotation": 0.4, "shoulder_l_adduction": -0.8}
    dofs = tuple(replace(dof, rest=rests.get(dof.name, dof.rest)) for dof in scene.tree.dofs)
    q = torch.stack([torch.full_like(x, dof.rest) for x, dof in zip(scene.q, dofs, strict=True)])
    bent = replace(scene, q=q, tree=replace(scene.tree, dofs=dofs))
    course = bend(bent, Place(("shoulder_l",), follows=REORDERED))
    assert_close(course, torch.zeros_like(course), rtol=0.0, atol=1e-12)


def test_three_turns_about_two_axes_have_one_order():
    """As some files have them."""
    scene = moving(flexion=1.0, rotation=0.6, adduction=-1.0)
    tree, k = scene.tree, scene.tree.index("upper_arm_l")
    first, second, _ = tree.bodies[k].turns
    twice = replace(tree.bodies[k], turns=(first, second, replace(tree.bodies[k].turns[2], axis=first.axis)))
    same = replace(scene, tree=replace(tree, bodies=(*tree.bodies[:k], twice, *tree.bodies[k + 1 :])))
    assert orders([same], FLEXION.dof) == (FLEXION,)


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


@pytest.mark.parametrize(
    "follows", ["shoulder_l_bending", "shoulder_l_flexion before elbow_l_flexion", "knee_l before hip", "knee before "]
)
def test_an_angle_that_the_model_has_not(follows):
    """It is named in the error."""
    with pytest.raises(ConfigError, match=follows):
        bend(moving(flexion=1.0), Place(("shoulder_l",), follows=parse_angle(follows)))
