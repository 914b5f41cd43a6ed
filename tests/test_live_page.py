"""The page of a stream: it shows what comes, holds nobody up, and can be left and opened again."""

import re
import time
from collections.abc import Iterator

import msgspec
import psutil
import pytest
import small_session
import torch
import viser
import zstandard
from children import quick_children
from test_live import moving, subject
from websockets.sync.client import connect
from websockets.sync.connection import Connection
from websockets.typing import Subprotocol

from torchid.errors import ConfigError
from torchid.live.display.board import Board, bars
from torchid.live.display.page import Address, Page, Show, drawn
from torchid.live.estimation.beside import LiveEstimate
from torchid.live.estimation.pipeline import Moment, Pipeline
from torchid.live.estimation.pose import PostureFollower, Postures
from torchid.live.exercises.advice import Advice
from torchid.live.sources.stream import Replay
from torchid.scene.scene import Ground
from torchid.scene.server import close_page, open_page

pytestmark = pytest.mark.shown
PROTOCOL = Subprotocol(f"viser-v{viser.__version__}")
PORT = 18900


@pytest.fixture(scope="module")
def page() -> Iterator[Page]:
    """The page of the small session's subject."""
    trial = moving()
    assert trial.forces is not None
    where = Address(PORT, "127.0.0.1")
    with quick_children(), Page(subject(), trial.markers.labels, trial.forces.plates, where) as one:
        yield one


def watched(one: Connection, seconds: float) -> dict[str, int]:
    """How often every node of the scene changed."""
    counts: dict[str, int] = {}
    end = time.monotonic() + seconds
    while (left := end - time.monotonic()) > 0:
        try:
            raw = one.recv(timeout=left, decode=False)
        except TimeoutError:
            break
        size = int.from_bytes(raw[8:16], "little")
        found = msgspec.msgpack.decode(zstandard.ZstdDecompressor().decompress(bytes(raw[16 : 16 + size])))
        for message in found["messages"]:
            if message["type"] == "SceneNodeUpdateMessage":
                counts[message["name"]] = counts.get(message["name"], 0) + 1
    return counts


def moments(page: Page, seconds: float) -> int:
    """Send a trial's frames at a hundred a second; return how many."""
    trial, fit = moving(), subject().fit
    follower = PostureFollower(fit, trial.markers.labels)
    postures = follower(trial.markers.frames(slice(0, 8)))
    begun, sent = time.monotonic(), 0
    while time.monotonic() - begun < seconds:
        k = sent % 8
        some = Postures(postures.q[k : k + 1], postures.error[k : k + 1])
        assert trial.forces is not None
        markers = trial.markers.frames(slice(k, k + 1))
        page.show(Moment(torch.tensor([sent]), markers, some, fit, trial.forces.wrench[k], None))
        sent += 1
        time.sleep(0.01)
    return sent


def test_a_browser_gets_what_comes_and_may_leave_and_return(page):
    """The body moves for a viewer, and for one that comes later."""
    url = page.address.replace("http", "ws")
    for _ in range(2):
        with connect(url, subprotocols=[PROTOCOL], proxy=None) as one:
            moments(page, 1.0)
            counts = watched(one, 1.0)
        assert counts.get("/body", 0) > 10 and counts.get("/forces/plates", 0) > 10, counts


def test_a_page_that_stands_still_holds_nobody_up(page):
    """Pictures that it does not take are dropped; once it goes on, viewers get new ones."""
    process = psutil.Process(page._process.pid)
    process.suspend()
    try:
        before = page.dropped
        moments(page, 1.0)  # would never end if it waited
        assert page.dropped > before
    finally:
        process.resume()
    with connect(page.address.replace("http", "ws"), subprotocols=[PROTOCOL], proxy=None) as one:
        moments(page, 0.5)
        assert watched(one, 1.0).get("/body", 0) > 0


def test_a_stream_shows_what_it_identifies(page):
    """Parameters come to the page with the forces that the identified dynamics reconstruct."""
    found = []
    with Pipeline(subject(), Replay(moving(), 1.0)) as pipeline:

        def show(moment: Moment) -> None:
            page.show(moment)
            if moment.found is not None and moment.found.forces is not None:
                found.append(moment.found.forces)

        pipeline.run(show=show)
    force, said = found[-1].measured[:, 2], found[-1].predicted[:, 2]
    assert float((force - said).square().mean().sqrt()) < 0.1 * float(force.mean())


def test_a_page_that_cannot_open_is_said():
    """With the server's own words; nothing is left running."""
    trial = moving()
    assert trial.forces is not None
    with pytest.raises(ConfigError, match="scene.host"):
        Page(subject(), trial.markers.labels, trial.forces.plates, Address(PORT, "192.0.2.1"))


def test_a_page_that_dies_is_said(monkeypatch):
    """Where its process ends before it has opened."""
    trial = moving()
    assert trial.forces is not None
    monkeypatch.setattr("torchid.live.display.page._serve", abort)
    with pytest.raises(ConfigError, match="live.page"):
        Page(subject(), trial.markers.labels, trial.forces.plates, Address(PORT, "127.0.0.1"))


def abort(*_: object) -> None:
    """End a process as one that has no memory does."""
    raise SystemExit(9)


def test_forces_are_shown_when_the_identifier_has_reached_them():
    """Total forces stand beside the body of the same instant plus the stated delay, and silence is told."""
    server, _ = open_page(PORT + 50)
    try:
        o = small_session.outcome()
        names = o.fit.model.tree.names
        board = Board(server, Ground((), ()), names, o.prior)
        postures = torch.stack([o.followed["squats"].tracked.q[k] for k in (0, 100)])
        show = Show(board, o.fit, list(range(len(o.fit.attachment.labels))), 6.0, {"bends": drawn(o.fit, postures)})
        assert o.identified is not None
        board.identified(o.identified.fit, 3.0)
        assert "✓" in bars({"pelvis": 0.95}) and "✓" not in bars({"pelvis": 0.5})
        assert "<img" not in bars({"<img src=x onerror=alert(1)>": 0.5})
        advice = Advice("bends", "Bend your knees", 10.0, 3.0, ("thigh_l", "thigh_r"))
        show.found(LiveEstimate(o.identified.fit, 300, 3.0, None, advice))
        assert "Bend your knees" in board._advice.content and "thigh l, thigh r" in board._advice.content
        board.warn(["plate_1 reads 9 N while nobody is on it", "<b>"])
        assert (
            "plate_1 reads 9 N" in board._wrong.content and "<b>" not in board._wrong.content and board._wrong.visible
        )
        board.warn([])
        assert not board._wrong.visible
        show._seen_s -= 2.0
        board._placed = True
        show.wait()
        assert re.search(r"No frame for 2\.\d s", board._state.content), "a busy machine takes its tenths"
    finally:
        close_page(server)
