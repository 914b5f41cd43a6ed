"""Streams of Lab Streaming Layer, and recordings of them, come in as they were sent, whatever becomes of a sender."""

import logging
import os
import struct
import subprocess
import sys
import tempfile
import threading
import time
import uuid
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import small_session
import torch
from test_scripts import script
from torch.testing import assert_close

from torchid.config import load_config
from torchid.errors import ConfigError, InputError
from torchid.live.run import run_live
from torchid.live.sources.intake import Counts, Intake
from torchid.live.sources.stream import Packet
from torchid.recording import Forces, Markers, Plate, Trial

# A laboratory of its own, which no other sees, found without multicast: must be told before the library is loaded.
LABORATORY = Path(tempfile.mkdtemp()) / "lsl_api.cfg"
LABORATORY.write_text(
    f"[lab]\nSessionID = {uuid.uuid4()}\nKnownPeers = {{127.0.0.1}}\n[multicast]\nResolveScope = machine\n"
    "[ports]\nIPv6 = disable\n[log]\nlevel = -3\n"
)
os.environ["LSLAPICFG"] = str(LABORATORY)

pylsl = pytest.importorskip("pylsl")
pytest.importorskip("pyxdf")
from torchid.live.sources import description, lsl  # noqa: E402
from torchid.live.sources.lsl import LslSource  # noqa: E402
from torchid.live.sources.outlets import Outlets, describe_markers, describe_plates, play  # noqa: E402
from torchid.live.sources.xdf import device_series, replay_xdf  # noqa: E402

pytestmark = pytest.mark.shown
RATE, FORCE_RATE, FRAMES = 100.0, 400.0, 60
LABELS = ("A", "B", "C")
CORNERS = torch.tensor([[0.5, 0.0, 0.0], [0.5, 0.4, 0.0], [0.0, 0.4, 0.0], [0.0, 0.0, 0.01]], dtype=torch.float64)
PLATES = (Plate("left", CORNERS, number=1), Plate("right", number=2))
GIVE_UP_S = 20.0
ROOT = str(Path(__file__).resolve().parents[1])


@pytest.fixture(scope="module", autouse=True)
def network() -> None:
    """Without a loopback on which a stream is found nothing of this can be tested."""
    outlet = pylsl.StreamOutlet(pylsl.StreamInfo("probe", "probe", 1, 1.0, pylsl.cf_float32, "probe"))
    if not pylsl.resolve_byprop("type", "probe", timeout=10.0):
        pytest.skip("no stream is found on this machine's own network")
    del outlet


def trial(rng: np.random.Generator, frames: int = FRAMES) -> Trial:
    """Three markers and two plates whose values nobody else has."""
    time_s = torch.arange(frames, dtype=torch.float64) / RATE
    samples = torch.arange(4 * frames, dtype=torch.float64) / FORCE_RATE
    position = torch.from_numpy(rng.normal(size=(frames, 3, 3)))
    position[5:9, 1] = torch.nan
    wrench = torch.from_numpy(rng.normal(size=(len(samples), 2, 6)))
    return Trial("a", Markers(LABELS, time_s, position), Forces(samples, wrench, PLATES))


def whole(given: Trial) -> Packet:
    """All of it at once."""
    return Packet(given.markers, given.forces, 0.0)


def gather(source: LslSource, done: Callable[[list[Packet]], bool]) -> Packet:
    """What is taken until enough has come; no take waits."""
    found: list[Packet] = []
    end = time.monotonic() + GIVE_UP_S
    while not done(found):
        assert time.monotonic() < end, f"{frames(found)} frames came"
        begun = time.monotonic()
        found.append(source.take())
        assert time.monotonic() - begun < 0.4 * lsl.REPLY_S, "a take waits"
        assert found[-1].arrived_s >= begun
        time.sleep(0.002)
    forces = [one.forces for one in found if one.forces is not None]
    markers = Markers(source.labels, torch.cat([one.markers.time for one in found]),
                      torch.cat([one.markers.position for one in found]))  # fmt: skip
    return Packet(markers, Forces(torch.cat([one.time for one in forces]), torch.cat([one.wrench for one in forces]),
                                  source.plates), 0.0)  # fmt: skip


