"""The built-in template: tree, signs, geometry prior, ties, locks and landmarks."""

import math

import numpy as np
import pytest
import torch
from documentation.joints import joint_table
from scipy.spatial.transform import Rotation

from torchid.errors import ConfigError
from torchid.kinematics.plan import plan_tree
from torchid.model.geometry_prior import group, tie_sides
from torchid.model.landmarks import COVER, LANDMARKS, PELVIC_TILT
from torchid.model.skeleton import SEGMENTS
from torchid.model.whole_body import lock_bodies, whole_body

PEOPLE = [(1.755, 77.0, "male"), (1.63, 60.0, "female"), (None, None, "unknown"), (1.2, 25.0, "unknown")]
MIRROR = np.diag([1.0, -1.0, 1.0])


def poses(tree, geometry, q):
    """Poses of all bodies by plain composition: an independent reference for this template."""
    R, p = [Rotation.from_rotvec(q[3:6])], [q[:3]]
    for k, body in enumerate(tree.bodies[1:], start=1):
        turn = R[body.parent]
        p.append(p[body.parent] + turn.apply(geometry.offset[k].numpy()))
        for t in body.turns:
            angle = t.sign * (q[t.row] if t.moving else float(geometry.hinge[t.row]))
            turn = turn * Rotation.from_rotvec(angle * np.eye(3)[t.axis])
        R.append(turn)
    return np.stack([r.as_matrix() for r in R]), np.stack(p)


def neutral(model):
    q = np.array([dof.rest for dof in model.tree.dofs])
    return poses(model.tree, model.geometry.geometry(model.geometry.mean), q)


def swapped(name):
    """The name of the other side."""
    return "_".join({"l": "r", "r": "l"}.get(part, part) for part in name.split("_"))


def random_pose(model, rng):
    return np.array([rng.uniform(-0.6, 0.6) for _ in model.tree.dofs])


@pytest.mark.parametrize("person", PEOPLE)
def test_neutral_pose_has_parallel_axes_for_any_hinge_angles(person):
    """In the neutral pose every body is aligned with W, however the hinge axes lean."""
    model = whole_body(*person)
    R, _ = neutral(model)
    np.testing.assert_allclose(R, np.broadcast_to(np.eye(3), R.shape), atol=1e-12)


def test_template_has_the_published_joints():
    """16 bodies and 41 coordinates, base first, and the lean recursion's plan accepts the tree."""
    tree = whole_body(1.75, 70.0, "male").tree
    assert tree.names == SEGMENTS and len(tree.dofs) == 41
    assert tree.dof_names[:6] == ("pelvis_x", "pelvis_y", "pelvis_z", "pelvis_rx", "pelvis_ry", "pelvis_rz")
    count = {body.name: sum(t.moving for t in body.turns) for body in tree.bodies}
    two, one = ("forearm", "hand", "foot"), ("shank",)
    for name, number in count.items():
        stem = name[:-2] if name.endswith(("_l", "_r")) else name
        assert number == (0 if name == "pelvis" else 2 if stem in two else 1 if stem in one else 3)
    assert len(plan_tree(tree).motion) == 35


@pytest.mark.parametrize("person", PEOPLE)
def test_neutral_heights_are_those_of_a_standing_person(person):
    """Hips near 0.53, knees near 0.285, shoulders near 0.80, neck near 0.86 of stature, ankles just above the floor."""
    model = whole_body(*person)
    _, p = neutral(model)
    z = dict(zip(SEGMENTS, p[:, 2] / model.height, strict=True))
    assert 0.51 < z["pelvis"] < 0.55 and 0.27 < z["shank_l"] < 0.30 and 0.03 < z["foot_r"] < 0.05
    assert 0.78 < z["upper_arm_l"] < 0.82 and 0.84 < z["head"] < 0.88
    assert 0.43 < z["hand_r"] < 0.51


