"""OpenSim models in: every body and marker of every file is where OpenSim puts it, and what cannot be read is said."""

import logging
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
from osim_files import (
    MARKER,
    MOTIONS,
    NAMES,
    OLD_BODY,
    Twin,
    draw,
    joint,
    largest_errors,
    old_joint,
    old_osim,
    osim,
    transform,
)
from osim_functions import opensim_values
from torch.testing import assert_close

from torchid.errors import DataError, InputError
from torchid.kinematics.chain import chain_points
from torchid.model.opensim.bodies import MOMENTS
from torchid.model.opensim.functions import Function, broken_line, simm_spline
from torchid.model.opensim.model import CoordinateKind, OsimCoordinate, OsimModel
from torchid.model.opensim.posing import body_poses, coordinate_values, coupled, marker_places
from torchid.model.opensim.reading import WORDS, read_osim
from torchid.model.osim import osim_coordinates, osim_names, write_osim
from torchid.model.whole_body import whole_body

CLOSE = 1e-6
"""Largest difference to OpenSim [m, rad]."""


def _write(path: Path, text: str) -> Path:
    path.write_text(text, encoding="utf-8")
    return path


def _same_coordinates(model: OsimModel, twin: Twin) -> None:
    theirs = twin.model.getCoordinateSet()
    assert theirs.getSize() == len(model.coordinates)
    for one in model.coordinates:
        other = theirs.get(one.name)
        read = OsimCoordinate(
            name=other.getName(), motion=CoordinateKind(MOTIONS[other.getMotionType()]),
            default=other.getDefaultValue(),
            lower=other.getRangeMin(), upper=other.getRangeMax(), clamped=other.getDefaultClamped(),
            locked=other.getDefaultLocked(), prescribed=other.get_prescribed(),
        )  # fmt: skip
        assert read == one


def _compare(path: Path, seed: int, frames: int = 4, close: float = CLOSE) -> OsimModel:
    model, _ = read_osim(path)
    twin = Twin(path)
    _same_coordinates(model, twin)
    errors = largest_errors(model, twin, draw(model, np.random.default_rng(seed), frames))
    assert max(errors.values()) < close, errors
    return model


@pytest.mark.data
@pytest.mark.parametrize("name", NAMES)
def test_laboratories_models_are_posed_as_by_opensim(name: str, data_dir: Path, seed: int) -> None:
    """Bodies, markers, couplers and coordinates are OpenSim's, within the ranges and beyond.

    OpenSim itself rounds joint offsets and moments of inertia of files older than version 4 to six digits.
    """
    path = data_dir / name
    if not path.exists():
        pytest.skip(f"no {path}")
    model = _compare(path, seed)
    twin = Twin(path)
    for k, body in enumerate(model.bodies):
        other = twin.model.getBodySet().get(body)
        assert other.getMass() == float(model.stated.mass[k])
        assert [other.getMassCenter().get(i) for i in range(3)] == model.stated.centre[k].tolist()
        moments = torch.tensor([other.get_inertia().get(i) for i in range(6)], dtype=torch.float64)
        ours = torch.stack([model.stated.moments[k, i, j] for i, j in MOMENTS])
        assert_close(moments, ours, rtol=0.0 if model.version >= 40000 else 1e-5, atol=0.0)


PLAIN = {
    "PinJoint": 1, "SliderJoint": 1, "UniversalJoint": 2, "BallJoint": 3, "GimbalJoint": 3, "PlanarJoint": 3,
    "FreeJoint": 6,
}  # fmt: skip
NAMED = ("q0", "q1", "q2", "q3", "q4", "q5")


@pytest.mark.parametrize("kind", PLAIN)
def test_every_plain_joint_moves_as_opensims(kind: str, seed: int, tmp_path: Path) -> None:
    """The joints whose coordinates are their turns and slides: outwards, inwards, and in the words of old files."""
    names = NAMED[: PLAIN[kind]]
    mark = f"<MarkerSet><objects>{MARKER.format('M', '/bodyset/a')}</objects></MarkerSet>"
    weld = joint("WeldJoint", parent="/bodyset/a", child="/bodyset/b")
    _compare(_write(tmp_path / "out.osim", osim(joint(kind, *names), weld, bodies="ab", rest=mark)), seed)
    inwards = joint(kind, *names, parent="/bodyset/a", child="/ground")
    model = _compare(_write(tmp_path / "in.osim", osim(inwards, rest=mark)), seed)
    assert not model.joints[0].outward and model.parents == (-1,)
    for reverse in ("false", "true"):
        text = old_osim(OLD_BODY.format("a", old_joint(kind, *names, reverse=reverse)))
        _compare(_write(tmp_path / "old.osim", text), seed)


