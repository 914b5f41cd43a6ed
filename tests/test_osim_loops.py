"""Constraints and loops of OpenSim files: what hangs, what is opened, what follows, and that OpenSim has it there."""

from pathlib import Path

import numpy as np
import pytest
import torch
from harness.opensim_forces import osim_inverse_dynamics
from osim_dynamics import opensim_forces
from osim_files import (
    MARKER,
    OLD_BODY,
    Twin,
    coordinates,
    draw,
    joint,
    largest_errors,
    old_joint,
    old_osim,
    osim,
    transform,
)
from osim_trees import checked, drawn_state
from rates import at_least
from torch.testing import assert_close

from torchid.model.opensim.constraints import ENDS, OLD_OFFSETS, WELD
from torchid.model.opensim.joint_values import closed
from torchid.model.opensim.model import OsimModel
from torchid.model.opensim.reading import read_osim
from torchid.model.opensim.reversed_slides import ReversedSlide
from torchid.model.opensim.writing_back import identified_model, write_back

CLOSE = 1e-6
"""Largest difference to OpenSim [m, rad]."""
SIX, SEVEN = (tuple(f"{letter}{k}" for k in range(6)) for letter in "qf")
BODY_MARKERS = tuple(f"/bodyset/{body}" for body in "aaab")


def _numbers(rng: np.random.Generator, size: int = 3) -> str:
    return " ".join(f"{x:.6f}" for x in rng.uniform(-0.6, 0.6, size))


def _offset(name: str, body: str, rng: np.random.Generator) -> str:
    return (
        f'<PhysicalOffsetFrame name="{name}"><socket_parent>{body}</socket_parent>'
        f"<translation>{_numbers(rng)}</translation><orientation>{_numbers(rng)}</orientation></PhysicalOffsetFrame>"
    )


def _weld(name: str, first: str, second: str, rng: np.random.Generator) -> str:
    """A weld of OpenSim 4 between two offset frames of its own."""
    frames = _offset("one", first, rng) + _offset("two", second, rng)
    return (
        f'<WeldConstraint name="{name}"><socket_frame1>one</socket_frame1><socket_frame2>two</socket_frame2>'
        f"<frames>{frames}</frames></WeldConstraint>"
    )


def _old_weld(name: str, first: str, second: str, rng: np.random.Generator) -> str:
    places = "".join(f"<{tag}>{_numbers(rng)}</{tag}>" for pair in OLD_OFFSETS for tag in pair)
    return f'<WeldConstraint name="{name}"><body_1>{first}</body_1><body_2> {second} </body_2>{places}</WeldConstraint>'


def _set(*objects: str, tag: str = "ConstraintSet") -> str:
    return f"<{tag}><objects>{''.join(objects)}</objects></{tag}>"


def _markers(*frames: str) -> str:
    return _set(*(MARKER.format(f"M{k}", frame) for k, frame in enumerate(frames)), tag="MarkerSet")


def _holds(path: Path, seed: int, frames: int = 4) -> OsimModel:
    """Bodies are where OpenSim has them at coordinates that fulfil its own constraints."""
    model, _ = read_osim(path)
    q = closed(model, draw(model, np.random.default_rng(seed), frames))
    errors = largest_errors(model, Twin(path), q)
    assert max(errors.values()) < CLOSE, errors
    return model


PERSON = (joint("FreeJoint", *SIX), joint("PinJoint", "q6", parent="/bodyset/a", child="/bodyset/b"))
BAR = joint("FreeJoint", *SEVEN, child="/bodyset/c")
HELD = ("/bodyset/b", "/bodyset/c")


