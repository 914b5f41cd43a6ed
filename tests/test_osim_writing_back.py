"""OpenSim models written back: what was changed means the same to OpenSim, and no other byte is touched."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from osim_files import MARKER, NAMES, OLD_BODY, Twin, draw, joint, old_joint, old_osim, osim
from test_osim_reading import DIALECTS
from torch.testing import assert_close

from torchid.errors import DataError, InputError
from torchid.model.opensim.bodies import MOMENTS
from torchid.model.opensim.model import Frame, Inertias, OsimModel
from torchid.model.opensim.posing import marker_places
from torchid.model.opensim.reading import read_osim
from torchid.model.opensim.writing_back import write_back

NUMBER = re.compile(rb"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?(?![\w.])")
CHANGEABLE = re.compile(
    rb"\s*<(mass|mass_center|inertia(_[xyz]{2})?|translation|orientation(_in_parent)?|location(_in_parent)?)>"
)


def _rounded(values: torch.Tensor, version: int) -> torch.Tensor:
    """Six digits for files of old versions, which is all that OpenSim keeps of them."""
    if version >= 40000:
        return values
    return torch.tensor([float(f"{x:.6g}") for x in values.flatten().tolist()], dtype=torch.float64).view(values.shape)


def _changed(model: OsimModel, rng: np.random.Generator) -> OsimModel:
    """The model with other inertia, joint frames and marker places."""

    def near(values: torch.Tensor, scatter: float) -> torch.Tensor:
        return _rounded(values + scatter * torch.tensor(rng.normal(size=values.shape)), model.version)

    def moved(frame: Frame) -> Frame:
        return replace(frame, translation=near(frame.translation, 0.02), orientation=near(frame.orientation, 0.1))

    old = model.inertias
    R = torch.linalg.qr(torch.tensor(rng.normal(size=(len(old.mass), 3, 3)))).Q
    scale = torch.tensor(rng.uniform(0.8, 1.2, len(old.mass)))
    moments = _rounded(R @ (scale[:, None, None] * old.moments) @ R.mT, model.version)
    moments = 0.5 * (moments + moments.mT)
    inertias = Inertias(_rounded(old.mass * scale, model.version), near(old.centre, 0.01), moments)
    joints = tuple(replace(one, parent=moved(one.parent), child=moved(one.child)) for one in model.joints)
    markers = tuple(replace(one, location=near(one.location, 0.01)) for one in model.markers)
    return replace(model, inertias=inertias, joints=joints, markers=markers)


def _set(twin: Twin, model: OsimModel) -> None:
    """Give OpenSim's model the same numbers by its own functions."""
    o = twin.opensim
    for k, name in enumerate(model.bodies):
        body = twin.model.getBodySet().get(name)
        body.setMass(float(model.inertias.mass[k]))
        body.setMassCenter(o.Vec3(*model.inertias.centre[k].tolist()))
        body.setInertia(o.Inertia(*(float(model.inertias.moments[k, i, j]) for i, j in MOMENTS)))
    for one in model.joints:
        frames = twin.model.getJointSet().get(one.name)
        for frame, theirs in ((one.parent, frames.getParentFrame()), (one.child, frames.getChildFrame())):
            offset = o.PhysicalOffsetFrame.safeDownCast(theirs)
            offset.set_translation(o.Vec3(*frame.translation.tolist()))
            offset.set_orientation(o.Vec3(*frame.orientation.tolist()))
    for marker in model.markers:
        twin.model.getMarkerSet().get(marker.name).set_location(o.Vec3(*marker.location.tolist()))


def _without_forces(twin: Twin) -> Twin:
    forces = twin.model.getForceSet()
    for k in range(forces.getSize()):
        forces.get(k).set_appliesForce(False)
    return twin


def _same_but_numbers(before: bytes, after: bytes) -> None:
    """Lines are the same, or the same but for the numbers of an element that may change."""
    old, new = before.split(b"\n"), after.split(b"\n")
    assert len(old) == len(new)
    other = [(a, b) for a, b in zip(old, new, strict=True) if a != b]
    assert other
    for a, b in other:
        assert CHANGEABLE.match(a), a
        assert re.sub(rb"\s+", b" ", NUMBER.sub(b"#", a)) == re.sub(rb"\s+", b" ", NUMBER.sub(b"#", b))
        assert re.match(rb"\s*<\w+>\s*", a).group() == re.match(rb"\s*<\w+>\s*", b).group()
        assert re.search(rb"\s*</\w+>\s*$", a).group() == re.search(rb"\s*</\w+>\s*$", b).group()


def _same_numbers(model: OsimModel, other: OsimModel) -> None:
    for name in ("mass", "centre", "moments"):
        assert torch.equal(getattr(model.inertias, name), getattr(other.stated, name)), name
    for a, b in zip(model.joints, other.joints, strict=True):
        for ours, theirs in ((a.parent, b.parent), (a.child, b.child)):
            assert torch.equal(ours.translation, theirs.translation) and torch.equal(
                ours.orientation, theirs.orientation
            )
    for a, b in zip(model.markers, other.markers, strict=True):
        assert torch.equal(a.location, b.location)