ON_ELLIPSOID = {
    "EllipsoidJoint": (NAMED[:3], "<radii_x_y_z>{0} {1} {2}</radii_x_y_z>"),
    "ScapulothoracicJoint": (
        NAMED[:4],
        "<thoracic_ellipsoid_radii_x_y_z>{0} {1} {2}</thoracic_ellipsoid_radii_x_y_z>"
        "<scapula_winging_axis_origin>{3} {4}</scapula_winging_axis_origin>"
        "<scapula_winging_axis_direction>{5}</scapula_winging_axis_direction>",
    ),
}


@pytest.mark.parametrize("kind", ON_ELLIPSOID)
def test_bodies_on_an_ellipsoid_move_as_opensims(kind: str, seed: int, tmp_path: Path) -> None:
    """The joints of shoulder models: outwards, inwards and in old files, with radii and axes by lot.

    A ScapulothoracicJoint whose child is ground ends OpenSim itself, without a word.
    """
    rng = np.random.default_rng(seed)
    names, rest = ON_ELLIPSOID[kind]
    rest = rest.format(*rng.uniform(0.05, 0.3, 3), *rng.uniform(-0.1, 0.1, 2), rng.uniform(-3.0, 3.0))
    model = _compare(_write(tmp_path / "out.osim", osim(joint(kind, *names, rest=rest))), seed)
    if kind == "EllipsoidJoint":
        inwards = joint(kind, *names, parent="/bodyset/a", child="/ground", rest=rest)
        _compare(_write(tmp_path / "in.osim", osim(inwards)), seed)
    old = old_joint(kind, *names, rest=rest)
    _compare(_write(tmp_path / "old.osim", old_osim(OLD_BODY.format("a", old))), seed)
    x = torch.tensor(rng.uniform(-1.5, 1.5, size=(3, len(names))))
    for slide in model.joints[0].slides:
        by_forward_mode = torch.stack([torch.func.jacfwd(slide.function)(one) for one in x])
        assert_close(slide.function.slopes(x), by_forward_mode, rtol=0, atol=1e-14)


POINTS = "<x>-1.3 -0.4 0.1 0.9 1</x><y>0.2 -0.1 0.3 0.25 -0.2</y>"
FUNCTIONS = {
    "constant": ("", "<Constant><value>0.37</value></Constant>"),
    "linear": ("q0", "<LinearFunction><coefficients>-0.7 0.2</coefficients></LinearFunction>"),
    "several": ("q0 q1", "<LinearFunction><coefficients>0.4 -0.6 0.1</coefficients></LinearFunction>"),
    "default": ("q0", "<LinearFunction></LinearFunction>"),
    "spline": ("q0", f"<SimmSpline>{POINTS}</SimmSpline>"),
    "natural": ("q0", f"<NaturalCubicSpline>{POINTS}</NaturalCubicSpline>"),
    "three": ("q0", "<SimmSpline><x>-1 0.2 1</x><y>0 0.4 -0.3</y></SimmSpline>"),
    "four": ("q0", "<SimmSpline><x>-1 0.2 0.7 1</x><y>0 0.4 -0.3 0.1</y></SimmSpline>"),
    "two": ("q0", "<SimmSpline><x>-1 1</x><y>0.1 -0.3</y></SimmSpline>"),
    "pieces": ("q0", f"<PiecewiseLinearFunction>{POINTS}</PiecewiseLinearFunction>"),
    "polynomial": ("q0", "<PolynomialFunction><coefficients>0.3 -0.2 0.5 0.1</coefficients></PolynomialFunction>"),
    "sine": ("q0", "<Sine><amplitude>0.4</amplitude><omega>2</omega><phase>0.3</phase><offset>0.1</offset></Sine>"),
    "scaled": (
        "q0",
        f"<MultiplierFunction><function><SimmSpline>{POINTS}</SimmSpline></function><scale>-1.7</scale>"
        "</MultiplierFunction>",
    ),
}