def _hung(case: str, rng: np.random.Generator) -> str:
    """A bar c that is free on ground and welded to the forearm b of a person a, b, as one of the dialects has it."""
    marks = _markers(*BODY_MARKERS)
    if case.startswith("old"):
        bodies = (
            OLD_BODY.format("a", old_joint("FreeJoint", *SIX)),
            OLD_BODY.format("b", old_joint("PinJoint", "q6", parent="a")),
            OLD_BODY.format("c", old_joint("FreeJoint", *SEVEN).replace('name="FreeJoint_ground"', 'name="bar"')),
        )
        marks = marks.replace("/bodyset/", "").replace("socket_parent_frame", "body")
        return old_osim(*bodies, rest=_set(_old_weld("w", "b", "c", rng)) + marks, version=int(case.split()[1]))
    weld = _weld("w", *(HELD[::-1] if case == "exchanged" else HELD), rng)
    rest = {
        "in a set of components": _set(weld, tag="ComponentSet"),
        "in components": f"<components>{weld}</components>",
        "in a set in a set": _set(_set(weld), tag="ComponentSet"),
        "unnamed": _set(weld.replace(' name="w"', "")),
        "bodies": _set('<WeldConstraint name="w"><socket_frame1>../../bodyset/b</socket_frame1>'
                       "<socket_frame2>/bodyset/c</socket_frame2></WeldConstraint>"),
        "twice": _set(weld, weld.replace("<frames>", "<isEnforced>false</isEnforced><frames>")),
    }.get(case, _set(weld))  # fmt: skip
    inwards = joint("FreeJoint", *SEVEN, parent="/bodyset/c", child="/ground")
    return osim(*PERSON, inwards if case == "inwards" else BAR, bodies="abc", rest=rest + marks)


@pytest.mark.parametrize(
    "case",
    [
        "plain", "exchanged", "inwards", "in a set of components", "in components", "in a set in a set", "unnamed",
        "bodies", "twice", "old 30000", "old 20302",
    ],
)  # fmt: skip
def test_a_weld_carries_what_its_own_joint_leaves_free(case: str, seed: int, tmp_path: Path) -> None:
    """The bar is one body with the forearm, its free coordinates follow, and the file keeps its words."""
    rng = np.random.default_rng(seed)
    text = _hung(case, rng)
    made, notes = checked(tmp_path, text, rng)
    assert made.osim is not None
    assert made.tree.names == ("a", "b") and made.osim.groups == ((0,), (1, 2))
    assert {note.code for note in notes} >= {"osim.hung", "osim.welded"}
    model = _holds(tmp_path / "a.osim", seed)
    assert {model.coordinate_names[row] for joint in model.closing for row in joint.rows} == set(SEVEN)
    phi = made.inertia.mean * torch.tensor([[1.3], [0.8]])
    geometry = made.geometry.geometry(made.geometry.mean)
    write_back(identified_model(made.osim, geometry, phi, {}), tmp_path / "b.osim")
    new = (tmp_path / "b.osim").read_text()
    kept = text[text.index("<WeldConstraint") : text.index("</WeldConstraint>")]
    assert kept in new and new != text
    assert_close(read_osim(tmp_path / "b.osim")[0].inertias.mass.sum(), 2.6 + torch.tensor(3.2).double())


def _link(kind: str, first: str, second: str, old: bool) -> str:
    tags = [pair[old] for pair in ENDS[kind]]
    ends = "".join(f"<{tag}>{name}</{tag}>" for tag, name in zip(tags, (first, second), strict=True))
    ends += "<line_direction_vec>0 1 0</line_direction_vec>" if "Line" in kind else ""
    ends += "<constant_distance>0.3</constant_distance>" if "Distance" in kind else ""
    return f'<{kind} name="w">{ends}</{kind}>'


