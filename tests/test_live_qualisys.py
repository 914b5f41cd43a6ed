"""Qualisys Track Manager's real-time protocol comes in as it was sent, whatever becomes of the server."""

import logging
import struct
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
import pytest
import qtm_server
import small_session
import torch
from qtm_server import CORNERS, Laboratory, Server, data, forces_part, in_plate, markers_part, packet
from torch.testing import assert_close

from torchid.config import load_config
from torchid.errors import ConfigError, InputError
from torchid.live.run import run_live
from torchid.live.sources.intake import JUMP_S, Counts, Intake
from torchid.live.sources.stream import Packet, Source
from torchid.recording import Forces, Markers

pytest.importorskip("qtm_rt")
from torchid.live.sources.qtm_link import HOST, LARGEST, PORT, address_of  # noqa: E402
from torchid.live.sources.qualisys import QualisysSource  # noqa: E402

pytestmark = pytest.mark.shown
RATE, EACH, FRAMES = 100.0, 10, 40
LABORATORY = Laboratory()
GIVE_UP_S = 20.0


@pytest.fixture
def server() -> Iterator[Server]:
    with Server(LABORATORY) as one:
        yield one


def opened(server: Server) -> QualisysSource:
    return QualisysSource(f"127.0.0.1:{server.port}")


def positions(rng: np.random.Generator, frames: int = FRAMES, markers: int = 3) -> np.ndarray:
    """Markers [mm] as 32-bit numbers."""
    return rng.normal(scale=800.0, size=(frames, markers, 3)).astype(np.float32)


def loads(rng: np.random.Generator, corners: np.ndarray, samples: int) -> np.ndarray:
    """Wrenches on somebody who stands on a plate, about the origin of the world."""
    force = np.stack([*rng.normal(scale=60.0, size=(2, samples)), rng.uniform(200.0, 900.0, samples)], axis=1)
    shares = rng.dirichlet(np.ones(4), samples)
    twist = rng.normal(scale=8.0, size=(samples, 1)) * normal(corners)
    return np.concatenate([force, np.cross(shares @ corners / 1e3, force) + twist], axis=1)


def normal(corners: np.ndarray) -> np.ndarray:
    across = np.cross(corners[1] - corners[0], corners[2] - corners[1])
    return across / np.linalg.norm(across)


class Session:
    """Frames from one on, with samples of both plates, each with its number."""

    def __init__(self, rng: np.random.Generator, frames: int = FRAMES, laboratory: Laboratory = LABORATORY) -> None:
        self.markers = positions(rng, frames, len(laboratory.labels))
        self.wrench = np.stack([loads(rng, one, EACH * frames) for one in laboratory.plates.values()], axis=1)
        self.sent = [in_plate(self.wrench[:, k], one).astype(np.float32)
                     for k, one in enumerate(laboratory.plates.values())]  # fmt: skip
        self._first_id = laboratory.first_id

    def chunk(self, first: int, stop: int, plates: tuple[int, ...] = (0, 1)) -> bytes:
        """Samples of plates, counted from zero."""
        return forces_part([(self._first_id + k, first + 1, self.sent[k][first:stop]) for k in plates])

    def frame(self, k: int, number: int | None = None) -> bytes:
        """A frame with its own samples, counted from zero, under its number."""
        number = k + 1 if number is None else number
        forces = [(self._first_id + j, (number - 1) * EACH + 1, one[EACH * k : EACH * (k + 1)])
                  for j, one in enumerate(self.sent)]  # fmt: skip
        return data(number, 10_000 * number, markers_part(self.markers[k]), forces_part(forces))


def gather(source: Source, done: Callable[[int, int], bool]) -> Packet:
    """What is taken until so many frames and samples have come; no take waits."""
    found, end = [source.take()], time.monotonic() + GIVE_UP_S
    while not done(*counted(found)):
        assert time.monotonic() < end, f"{counted(found)} came"
        begun = time.monotonic()
        found.append(source.take())
        assert time.monotonic() - begun < 0.5, "a take waits"
        time.sleep(0.002)
    markers = Markers(source.labels, torch.cat([one.markers.time for one in found]),
                      torch.cat([one.markers.position for one in found]))  # fmt: skip
    forces = [one.forces for one in found]
    return Packet(markers, Forces(torch.cat([one.time for one in forces]), torch.cat([one.wrench for one in forces]),
                                  source.plates), found[-1].arrived_s)  # fmt: skip