@pytest.mark.parametrize("old", [False, True])
@pytest.mark.parametrize("case", FUNCTIONS)
def test_every_function_drives_a_joint_as_in_opensim(case: str, old: bool, seed: int, tmp_path: Path) -> None:
    """Each function turns about a leaning axis of odd length and slides along another one."""
    names, function = FUNCTIONS[case]
    used = tuple(dict.fromkeys(("q0", *names.split())))
    itself = "<LinearFunction><coefficients>1 0</coefficients></LinearFunction>"
    axes = {
        "rotation1": ("q0", "0 0 1", itself),
        "rotation2": (names, "0.3 -0.9 0.2", function),
        "rotation3": (names, "1 0 0", function),
        "translation2": (names, "0 1 0", function),
    }
    custom = transform(axes, old)
    mark = (
        "<MarkerSet><objects><Marker name='M'><body>a</body><location>0.1 0 2</location></Marker></objects></MarkerSet>"
    )
    if old:
        text = old_osim(OLD_BODY.format("a", old_joint("CustomJoint", *used, rest=custom)), rest=mark)
    else:
        text = osim(joint("CustomJoint", *used, rest=custom))
    _compare(_write(tmp_path / "a.osim", text), seed)


@pytest.mark.parametrize("function", ["", "<SimmSpline><x>0 1 2</x><y>3 4 6</y></SimmSpline>"])
def test_functions_without_a_name_or_missing_are_as_in_opensim(function: str, seed: int, tmp_path: Path) -> None:
    """A function without a name is the axis's; without any, the axis does nothing."""
    itself = "<LinearFunction><coefficients>1 0</coefficients></LinearFunction>"
    axes = {"rotation3": ("q0", "0 0 1", itself), "translation1": ("q0", "1 0 0", "<F></F>")}
    custom = transform(axes).replace('<F name="function"></F>', function)
    _compare(_write(tmp_path / "a.osim", osim(joint("CustomJoint", "q0", rest=custom))), seed)


COUPLER = """<CoordinateCouplerConstraint name="{0}"><isEnforced>{3}</isEnforced><coupled_coordinates_function>
<SimmSpline>{4}</SimmSpline></coupled_coordinates_function>
<independent_coordinate_names>{1}</independent_coordinate_names>
<dependent_coordinate_name>{2}</dependent_coordinate_name><scale_factor>0.8</scale_factor></CoordinateCouplerConstraint>"""


def _coupled(*couplers: str) -> str:
    constraints = f"<ConstraintSet><objects>{''.join(couplers)}</objects></ConstraintSet>"
    return osim(joint("FreeJoint", *NAMED), rest=constraints)


def test_couplers_hold_whatever_is_given(seed: int, tmp_path: Path) -> None:
    """A chain of couplers in the wrong order holds; one that is switched off does not."""
    chain = [COUPLER.format("second", "q1", "q2", "true", POINTS), COUPLER.format("first", "q0", "q1", "true", POINTS)]
    off = COUPLER.format("off", "q0", "q4", "false", POINTS)
    model = _compare(_write(tmp_path / "a.osim", _coupled(*chain, off)), seed)
    q = torch.randn(7, 6, dtype=torch.float64)
    full = coupled(model, q)
    assert_close(full[:, [0, 3, 4, 5]], q[:, [0, 3, 4, 5]], rtol=0, atol=0)
    assert (full[:, 1:3] != q[:, 1:3]).all()
    assert_close(body_poses(model, q), body_poses(model, full), rtol=0, atol=0)
    assert_close(coupled(model, full), full, rtol=0, atol=0)


@pytest.mark.parametrize("off", [False, True])
def test_couplers_of_older_files_hold(off: bool, seed: int, tmp_path: Path) -> None:
    """Older files say that a constraint is disabled, newer ones that it is enforced."""
    coupler = COUPLER.format("c", "q0", "q1", "true", POINTS)
    coupler = coupler.replace("<isEnforced>true</isEnforced>", f"<isDisabled>{str(off).lower()}</isDisabled>")
    rest = f"<ConstraintSet><objects>{coupler}</objects></ConstraintSet>"
    text = old_osim(OLD_BODY.format("a", old_joint("BallJoint", "q0", "q1", "q2")), rest=rest)
    assert len(_compare(_write(tmp_path / "a.osim", text), seed).couplers) == (not off)