@pytest.mark.parametrize("old", [False, True])
@pytest.mark.parametrize("kind", ENDS)
def test_other_constraints_are_opened_and_said(kind: str, old: bool, seed: int, tmp_path: Path) -> None:
    """Both between bodies of the person and to ground; poses are OpenSim's at any coordinates."""
    rng = np.random.default_rng(seed)
    for second in ("a", "ground"):
        if old:
            bodies = [OLD_BODY.format("a", old_joint("FreeJoint", *SIX))]
            bodies.append(OLD_BODY.format("b", old_joint("PinJoint", "q6", parent="a")))
            text = old_osim(*bodies, rest=_set(_link(kind, "b", second, old)))
        else:
            far = "/ground" if second == "ground" else f"/bodyset/{second}"
            text = osim(*PERSON, bodies="ab", rest=_set(_link(kind, "/jointset/PinJoint_b/c", far, old)))
        made, notes = checked(tmp_path, text, rng)
        assert made.tree.names == ("a", "b") and made.tree.dof_names[6:] == ("q6",)
        said = [note.message for note in notes if note.code == "osim.opened"]
        assert len(said) == 1 and said[0].startswith(f"{kind} w (b, {second})")
        model, _ = read_osim(tmp_path / "a.osim")
        # Switched off for OpenSim, which takes minutes to find that some cannot be fulfilled.
        off = text.replace('name="w">', 'name="w"><isEnforced>false</isEnforced>')
        (tmp_path / "b.osim").write_text(off)
        errors = largest_errors(model, Twin(tmp_path / "b.osim"), draw(model, rng, 3))
        assert max(errors.values()) < CLOSE, errors


def test_words_of_other_versions_switch_nothing_off(seed: int, tmp_path: Path) -> None:
    """``isDisabled`` does so before OpenSim 4 only, ``isEnforced`` always."""
    rng = np.random.default_rng(seed)
    for version in (20302, 30000, 40000, 40500):
        for word, off in (("<isEnforced>false</isEnforced>", True), ("<isDisabled>true</isDisabled>", version < 40000)):
            text = _hung(f"old {version}" if version < 40000 else "plain", rng)
            (tmp_path / "a.osim").write_text(text.replace('<WeldConstraint name="w">', f"{WELD_W}{word}"))
            model, _ = read_osim(tmp_path / "a.osim")
            assert bool(model.closing) is not off
            twin = Twin(tmp_path / "a.osim")
            twin.take(model, draw(model, rng, 1)[0])
            assert (twin.coupler_error() == 0.0) is off


WELD_W = '<WeldConstraint name="w">'


def test_a_second_grip_is_opened(seed: int, tmp_path: Path) -> None:
    """A bar in both hands hangs on the first; a foot that is welded to ground keeps the pelvis where it is."""
    rng = np.random.default_rng(seed)
    other = joint("BallJoint", "g0", "g1", "g2", parent="/bodyset/a", child="/bodyset/d")
    welds = (
        _weld("one", *HELD, rng),
        _weld("two", "/bodyset/d", "/bodyset/c", rng),
        _weld("foot", "/ground", *HELD[:1], rng),
    )
    rest = _set(*welds) + _markers(*BODY_MARKERS, "/bodyset/d")
    made, notes = checked(tmp_path, osim(*PERSON, BAR, other, bodies="abcd", rest=rest), rng)
    assert made.osim is not None and made.osim.model.bodies[made.osim.root.carried.body] == "a"
    said = {note.code: note.message for note in notes}
    assert "two (d, c)" in said["osim.opened"] and "foot (ground, b)" in said["osim.opened"]
    assert "one (b, c)" in said["osim.hung"] and made.osim.groups == ((0,), (1, 2), (3,))


def test_bodies_that_no_marker_tells_hang_by_their_weld(seed: int, tmp_path: Path) -> None:
    """A link of a device without markers, hinged to its frame: the thigh that it is strapped to tells where it is."""
    rng = np.random.default_rng(seed)
    frame = joint("WeldJoint", parent="/bodyset/a", child="/bodyset/c")
    link = joint("PinJoint", "q7", parent="/bodyset/c", child="/bodyset/d").replace("PinJoint_d", "hinge", 1)
    for marked in (False, True):
        marks = _markers(*BODY_MARKERS, *(["/bodyset/d"] if marked else []))
        text = osim(*PERSON, frame, link, bodies="abcd", rest=_set(_weld("w", "/bodyset/b", "/bodyset/d", rng)) + marks)
        made, notes = checked(tmp_path, text, rng)
        assert made.osim is not None
        assert made.osim.groups == (((0, 2), (1,), (3,)) if marked else ((0, 2), (1, 3)))
        opened = next(note.message for note in notes if note.code == "osim.opened")
        assert opened.startswith("WeldConstraint w (b, d)" if marked else "PinJoint hinge (c, d)")


