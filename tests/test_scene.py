"""The scene of the page: solids that have the inertia they are drawn for, a server that lets no stranger in."""

import http.client
import socket
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from urllib.parse import urlsplit

import msgspec
import numpy as np
import psutil
import pytest
import roma
import small_session
import torch
import viser
from torch.testing import assert_close
from typer.testing import CliRunner
from websockets.datastructures import Headers
from websockets.exceptions import InvalidStatus
from websockets.http11 import Request
from websockets.sync.client import connect
from websockets.typing import Subprotocol

import torchid.cli
from torchid.cli import app
from torchid.errors import ConfigError, InputError
from torchid.run.write import write_outcome
from torchid.scene import colours
from torchid.scene.finished import FinishedRun, Segments
from torchid.scene.panel import card, figure
from torchid.scene.player import Player
from torchid.scene.scene import FAR_M, METRES_PER_N, Ground, Instant, PageScene, arrow
from torchid.scene.server import COOKIE, Guard, close_page, open_page
from torchid.scene.solids import centre_of_mass, placed, quaternion, solids
from torchid.storage.results import OutputFolder

pytestmark = pytest.mark.shown
PROTOCOL = Subprotocol(f"viser-v{viser.__version__}")


@pytest.fixture(scope="module")
def out(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a finished run."""
    folder = tmp_path_factory.mktemp("finished") / "out"
    with OutputFolder(folder) as made:
        write_outcome(small_session.outcome(), made, None)
    return folder


@pytest.fixture
def page() -> Iterator[tuple[viser.ViserServer, str]]:
    """An open page and its address."""
    server, address = open_page(18500)
    yield server, address
    close_page(server)


def answered(netloc: str, path: str, headers: dict[str, str]) -> tuple[int, str]:
    """Status and cookie of a page's answer."""
    with closing(http.client.HTTPConnection(netloc, timeout=10)) as plain:
        plain.request("GET", path, headers=headers)
        answer = plain.getresponse()
        answer.read()
        return answer.status, answer.headers.get("Set-Cookie", "")


def drawn(seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Masses, centres and inertia of some bodies that are ellipsoids."""
    rng = np.random.default_rng(seed)
    mass, centre, radius = rng.uniform(0.3, 20, 5), rng.normal(0, 0.1, (5, 3)), rng.uniform(0.02, 0.4, (5, 3))
    turn = roma.random_rotmat(5, dtype=torch.float64).numpy()
    square = radius**2
    moments = mass[:, None] / 5 * (square.sum(1, keepdims=True) - square)
    return mass, centre, turn @ (moments[:, :, None] * turn.transpose(0, 2, 1))


def test_a_solid_has_the_inertia_it_is_drawn_for(seed):
    """Radii and axes give the inertia back; axes are right-handed."""
    mass, centre, inertia = drawn(seed)
    some = solids(tuple("abcde"), mass, centre, inertia)
    square = some.radius**2
    moments = mass[:, None] / 5 * (square.sum(1, keepdims=True) - square)
    np.testing.assert_allclose(some.axes @ (moments[:, :, None] * some.axes.transpose(0, 2, 1)), inertia, atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(some.axes), 1.0)


def test_an_inertia_of_no_solid_is_still_drawn():
    """A body without mass, and one whose moments break the triangle inequality, have radii that can be seen."""
    some = solids(
        ("a", "b"), np.array([0.0, 1.0]), np.zeros((2, 3)), np.stack([np.zeros((3, 3)), np.diag([1.0, 1, 9])])
    )
    assert np.isfinite(some.radius).all() and (some.radius > 0).all()


def test_quaternions_are_those_of_the_rotations(seed):
    """Against roma, half turns among them."""
    R = torch.cat([roma.random_rotmat(50, dtype=torch.float64), torch.diag_embed(2 * torch.eye(3).double() - 1)])
    found = torch.from_numpy(quaternion(R.numpy()))
    assert_close(roma.unitquat_to_rotmat(found[:, [1, 2, 3, 0]]), R)


def test_solids_are_placed_and_balanced_as_their_bodies_lie(seed):
    """Centres of mass move with the bodies, and their mean is weighed by mass."""
    mass, centre, inertia = drawn(seed)
    X = np.tile(np.eye(4), (5, 1, 1))
    X[:, :3, :3], X[:, :3, 3] = (
        roma.random_rotmat(5, dtype=torch.float64).numpy(),
        np.random.default_rng(1).normal(size=(5, 3)),
    )
    some = solids(tuple("abcde"), mass, centre, inertia)
    expected = np.stack([X[k, :3, :3] @ centre[k] + X[k, :3, 3] for k in range(5)])
    np.testing.assert_allclose(placed(some, X)[0], expected)
    np.testing.assert_allclose(centre_of_mass(some, X), mass @ expected / mass.sum())


def test_an_arrow_stands_at_the_centre_of_pressure():
    """Nothing is drawn where a plate bears nothing, or is not known."""
    force, foot = np.array([10.0, -20.0, 700.0]), np.array([0.3, 0.2, 0.0])
    found = arrow(np.concatenate([force, np.cross(foot, force)]))
    np.testing.assert_allclose(found, [foot, foot + METRES_PER_N * force], atol=1e-12)
    for nothing in (np.zeros(6), np.full(6, np.nan)):
        assert (arrow(nothing)[:, 2] < 0.5 * FAR_M).all()


def test_progress_is_told_twice():
    """By a colour from red to green, and by how solid a segment is; an unknown share is none."""
    tints = colours.by_progress(np.array([0.0, 1.0, np.nan]))
    assert tuple(tints[0]) == colours.UNKNOWN == tuple(tints[2]) and tuple(tints[1]) == colours.KNOWN
    assert (np.diff(colours.opacity(np.linspace(0, 1, 9))) > 0).all()
    assert tuple(colours.by_distance(np.array([1.0]))[0]) == colours.UNKNOWN


def test_figures_have_the_digits_that_their_spread_supports():
    """Two digits of the standard deviation."""
    assert (
        figure(9.5612, 0.672) == "9.56 ± 0.67"
        and figure(144.4, 11.2) == "144 ± 11"
        and figure(1.0, 0.0) == "1.00 ± 0.00"
    )


def test_a_card_shows_nothing_of_a_name_but_the_name(out):
    """A segment's ten figures; a name that is HTML is text."""
    table = FinishedRun(out).segments.table
    assert card("pelvis", table).count("±") == 10
    assert "<img" not in card("<img src=x>", {"<img src=x>": table["pelvis"]})
    assert "Click" in card(None, table)


def test_a_finished_run_is_read_back(out):
    """Every frame of every trial, with markers, forces and the scaled skeleton."""
    outcome, run = small_session.outcome(), FinishedRun(out)
    assert set(run.trials) == set(outcome.session.trials)
    moving = run.trial("squats")
    now = moving.instant(len(moving) - 1)
    assert now.X_WB is not None and now.sticks is not None and now.measured is not None and now.plates is not None
    assert now.extended is None, "no effect is applied"
    np.testing.assert_allclose(now.X_WB[0, :3, 3], outcome.followed["squats"].motion.q[-1, :3].numpy())
    assert now.sticks[:, :, 2].min() > -0.2 and now.sticks[:, :, 2].max() < 2.2
    assert len(moving.ground.names) == len(now.plates) and moving.ground.corners[0] is not None
    assert isinstance(run.segments, Segments) and run.segments.solids.mass.sum() > 30
    curve = moving.wrench("measured", 50)
    assert curve is not None and len(curve[0]) == len(curve[1]) <= 50


@pytest.mark.parametrize("spoil", ["nothing", "no motion", "table", "series"])
def test_what_is_no_run_is_said(out, tmp_path, spoil):
    """An empty folder, one without motion, and files that are none."""
    code = "view.no_run"
    if spoil != "nothing":
        (tmp_path / "inertia.json").write_bytes((out / "inertia.json").read_bytes())
    if spoil == "table":
        (tmp_path / "inertia.json").write_text("{")
        code = "view.unreadable"
    if spoil == "series":
        (tmp_path / "motion_walk.nc").write_bytes(b"no netCDF")
        code = "view.unreadable"
    with pytest.raises(InputError, match=code):
        run = FinishedRun(tmp_path)
        run.trial(run.trials[0])


def test_the_page_of_a_run_moves_with_its_slider(out, page):
    """What is drawn is the frame that the slider says."""
    server, _ = page
    run = FinishedRun(out)
    player = Player(server, run)
    trial = run.trial(run.trials[0])
    player._slider.value = 7
    assert player.frame == 7 and f"{trial.time[7]:.2f} s" in player._clock.content
    player._toggle()
    player.play(0.5)
    assert player.frame > 7


def test_the_default_page_is_open_on_this_machine_alone(page):
    """Every socket that listens for it is a loopback's."""
    _, address = page
    port = urlsplit(address).port
    bound = {
        c.laddr.ip for c in psutil.Process().net_connections("tcp") if c.status == "LISTEN" and c.laddr.port == port
    }
    assert bound == {"127.0.0.1"}


@pytest.mark.parametrize(
    ("headers", "status"),
    [({}, 200), ({"Host": "evil.example"}, 403), ({"Origin": "http://evil.example"}, 403), ({"Origin": "null"}, 403)],
)
def test_foreign_pages_are_refused(page, headers, status):
    """By the name under which they ask, and by the page that asks."""
    where = urlsplit(page[1])
    assert answered(where.netloc, "/", headers)[0] == status
    url = f"ws://{where.netloc}"
    if status == 200:
        with connect(url, subprotocols=[PROTOCOL], origin=page[1], proxy=None) as one:
            assert one.recv(timeout=20)
        return
    with pytest.raises(InvalidStatus, match="40[03]"):
        connect(url, subprotocols=[PROTOCOL], additional_headers=headers, proxy=None).close()


def test_other_machines_need_the_token():
    """By the address, then by the cookie it sets; a wrong or missing one is refused."""
    server, address = open_page(18600, "0.0.0.0", "right")  # noqa: S104
    try:
        where = urlsplit(address)
        asked = {}
        for name, path, headers in (
            ("none", "/", {}), ("wrong", "/?token=wrong", {}), ("right", "/?token=right", {}),
            ("kept", "/", {"Cookie": f"{COOKIE}=right"}), ("forged", "/", {"Cookie": f"{COOKIE}=left"}),
        ):  # fmt: skip
            asked[name], cookie = answered(where.netloc, path, headers)
            assert name != "right" or "SameSite=Lax" in cookie
        assert asked == {"none": 403, "wrong": 403, "right": 302, "kept": 200, "forged": 403}
        with pytest.raises(InvalidStatus, match="403"):
            connect(f"ws://{where.netloc}", subprotocols=[PROTOCOL], proxy=None).close()
    finally:
        close_page(server)
    assert Guard(None).token is None


def test_garbage_does_not_stop_a_page(page, seed):
    """Bytes that are no message, and messages that are no viser's, close their own connection at most."""
    url, rng = page[1].replace("http", "ws"), np.random.default_rng(seed)
    for k in range(20):
        with connect(url, subprotocols=[PROTOCOL], proxy=None) as one:
            for _ in range(10):
                garbage = (
                    rng.bytes(int(rng.integers(1, 200))) if k % 2 else msgspec.msgpack.encode([{"type": "Nothing"}])
                )
                try:
                    one.send(garbage)
                except Exception:  # closed by the page, as it may
                    break
    with connect(url, subprotocols=[PROTOCOL], proxy=None) as one:
        assert one.recv(timeout=20)


def test_an_address_of_another_machine_and_ports_that_are_taken_are_said():
    """Instead of looking for a free port for ever."""
    with pytest.raises(ConfigError, match="scene.host"):
        open_page(18700, "192.0.2.1")
    with socket.socket() as other:
        other.bind(("127.0.0.1", 65535))
        other.listen()
        with pytest.raises(ConfigError, match="scene.host"):
            open_page(65535)


def test_cookies_of_others_do_not_hide_the_token():
    """Services of a host share their cookies; some of them no cookie jar can read."""
    guard = Guard("tok")
    for cookie, welcome in (
        (f"a/b=1; {COOKIE}=tok", True),
        (f'p={{"a": 1}}; {COOKIE}=tok', True),
        (f"{COOKIE}=to", False),
    ):
        headers = Headers({"Host": "lab:8080", "Cookie": cookie})
        assert (guard(Request("/", headers)) is None) is welcome


def test_a_plate_that_tells_nothing_is_not_drawn(page):
    """No plates, unknown readings and distances, and an instant of which nothing is known."""
    scene = PageScene(page[0].scene, Ground((), ()))
    markers = np.array([[0.0, 0.0, 1.0], [np.nan] * 3, [0.0, 1.0, 1.0]])
    scene.show(Instant(markers=markers, distance=np.array([np.nan, np.nan, 0.0]), plates=np.zeros((0, 6))))
    assert [tuple(one) for one in scene._markers.colors] == [colours.MARKER, colours.KNOWN]
    for plates in (None, np.full((2, 6), np.nan)):
        scene.show(Instant(plates=plates))
        assert (scene._plates.points[..., 2] < 0.5 * FAR_M).all()


def test_a_page_that_is_taken_moves_on(page):
    """The next free port."""
    port = urlsplit(page[1]).port
    with socket.socket() as other:
        assert other.connect_ex(("127.0.0.1", port)) == 0
    server, address = open_page(port)
    close_page(server)
    assert urlsplit(address).port > port


def test_without_viser_it_is_said_what_is_missing(out, monkeypatch):
    """And how to get it."""
    monkeypatch.setattr(torchid.cli, "find_spec", lambda name: None)
    answer = CliRunner().invoke(app, ["view", str(out)])
    assert answer.exit_code == 2 and "scene.no_viser" in answer.output and "torchid[live]" in answer.output


def test_view_opens_a_page_and_ends(out):
    """The address is told on stderr."""
    answer = CliRunner().invoke(app, ["view", str(out), "--port", "18800", "--seconds", "0.2"])
    assert answer.exit_code == 0, answer.output
    assert "open http://127.0.0.1:18800 in a browser" in answer.stderr and not answer.stdout