def test_markers_stand_on_any_frame(seed: int, tmp_path: Path) -> None:
    """On ground, on bodies by path or name, and on offset frames of offset frames."""
    offset = """<PhysicalOffsetFrame name="{0}"><socket_parent>{1}</socket_parent><translation>0.1 0 0.2</translation>
<orientation>0.1 0.2 0.3</orientation></PhysicalOffsetFrame>"""
    frames = offset.format("inner", "/bodyset/a") + offset.format("outer", "/componentset/inner")
    marks = {"G": "/ground", "A": "/bodyset/a", "I": "/componentset/inner", "O": "/componentset/outer"}
    marks["J"] = "/jointset/PinJoint_a/c"
    marks["R"] = "../../bodyset/a"
    rest = f"<ComponentSet><objects>{frames}</objects></ComponentSet><MarkerSet name='markerset'><objects>"
    rest += "".join(MARKER.format(*pair) for pair in marks.items()) + "</objects></MarkerSet>"
    model = _compare(_write(tmp_path / "a.osim", osim(joint("PinJoint", "q0"), rest=rest)), seed)
    q = draw(model, np.random.default_rng(seed), 3)
    everything = marker_places(model, q)
    assert_close(marker_places(model, q, ["O", "G"]), everything[:, [3, 0]], rtol=0, atol=0)
    with pytest.raises(DataError, match=r"found: X\).*osim\.no_marker"):
        marker_places(model, q, ["X"])


def test_coordinates_by_name(tmp_path: Path) -> None:
    """Named values fill rows, others have their defaults, shapes are joined, unknown names refused."""
    model, _ = read_osim(_write(tmp_path / "a.osim", osim(joint("UniversalJoint", "q0", "q1"))))
    q = coordinate_values(model, {"q1": torch.tensor([1.0, 2.0], dtype=torch.float64)})
    assert_close(q, torch.tensor([[0.1, 1.0], [0.1, 2.0]], dtype=torch.float64))
    assert_close(coordinate_values(model, {}), model.defaults)
    assert body_poses(model, q.reshape(2, 1, 2)).shape == (2, 1, 1, 4, 4)
    with pytest.raises(DataError, match=r"found: q7\).*osim\.no_coordinate"):
        coordinate_values(model, {"q7": 1.0})


@pytest.mark.parametrize("through", [simm_spline, broken_line])
@pytest.mark.parametrize("knots", [2, 3, 4, 5, 12])
def test_splines_and_their_derivatives_are_opensims(through, knots: int, seed: int) -> None:
    """Value, slope and curvature between random knots and far beyond the ends."""
    pytest.importorskip("opensim")
    rng = np.random.default_rng([seed, knots])
    x, y = np.cumsum(rng.uniform(0.05, 1.0, knots)), rng.normal(size=knots)
    at = torch.tensor(np.sort(rng.uniform(x[0] - 1.0, x[-1] + 1.0, 60)))
    ours = list(_derivatives(through(torch.tensor(x), torch.tensor(y)), at))
    kind = "SimmSpline" if through is simm_spline else "PiecewiseLinearFunction"
    theirs = opensim_values(kind, x.tolist(), y.tolist(), at.tolist(), len(ours))
    for values, expected in zip(ours, theirs, strict=True):
        assert_close(values, torch.tensor(expected, dtype=torch.float64), rtol=1e-9, atol=1e-9)


def _derivatives(function: Function, at: torch.Tensor) -> list[torch.Tensor]:
    """Value, first and second derivative by autograd."""
    x = at.clone().requires_grad_()
    found = [function(x[:, None])]
    for _ in range(2):
        previous = found[-1]
        slope = torch.autograd.grad(previous.sum(), x, create_graph=True)[0] if previous.requires_grad else 0.0 * x
        found.append(slope)
    return [one.detach() for one in found]


def test_poses_are_differentiable(seed: int, tmp_path: Path) -> None:
    """Jacobians of markers through splines and couplers are those of finite differences."""
    axes = {
        "rotation2": ("q0", "0.3 -0.9 0.2", FUNCTIONS["spline"][1]),
        "translation1": ("q1", "1 0 0", FUNCTIONS["linear"][1]),
    }
    mark = f"<MarkerSet><objects>{MARKER.format('M', '/bodyset/a')}</objects></MarkerSet>"
    constraint = COUPLER.format("c", "q0", "q1", "true", POINTS)
    rest = mark + f"<ConstraintSet><objects>{constraint}</objects></ConstraintSet>"
    text = osim(joint("CustomJoint", "q0", "q1", rest=transform(axes)), rest=rest)
    model, _ = read_osim(_write(tmp_path / "a.osim", text))
    q = draw(model, np.random.default_rng(seed), 3).requires_grad_()
    assert torch.autograd.gradcheck(lambda x: marker_places(model, x), (q,))