@pytest.mark.parametrize(
    ("dof", "body", "axis", "sign"),
    [
        ("hip_{}_flexion", "shank_{}", 0, 1),
        ("hip_{}_adduction", "shank_{}", 1, "inward"),
        ("knee_{}_flexion", "foot_{}", 0, -1),
        ("shoulder_{}_flexion", "forearm_{}", 0, 1),
        ("shoulder_{}_adduction", "forearm_{}", 1, "inward"),
        ("elbow_{}_flexion", "hand_{}", 0, 1),
        ("lower_spine_flexion", "head", 0, 1),
        ("upper_spine_bending", "head", 1, -1),
    ],
)
@pytest.mark.parametrize("side", ["l", "r"])
def test_positive_coordinates_move_the_anatomical_way(dof, body, axis, sign, side):
    """A positive coordinate displaces a distal joint centre forward, back, inward or to the right as its name says."""
    model = whole_body(1.75, 70.0, "male")
    tree, geometry = model.tree, model.geometry.geometry(model.geometry.mean)
    q = np.array([d.rest for d in tree.dofs])
    before = poses(tree, geometry, q)[1][tree.index(body.format(side))]
    q[tree.dof_names.index(dof.format(side))] += 0.3
    after = poses(tree, geometry, q)[1][tree.index(body.format(side))]
    inward = -1 if side == "l" else 1
    assert (after - before)[axis] * (inward if sign == "inward" else sign) > 0.02


@pytest.mark.parametrize("side", ["l", "r"])
def test_positive_turns_point_the_segment_the_anatomical_way(side):
    """Internal rotation, pronation, palmar flexion, ulnar deviation, dorsiflexion and inversion on either side."""
    model = whole_body(1.75, 70.0, "male")
    tree, geometry = model.tree, model.geometry.geometry(model.geometry.mean)
    medial = np.array([0.0, -1.0 if side == "l" else 1.0, 0.0])
    front, up = np.eye(3)[0], np.eye(3)[2]
    cases = [
        ("hip_{}_rotation", "thigh_{}", front, medial),
        ("shoulder_{}_rotation", "upper_arm_{}", front, medial),
        ("elbow_{}_pronation", "forearm_{}", front, medial),
        ("wrist_{}_flexion", "hand_{}", -up, medial),
        ("wrist_{}_deviation", "hand_{}", -up, -front),
        ("ankle_{}_flexion", "foot_{}", front, up),
        ("ankle_{}_inversion", "foot_{}", medial, up),
    ]
    for dof, body, direction, towards in cases:
        q = np.array([d.rest for d in tree.dofs])
        q[tree.dof_names.index(dof.format(side))] += 0.3
        R = poses(tree, geometry, q)[0][tree.index(body.format(side))]
        assert (R @ direction) @ towards > 0.1, dof


def test_mirrored_coordinates_give_mirrored_poses(seed):
    """Exchanging left and right coordinates, and flipping those of trunk and base that flip, mirrors every pose."""
    model = whole_body(1.70, 65.0, "female")
    tree, geometry = model.tree, model.geometry.geometry(model.geometry.mean)
    q = random_pose(model, np.random.default_rng(seed))
    flips = ("bending", "rotation")
    other = np.empty_like(q)
    for k, name in enumerate(tree.dof_names):
        value = q[tree.dof_names.index(swapped(name))]
        axial = swapped(name) == name
        other[k] = (
            -value if axial and (name.endswith(flips) or name in ("pelvis_y", "pelvis_rx", "pelvis_rz")) else value
        )
    R, p = poses(tree, geometry, q)
    R_other, p_other = poses(tree, geometry, other)
    order = [tree.index(swapped(name)) for name in tree.names]
    np.testing.assert_allclose(R_other, MIRROR @ R[order] @ MIRROR, atol=1e-12)
    np.testing.assert_allclose(p_other, p[order] @ MIRROR, atol=1e-12)


def test_subtalar_axis_leans_up_and_inwards_as_inman_found():
    """The inversion axis rises 42 degrees and deviates 23 degrees medially on both sides."""
    model = whole_body(1.75, 70.0, "male")
    tree, geometry = model.tree, model.geometry.geometry(model.geometry.mean)
    for side, inward in (("l", -1.0), ("r", 1.0)):
        q = np.zeros(len(tree.dofs))
        q[tree.dof_names.index(f"ankle_{side}_inversion")] = 0.2
        axis = Rotation.from_matrix(poses(tree, geometry, q)[0][tree.index(f"foot_{side}")]).as_rotvec() / 0.2
        axis *= np.sign(axis[0])
        assert math.degrees(math.asin(axis[2])) == pytest.approx(42.0)
        assert math.degrees(math.atan2(inward * axis[1], axis[0])) == pytest.approx(23.0)


@pytest.mark.parametrize("person", PEOPLE)
def test_geometry_prior_is_symmetric_and_of_full_rank(person):
    """Left and right have equal priors, every parameter moves the geometry, and no two move it alike."""
    prior = whole_body(*person).geometry
    assert np.linalg.matrix_rank(prior.map.numpy()) == len(prior.names) == len(set(prior.names))
    assert bool((prior.sd > 0).all())
    for name in prior.names:
        k, twin = prior.names.index(name), prior.names.index(swapped(name))
        assert prior.mean[k] == prior.mean[twin] and prior.sd[k] == prior.sd[twin]