def counted(found: list[Packet]) -> tuple[int, int]:
    return sum(len(one.markers.time) for one in found), sum(len(one.forces.time) for one in found)


def at_least(frames: int, samples: int = 0) -> Callable[[int, int], bool]:
    return lambda got, some: got >= frames and some >= samples


def wait(done: Callable[[], bool], seconds: float = GIVE_UP_S) -> float:
    """How long something took."""
    begun = time.monotonic()
    while not done():
        assert time.monotonic() - begun < seconds
        time.sleep(0.005)
    return time.monotonic() - begun


def count(caplog: pytest.LogCaptureFixture, *words: str) -> int:
    """How many lines of the log have all words."""
    return sum(all(word in one.getMessage() for word in words) for one in caplog.records)


def said(caplog: pytest.LogCaptureFixture, *words: str) -> bool:
    return count(caplog, *words) > 0


def test_what_is_sent_is_received_unchanged(server, seed):
    """Markers in metres, wrenches on the subject about the origin of W, sub-samples at their times, NaN for missing."""
    session = Session(np.random.default_rng(seed))
    session.markers[5:9, 1] = np.frombuffer(b"\xff" * 4, "<f4")[0]
    session.markers[20, 2] = 0.0
    with opened(server) as source:
        assert isinstance(source, Source) and source.labels == ("A", "B", "C")
        assert (source.rate_hz, source.force_rate_hz) == (RATE, EACH * RATE)
        assert [(one.name, one.number) for one in source.plates] == [("left", 1), ("right", 2)]
        assert_close(source.plates[0].corners, torch.from_numpy(1e-3 * CORNERS), rtol=0.0, atol=1e-12)
        before = time.monotonic()
        for k in range(FRAMES):
            server.send(session.frame(k))
        found = gather(source, at_least(FRAMES, EACH * FRAMES))
        assert before <= found.arrived_s <= time.monotonic()
    expected = torch.from_numpy(session.markers.astype(np.float64) / 1e3)
    expected[20, 2] = torch.nan
    assert int(expected.isnan().any(-1).sum()) == 5
    assert_close(found.markers.position, expected, rtol=0.0, atol=1e-12, equal_nan=True)
    assert_close(found.markers.time, torch.arange(1, FRAMES + 1).double() / RATE, rtol=0.0, atol=1e-9)
    samples = (torch.arange(FRAMES * EACH).double() / EACH + 1.0) / RATE
    assert_close(found.forces.time, samples, rtol=0.0, atol=1e-9)
    assert_close(found.forces.wrench, torch.from_numpy(session.wrench), rtol=1e-6, atol=2e-4)
    assert bool((found.forces.wrench[..., 2] > 0.0).all())


def test_a_wrench_is_that_of_known_numbers():
    """Somebody of 100 N who stands 0.1 m from a plate's centre, towards corners 1 and 4, and pushes it that way."""
    corners = np.array([[2.0, 1.0, 0.0], [1.0, 1.0, 0.0], [1.0, 0.0, 0.0], [2.0, 0.0, 0.0]]) * 1e3
    with Server(replace(LABORATORY, plates={"one": corners[[3, 2, 1, 0]]})) as server, opened(server) as source:
        # X of the plate is the world's, its Y and Z are the world's turned round: corner 1 is at the smallest y.
        sample = np.array([[20.0, 0.0, 100.0, 0.0, -10.0, 3.0, 100.0, 0.0, 0.0]])
        server.send(data(1, 10_000, markers_part(np.ones((3, 3))), forces_part([(1, 1, sample)])))
        found = gather(source, at_least(1, 1))
    # -20 N along X and 100 N up at (1.6, 0.5, 0), and -3 N m about the plate's Z, which points down: +3 N m about W's.
    arm, force = torch.tensor([1.6, 0.5, 0.0]).double(), torch.tensor([-20.0, 0.0, 100.0]).double()
    moment = torch.linalg.cross(arm, force) + torch.tensor([0.0, 0.0, 3.0]).double()
    assert_close(found.forces.wrench[0, 0], torch.cat([force, moment]), rtol=1e-6, atol=1e-4)