def test_joints_that_close_a_loop_are_opened_and_follow(seed: int, tmp_path: Path) -> None:
    """A four-bar of pins: what stands last follows from where its bodies are, exactly where the loop is closed.

    Poses of a parallelogram: the fourth pin's angle is the first's, and OpenSim has the same bodies there.
    """
    pin = '<PinJoint name="{0}"><socket_parent_frame>p</socket_parent_frame><socket_child_frame>c</socket_child_frame>'
    pin += "<coordinates>{1}</coordinates><frames>"
    at = '<PhysicalOffsetFrame name="{0}"><socket_parent>{1}</socket_parent><translation>{2}</translation>'
    at += "</PhysicalOffsetFrame>"

    def hinge(name: str, parent: str, child: str, there: str, here: str) -> str:
        stated = coordinates(name.replace("j", "q"))
        ends = at.format("p", parent, there) + at.format("c", child, here)
        return f"{pin.format(name, stated)}{ends}</frames></PinJoint>"

    joints = (
        joint("WeldJoint"),
        hinge("j1", "/bodyset/a", "/bodyset/b", "0 0 0", "0 0.3 0"),
        hinge("j2", "/bodyset/a", "/bodyset/c", "0.2 0 0", "0 0.3 0"),
        hinge("j3", "/bodyset/b", "/bodyset/d", "0 0 0", "0 0 0"),
        hinge("j4", "/bodyset/c", "/bodyset/d", "0 0 0", "0.2 0 0"),
    )
    made, notes = checked(tmp_path, osim(*joints, bodies="abcd"), np.random.default_rng(seed))
    assert "PinJoint j4 (c, d)" in next(note.message for note in notes if note.code == "osim.opened")
    model, _ = read_osim(tmp_path / "a.osim")
    turn = torch.tensor(np.random.default_rng(seed).uniform(-1.0, 1.0, 5))
    q = closed(model, torch.stack([turn, turn, -turn, 0.0 * turn], dim=1))
    assert_close(q[:, 3], -turn, rtol=0, atol=1e-9)
    errors = largest_errors(model, Twin(tmp_path / "a.osim"), q)
    assert max(errors.values()) < CLOSE, errors


LINE = "<LinearFunction><coefficients>{0}</coefficients></LinearFunction>"
SPLINE = "<SimmSpline><x>-1 0 0.6 1</x><y>0.2 -0.1 0.3 0.1</y></SimmSpline>"
SEVERAL = {
    "line": (("q1", "q2"), LINE.format("0.5 -0.7 0.1")),
    "multiplied": (
        ("q1", "q2"), f"<MultiplierFunction><function>{LINE.format('0.5 0.7 0.1')}</function><scale>-1.3</scale>"
        "</MultiplierFunction>",
    ),
    "polynomial": (
        ("q1", "q4", "q0"),
        "<MultivariatePolynomialFunction><dimension>3</dimension><order>2</order><coefficients>{0}</coefficients>"
        "</MultivariatePolynomialFunction>",
    ),
    "of fewer": (("q1", "q2"), SPLINE),
    "of none": (("q1", "q2"), "<Constant><value>0.3</value></Constant>"),
    "alone": ((), "<Constant><value>0.3</value></Constant>"),
}  # fmt: skip
"""Coordinates that lead, and the function: in OpenSim, what stands behind its arguments follows."""
COUPLER = """<CoordinateCouplerConstraint name="k"><coupled_coordinates_function>{0}</coupled_coordinates_function>
<independent_coordinate_names>{1}</independent_coordinate_names><scale_factor>0.8</scale_factor>
<dependent_coordinate_name>q6</dependent_coordinate_name></CoordinateCouplerConstraint>"""