def frames(found: list[Packet]) -> int:
    return sum(len(one.markers.time) for one in found)


def enough(count: int, samples: int = 0) -> Callable[[list[Packet]], bool]:
    """Whether so many frames and samples have come."""
    return lambda found: frames(found) >= count and sum(
        len(one.forces.time) for one in found if one.forces is not None
    ) >= samples  # fmt: skip


def joined(source: LslSource, outlets: Outlets) -> None:
    """Wait until samples that are sent would be received."""
    end = time.monotonic() + GIVE_UP_S
    while not (outlets.listened() and (outlets._plates is None or outlets._plates.have_consumers())):
        source.take()
        assert time.monotonic() < end
        time.sleep(0.01)
    time.sleep(0.1)


def test_what_is_sent_is_received_unchanged(seed):
    """Values to the last bit, times by this machine's clock, names, rates and plates with their corners."""
    given = trial(np.random.default_rng(seed))
    assert given.forces is not None
    outlets = Outlets(given, "unchanged")
    with LslSource("unchanged") as source:
        assert source.labels == LABELS and (source.rate_hz, source.force_rate_hz) == pytest.approx((RATE, FORCE_RATE))
        assert [plate.name for plate in source.plates] == ["left", "right"]
        assert source.plates[0].corners is not None and torch.equal(source.plates[0].corners, CORNERS)
        assert source.plates[1].corners is None and source.plates[1].number == 2
        assert frames([source.take()]) == 0
        joined(source, outlets)
        shift = pylsl.local_clock()
        outlets.send(whole(given), shift)
        found = gather(source, enough(FRAMES, 4 * FRAMES))
    assert found.forces is not None
    assert_close(found.markers.position, given.markers.position, rtol=0.0, atol=0.0, equal_nan=True)
    assert_close(found.forces.wrench, given.forces.wrench, rtol=0.0, atol=0.0)
    assert_close(found.markers.time - shift, given.markers.time, rtol=0.0, atol=2e-3)
    assert_close(found.forces.time - shift, given.forces.time, rtol=0.0, atol=2e-3)


def test_a_trial_is_played_at_its_pace(seed):
    """Twice as fast with the recording's time stamps; a loop begins again behind a pause."""
    given = trial(np.random.default_rng(seed))
    outlets = Outlets(given, "played")
    with LslSource("played") as source:
        joined(source, outlets)
        stop, begun = threading.Event(), time.monotonic()
        player = threading.Thread(target=play, args=(given, outlets, 2.0, True, stop.is_set))
        player.start()
        found = gather(source, enough(FRAMES))
        took = time.monotonic() - begun
        again = gather(source, enough(1))
        stop.set()
        player.join()
    assert 0.5 * FRAMES / RATE - 0.05 < took < 2.0
    assert_close(found.markers.time.diff(), given.markers.time.diff(), rtol=0.0, atol=2e-3)
    assert float(again.markers.time[0] - found.markers.time[-1]) > 2.5
    assert_close(again.markers.position[0], given.markers.position[0], rtol=0.0, atol=0.0)


def test_a_rate_that_is_not_stated_is_measured():
    """As it must be of senders that open irregular streams."""
    info = describe_markers(LABELS, 0.0, "irregular", "irregular")
    outlet, stop = pylsl.StreamOutlet(info), threading.Event()

    def send() -> None:
        begun, k = pylsl.local_clock(), 0
        while not stop.wait(0.005):
            while begun + k / RATE < pylsl.local_clock():
                outlet.push_sample([1.0] * 9, begun + k / RATE)
                k += 1

    sender = threading.Thread(target=send)
    sender.start()
    try:
        (found,) = pylsl.resolve_byprop("name", info.name(), 1, GIVE_UP_S)
        one = lsl.Feed(found, description.marker_layout)
        assert one.layout.rate_hz == 0.0 and one.rate_hz == RATE
        one.close()
    finally:
        stop.set()
        sender.join()