@pytest.mark.parametrize("behind", [1, 3])
def test_forces_that_come_in_chunks_find_their_times(server, seed, behind):
    """Some frames late, one plate before the other, as QTM sends them; a sample counts when both plates have it."""
    session = Session(np.random.default_rng(seed))
    with opened(server) as source:
        for k in range(0, FRAMES, 4):
            for j in range(k, k + 4):
                server.send(data(j + 1, 10_000 * (j + 1), markers_part(session.markers[j])))
            if k >= 4 * behind:
                first = EACH * (k - 4 * behind)
                server.send(data(0, 0, session.chunk(first, first + 4 * EACH, (1,))))
                server.send(data(0, 0, session.chunk(first, first + 2 * EACH, (0,))))
                server.send(data(0, 0, session.chunk(first + 2 * EACH, first + 4 * EACH, (0,))))
        count = EACH * (FRAMES - 4 * behind)
        found = gather(source, at_least(FRAMES, count))
    assert len(found.forces.time) == count
    assert_close(found.forces.time, (torch.arange(count).double() / EACH + 1.0) / RATE, rtol=0.0, atol=1e-9)
    assert_close(found.forces.wrench, torch.from_numpy(session.wrench[:count]), rtol=1e-6, atol=2e-4)


def test_lost_frames_are_gaps(server, seed):
    """Neither their neighbours nor the forces of others move; a sample without a force is left out."""
    rng = np.random.default_rng(seed)
    session = Session(rng)
    lost = set(rng.choice(np.arange(1, FRAMES - 1), 6, replace=False).tolist())
    kept = [k for k in range(FRAMES) if k not in lost]
    session.sent[0][EACH * kept[3] + 2] = np.nan
    with opened(server) as source:
        for k in kept:
            server.send(session.frame(k))
        found = gather(source, at_least(len(kept), EACH * len(kept) - 1))
        intake = Intake(source.rate_hz, source.force_rate_hz, 0.5)
    placed = intake.place(found)
    assert placed.index.tolist() == kept and intake.counts == Counts(len(kept), 6, 0, 0, 0)
    numbers = [EACH * k + j for k in kept for j in range(EACH) if (k, j) != (kept[3], 2)]
    assert placed.sample.tolist() == numbers
    assert_close(placed.wrench, torch.from_numpy(session.wrench[numbers]), rtol=1e-6, atol=2e-4)


def test_y_upwards_is_turned(seed):
    """Markers, corners and wrenches alike."""
    turn = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])  # W's vectors in QTM's axes
    laboratory = replace(LABORATORY, up="+Y", plates={name: one @ turn.T for name, one in LABORATORY.plates.items()})
    session = Session(np.random.default_rng(seed), 3)
    with Server(laboratory) as server, opened(server) as source:
        plain = session.markers.copy()
        session.markers = (session.markers @ turn.T).astype(np.float32)
        for k in range(3):
            server.send(session.frame(k))
        found = gather(source, at_least(3, 3 * EACH))
        assert_close(source.plates[1].corners, torch.from_numpy(1e-3 * LABORATORY.plates["right"]), rtol=0, atol=1e-9)
    assert_close(found.markers.position, torch.from_numpy(plain.astype(np.float64) / 1e3), rtol=0.0, atol=1e-6)
    assert_close(found.forces.wrench, torch.from_numpy(session.wrench[: 3 * EACH]), rtol=1e-6, atol=2e-4)


def test_moments_about_the_sensors_change_nothing_but_about_the_vertical(server, seed, caplog):
    """The point of application says what they are; unloaded, where QTM states none, they are taken as they are sent."""
    session = Session(np.random.default_rng(seed))
    plates = list(LABORATORY.plates.values())
    session.sent = [in_plate(session.wrench[:, k], one, np.array([0.0, 0.0, 0.04])).astype(np.float32)
                    for k, one in enumerate(plates)]  # fmt: skip
    session.wrench[:EACH, 0] *= 0.01
    session.sent[0][:EACH] = in_plate(session.wrench[:EACH, 0], plates[0])
    session.sent[0][:EACH, 6:] = 0.0
    with opened(server) as source:
        for k in range(FRAMES):
            server.send(session.frame(k))
        found = gather(source, at_least(FRAMES, EACH * FRAMES))
    assert_close(found.forces.wrench, torch.from_numpy(session.wrench), rtol=1e-6, atol=2e-4)
    assert not caplog.records