@pytest.mark.parametrize("case", SEVERAL)
def test_couplers_of_several_coordinates_hold_as_in_opensim(case: str, seed: int, tmp_path: Path) -> None:
    """Its constraints have no error at our coordinates, and slopes are those of forward mode."""
    rng, (leading, function) = np.random.default_rng(seed), SEVERAL[case]
    coupler = COUPLER.format(function.format(_numbers(rng, 10)), " ".join(leading))
    ground = joint("WeldJoint", child="/bodyset/c")
    joints = (ground, joint("FreeJoint", *SIX, parent="/bodyset/c"), PERSON[1])
    rest = _set(coupler) + _markers("/bodyset/c", "/bodyset/c", "/bodyset/a")
    made, _ = checked(tmp_path, osim(*joints, bodies="abc", rest=rest), rng)
    model = _holds(tmp_path / "a.osim", seed)
    assert made.osim is not None and len(made.osim.model.couplers) == len(model.couplers) == 1
    x = torch.tensor(rng.uniform(-1.5, 1.5, size=(4, model.couplers[0].function.n_arguments)))
    by_forward_mode = torch.stack([torch.func.jacfwd(model.couplers[0].function)(one) for one in x])
    assert_close(model.couplers[0].function.slopes(x), by_forward_mode, rtol=0, atol=1e-12)


SIX_AXES = ("rotation1", "rotation2", "rotation3", "translation1", "translation2", "translation3")


def _of_functions(names: tuple[str, ...], *functions: str, parent: str = "/ground", child: str = "/bodyset/a") -> str:
    """A custom joint whose axes are driven by one coordinate each."""
    unit = ("1 0 0", "0 1 0", "0 0 1", "1 0 0", "0 1 0", "0 0 1")
    axes = dict(zip(SIX_AXES, zip(names, unit, functions, strict=True), strict=True))
    return joint("CustomJoint", *dict.fromkeys(names), parent=parent, child=child, rest=transform(axes))


@pytest.mark.parametrize("kind", ["SliderJoint", "PlanarJoint", "CustomJoint"])
def test_forces_of_reversed_slides_are_opensims(kind: str, seed: int, tmp_path: Path) -> None:
    """Poses, rates and accelerations all enter: inverse dynamics of slides whose child carries the parent.

    Without Ball and Free joints, whose speeds in OpenSim are no rates of their coordinates.
    """
    pytest.importorskip("opensim")
    line, ends = LINE.format("1 0"), {"parent": "/bodyset/b", "child": "/bodyset/a"}
    names = {"SliderJoint": ("s0",), "PlanarJoint": ("s0", "s1", "s2")}
    if kind == "CustomJoint":
        curve = "<PolynomialFunction><coefficients>0.3 -0.2 0.1</coefficients></PolynomialFunction>"
        other = _of_functions(("s0", "s1", "s2", "s0", "s2", "s3"), line, line, line, curve, SPLINE, line, **ends)
    else:
        other = joint(kind, *names[kind], **ends)
    path = tmp_path / "a.osim"
    root = _of_functions(SIX, *[line] * 6)
    path.write_text(osim(root, other.replace(f'"{kind}_a"', '"other"', 1), bodies="ab"))
    model, _ = read_osim(path)
    q, v, a = drawn_state(model, np.random.default_rng(seed), 3)
    theirs = opensim_forces(path, model.coordinate_names, *(x.tolist() for x in (q, v, a)))
    expected = torch.tensor(theirs, dtype=torch.float64)
    found = osim_inverse_dynamics(model, q, v, a)
    ours = torch.stack([found[name] for name in model.coordinate_names], dim=1)
    assert_close(ours, expected, rtol=0, atol=1e-8 * float(expected.abs().max()))


