"""Devices as sheets: what is read, what is refused."""

from pathlib import Path

import pytest
from device_cases import made

from torchid.devices import SheetValue, library, load_device, placed
from torchid.devices.device import Axis, Coordinate, Drive, Handle
from torchid.devices.device import Path as Run
from torchid.errors import ConfigError
from torchid.model.skeleton import SEGMENTS

SHEET = """
name: tried
sources: [a drawing]
parts:
  - {segment: pelvis, mass_kg: {value: 2.5, sd: 0.1}, com_m: {value: [-0.1, 0, 0.1], sd: 0.02}, inertia_kgm2: [0.02, 0.03, 0.02]}
  - {segment: thigh_l, mass_kg: unknown}
elements:
  - {type: spring, name: hip, between: [pelvis, thigh_l], coordinate: hip_l_flexion, stiffness_Nm_rad: unknown, rest_rad: 0.1, sensor: {torque: hip_torque}}
  - {type: cable, between: [thorax, thigh_r], from_m: [-0.1, 0, 0.1], to_marker: RTHI, via: [{segment: pelvis, point_m: [-0.15, 0, 0]}], stiffness_N_m: 500, rest_m: 0.5}
  - {type: torque, between: [shank_l, foot_l], axis: [0, 2, 0], profile: {over: phase, file: profile.csv}, gain: {value: 1, sd: 0.1}}
  - {type: ground, between: [pelvis, world], from_m: [0, 0, 0.1], to_m: [0, 0, 2.5], rail: [1, 0, 0], force_N: 150}
  - {type: ground, between: [hand_l, world], from_m: [0, 0, -0.05], channels: [fx, fy, fz]}
"""  # noqa: E501


@pytest.fixture
def sheet(tmp_path: Path) -> Path:
    (tmp_path / "profile.csv").write_text("phase,torque\n0,0\n0.5,-20\n1,0\n")
    (tmp_path / "device.yaml").write_text(SHEET)
    return tmp_path / "device.yaml"


def test_a_sheet_is_read(sheet: Path) -> None:
    """Numbers with and without sd, unknown ones, every kind of element."""
    device = load_device(sheet)
    pelvis, thigh = device.parts
    assert pelvis.mass_kg == SheetValue(2.5, 0.1) and pelvis.com_m and pelvis.com_m[0] == SheetValue(-0.1, 0.02)
    assert pelvis.inertia_kgm2 and [x.value for x in pelvis.inertia_kgm2] == [0.02, 0.0, 0.03, 0.0, 0.0, 0.02]
    assert thigh.mass_kg is None and thigh.com_m is None
    hip, cable, ankle, weight, hand = device.elements
    assert hip.line == Coordinate("hip_l_flexion") and hip.unknown == ("stiffness",)
    assert isinstance(cable.line, Run) and cable.law and cable.law.tension_only and len(cable.line.points) == 3
    assert ankle.line == Axis((0.0, 1.0, 0.0)) and isinstance(ankle.drive, Drive)
    assert ankle.drive.profile == ((0.0, 0.0), (0.5, -20.0), (1.0, 0.0)) and ankle.drive.gain == SheetValue(1.0, 0.1)
    assert weight.grounded and weight.law and weight.law.preload == SheetValue(150.0)
    assert isinstance(hand.line, Handle) and hand.grounded and not hip.grounded
    assert device.unknown == ("thigh_l.mass_kg", "thigh_l.com_m", "hip.stiffness_Nm_rad")


def test_markers_are_placed(sheet: Path) -> None:
    """A point by a marker is where the marker is, on the segment that the sheet says."""
    device = load_device(sheet)
    run = placed(device, {"RTHI": ("thigh_r", (0.0, -0.1, -0.2))}).elements[1].line
    assert isinstance(run, Run) and run.points[-1].place == (0.0, -0.1, -0.2)
    with pytest.raises(ConfigError, match="device.marker"):
        placed(device, {"RTHI": ("shank_r", (0.0, 0.0, 0.0))})


def test_the_sheet_of_the_page_is_one(tmp_path: Path) -> None:
    """What docs/devices.md shows is read as printed."""
    page = (Path(__file__).resolve().parents[1] / "docs" / "devices.md").read_text(encoding="utf-8")
    text = page.split('```yaml title="exo.yaml"\n')[1].split("```")[0]
    (tmp_path / "exo.yaml").write_text(text)
    device = load_device(tmp_path / "exo.yaml")
    assert len(device.parts) == 2 and [one.kind for one in device.elements] == ["spring", "cable", "torque", "ground"]


FAULTS = {
    "unknown_key": ({"elements": [{"type": "spring", "between": ["a", "b"], "stifness_N_m": 3}]}, "stiffness_N_m"),
    "missing_key": ({"parts": [{"mass_kg": 1}]}, "segment"),
    "value": ({"parts": [{"segment": "pelvis", "mass_kg": "much"}]}, "unknown"),
    "name_twice": ({"parts": [{"segment": "pelvis"}, {"segment": "pelvis"}]}, "name"),
    "mass": ({"parts": [{"segment": "pelvis", "mass_kg": -1}]}, "negative"),
    "axis": ({"elements": [{"type": "spring", "between": ["a", "b"], "axis": [0, 0, 0],
                            "stiffness_Nm_rad": 1}]}, "zero"),
    "table": ({"elements": [{"type": "spring", "between": ["a", "b"], "coordinate": "q",
                             "table": [[1, 0], [0, 1]]}]}, ""),
    "profile": ({"elements": [{"type": "torque", "between": ["a", "b"], "coordinate": "q",
                               "profile": {"over": "time", "file": "absent.csv"}}]}, ""),
}  # fmt: skip