@pytest.mark.parametrize(("spoil", "words"), [
    (lambda sent: -sent, ("left", "pulled upwards")),
    (lambda sent: np.concatenate([sent[:, :3], 0.0 * sent[:, 3:5], sent[:, 5:]], axis=1), ("left", "moments")),
])  # fmt: skip
def test_loads_that_cannot_be_are_said_once(server, seed, caplog, spoil, words):
    """A plate that is pulled, and moments about the point of application."""
    session = Session(np.random.default_rng(seed))
    session.sent[0] = spoil(session.sent[0]).astype(np.float32)
    with opened(server) as source:
        for k in range(FRAMES):
            server.send(session.frame(k))
        gather(source, at_least(FRAMES, EACH * FRAMES))
    assert said(caplog, *words) and len(caplog.records) == 1


def test_a_plate_that_sends_nothing_is_named(server, seed, caplog):
    """Without it nothing is known of the whole force, and so nothing is handed over."""
    session = Session(np.random.default_rng(seed), 250)
    with opened(server) as source:
        for k in range(250):
            chunk = session.chunk(EACH * k, EACH * (k + 1), (0,))
            server.send(data(k + 1, 10_000 * (k + 1), markers_part(session.markers[k]), chunk))
        found = gather(source, at_least(250))
    assert not len(found.forces.time) and said(caplog, "no forces of right") and len(caplog.records) == 1


def test_forces_that_count_from_another_instant_come_with_their_frames(server, seed, caplog):
    """And it is said."""
    session = Session(np.random.default_rng(seed), 3)
    with opened(server) as source:
        for k in range(3):
            chunk = [(1 + j, 500_001 + EACH * k, one[EACH * k : EACH * (k + 1)]) for j, one in enumerate(session.sent)]
            server.send(data(k + 1, 10_000 * (k + 1), markers_part(session.markers[k]), forces_part(chunk)))
        found = gather(source, at_least(3, 3 * EACH))
    assert_close(found.forces.time, (torch.arange(3 * EACH).double() / EACH + 1.0) / RATE, rtol=0.0, atol=1e-6)
    assert said(caplog, "do not count from the same instant")


def test_a_server_that_is_killed_and_comes_back_goes_on(seed, caplog):
    """With numbers of its own, labels in another order, one less, plates the other way round: nothing is mixed up."""
    rng = np.random.default_rng(seed)
    first = Server(LABORATORY)
    intake, newest = Intake(RATE, EACH * RATE, 0.5), -np.inf
    plates = dict(reversed(LABORATORY.plates.items()))
    changed = [replace(LABORATORY, labels=("C", "X", "B", "A")), replace(LABORATORY, labels=("B", "A"), plates=plates)]
    with opened(first) as source:
        for run, laboratory in enumerate([LABORATORY, *changed]):
            if run:
                wait(lambda run=run: count(caplog, "no answer") == run)
            server = first if run == 0 else Server(laboratory, first.port)
            assert wait(lambda server=server: bool(server.streams)) < 2.0
            session, start = Session(rng, FRAMES, laboratory), int(rng.integers(1, 5000))
            for k in range(FRAMES):
                server.send(session.frame(k, start + k))
            found = gather(source, at_least(FRAMES, EACH * FRAMES))
            server.close()
            expected = torch.full((FRAMES, 3, 3), torch.nan).double()
            for k, label in enumerate(LABORATORY.labels):
                if label in laboratory.labels:
                    expected[:, k] = torch.from_numpy(session.markers[:, laboratory.labels.index(label)] / 1e3)
            assert_close(found.markers.position, expected, rtol=0.0, atol=1e-6, equal_nan=True)
            order = [list(laboratory.plates).index(plate.name) for plate in source.plates]
            assert_close(found.forces.wrench, torch.from_numpy(session.wrench[:, order]), rtol=1e-6, atol=2e-4)
            assert_close(found.forces.time[::EACH], found.markers.time, rtol=0.0, atol=1e-9)
            assert run == 0 or float(found.markers.time[0]) - newest > JUMP_S
            newest = float(found.markers.time[-1])
            placed = intake.place(found)
            assert len(placed.index) == FRAMES and len(placed.sample) == EACH * FRAMES
    assert intake.counts == Counts(3 * FRAMES, 0, 0, 0, 2)
    assert count(caplog, "is back") == 2 and said(caplog, "came back without C")