def test_lost_doubled_and_overtaking_samples_find_their_places(seed):
    """What a sender does to the order of its samples changes nothing of what is placed."""
    rng = np.random.default_rng(seed)
    given = trial(rng)
    lost = rng.choice(np.arange(1, FRAMES - 1), 6, replace=False)
    order = np.array([k for k in np.argsort(np.arange(FRAMES) + rng.uniform(0.0, 5.0, FRAMES)) if k not in lost])
    order = np.concatenate([[0], order[order != 0], order[-3:]])
    outlets = Outlets(given, "spoilt")
    with LslSource("spoilt") as source:
        joined(source, outlets)
        outlets.send(Packet(given.markers.frames(torch.from_numpy(order)), None, 0.0), pylsl.local_clock())
        found = gather(source, enough(len(order)))
    intake = Intake(source.rate_hz, source.force_rate_hz, 0.5)
    placed = intake.place(found)
    kept = np.setdiff1d(np.arange(FRAMES), lost)
    assert placed.index.tolist() == kept.tolist()
    assert_close(placed.markers.position, given.markers.position[kept], rtol=0.0, atol=0.0, equal_nan=True)
    assert intake.counts == Counts(len(kept), 6, 3, 0, 0)


@pytest.fixture
def sender() -> Iterator[Callable[..., None]]:
    """Start a sender; one that is there is killed first."""
    command, running = [sys.executable, str(Path(__file__).with_name("lsl_sender.py"))], []

    def start(labels: tuple[str, ...] = LABELS, rate_hz: float = RATE) -> None:
        for process in running:
            process.kill()
            process.wait()
        words = [*command, "".join(labels), str(rate_hz)]
        running.append(
            subprocess.Popen(words, stdout=subprocess.PIPE, text=True, env={**os.environ, "PYTHONPATH": ROOT})
        )
        assert running[-1].stdout.readline() == "open\n"

    yield start
    for process in running:
        process.kill()
        process.wait()
        process.stdout.close()


def expected(labels: tuple[str, ...]) -> torch.Tensor:
    """Where these markers are, NaN for an empty name."""
    places = [float(ord(label)) if label else float("nan") for label in labels]
    return torch.tensor(places, dtype=torch.float64)[None, :, None].expand(1, -1, 3)


@pytest.mark.slow
def test_a_sender_that_is_killed_and_comes_back_goes_on(sender, caplog):
    """The same, then under another order of names, then without a marker, then with none of them, which is refused."""
    caplog.set_level(logging.WARNING)
    sender()
    with LslSource("mortal", 20.0) as source:
        first = gather(source, enough(20, 20))
        assert_close(first.markers.position, expected(LABELS).expand(len(first.markers.time), -1, -1))
        for labels, seen in ((LABELS, LABELS), (("C", "X", "B", "A"), LABELS), (("B", "A"), ("A", "B", ""))):
            sender(labels)
            gather(source, lambda found: len(found) > 20)  # what was under way
            back = gather(source, enough(20, 20))
            off = back.markers.position - expected(seen)
            assert_close(back.markers.position, expected(seen).expand(len(off), -1, -1), equal_nan=True)
            assert bool((back.markers.time.diff() > 0.0).all())
        for labels, rate_hz, why in ((("X", "Y"), RATE, "none of the names"), (LABELS, 2.0 * RATE, "another rate")):
            sender(labels, rate_hz)
            said, end = len(caplog.records), time.monotonic() + GIVE_UP_S
            while not any(why in one.getMessage() for one in caplog.records[said:]) and time.monotonic() < end:
                assert not len(source.take().markers.time)
                time.sleep(0.01)
            assert any(why in one.getMessage() and "live.lsl" in one.getMessage() for one in caplog.records[said:])
    assert any("without C" in one.getMessage() for one in caplog.records)


def edited(info: "pylsl.StreamInfo", *changes: tuple[str, str]) -> description.Tree:
    """The description of a stream with some of its text exchanged."""
    xml = info.as_xml()
    for old, new in changes:
        assert old in xml
        xml = xml.replace(old, new)
    return description.tree(xml)