@pytest.mark.parametrize("code", FAULTS)
def test_a_fault_is_named(code: str) -> None:
    """With its place, and the nearest key where one is misspelt."""
    sheet, hint = FAULTS[code]
    with pytest.raises(ConfigError) as caught:
        made(**sheet)
    assert caught.value.code == f"device.{code}" and hint in str(caught.value)


SPRING = {"type": "spring", "between": ["pelvis", "thigh_l"]}
MISFITS = [
    {**SPRING, "stiffness_N_m": 3},
    {**SPRING, "coordinate": "q"},
    {**SPRING, "coordinate": "q", "stiffness_N_m": 3},
    {**SPRING, "coordinate": "q", "axis": [0, 1, 0], "stiffness_Nm_rad": 3},
    {**SPRING, "from_m": [0, 0, 0], "stiffness_N_m": 3},
    {**SPRING, "from_m": [0, 0, 0], "to_m": [0, 0, 0], "via": [{"segment": "pelvis"}], "stiffness_N_m": 3},
    {"type": "spring", "between": ["pelvis", "world"], "from_m": [0, 0, 0], "to_m": [0, 0, 2], "stiffness_N_m": 3},
    {"type": "ground", "between": ["pelvis", "thigh_l"], "from_m": [0, 0, 0], "to_m": [0, 0, 2], "force_N": 3},
    {"type": "ground", "between": ["hand_l", "world"], "channels": ["x", "y", "z"]},
    {"type": "torque", "between": ["pelvis", "thigh_l"], "from_m": [0, 0, 0], "to_m": [0, 0, 2], "channel": "t"},
    {"type": "torque", "between": ["pelvis", "thigh_l"], "coordinate": "q"},
    {"type": "torque", "between": ["pelvis", "thigh_l"], "coordinate": "q", "channel": "t",
     "profile": {"over": "time", "table": [[0, 0], [1, 1]]}},
    {"type": "ground", "between": ["pelvis", "world"], "from_m": [0, 0, 0], "to_m": [0, 0, 2], "force_N": 3,
     "preload_N": 2},
]  # fmt: skip


@pytest.mark.parametrize("element", MISFITS)
def test_keys_that_do_not_go_together_are_refused(element: dict) -> None:
    """Lines of action, laws and the ground, each with a remedy."""
    with pytest.raises(ConfigError) as caught:
        made(elements=[element])
    assert caught.value.code == "device.element" and caught.value.remedy


def test_an_unknown_device_names_the_nearest(tmp_path: Path) -> None:
    """Of the library; a path that is not there is said as such."""
    with pytest.raises(ConfigError, match="dephy_exoboot") as caught:
        load_device("dephy_exobot")
    assert caught.value.code == "device.unknown_name"
    with pytest.raises(ConfigError) as caught:
        load_device(tmp_path / "absent.yaml")
    assert caught.value.code == "device.missing_file"


@pytest.mark.parametrize("name", library())
def test_the_library_is_sound(name: str) -> None:
    """Every device says where its numbers come from and sits on segments of the model."""
    device = load_device(name)
    assert device.sources and {part.segment for part in device.parts} <= set(SEGMENTS)
    stated = [part.mass_kg.value for part in device.parts if part.mass_kg]
    if device.mass_kg and len(stated) == len(device.parts):
        assert abs(sum(stated) - device.mass_kg.value) < 3.0 * device.mass_kg.sd


URDF = """<robot name="exo">
  <link name="cuff"><inertial><origin xyz="0 0 -0.1"/><mass value="1.5"/>
    <inertia ixx="0.01" iyy="0.02" izz="0.015" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="lever"><inertial><mass value="0.5"/>
    <inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="hinge" type="continuous"><parent link="cuff"/><child link="lever"/><axis xyz="0 1 0"/></joint>
</robot>"""


def test_links_of_a_urdf_are_parts(tmp_path: Path) -> None:
    """In the axes of the segments that they are attached to."""
    path = tmp_path / "exo.urdf"
    path.write_text(URDF)
    (tmp_path / "exo.yaml").write_text(
        "name: exo\nurdf: exo.urdf\nattach: {cuff: {segment: pelvis, xyz: [0.1, 0, 0],"
        " rpy: [0, 1.5707963267948966, 0]}, lever: thigh_l}\n"
    )
    cuff, lever = load_device(tmp_path / "exo.yaml").parts
    assert cuff.segment == "pelvis" and lever.segment == "thigh_l" and lever.mass_kg == SheetValue(0.5)
    assert cuff.com_m and [round(x.value, 12) for x in cuff.com_m] == [0.0, 0.0, 0.0]
    assert cuff.inertia_kgm2 and [round(x.value, 12) for x in cuff.inertia_kgm2] == [0.015, 0, 0.02, 0, 0, 0.01]
    with pytest.raises(ConfigError, match="cuff"):
        load_device(path, {"cuf": "pelvis"})
    with pytest.raises(ConfigError) as caught:
        load_device(path, {"cuff": "pelvis"})
    assert caught.value.code == "device.attachment" and "lever" in str(caught.value)