@pytest.mark.data
def test_speeds_come_from_forward_derivatives(data_dir: Path, seed: int) -> None:
    """``torch.func.jvp`` of all markers of a whole model, twice, is what finite differences say."""
    path = data_dir / NAMES[0]
    if not path.exists():
        pytest.skip(f"no {path}")
    model, _ = read_osim(path)
    rng = np.random.default_rng(seed)
    q, v = draw(model, rng, 3), torch.tensor(rng.normal(size=(3, len(model.coordinates))))

    def speed(at: torch.Tensor) -> torch.Tensor:
        return torch.func.jvp(lambda x: marker_places(model, x), (at,), (v,))[1]

    step = 1e-6
    assert_close(speed(q), _central(lambda x: marker_places(model, x), q, v, step), rtol=1e-6, atol=1e-6)
    assert_close(torch.func.jvp(speed, (q,), (v,))[1], _central(speed, q, v, step), rtol=1e-5, atol=1e-5)


def _central(function: Callable, at: torch.Tensor, along: torch.Tensor, step: float) -> torch.Tensor:
    return (function(at + step * along) - function(at - step * along)) / (2.0 * step)


def test_what_torchid_writes_is_read(seed: int, tmp_path: Path) -> None:
    """Markers of a written body are where the body's own kinematics put them, and every mass is there."""
    rng = np.random.default_rng(seed)
    body = whole_body(1.75, 70.0)
    tree, geometry = body.tree, body.geometry.geometry(body.geometry.mean)
    marks = {f"M{k}": (name, rng.normal(size=3).tolist()) for k, name in enumerate(tree.names)}
    write_osim(tree, geometry, body.inertia.mean, tmp_path / "a.osim", marks)
    model, notes = read_osim(tmp_path / "a.osim")
    assert not notes and model.bodies == tree.names
    assert_close(model.inertias.mass, body.inertia.mean[:, 0])
    q = torch.tensor(0.5 * rng.normal(size=(3, len(tree.dofs))))
    values = dict(zip(osim_names(tree), osim_coordinates(q).T, strict=True))
    places = marker_places(model, coordinate_values(model, values), list(marks))
    points = torch.tensor([p for _, p in marks.values()], dtype=torch.float64)
    expected = chain_points(tree, q, geometry, torch.arange(len(tree.names)), points)
    x, y, z = places.unbind(-1)
    assert_close(torch.stack([x, -z, y], dim=-1), expected, rtol=0, atol=1e-9)


