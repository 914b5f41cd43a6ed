"""Tests of torchid.io.force_names: columns of forces under every name, and markers that look like them."""

import pytest

from torchid.errors import InputError
from torchid.io.force_names import force_columns, parse_column, refuse_forces

STYLES = [
    ("ground_force_{a}", "ground_torque_{t}"),
    ("1_ground_force_{a}", "1_ground_torque_{t}"),
    ("ground_force_1_{a}", "ground_moment_1_m{t}"),
    ("ground_force1_{a}", "ground_torque1_{t}"),
    ("FP1_{a}", "FP1_moment_{t}"),
    ("calcn_r_force_{a}", "calcn_r_torque_{t}"),
    ("ground_force_calcn_r_{a}", "ground_torque_calcn_r_{t}"),
    ("R_ground_force_{a}", "Right_ground_torque_{t}"),
    ("groundForceR_{a}", "groundTorqueR_{t}"),
    ("groundforce_2_{a}", "groundtorque_2_{t}"),
    ("force_plate_2_{a}", "force_plate_2_free_moment_{t}"),
    ("l_{a}", "l_m{t}"),
]


@pytest.mark.parametrize(("force", "moment"), STYLES)
def test_every_style_gives_one_plate(force: str, moment: str) -> None:
    """Forces, centres of pressure and free moments find each other, axis by axis, among other columns."""
    names = [force.format(a=w + a) for w in "vp" for a in "xyz"] + [moment.format(t=a) for a in "xyz"]
    (plate,) = force_columns(("pelvis_tilt", *names, "emg_1"), "x").values()
    expected = {"force": (1, 2, 3), "point": (4, 5, 6), "torque": (7, 8, 9)}
    assert plate == {kind: dict(zip("xyz", columns, strict=True)) for kind, columns in expected.items()}


@pytest.mark.parametrize(
    ("names", "expected"),
    [
        (("Fx1", "Mz1", "COPy1"), [(("1",), "force", "x"), (("1",), "moment", "z"), (("1",), "point", "y")]),
        (("f1_x", "p1_y", "m1_z"), [(("1",), "force", "x"), (("1",), "point", "y"), (("1",), "moment", "z")]),
        (("LFx", "left_cop_z"), [(("l",), "force", "x"), (("l",), "point", "z")]),
        (("FP2_Tz", "FP2_force_vx"), [(("fp", "2"), "torque", "z"), (("fp", "2"), "force", "x")]),
    ],
)
def test_tokens_may_stand_anywhere(names: tuple[str, ...], expected: list) -> None:
    """Numbers, sides, letters and words are told apart wherever they stand."""
    found = [parse_column(name) for name in names]
    assert [column and (column.plate, column.kind, column.axis) for column in found] == expected


@pytest.mark.parametrize("name", ["knee_angle_r", "time", "pelvis_x", "state_1", "", "1", "___"])
def test_other_columns_are_none(name: str) -> None:
    """Names without an axis or a quantity are no columns of forces."""
    assert parse_column(name) is None


def test_several_plates_stay_apart() -> None:
    """Sides and numbers make plates, with the names that the file gives its forces."""
    names = tuple(f"{side}_{n}_{w}{a}" for side in "rl" for n in (1, 2) for w in "vpm" for a in "xyz")
    plates = force_columns(names, "x")
    assert list(plates) == ["r_1", "r_2", "l_1", "l_2"]
    assert plates["l_1"]["torque"]["z"] == names.index("l_1_mz")


def test_a_torque_beside_moments_is_the_free_one() -> None:
    """Where a file holds plate moments and free moments, the free ones are taken."""
    names = tuple(f"F1_{w}{a}" for w in ("v", "p", "m", "t") for a in "xyz")
    assert force_columns(names, "x")["F1"]["torque"] == {"x": 9, "y": 10, "z": 11}


@pytest.mark.parametrize(
    "names",
    [
        ("a_vx", "a_vy", "a_vz"),
        ("a_vx", "a_px", "a_py", "a_pz"),
        ("a_vx", "a_vy", "a_vz", "a_px", "a_py", "a_pz", "A_force_x"),
        ("knee_angle_r",),
    ],
)
def test_incomplete_and_double_columns_are_refused(names: tuple[str, ...]) -> None:
    """Forces without centres of pressure, missing axes, two columns for one thing, and no forces at all."""
    with pytest.raises(InputError, match=r"mot\.columns"):
        force_columns(names, "x")


@pytest.mark.parametrize("labels", [["PX"], ["R_PX", "C7"], ["VX", "PY", "MZ"], ["LFx", "FX1"], ["P.X", "V_Y"]])
def test_a_marker_called_px_is_a_marker(labels: list[str]) -> None:
    """Single labels that look like columns of forces make no table of forces."""
    refuse_forces([*labels, "LASI", "RASI"], "x")


@pytest.mark.parametrize(
    "labels", [["ground_force_vx"], ["C7", "Ground.Torque"], [f"FP1_{w}{a}" for w in "vp" for a in "xyz"]]
)
def test_tables_of_forces_are_no_markers(labels: list[str]) -> None:
    """The name ground_force, or all axes of force and centre of pressure, show a table of forces."""
    with pytest.raises(InputError, match=r"trc\.forces"):
        refuse_forces(labels, "x")