def markers_info(labels: tuple[str, ...] = LABELS) -> "pylsl.StreamInfo":
    return describe_markers(labels, RATE, "m", "m")


def test_units_axes_and_lags_are_read(seed):
    """Millimetres, Y up, how late stamps are, and what a sender has taken off them already."""
    raw = torch.from_numpy(np.random.default_rng(seed).normal(size=(4, 9)))
    plain = description.marker_layout(edited(markers_info()), "s")
    milli = description.marker_layout(edited(markers_info(), ("<unit>meters", "<unit>mm")), "s")
    assert_close(1e-3 * plain.read(raw), milli.read(raw))
    assert_close(plain.read(raw), raw.reshape(4, 3, 3))
    turned = description.marker_layout(edited(markers_info(), ("<up>z", "<up>Y")), "s").read(raw)
    assert_close(turned, torch.stack([raw.reshape(4, 3, 3)[..., 0], -raw.reshape(4, 3, 3)[..., 2],
                                      raw.reshape(4, 3, 3)[..., 1]], dim=-1))  # fmt: skip
    raw[2, 3:6] = 0.0
    assert bool(plain.read(raw)[2, 1].isnan().all()) and int(plain.read(raw).isnan().sum()) == 3
    late = "<desc><synchronization><offset_mean>0.03</offset_mean></synchronization>"
    lag = "<acquisition><compensated_lag>0.01</compensated_lag></acquisition>"
    found = description.marker_layout(edited(markers_info(), ("<desc>", late + lag)), "s")
    assert (found.late_s, found.compensated_s, plain.late_s) == (0.03, 0.01, 0.0)
    plates = description.plate_layout(edited(describe_plates(PLATES, FORCE_RATE, "p", "p"), ("N m<", "Nmm<")), "s")
    assert_close(
        plates.read(torch.ones(1, 12, dtype=torch.float64))[0, 0], torch.tensor([1.0] * 3 + [1e-3] * 3).double()
    )
    assert torch.equal(plates.corners["left"], CORNERS)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ((("<unit>meters", "<unit>furlongs"),), "furlongs"),
        ((("<unit>meters</unit>", ""),), "none of channel A_PositionX"),
        ((("<marker>", "<bone>"), ("</marker>", "</bone>")), "no channel of a marker"),
        ((("<marker>B", "<marker>A"),), "A PositionX"),
        ((("PositionZ", "Confidence"),), "A PositionZ"),
        ((("<channel_count>9", "<channel_count>10"),), "9 described of 10"),
        ((("<up>z", "<up>x"),), "setup/up x"),
        ((("double64", "string"),), "holds texts"),
        ((("</setup>", "</setup><synchronization><offset_mean>soon</offset_mean></synchronization>"),), "soon"),
    ],
)
def test_a_description_that_leaves_something_open_is_refused(changes, said):
    """With what was found, and what to do."""
    with pytest.raises(InputError, match=r"live\.lsl") as caught:
        description.marker_layout(edited(markers_info(), *changes), "stream m")
    assert said in str(caught.value) and caught.value.source == "stream m"


def test_other_faults_of_a_description_are_refused():
    """No XML, a rate that nothing tells, a plate with three corners."""
    with pytest.raises(InputError, match=r"live\.lsl.*|no XML"):
        description.tree("<info><desc></info>")
    still = description.marker_layout(edited(markers_info(), ("<nominal_srate>100", "<nominal_srate>0")), "s")
    assert still.rate_hz == 0.0
    assert description.rate_of(still, torch.arange(0, 2, 0.01003, dtype=torch.float64), "s") == RATE
    with pytest.raises(InputError, match="states no rate"):
        description.rate_of(still, torch.zeros(1, dtype=torch.float64), "s")
    xml = describe_plates(PLATES, FORCE_RATE, "p", "p").as_xml()
    start = xml.index("<corner>")
    less = xml[:start] + xml[xml.index("</corner>") + len("</corner>") :]
    with pytest.raises(InputError, match="four corners"):
        description.plate_layout(description.tree(less), "s")