@pytest.mark.parametrize(("change", "why"), [
    ({"rate": 200.0}, "another rate"), ({"labels": ("X", "Y")}, "none of the labels"),
    ({"plates": {"left": CORNERS + [1.0, 0.0, 0.0], "right": LABORATORY.plates["right"]}}, "other plates"),
    ({"plates": {"left": CORNERS}}, "other plates"),
])  # fmt: skip
def test_a_server_that_comes_back_as_another_is_refused(seed, caplog, change, why):
    """And taken up again when it is as it was."""
    first = Server(LABORATORY)
    with opened(first) as source:
        first.close()
        with Server(replace(LABORATORY, **change), first.port):
            wait(lambda: said(caplog, why, "live.qualisys"))
            assert not len(source.take().markers.time)
        with Server(LABORATORY, first.port) as server:
            wait(lambda: bool(server.streams))
            session = Session(np.random.default_rng(seed), 2)
            server.send(session.frame(0) + session.frame(1))
            assert len(gather(source, at_least(2)).markers.time) == 2


EVENTS = {"counts anew": b"", "an event": packet(qtm_server.EVENT, bytes([qtm_server.SETTINGS_CHANGED]))}


@pytest.mark.parametrize("between", EVENTS.values(), ids=EVENTS)
def test_a_server_that_begins_anew_is_asked_for_its_parameters_again(server, seed, caplog, between):
    """Where frames count from one again, and where QTM says that settings have changed; events of others do nothing."""
    session = Session(np.random.default_rng(seed))
    with opened(server) as source:
        server.send(b"".join(session.frame(k, 50 + k) for k in range(FRAMES)))
        server.send(packet(qtm_server.EVENT, b"\x10"))
        before = gather(source, at_least(FRAMES, EACH * FRAMES))
        server.laboratory = replace(LABORATORY, labels=("B", "A", "C"))
        server.send(between + session.frame(0))
        wait(lambda: server.commands.count("getparameters general 3d force") == 2 and bool(server.streams))
        server.send(session.frame(1, 7))
        after = gather(source, at_least(1))
    assert said(caplog, "is back") and len(after.markers.time) == 1
    assert float(after.markers.time[0] - before.markers.time[-1]) > JUMP_S
    expected = torch.from_numpy(session.markers[1][[1, 0, 2]] / 1e3).double()
    assert_close(after.markers.position[0], expected, rtol=0.0, atol=1e-6)


def test_a_server_that_falls_silent_is_asked_and_left(server, seed, caplog):
    """One that measures nothing answers, and is kept; one that is gone without a word is not."""
    session = Session(np.random.default_rng(seed), 1)
    with opened(server) as source:
        wait(lambda: "qtmversion" in server.commands)
        server.send(session.frame(0))
        gather(source, at_least(1))
        assert not caplog.records
        server.deaf = True
        wait(lambda: said(caplog, "does not answer"))
        server.deaf = False
        wait(lambda: said(caplog, "is back"), 8.0)


NONSENSE = {
    "no size": struct.pack("<II", 0, qtm_server.COMMAND) + b"\0" * 64,
    "a text": b"HTTP/1.1 400 Bad Request\r\n\r\n",
    "a huge size": struct.pack("<II", LARGEST + 1, qtm_server.DATA),
    "no such type": packet(77, b"\0" * 9),
    "more components than bytes": packet(qtm_server.DATA, struct.pack("<qII", 1, 1, 2**31)),
    "a component that lies": data(1, 1, packet(1, struct.pack("<Ihh", 1000, 0, 0))),
    "no header of data": packet(qtm_server.DATA, b"\0"),
    "an unknown component": data(1, 1, packet(99, b"")),
    "other markers": data(1, 10_000, markers_part(np.ones((2, 3)))),
    "forces anew": data(1, 10_000, markers_part(np.ones((3, 3))), forces_part([(1, 5, np.ones((2, 9)))])),
    "another plate": data(1, 10_000, markers_part(np.ones((3, 3))), forces_part([(9, 1, np.ones((2, 9)))])),
}