def test_slopes_of_reversed_slides_are_those_of_forward_mode(seed: int) -> None:
    """For any number of turns and slides, leaning axes included."""
    rng = np.random.default_rng(seed)
    for turns, slides in ((0, 1), (1, 2), (3, 3)):
        units = [torch.nn.functional.normalize(torch.tensor(rng.normal(size=(n, 3))), dim=1) for n in (turns, slides)]
        for k in range(3):
            slide = ReversedSlide(k, *units)
            x = torch.tensor(rng.uniform(-1.5, 1.5, size=(4, turns + slides)))
            by_forward_mode = torch.stack([torch.func.jacfwd(slide)(one) for one in x])
            assert_close(slide.slopes(x), by_forward_mode, rtol=0, atol=1e-13)


MODELS = 20
KINDS = {"WeldJoint": 0, "PinJoint": 1, "SliderJoint": 1, "UniversalJoint": 2, "GimbalJoint": 3, "FreeJoint": 6}


def _any_model(rng: np.random.Generator) -> str:
    """Bodies on each other or on ground by joints either way round, constraints between any of them, any markers."""
    bodies = "abcdef"[: rng.integers(2, 7)]
    where = ["/ground", *(f"/bodyset/{body}" for body in bodies)]
    joints, names = [], []
    for k, body in enumerate(where[1:]):
        kind = str(rng.choice([*KINDS, "FreeJoint", "FreeJoint"]))
        own = [f"q{len(names) + i}" for i in range(KINDS[kind])]
        names += own
        ends = [where[rng.integers(0, k + 1)], body][:: rng.choice((1, -1))]
        made = joint(kind, *own, parent=ends[0], child=ends[1])
        joints.append(made.replace(f'name="{kind}_{ends[1][-1]}"', f'name="j{k}"', 1))
    constraints = []
    for k in range(rng.integers(1, 4)):
        first, second = rng.choice(where, 2, replace=False)
        kind = str(rng.choice([WELD, WELD, *ENDS]))
        made = _weld("w", first, second, rng) if kind == WELD else _link(kind, first, second, False)
        constraints.append(made.replace('name="w"', f'name="w{k}"'))
    if len(names) > 2:
        *leading, following = rng.choice(names, 3, replace=False)
        coupler = COUPLER.format(LINE.format(_numbers(rng)), " ".join(leading)).replace(">q6<", f">{following}<")
        constraints += [coupler] if rng.random() < 0.5 else []
    order = rng.permutation(len(joints))
    rest = _set(*constraints) + _markers(*rng.choice(where, rng.integers(0, 7)))
    return osim(*(joints[k] for k in order), bodies=bodies, rest=rest)


def test_what_opensim_opens_is_opened_and_posed_alike(seed: int, tmp_path: Path) -> None:
    """Models by lot: all are read, written back as they are, and become trees that pose bodies as the file does.

    Where nothing but free joints closes loops, OpenSim has the bodies there and finds all constraints fulfilled but
    those that are opened, which are switched off for it: to assemble them can take it minutes.
    """
    rng, path, compared, hung = np.random.default_rng(seed), tmp_path / "a.osim", 0, 0
    for _ in range(MODELS):
        text = _any_model(rng)
        checked(tmp_path, text, rng)
        model, notes = read_osim(path)
        write_back(model, tmp_path / "b.osim")
        assert (tmp_path / "b.osim").read_bytes() == path.read_bytes()
        if not all(len(joint.rows) == 6 for joint in model.closing):
            continue
        welds = {joint.name.rpartition("/")[2] for joint in model.joints if joint.kind == WELD}
        for name in {"w0", "w1", "w2"} - welds:
            text = text.replace(f'name="{name}">', f'name="{name}"><isEnforced>false</isEnforced>')
        (tmp_path / "b.osim").write_text(text)
        errors = largest_errors(model, Twin(tmp_path / "b.osim"), closed(model, draw(model, rng, 2)))
        compared, hung = compared + 1, hung + any(note.code == "osim.hung" for note in notes)
        assert max(errors.values()) < CLOSE, (errors, text)
    assert compared >= at_least(0.8, MODELS) and hung >= at_least(0.3, MODELS), (compared, hung)