@pytest.mark.parametrize("dialect", DIALECTS)
def test_dialects_keep_all_but_the_number(dialect: str, tmp_path: Path) -> None:
    """Names that a file leaves out stay out."""
    path = _write(tmp_path / "a.osim", DIALECTS[dialect].encode())
    write_back(_heavier(read_osim(path)[0]), tmp_path / "b.osim")
    assert (tmp_path / "b.osim").read_text() == DIALECTS[dialect].replace("<mass>2<", "<mass>2.5<")


@pytest.mark.data
@pytest.mark.parametrize("name", NAMES)
def test_unchanged_models_keep_every_byte(name: str, data_dir: Path, tmp_path: Path) -> None:
    """Also where the stated inertia is impossible."""
    path = data_dir / name
    if not path.exists():
        pytest.skip(f"no {path}")
    write_back(read_osim(path)[0], tmp_path / "a.osim")
    assert (tmp_path / "a.osim").read_bytes() == path.read_bytes()


@pytest.mark.data
@pytest.mark.parametrize("name", NAMES)
def test_written_models_mean_the_same_to_opensim(name: str, data_dir: Path, seed: int, tmp_path: Path) -> None:
    """Inverse dynamics and markers are those of the model changed through OpenSim's functions; other bytes stay."""
    path = data_dir / name
    if not path.exists():
        pytest.skip(f"no {path}")
    rng = np.random.default_rng(seed)
    model, _ = read_osim(path)
    changed = _changed(model, rng)
    write_back(changed, tmp_path / "a.osim")
    _same_but_numbers(path.read_bytes(), (tmp_path / "a.osim").read_bytes())
    _same_numbers(changed, read_osim(tmp_path / "a.osim")[0])
    written, set_by_hand = (_without_forces(Twin(one)) for one in (tmp_path / "a.osim", path))
    _set(set_by_hand, changed)
    for twin in (written, set_by_hand):
        twin.begin()
    q = draw(model, rng, 2)
    speeds, accelerations = rng.normal(size=(2, 2, len(model.coordinates)))
    places = marker_places(changed, q)
    for frame in range(len(q)):
        for twin in (written, set_by_hand):
            twin.take(changed, q[frame])
        for k, marker in enumerate(changed.markers):
            assert float((written.marker(marker.name) - places[frame, k]).norm()) < 1e-6
        found, expected = (twin.torques(speeds[frame], accelerations[frame]) for twin in (written, set_by_hand))
        assert np.linalg.norm(found - expected) < 1e-6 * np.linalg.norm(expected)


def _write(path: Path, text: str | bytes) -> Path:
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    return path


def _heavier(model: OsimModel, **other: torch.Tensor) -> OsimModel:
    values = {"mass": model.inertias.mass + 0.5} | other
    return replace(model, inertias=replace(model.inertias, **values))


PIN = joint("PinJoint", "q0")


@pytest.mark.parametrize(
    ("stated", "written"),
    [
        ("<mass>2</mass>", "<mass>2.5</mass>"),
        ("<mass>\t2\r\n </mass>", "<mass>\t2.5\r\n </mass>"),
        ("<mass><!-- kg -->2<!-- about --></mass>", "<mass><!-- kg -->2.5<!-- about --></mass>"),
        ("<mass>2<!-- point -->.0</mass>", "<mass>2.5<!-- point --></mass>"),
        ("<mass><![CDATA[2]]></mass>", "<mass><![CDATA[2.5]]></mass>"),
        ("<mass>&#50;</mass>", "<mass>2.5</mass>"),
        ("<mass unit='>'>2</mass >", "<mass unit='>'>2.5</mass >"),
    ],
)
def test_only_the_number_is_exchanged(stated: str, written: str, tmp_path: Path) -> None:
    """Whatever stands around it stays: blanks, comments, attributes, letters of other alphabets, marks of order."""
    text = osim(PIN).replace("<Model", "<!-- <mass>9</mass> µ --><?a b?><Model").replace("<mass>2</mass>", stated)
    for encoding in ("utf-8", "utf-8-sig", "iso-8859-1"):
        before, after = (
            one.replace('"UTF-8"', '"ISO-8859-1"' if encoding == "iso-8859-1" else '"UTF-8"').encode(encoding)
            for one in (text, text.replace(stated, written))
        )
        path = _write(tmp_path / "a.osim", before)
        write_back(_heavier(read_osim(path)[0]), path)
        assert path.read_bytes() == after