@pytest.mark.parametrize("nonsense", NONSENSE.values(), ids=NONSENSE)
def test_nonsense_in_a_stream_is_survived(server, seed, caplog, nonsense):
    """It ends that connection, and the next goes on."""
    session = Session(np.random.default_rng(seed), 2)
    with opened(server) as source:
        server.send(session.frame(0))
        gather(source, at_least(1))
        server.send(nonsense.replace(struct.pack("<qII", 10_000, 1, 1), struct.pack("<qII", 20_000, 2, 1)))
        wait(lambda: said(caplog, "live.qualisys") and said(caplog, "is back"))
        server.send(session.frame(1, 1))
        found = gather(source, at_least(1))
    assert_close(found.markers.position[-1], torch.from_numpy(session.markers[1] / 1e3).double(), rtol=0.0, atol=1e-6)


def test_random_bytes_are_survived(server, seed, caplog):
    """Whatever they are."""
    rng = np.random.default_rng(seed)
    session = Session(rng, 1)
    caplog.set_level(logging.CRITICAL, "qtm_rt")
    with opened(server) as source:
        for _ in range(5):
            wait(lambda: bool(server.streams))
            head = struct.pack("<II", int(rng.integers(0, 64)), int(rng.integers(0, 12)))
            server.send(head + rng.bytes(200) + b"\xff" * 16)
            time.sleep(0.7)
        wait(lambda: bool(server.streams))
        source.take()
        server.send(session.frame(0))
        gather(source, at_least(1))


@pytest.mark.parametrize("greeting", [NONSENSE["a text"], NONSENSE["no size"]], ids=["text", "zeros"])
def test_who_is_no_qtm_is_refused(greeting):
    with Server(LABORATORY, greeting=greeting) as server, pytest.raises(InputError, match=r"live\.qualisys") as caught:
        opened(server)
    assert "does not speak QTM's protocol" in str(caught.value) and "22223" in caught.value.remedy


def test_nobody_who_listens_is_told():
    """With the address, and what to do."""
    server = Server(LABORATORY)
    server.close()
    with pytest.raises(InputError, match=r"no answer.*live\.qualisys") as caught:
        opened(server)
    assert str(server.port) in caught.value.source and "qualisys:HOST:PORT" in caught.value.remedy
    assert threading.active_count() < 50 and not [one for one in threading.enumerate() if one.name.startswith("QTM")]


XML = LABORATORY.xml()


@pytest.mark.parametrize(("xml", "found"), [
    ("", "Parameters not available"),
    (XML[:-9], "no XML"),
    (XML.replace("<Name>B", "<Name>A"), "A, A, C"),
    (replace(LABORATORY, labels=()).xml(), "no labels"),
    (replace(LABORATORY, plates={}).xml(), "no force plates"),
    (replace(LABORATORY, up="-X").xml(), "-x"),
    (XML.replace("<Frequency>100<", "<Frequency>EXT<"), "General/Frequency EXT"),
    (XML.replace("<Frequency>1000<", "<Frequency>500<", 1), "500"),
    (XML.replace("<Name>right", "<Name>left"), "left, left"),
    (XML.replace("th>mm<", "th>inch<"), "inch"),
    (XML.replace("<X>600.0<", "<X>900.0<", 1), "rectangle"),
    (XML.replace("<X>600.0<", "<X><", 1), "Location/Corner1/X"),
])  # fmt: skip
def test_parameters_that_leave_something_open_are_refused(xml, found):
    with Server(xml) as server, pytest.raises(InputError, match=r"live\.qualisys") as caught:
        opened(server)
    assert found in str(caught.value)


def test_frames_at_another_rate_than_stated_are_not_taken_up(server, seed, caplog):
    """As behind an external clock: accelerations would be wrong by the square."""
    session = Session(np.random.default_rng(seed))
    with opened(server):
        for k in range(20):
            server.send(data(k + 1, 9_000 * (k + 1), markers_part(session.markers[k])))
        wait(lambda: said(caplog, "another rate than it states", "live.qualisys"))


def test_addresses():
    assert address_of("") == (HOST, PORT) == ("127.0.0.1", 22223)
    assert address_of("lab-pc") == ("lab-pc", PORT) and address_of("10.0.0.7:22323") == ("10.0.0.7", 22323)
    assert address_of("[::1]:5") == ("::1", 5)
    for bad in ("lab:port", "lab:99999", "lab/22223", "::1"):
        with pytest.raises(ConfigError, match=r"live\.source"):
            address_of(bad)