def test_impossible_inertia_becomes_the_nearest_and_is_said(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """The file's numbers stay in ``stated``; those taken are consistent, nearest, and named in a note and the log."""
    text = osim(joint("PinJoint", "q0"), joint("WeldJoint", parent="/bodyset/a", child="/bodyset/b"), bodies="ab")
    text = text.replace("0.02 0.01 0.021 0.001 -0.002 0.0005", "0.001 0.002 0.01 0 0 0", 1)
    with caplog.at_level(logging.WARNING):
        model, notes = read_osim(_write(tmp_path / "a.osim", text))
    assert [note.code for note in notes] == ["osim.inertia"] and "a: no body has" in caplog.text
    assert_close(model.stated.moments[0], torch.diag(torch.tensor([0.001, 0.002, 0.01], dtype=torch.float64)))
    assert_close(model.inertias.moments[1], model.stated.moments[1], rtol=0, atol=0)
    second = torch.diag(torch.tensor([0.0055, 0.0045, 2e-6], dtype=torch.float64))  # the third was -0.0035
    assert_close(model.inertias.moments[0], second.trace() * torch.eye(3, dtype=torch.float64) - second)
    assert model.inertias.phi.shape == (2, 10)


def test_a_driven_coordinate_is_said(tmp_path: Path) -> None:
    """A coordinate prescribed by a function of time is taken as free, with a note."""
    text = osim(joint("PinJoint", "q0")).replace("</Coordinate>", "<prescribed>true</prescribed></Coordinate>")
    _, notes = read_osim(_write(tmp_path / "a.osim", text))
    assert [note.code for note in notes] == ["osim.prescribed"] and "q0" in notes[0].message


PIN = joint("PinJoint", "q0")
TWO_MARKERS = 2 * MARKER.format("M", "/ground")
OWN = f"<SimmSpline>{POINTS}</SimmSpline>"
TWO = "<LinearFunction><coefficients>1 2 3</coefficients></LinearFunction>"
FEW = (
    "<MultivariatePolynomialFunction><dimension>2</dimension><order>1</order><coefficients>1 2</coefficients>"
    "</MultivariatePolynomialFunction>"
)
BOMB = (
    '<!DOCTYPE x [<!ENTITY a "aaaa"><!ENTITY b "&a;&a;&a;&a;&a;&a;">]>'
    '<OpenSimDocument Version="40500">&b;</OpenSimDocument>'
)
SPLINE = transform({"rotation1": ("q0", "1 0 0", "<SimmSpline><x>0 1</x><y>0 1</y></SimmSpline>")})


def _custom(rest: str) -> str:
    return osim(joint("CustomJoint", "q0", rest=rest))


@pytest.mark.parametrize(
    ("code", "text", "said"),
    [
        ("xml.syntax", "<OpenSimDocument><Model>", "line"),
        ("xml.doctype", BOMB, "document type"),
        ("xml.root", "<Model/>", "<Model>"),
        ("xml.number", osim(PIN).replace("<mass>2", "<mass>NaN"), "<mass>.*NaN"),
        ("xml.number", osim(PIN).replace("0.01 -0.2 0.03", "0.01 -0.2"), "<mass_center>"),
        ("osim.version", osim(PIN, version=10900), "10900"),
        ("osim.version", osim(PIN).replace(' Version="40500"', ""), "OpenSimDocument"),
        ("osim.model", '<OpenSimDocument Version="40500"><InverseDynamicsTool/></OpenSimDocument>', "setup file"),
        ("osim.frame", osim(PIN).replace('<Body name="a"', "<Body"), "/bodyset/a"),
        ("osim.body", osim(PIN, bodies="aa"), "two bodies"),
        ("osim.body", osim(PIN).replace("<Body name", "<Boddy name").replace("</Body>", "</Boddy>"), "Boddy"),
        ("osim.body", osim(bodies=""), "no bodies"),
        ("osim.elsewhere", osim(PIN, rest="<components><Marker name='w'/></components>"), "'w'"),
        ("osim.elsewhere", osim(PIN, rest="<defaults><Coordinate name='d'/></defaults>"), "'d'"),
        ("osim.mass", osim(PIN).replace("<mass>2", "<mass>-2"), "found: -2"),
        ("osim.mass", osim(PIN).replace("<mass>2</mass>", ""), "found: none"),
        ("osim.frame", osim(PIN.replace("/bodyset/a", "/bodyset/lost")), "line.*/bodyset/lost"),
        ("osim.frame", osim(PIN.replace("<socket_parent>/ground", "<socket_parent>/jointset/PinJoint_a/p")), "itself"),
        ("osim.frame", osim(PIN, rest=f"<MarkerSet><objects>{MARKER.format('M', 'x')}</objects></MarkerSet>"), "'M'"),
        ("osim.joint", osim(PIN.replace("PinJoint", "EllipsoidJoint")), "EllipsoidJoint"),
        ("osim.joint", osim(joint("PinJoint", "q0", "q1")), "2 instead of 1"),
        ("osim.joint", osim(joint("PinJoint")), "0 instead of 1"),
        ("osim.joint", _custom(""), "SpatialTransform"),
        ("osim.loop", osim(joint("PinJoint", "q0", parent="/bodyset/a")), "itself"),
        ("osim.unjoined", osim(PIN, bodies="ab"), "name='b'"),
        ("osim.twice", osim(PIN, joint("PinJoint", "q0", child="/bodyset/b"), bodies="ab"), "q0"),
        ("osim.twice", osim(PIN, rest=f"<MarkerSet><objects>{TWO_MARKERS}</objects></MarkerSet>"), "M"),
        ("osim.twice", osim(joint("BallJoint", "q0", "q1", "q0")), "q0, q1"),
        ("osim.flag", osim(PIN.replace("</Coordinate>", "<locked>maybe</locked></Coordinate>")), "maybe"),
        ("osim.range", osim(PIN.replace("-1.5 1.2", "1.5 1.2")), "1.5 > 1.2"),
        ("osim.coordinate", _custom(SPLINE.replace(">q0<", ">q1<")), "q0"),
        ("osim.axis", _custom(SPLINE.replace("rotation2", "rotation4")), "rotation4"),
        ("osim.axis", _custom(SPLINE.replace("rotation2", "rotation1")), "each once"),
        ("osim.elsewhere", osim().replace("</Body>", f"<Joint>{old_joint('PinJoint', 'q0')}</Joint></Body>"), "'PinJ"),
        ("osim.function", _custom(SPLINE.replace('Spline name="function"', 'Spline name="f"')), "SimmSpline"),
        ("osim.axis", _custom(SPLINE.replace("<axis>1 0 0", "<axis>0 0 0", 1)), "length zero"),
        ("osim.axis", _custom(SPLINE.replace(">q0<", ">q0 q1<")), "2 for 1"),
        ("osim.function", _custom(SPLINE.replace("SimmSpline", "GCVSpline")), "GCVSpline"),
        ("osim.function", _custom(SPLINE.replace("<x>0 1", "<x>1 1")), "increase"),
        ("osim.function", _custom(SPLINE.replace("<x>0 1", "<x>0 1 2")), "as many x as y"),
        ("osim.constraint", _coupled('<OtherConstraint name="w"/>'), "OtherConstraint"),
        ("osim.frame", _coupled('<WeldConstraint name="w"/>'), "'w'"),
        ("osim.coupler", _coupled(COUPLER.format("c", "q0", "q2", "true", POINTS).replace(OWN, TWO)), "one of 2"),
        ("osim.function", _coupled(COUPLER.format("c", "q0", "q2", "true", POINTS).replace(OWN, FEW)), "every term"),
        ("osim.coupler", _coupled(COUPLER.format("c", "x", "q2", "true", POINTS)), "found: x"),
        ("osim.coupler", _coupled(COUPLER.format("c", "q2", "q2", "true", POINTS)), "circle"),
        ("osim.coupler", _coupled(*(COUPLER.format(n, n, "q2", "true", POINTS) for n in ("q0", "q1"))), "two ways"),
        ("osim.coupler", _coupled(COUPLER.format("c", "q0", "q2", "true", "")).replace("coupled_", ""), "a function"),
    ],
)  # fmt: skip
def test_what_cannot_be_read_is_refused(code: str, text: str, said: str, tmp_path: Path) -> None:
    """Every fault is an error with file, place and remedy; nothing is guessed."""
    path = _write(tmp_path / "bad.osim", text)
    with pytest.raises(InputError, match=f"(?s){said}") as caught:
        read_osim(path)
    assert caught.value.code == code and caught.value.source == str(path) and caught.value.remedy


UNNAMED = osim(PIN, joint("PinJoint", "q1", parent="/bodyset/a", child="/bodyset/b"), bodies="ab")
LINE = "<LinearFunction><coefficients>0.5 0.3</coefficients></LinearFunction>"
TWICE = f"<MultiplierFunction><function>{LINE}</function><scale>-2</scale></MultiplierFunction>"
DIALECTS = {
    "unnamed joints": UNNAMED.replace('PinJoint name="PinJoint_a"', "PinJoint").replace(' name="PinJoint_b"', ""),
    "unnamed body": osim(PIN.replace("/bodyset/a", "/bodyset/body")).replace('<Body name="a"', "<Body"),
    "unnamed coordinate": osim(PIN).replace(' name="q0"', ' name=""'),
    "unnamed marker": osim(PIN, rest=f"<MarkerSet><objects>{MARKER.format('', '/bodyset/a')}</objects></MarkerSet>"),
    "an axis of no coordinate": _custom(transform({
        "rotation1": ("q0", "1 0 0", f"<SimmSpline>{POINTS}</SimmSpline>"), "rotation3": ("", "0 0 1", TWICE),
        "translation2": ("", "0 1 0", LINE),
    })),
    "tasks among defaults": osim(PIN, rest="<defaults><CMC_Joint name='default'><on>false</on></CMC_Joint></defaults>"),
    "classes within classes": osim(PIN, rest='<ForceSet name="f"><objects><HuntCrossleyForce name="c">'
        '<HuntCrossleyForce::ContactParametersSet name="p"><objects/></HuntCrossleyForce::ContactParametersSet>'
        "<A::B::C/></HuntCrossleyForce></objects></ForceSet>"),
}  # fmt: skip
"""Files that OpenSim opens, and how it does."""


@pytest.mark.parametrize("dialect", DIALECTS)
def test_dialects_are_read_as_by_opensim(dialect: str, seed: int, tmp_path: Path) -> None:
    """What other programs leave out or add."""
    path = _write(tmp_path / "a.osim", DIALECTS[dialect])
    model, twin = _compare(path, seed), Twin(path).model
    assert [one.name for one in model.joints] == [twin.getJointSet().get(k).getName() for k in range(len(model.joints))]
    assert [one.name for one in model.markers] == [
        twin.getMarkerSet().get(k).getName() for k in range(len(model.markers))
    ]


@pytest.mark.parametrize("kind", PLAIN)
def test_coordinates_that_are_left_out_are_opensims(kind: str, seed: int, tmp_path: Path) -> None:
    """With the names, ranges and values that it gives them."""
    text = osim(joint(kind).replace("<coordinates></coordinates>", ""))
    assert len(_compare(_write(tmp_path / "a.osim", text), seed).coordinates) == PLAIN[kind]


def test_coordinates_that_several_joints_leave_out_have_names_of_their_own(seed: int, tmp_path: Path) -> None:
    """Where OpenSim calls all of them alike; bodies are where it has them."""
    first, second = joint("PinJoint"), joint("BallJoint", parent="/bodyset/a", child="/bodyset/b")
    text = osim(first, second, bodies="ab").replace("<coordinates></coordinates>", "")
    model, _ = read_osim(_write(tmp_path / "a.osim", text))
    names = [one.name for one in model.coordinates]
    assert names == ["PinJoint_a_coord_0", *(f"BallJoint_b_coord_{k}" for k in range(3))]
    stated = joint("PinJoint", names[0]), joint("BallJoint", *names[1:], parent="/bodyset/a", child="/bodyset/b")
    named = _compare(_write(tmp_path / "b.osim", osim(*stated, bodies="ab")), seed)
    q = draw(model, np.random.default_rng(seed), 3)
    for ours, theirs in zip(body_poses(model, q), body_poses(named, q), strict=True):
        assert_close(ours, theirs)


@pytest.mark.data
@pytest.mark.parametrize(
    "name",
    ["osim_axis_without_coordinate/model", "osim_dialects/contact_parameters", "osim_dialects/defaults"],
)
def test_dialects_of_laboratories_are_read(name: str, data_dir: Path, seed: int) -> None:
    """Where OpenSim has the bodies."""
    path = data_dir.parent / "cases" / f"{name}.osim"
    if not path.exists():
        pytest.skip(f"no {path}")
    _compare(path, seed)


def test_misspelt_and_second_elements_are_said(tmp_path: Path) -> None:
    """What is left out because the format does not have it, or has it once, is named with its line."""
    text = osim(PIN).replace("mass_center", "mass_centre").replace("</range>", "</range><range>0 1</range>")
    _, notes = read_osim(_write(tmp_path / "a.osim", text))
    said = {note.code: note.message for note in notes}
    assert "<mass_centre>" in said["model.unread"] and "<range>" in said["model.twice"]


@pytest.mark.data
@pytest.mark.parametrize("name", NAMES)
def test_laboratories_models_have_no_strange_words(name: str, data_dir: Path) -> None:
    """The only note about them is that of impossible or flat toes."""
    path = data_dir / name
    if not path.exists():
        pytest.skip(f"no {path}")
    assert {note.code for note in read_osim(path)[1]} <= {"osim.inertia"}


def test_the_words_are_those_of_opensim() -> None:
    """Every property of the classes that are read is known, so that none is called misspelt."""
    opensim = pytest.importorskip("opensim")
    tags = set(WORDS) & {name for name in dir(opensim) if hasattr(getattr(opensim, name), "getPropertyByIndex")}
    assert len(tags) > 20
    for tag in tags - {
        "CoordinateSet",
        "BodySet",
        "JointSet",
        "ConstraintSet",
        "MarkerSet",
        "SpatialTransform",
        "Joint",
    }:
        one = getattr(opensim, tag)()
        names = {one.getPropertyByIndex(k).getName() for k in range(one.getNumProperties())} - {"ground"}
        assert names <= {word.rstrip("*") for word in WORDS[tag][1].split()}, tag