def test_a_stature_that_is_not_given_widens_every_length():
    """Without height the lengths' scatter holds that of adults' stature."""
    given, free = whole_body(1.69, None, "unknown").geometry, whole_body(None, None, "unknown").geometry
    k = given.names.index("thigh_l_length")
    torch.testing.assert_close(free.mean[k], given.mean[k])
    expected = torch.hypot(given.sd[k], given.mean[k] * math.sqrt(0.095**2 - 0.01**2) / 1.69)
    torch.testing.assert_close(free.sd[k], expected)


def test_tied_sides_keep_the_mean_and_mirror_every_change(seed):
    """After tying, the mean geometry is the same and any xi gives a geometry that is its own mirror image."""
    model = whole_body(1.75, 70.0, "male")
    tied = tie_sides(model.geometry)
    assert not any("_l_" in name or "_r_" in name for name in tied.names)
    free, kept = model.geometry.geometry(model.geometry.mean), tied.geometry(tied.mean)
    torch.testing.assert_close(kept.offset, free.offset)
    torch.testing.assert_close(kept.hinge, free.hinge)
    xi = tied.mean + tied.sd * torch.tensor(np.random.default_rng(seed).normal(size=len(tied.names)))
    moved = tied.geometry(xi)
    order = [model.tree.index(swapped(name)) for name in model.tree.names]
    torch.testing.assert_close(moved.offset[order] * torch.tensor([1.0, -1.0, 1.0]), moved.offset)
    names = model.tree.hinges
    torch.testing.assert_close(moved.hinge[[names.index(swapped(name)) for name in names]], moved.hinge)


def test_grouped_bones_keep_their_proportions():
    """Bones of different length that share a parameter stretch by the same factor."""
    prior = whole_body(1.75, 70.0, "male").geometry
    merged = group(prior, ("thigh_l_length", "shank_l_length"), "leg_l")
    assert len(merged.names) == len(prior.names) - 1
    torch.testing.assert_close(merged.geometry(merged.mean).offset, prior.geometry(prior.mean).offset)
    xi = merged.mean.clone()
    xi[merged.names.index("leg_l")] *= 1.1
    offset, before = merged.geometry(xi).offset, prior.geometry(prior.mean).offset
    for body in ("shank_l", "foot_l"):
        k = SEGMENTS.index(body)
        torch.testing.assert_close(offset[k, 2] / before[k, 2], offset.new_tensor(1.1))
    with pytest.raises(ConfigError, match="thigh_l_len"):
        group(prior, ("thigh_l_len", "shank_l_length"), "leg")
    with pytest.raises(ConfigError, match="unit"):
        group(prior, ("thigh_l_length", "knee_l_axis_x"), "leg")


def test_locked_bodies_stand_as_in_the_full_model_with_their_joints_at_rest(seed):
    """Locking removes the joints' coordinates and leans, says so, and leaves the poses of the others as they were."""
    model = whole_body(1.75, 70.0, "male")
    locked, notes = lock_bodies(model, ("head", "abdomen", "hand_l", "foot_r", "shank_l"))
    gone = {"neck_flexion", "neck_bending", "neck_rotation", "wrist_l_flexion", "wrist_l_deviation", "knee_l_flexion"}
    gone |= {"lower_spine_flexion", "lower_spine_bending", "lower_spine_rotation"}
    gone |= {"ankle_r_flexion", "ankle_r_inversion"}
    assert set(model.tree.dof_names) - set(locked.tree.dof_names) == gone
    assert len(notes) == 1 and all(name in notes[0].message for name in gone)
    held = set(model.geometry.names) - set(locked.geometry.names)
    assert {"neck_x", "neck_z", "forearm_l_length", "wrist_l_x", "subtalar_r_axis_y", "knee_l_axis_x"} <= held
    assert {"lower_spine_z", "thigh_l_length", "shank_l_length", "ankle_l_x"}.isdisjoint(held)
    assert len(plan_tree(locked.tree).motion) == len(locked.tree.dofs) - 6
    q = random_pose(model, np.random.default_rng(seed))
    q[[model.tree.dof_names.index(name) for name in gone]] = 0.0
    short = q[[model.tree.dof_names.index(name) for name in locked.tree.dof_names]]
    full = poses(model.tree, model.geometry.geometry(model.geometry.mean), q)
    less = poses(locked.tree, locked.geometry.geometry(locked.geometry.mean), short)
    for a, b in zip(less, full, strict=True):
        np.testing.assert_allclose(a, b, atol=1e-12)