def test_streams_that_are_not_there_or_too_many_are_told(seed):
    """By name, with those that were seen."""
    given = trial(np.random.default_rng(seed))
    outlets = Outlets(replace(given, forces=None), "alone")
    with pytest.raises(InputError, match=r"no stream called other.*alone \(MoCap.*live\.lsl"):
        LslSource("other", 1.0)
    with pytest.raises(InputError, match=r"ForcePlate: has no stream.*alone.*live\.lsl"):
        LslSource("alone", 1.0)
    second = Outlets(given, "second")
    with pytest.raises(InputError, match=r"several streams.*lsl:NAME"):
        LslSource("", 1.0)
    del outlets, second


def chunk(tag: int, content: bytes) -> bytes:
    """A chunk of an XDF file."""
    return b"\x04" + struct.pack("<IH", len(content) + 2, tag) + content


def xdf(path: Path, streams: list[tuple[str, np.ndarray, np.ndarray, float]]) -> Path:
    """An XDF file with streams: description, times by the sender's clock, samples, and the offset of that clock."""
    out = b"XDF:" + chunk(1, b"<?xml version='1.0'?><info><version>1.0</version></info>")
    for k, (xml, time_s, values, offset) in enumerate(streams, 1):
        number = struct.pack("<I", k)
        out += chunk(2, number + xml.encode())
        rows = b"".join(b"\x08" + struct.pack("<d", t) + row.astype("<f8").tobytes()
                        for t, row in zip(time_s, values, strict=True))  # fmt: skip
        out += chunk(3, number + b"\x04" + struct.pack("<I", len(time_s)) + rows)
        out += b"".join(chunk(4, number + struct.pack("<dd", t, offset)) for t in (time_s[0], time_s[-1]))
        out += chunk(6, number + b"<info></info>")
    path.write_bytes(out)
    return path


def recorded(path: Path, given: Trial) -> Path:
    """A trial as LabRecorder would have recorded it: clocks apart by minutes, two frames lost, two exchanged."""
    assert given.forces is not None
    order = np.array([k for k in range(FRAMES) if k not in (20, 21)])
    order[[30, 31]] = order[[31, 30]]
    m, f = given.markers, given.forces
    plates = describe_plates(PLATES, FORCE_RATE, "p", "p")
    return xdf(path, [
        (markers_info().as_xml(), m.time.numpy()[order] + 500.0, m.position.flatten(1).numpy()[order], -400.0),
        (plates.as_xml(), f.time.numpy() + 90.0, f.wrench.flatten(1).numpy(), 10.0),
    ])  # fmt: skip


def test_a_devices_own_stream_is_read(tmp_path):
    """By label or number, on the file's clock, in the order of time; markers, plates and texts are not among them."""
    channels = "<channels><channel><label>torque</label></channel><channel/></channels>"
    told = "<name>exo</name><type>Device</type><channel_count>2</channel_count><nominal_srate>0</nominal_srate>"
    info = f"<?xml version='1.0'?><info>{told}<channel_format>double64</channel_format><desc>{channels}</desc></info>"
    time_s, values = np.array([2.0, 1.0, 3.0]), np.array([[2.0, 20.0], [1.0, 10.0], [3.0, 30.0]])
    path = xdf(tmp_path / "exo.xdf", [(info, time_s, values, 100.0)])
    found = device_series(path)
    assert list(found) == ["torque", "exo_2"]
    np.testing.assert_allclose(found["torque"][0], [101.0, 102.0, 103.0])
    np.testing.assert_allclose(found["exo_2"][1], [10.0, 20.0, 30.0])
    with pytest.raises(InputError, match="two channels of one name"):
        device_series(xdf(tmp_path / "two.xdf", [(info, time_s, values, 0.0)] * 2))