def test_the_command_names_what_is_missing(tmp_path, monkeypatch):
    """A package, and an address that is none, before anything is computed."""
    config = load_config(small_session.config(), [f"out={tmp_path / 'out'}"])
    with pytest.raises(ConfigError, match=r"live\.source"):
        run_live(config, "qualisys:lab:port")
    with pytest.raises(ConfigError, match=r"qualisys:HOST:PORT.*live\.source"):
        run_live(config, "qualysis")
    for name in ("qualisys", "qtm_run", "qtm_link"):
        monkeypatch.delitem(sys.modules, f"torchid.live.sources.{name}")
    for name in [one for one in sys.modules if one.split(".")[0] == "qtm_rt"]:
        monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(ConfigError, match=r"torchid\[live\].*live\.extra"):
        run_live(config, "qualisys")


def simulated() -> tuple[Laboratory, Session]:
    """A trial of the small session as a laboratory with its plates sends it."""
    given = next(item.trial for item in small_session.session().trials if item.trial.name == "squats")
    plates = {plate.name: 1e3 * plate.corners.numpy() for plate in given.forces.plates}
    each = round(given.forces.rate / given.markers.rate)
    laboratory = Laboratory(given.markers.labels, given.markers.rate, given.forces.rate, plates)
    session = Session.__new__(Session)
    session.markers, session.wrench = 1e3 * given.markers.position.numpy(), given.forces.wrench.numpy()
    session.sent = [in_plate(session.wrench[:, k], one) for k, one in enumerate(plates.values())]
    session._first_id = 1
    assert each * (len(session.markers) - 1) < len(session.wrench)
    return laboratory, session


def play(server: Server, laboratory: Laboratory, session: Session, pace: float, over: Callable[[], bool]) -> None:
    """A trial once, at a multiple of its pace."""
    each, begun = round(laboratory.force_rate / laboratory.rate), time.monotonic()
    for k, markers in enumerate(session.markers):
        if over():
            return
        time.sleep(max(0.0, begun + k / laboratory.rate / pace - time.monotonic()))
        chunk = session.chunk(each * k, each * (k + 1), tuple(range(len(laboratory.plates))))
        server.send(data(k + 1, round(1e6 * (k + 1) / laboratory.rate), markers_part(markers), chunk))


def test_a_simulated_trial_is_received_as_it_is():
    """Markers to a hundredth of a millimetre, wrenches to a thousandth of a newton, as 32-bit numbers allow."""
    laboratory, session = simulated()
    frames, each = len(session.markers), round(laboratory.force_rate / laboratory.rate)
    samples = min(each * frames, len(session.wrench))
    with Server(laboratory) as server, opened(server) as source:
        play(server, laboratory, session, 50.0, lambda: False)
        found = gather(source, at_least(frames, samples))
    assert (source.labels, source.rate_hz) == (laboratory.labels, laboratory.rate)
    assert_close(found.markers.position, torch.from_numpy(session.markers / 1e3), rtol=0.0, atol=1e-5, equal_nan=True)
    assert_close(found.forces.wrench, torch.from_numpy(session.wrench[:samples]), rtol=0.0, atol=1e-3)


@pytest.mark.slow
@pytest.mark.usefixtures("quick_children")
def test_a_subject_is_identified_from_a_stream(tmp_path):
    """The command's own way; the mass is the subject's."""
    laboratory, session = simulated()
    config, over = load_config(small_session.config(), [f"out={tmp_path / 'out'}"]), threading.Event()

    def work() -> None:
        while not (server.streams or over.wait(0.01)):
            pass
        play(server, laboratory, session, 1.0, over.is_set)

    with Server(laboratory) as server:
        player = threading.Thread(target=work)
        player.start()
        try:
            told = run_live(config, f"qualisys:127.0.0.1:{server.port}", seconds=9.0)
        finally:
            over.set()
            player.join()
    truth = float(small_session.session().subject.phi[:, 0].sum())
    assert told["mass_kg"]["value"] == pytest.approx(truth, rel=0.03)
    assert told["frames"] > 200 and told["again"] == 0 and told["lost"] == 0