def test_numbers_that_are_not_stated_are_put_in(tmp_path: Path) -> None:
    """A body that leaves its centre out gets an element; so does an offset frame without elements."""
    frame = '<PhysicalOffsetFrame name="f"><socket_parent>/bodyset/a</socket_parent></PhysicalOffsetFrame>'
    text = osim(PIN, rest=f"<ComponentSet><objects>{frame}</objects></ComponentSet>")
    text = text.replace("<mass_center>0.01 -0.2 0.03</mass_center>", "").replace(
        "<translation>0.1 0.2 -0.3</translation>", ""
    )
    path = _write(tmp_path / "a.osim", text)
    model, _ = read_osim(path)
    centre = torch.tensor([[0.25, 0.0, -0.5]], dtype=torch.float64)
    parent = replace(model.joints[0].parent, translation=centre[0])
    changed = replace(_heavier(model, centre=centre), joints=(replace(model.joints[0], parent=parent),))
    write_back(changed, tmp_path / "b.osim")
    _same_numbers(changed, read_osim(tmp_path / "b.osim")[0])
    put_in = "<mass_center>0.25 0.0 -0.5</mass_center>"
    after = (tmp_path / "b.osim").read_text().replace("<mass>2.5<", "<mass>2<")
    assert after.replace(put_in, "").replace("<translation>0.25 0.0 -0.5</translation>", "") == text
    assert f'<Body name="a">{put_in}' in after


def test_a_body_with_impossible_inertia_is_written_whole(tmp_path: Path) -> None:
    """Once its mass is changed, the file states the inertia that was taken instead of the impossible one."""
    text = old_osim(OLD_BODY.format("a", old_joint("PinJoint", "q0", reverse="true")))
    text = text.replace("<inertia_zz>0.021", "<inertia_zz>0.5")
    path = _write(tmp_path / "a.osim", text)
    model, notes = read_osim(path)
    assert [note.code for note in notes] == ["osim.inertia"]
    changed = _changed(model, np.random.default_rng(1))
    write_back(changed, path)
    _same_numbers(changed, read_osim(path)[0])
    assert not read_osim(path)[1]


def _moved(model: OsimModel, *rows: int) -> OsimModel:
    joints = list(model.joints)
    for step, row in enumerate(rows, start=1):
        parent = replace(joints[row].parent, translation=joints[row].parent.translation + step)
        joints[row] = replace(joints[row], parent=parent)
    return replace(model, joints=tuple(joints))


SHARED = joint("PinJoint", "q1", child="/bodyset/b").replace(
    "<socket_parent_frame>p<", "<socket_parent_frame>PinJoint_a/p<"
)
ON_BODY = PIN.replace("<socket_parent_frame>p<", "<socket_parent_frame>/ground<")


@pytest.mark.parametrize(
    ("code", "text", "change"),
    [
        ("osim.no_element", osim(PIN), lambda m: replace(m, bodies=("b",))),
        ("osim.no_element", osim(PIN), lambda m: replace(m, joints=(replace(m.joints[0], name="x"),))),
        ("osim.no_offset", osim(ON_BODY), lambda m: _moved(m, 0)),
        ("osim.shared_frame", osim(PIN, SHARED, bodies="ab"), lambda m: _moved(m, 0, 1)),
        ("osim.not_finite", osim(PIN), lambda m: _heavier(m, mass=m.inertias.mass * float("nan"))),
        ("osim.negative_mass", osim(PIN), lambda m: _heavier(m, mass=-m.inertias.mass)),
    ],
)
def test_what_cannot_be_written_is_refused(code: str, text: str, change, tmp_path: Path) -> None:
    """Nothing is written when a change has no place in the file."""
    path = _write(tmp_path / "a.osim", text.replace("PinJoint_a/p", "/jointset/PinJoint_a/p"))
    model, _ = read_osim(path)
    with pytest.raises(DataError) as caught:
        write_back(change(model), tmp_path / "b.osim")
    assert caught.value.code == code and caught.value.remedy and not (tmp_path / "b.osim").exists()


def test_wide_letters_are_refused(tmp_path: Path) -> None:
    """UTF-16 is read, but numbers are not exchanged in it."""
    path = _write(tmp_path / "a.osim", osim(PIN).replace("UTF-8", "UTF-16").encode("utf-16"))
    model, _ = read_osim(path)
    with pytest.raises(InputError, match=r"osim\.encoding"):
        write_back(_heavier(model), tmp_path / "b.osim")


def test_markers_on_offset_frames_are_written_where_they_are_stated(tmp_path: Path) -> None:
    """The place that is written is the one in the marker's frame."""
    mark = f"<MarkerSet><objects>{MARKER.format('M', '/jointset/PinJoint_a/c')}</objects></MarkerSet>"
    path = _write(tmp_path / "a.osim", osim(PIN, rest=mark))
    model, _ = read_osim(path)
    location = model.markers[0].location + 1.0
    write_back(replace(model, markers=(replace(model.markers[0], location=location),)), path)
    assert_close(
        read_osim(path)[0].markers[0].p_BM_B - model.markers[0].p_BM_B, model.markers[0].frame.X_BF[:3, :3].sum(1)
    )