def test_locking_the_root_or_an_unknown_body_is_refused():
    """The root and unknown names raise an error that lists what can be locked."""
    model = whole_body(1.75, 70.0, "male")
    for name, found in (("pelvis", "the root"), ("tail", "")):
        with pytest.raises(ConfigError, match="abdomen") as caught:
            lock_bodies(model, (name,))
        assert (caught.value.code, caught.value.place, caught.value.found) == ("model.body", name, found)
    assert lock_bodies(model, ()) == (model, ())


@pytest.mark.parametrize(
    ("height", "mass", "sex", "code", "place", "found"),
    [
        (175.0, 70.0, "male", "subject.height", "height_m", "175"),
        (1.75, 0.07, "male", "subject.mass", "mass_kg", "0.07"),
        (1.75, 70.0, "m", "subject.sex", "sex", "'m'"),
    ],
)
def test_impossible_people_are_refused(height, mass, sex, code, place, found):
    """Centimetres, tonnes and unknown sexes raise a ConfigError that names the key and what it holds."""
    with pytest.raises(ConfigError) as caught:
        whole_body(height, mass, sex)
    assert (caught.value.code, caught.value.place, caught.value.found) == (code, place, found) and caught.value.remedy


@pytest.mark.parametrize("person", PEOPLE)
def test_landmarks_are_mirrored_and_bracket_their_joint_centres(person):
    """Left and right landmarks mirror; lateral and medial ones have the joint centre in their middle within 2 mm."""
    model = whole_body(*person)
    assert set(model.landmarks) == set(LANDMARKS)
    for name, mark in model.landmarks.items():
        other = model.landmarks[swapped(name)]
        assert other.segment == swapped(mark.segment) and other.sd == mark.sd
        np.testing.assert_allclose(other.p_BM_B, np.multiply(mark.p_BM_B, (1, -1 if other is not mark else 1, 1)))
    geometry = model.geometry.geometry(model.geometry.mean)
    for pair, child in (
        (("knee_lateral_l", "knee_medial_l"), "shank_l"),
        (("ankle_lateral_r", "ankle_medial_r"), "foot_r"),
        (("elbow_lateral_l", "elbow_medial_l"), "forearm_l"),
        (("wrist_radial_r", "wrist_ulnar_r"), "hand_r"),
    ):
        middle = np.mean([model.landmarks[name].p_BM_B for name in pair], axis=0)
        np.testing.assert_allclose(middle, geometry.offset[model.tree.index(child)].numpy(), atol=2e-3)


@pytest.mark.parametrize("person", PEOPLE[:2])
def test_hip_centres_agree_with_the_regression_of_harrington(person):
    """From the template's iliac spines, Harrington et al. 2007 puts the hip centre within 15 mm of the template's."""
    model = whole_body(*person)
    asis, psis = (np.array(model.landmarks[f"{name}_r"].p_BM_B) for name in ("asis", "psis"))
    asis, psis = asis - [COVER, 0, 0], psis + [COVER, 0, 0]
    width, depth = 2 * abs(asis[1]), math.hypot(asis[0] - psis[0], asis[2] - psis[2])
    leg = neutral(model)[1][0, 2] - 0.04 * model.height
    back = -0.24 * depth - 0.0099
    down = -0.16 * width - 0.04 * leg - 0.0071
    out = 0.28 * depth + 0.16 * width + 0.0079
    tilt = Rotation.from_rotvec([0.0, PELVIC_TILT, 0.0])
    centre = np.array([asis[0], 0.0, asis[2]]) + tilt.apply([back, -out, down])
    k = model.tree.index("thigh_r")
    hip = model.geometry.geometry(model.geometry.mean).offset[k].numpy()
    np.testing.assert_allclose(centre, hip, atol=15e-3)


def test_joint_table_lists_every_joint_and_coordinate():
    """The published table has a row per body and every coordinate once, with its limits."""
    model = whole_body(1.75, 70.0, "male")
    rows = joint_table(model.tree).splitlines()
    assert len(rows) == 2 + len(SEGMENTS)
    cells = [name for row in rows[2:] for name in row.split("|")[4].strip().split(", ")]
    assert tuple(cells) == model.tree.dof_names
    assert "-15 to 165" in rows[2 + SEGMENTS.index("shank_l")]