def test_a_recorded_file_is_replayed_as_it_was_sent(tmp_path, seed):
    """On one clock, at the nominal rate, with its gap."""
    given = trial(np.random.default_rng(seed))
    assert given.forces is not None
    source = replay_xdf(recorded(tmp_path / "a.xdf", given), float("inf"))
    assert (source.labels, source.rate_hz, source.force_rate_hz) == (LABELS, RATE, FORCE_RATE)
    intake, found, wrench = Intake(RATE, FORCE_RATE, 0.5), {}, {}
    while (packet := source.take()) is not None:
        placed = intake.place(packet)
        found |= dict(zip(placed.index.tolist(), placed.markers.position, strict=True))
        wrench |= dict(zip(placed.sample.tolist(), placed.wrench, strict=True))
    assert intake.counts == Counts(FRAMES - 2, 2, 0, 0, 0)
    for k, position in found.items():
        assert_close(position, given.markers.position[k], rtol=0.0, atol=0.0, equal_nan=True)
    assert_close(torch.stack([wrench[k] for k in range(4 * FRAMES)]), given.forces.wrench, rtol=0.0, atol=0.0)


def test_a_file_that_is_no_recording_of_both_is_refused(tmp_path, seed):
    bad = tmp_path / "bad.xdf"
    bad.write_bytes(b"XLS:")
    with pytest.raises(InputError, match=r"live\.xdf"):
        replay_xdf(bad)
    m = trial(np.random.default_rng(seed)).markers
    one = (markers_info().as_xml(), m.time.numpy(), m.position.flatten(1).numpy(), 0.0)
    with pytest.raises(InputError, match=r"no stream of type ForcePlate.*m \(MoCap\).*live\.lsl"):
        replay_xdf(xdf(tmp_path / "one.xdf", [one]))
    with pytest.raises(InputError, match=r"several streams of type MoCap.*live\.lsl"):
        replay_xdf(xdf(tmp_path / "two.xdf", [one, one]))


@pytest.mark.slow
def test_the_script_sends_a_trial_of_a_config():
    """Every frame as it was read, once somebody listens."""
    given = next(item.trial for item in small_session.session().trials if item.trial.name == "squats")
    words = [str(small_session.config()), "--trial", "squats", "--name", "scripted", "--speed", "4"]
    sender = threading.Thread(target=script("send_lsl").main, args=(words,))
    sender.start()
    with LslSource("scripted", 60.0) as source:
        found = gather(source, enough(len(given.markers.time)))
        sender.join()
    assert set(source.labels) == set(given.markers.labels)
    sent = given.markers.select(source.labels).position
    assert_close(found.markers.position, sent, rtol=0.0, atol=1e-4, equal_nan=True)


@pytest.mark.slow
@pytest.mark.usefixtures("quick_children")
def test_a_subject_is_identified_from_a_stream(tmp_path):
    """The command's own way, while a trial is sent again and again; the mass is the subject's."""
    given = next(item.trial for item in small_session.session().trials if item.trial.name == "squats")
    outlets, stop = Outlets(given, "subject"), threading.Event()
    player = threading.Thread(target=play, args=(given, outlets, 1.0, True, stop.is_set))
    player.start()
    try:
        config = load_config(small_session.config(), [f"out={tmp_path / 'out'}"])
        # A trial takes 4 s, and begins while the subject is prepared: its second round is seen on a busy machine, too.
        said = run_live(config, "lsl:subject", seconds=14.0)
    finally:
        stop.set()
        player.join()
    truth = float(small_session.session().subject.phi[:, 0].sum())
    assert said["mass_kg"]["value"] == pytest.approx(truth, rel=0.03)
    assert said["frames"] > 200 and said["again"] == 0 and said["restarts"] >= 1


@pytest.mark.parametrize(("package", "source"), [("pylsl", "lsl"), ("pyxdf", "xdf:{}")])
def test_a_package_that_is_missing_is_named(tmp_path, monkeypatch, package, source):
    config = load_config(small_session.config(), [f"out={tmp_path / 'out'}"])
    for name in ("lsl", "xdf"):
        monkeypatch.delitem(sys.modules, f"torchid.live.sources.{name}")
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(ConfigError, match=r"torchid\[live\].*live\.extra"):
        run_live(config, source.format(small_session.config()))
