"""Frames and samples find their places on one clock, whatever a network does to them, and are on the disk at once."""

import errno
import os
import resource
import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
import torch
from torch.testing import assert_close

from torchid.errors import InputError
from torchid.io import ReadOptions, read_trial
from torchid.live.sources.intake import Counts, Intake
from torchid.live.sources.recorder import Recorder
from torchid.live.sources.stream import AT_ONCE, Packet, Replay
from torchid.live.sources.timeline import Timeline
from torchid.recording import Forces, Markers, Plate, Trial

RATE, FORCE_RATE, PATIENCE_S = 100.0, 400.0, 0.5
PLATES = (Plate("1", number=1), Plate("2", number=2))


def trial(rng: np.random.Generator, frames: int = 300) -> Trial:
    """Three markers and two plates whose values nobody else has."""
    time_s = torch.arange(frames, dtype=torch.float64) / RATE
    samples = torch.arange(4 * frames, dtype=torch.float64) / FORCE_RATE
    position = torch.from_numpy(rng.normal(size=(frames, 3, 3)))
    # Plates that bear some weight near the origin: anything else would be read with a doubt.
    wrench = torch.from_numpy(rng.normal(size=(len(samples), 2, 6))) + torch.tensor([0.0, 0.0, 300.0, 0.0, 0.0, 0.0])
    return Trial("a", Markers(("A", "B", "C"), time_s, position), Forces(samples, wrench, PLATES))


def packets(given: Trial) -> list[Packet]:
    """The trial in packets of a few frames."""
    source, found = Replay(given, float("inf")), []
    while (packet := source.take()) is not None:
        found.append(packet)
    return found


def single(given: Trial, order: np.ndarray, shift_s: np.ndarray | None = None) -> list[Packet]:
    """One frame a packet, in an order, with times that are off by so much."""
    m, off = given.markers, np.zeros(len(order)) if shift_s is None else shift_s
    return [Packet(Markers(m.labels, m.time[k : k + 1] + off[n], m.position[k : k + 1]), None, 0.0)
            for n, k in enumerate(order.tolist())]  # fmt: skip


def taken(intake: Intake, given: list[Packet]) -> dict[int, torch.Tensor]:
    """Frames by their place; none is placed twice."""
    found: dict[int, torch.Tensor] = {}
    for packet in given:
        placed = intake.place(packet)
        assert not set(placed.index.tolist()) & set(found)
        found |= dict(zip(placed.index.tolist(), placed.markers.position, strict=True))
    return found


def test_replay_gives_everything_once_and_no_sample_before_its_frame(seed):
    given = trial(np.random.default_rng(seed))
    assert given.forces is not None
    clock = iter(np.sort(np.random.default_rng(seed).uniform(0.0, 9.0, 40)).tolist() + [99.0] * 9)
    source, frames, samples = Replay(given, 0.5, lambda: next(clock)), [], []
    while (packet := source.take()) is not None:
        assert packet.forces is not None
        frames.append(packet.markers.position)
        samples.append(packet.forces.wrench)
        if sum(map(len, frames)) < len(given.markers.time):
            assert abs(sum(map(len, samples)) - 4 * sum(map(len, frames))) <= 4
    assert torch.equal(torch.cat(frames), given.markers.position) and torch.equal(
        torch.cat(samples), given.forces.wrench
    )
    assert max(len(one.markers.time) for one in packets(given)) == AT_ONCE


def test_order_and_doubles_change_nothing(seed):
    """Frames that overtake each other by less than the patience, some of them sent twice."""
    rng = np.random.default_rng(seed)
    given = trial(rng)
    order = np.argsort(np.arange(300) + rng.uniform(0.0, 0.8 * PATIENCE_S * RATE, 300))
    twice = np.insert(order, 140 + rng.integers(1, 20), order[140])
    intake = Intake(RATE, FORCE_RATE, PATIENCE_S)
    first = int(twice[0])
    found = taken(intake, single(given, twice))
    expected = {k - first: given.markers.position[k] for k in range(first, 300)}
    assert set(found) == set(expected) and all(torch.equal(found[k], expected[k]) for k in found)
    assert intake.counts == Counts(300 - first, 0, 1, first, 0)


def test_lost_late_and_timeless_frames_are_counted(seed):
    rng = np.random.default_rng(seed)
    given = trial(rng)
    lost = rng.choice(np.arange(1, 299), 30, replace=False)
    order = np.setdiff1d(np.arange(300), lost)
    off = np.zeros(len(order) + 2)
    order = np.append(
        order, [int(lost[(lost > 110) & (lost < 240)][0]), 299]
    )  # one that is too late, and one without a time
    off[-1] = np.nan
    intake = Intake(RATE, FORCE_RATE, PATIENCE_S)
    found = taken(intake, single(given, order, off))
    assert len(found) == 270
    assert intake.counts == Counts(270, 30, 0, 1, 0)


@pytest.mark.parametrize("jump_s", [3600.0, -3600.0])
def test_a_clock_that_is_set_is_a_pause(seed, jump_s):
    """Nothing is smoothed across it, and all frames before and after are there."""
    rng = np.random.default_rng(seed)
    given, at = trial(rng), int(rng.integers(50, 250))
    off = np.where(np.arange(300) >= at, jump_s, 0.0)
    intake = Intake(RATE, FORCE_RATE, PATIENCE_S)
    found = sorted(taken(intake, single(given, np.arange(300), off)))
    pause = round(PATIENCE_S * RATE)
    assert found == [*range(at), *range(at + pause, 300 + pause)]
    assert intake.counts == Counts(300, 0, 0, 0, 1)


def test_samples_lie_beside_their_frames(seed):
    given = trial(np.random.default_rng(seed))
    assert given.forces is not None
    late = Trial("a", Markers(given.markers.labels, given.markers.time + 7.0, given.markers.position),
                 Forces(given.forces.time + 7.0, given.forces.wrench, PLATES))  # fmt: skip
    intake, line = Intake(RATE, FORCE_RATE, PATIENCE_S), Timeline((2, 6))
    for packet in packets(late):
        placed = intake.place(packet)
        line.put(placed.sample, placed.wrench)
    assert torch.equal(line.get(slice(0, 1200)), given.forces.wrench)


@pytest.mark.parametrize("phase", [0.0, 0.3, 0.5])
def test_plates_between_the_places_of_frames_leave_no_holes(seed, phase):
    """Their clock is another; its stamps jitter by a tenth of a sample."""
    rng = np.random.default_rng(seed)
    given = trial(rng)
    assert given.forces is not None
    off = (phase + torch.from_numpy(rng.uniform(-0.1, 0.1, len(given.forces.time)))) / FORCE_RATE
    moved = Trial("a", given.markers, Forces(given.forces.time + off, given.forces.wrench, PLATES))
    intake, places = Intake(RATE, FORCE_RATE, PATIENCE_S), []
    for packet in packets(moved):
        places += intake.place(packet).sample.tolist()
    assert places == list(range(places[0], places[0] + len(given.forces.time))) and places[0] in (0, 1)


def test_a_timeline_forgets_and_holds_what_comes_in_any_order(seed):
    rng = np.random.default_rng(seed)
    line, index = Timeline((2,)), torch.from_numpy(rng.permutation(5000))
    values = torch.from_numpy(rng.normal(size=(5000, 2)))
    for some in index.split(70):
        line.put(some, values[some])
    assert torch.equal(line.get(slice(0, 5000)), values)
    line.forget(4000)
    line.put(torch.tensor([3999, 4000]), torch.zeros(2, 2, dtype=torch.float64))
    assert line.start == 4000 and line.stop == 5000
    found = line.get(slice(3990, 5010))
    assert bool(torch.isnan(found[:10]).all() & torch.isnan(found[-10:]).all())
    assert torch.equal(found[11:-10], values[4001:]) and bool((found[10] == 0).all())


def recorded(folder: Path, given: Trial, lost: int | None = None) -> Recorder:
    """What is written of a trial of which one packet is lost."""
    intake = Intake(RATE, FORCE_RATE, PATIENCE_S)
    with Recorder(folder, given.markers.labels, RATE, PLATES, FORCE_RATE) as recorder:
        for k, packet in enumerate(packets(given)):
            if k != lost:
                recorder.add(intake.place(packet))
    return recorder


def test_a_recording_reads_as_what_came(tmp_path, seed):
    """Numbers, clocks and gaps; nothing that is there is overwritten."""
    given = trial(np.random.default_rng(seed))
    given.markers.position[40:50, 1] = torch.nan
    recorder = recorded(tmp_path / "new", given)
    found = read_trial("a", recorder.markers, recorder.forces, options=ReadOptions(up="z"))
    assert found.forces is not None and given.forces is not None
    torch.testing.assert_close(found.markers.position, given.markers.position, rtol=1e-6, atol=1e-6, equal_nan=True)
    torch.testing.assert_close(found.forces.wrench, given.forces.wrench, rtol=1e-5, atol=1e-3)
    assert found.markers.rate == pytest.approx(RATE) and found.forces.rate == pytest.approx(FORCE_RATE)
    with pytest.raises(InputError, match=r"live\.recorded"):
        recorded(tmp_path / "new", given)
    holes = read_trial("a", recorded(tmp_path / "holes", given, 7).markers, options=ReadOptions(up="z")).markers
    assert bool(torch.isnan(holes.position[7 * AT_ONCE : 8 * AT_ONCE]).all()) and len(holes.time) == 300


@pytest.mark.parametrize("share", ["markers", "forces"])
def test_a_disk_that_gets_full_ends_the_recording_at_its_last_whole_row(tmp_path, seed, share, caplog):
    """The system takes no more bytes, amid a row: what came before reads as what was sent, and one warning says so."""
    rng = np.random.default_rng(seed)
    given, intake = trial(rng), Intake(RATE, FORCE_RATE, PATIENCE_S)
    whole = recorded(tmp_path / "whole", given)
    full = (whole.markers if share == "markers" else whole.forces).stat().st_size
    recorder = Recorder(tmp_path / "r", given.markers.labels, RATE, PLATES if share == "forces" else (), FORCE_RATE)
    with limited(int(rng.uniform(0.2, 0.9) * full)), recorder:
        for packet in packets(given):
            recorder.add(intake.place(packet))
    assert recorder.fault == os.strerror(errno.EFBIG) and recorder.table["fault"] == recorder.fault
    assert [one.levelname for one in caplog.records] == ["WARNING"] and "the stream goes on" in caplog.text
    forces = recorder.forces if share == "forces" else None
    found = read_trial("a", recorder.markers, forces, options=ReadOptions(up="z"))
    frames = round(recorder.table["until_s"] * RATE)
    assert 0 < frames <= len(found.markers.time) <= frames + AT_ONCE < len(given.markers.time)
    assert_close(found.markers.position, given.markers.position[: len(found.markers.time)], rtol=1e-6, atol=1e-6)
    assert recorder.markers.read_bytes() == whole.markers.read_bytes()[: recorder.markers.stat().st_size]
    if forces is not None:
        assert given.forces is not None and found.forces is not None
        assert 4 * (frames - 1) < len(found.forces.time) <= 4 * frames
        sent = given.forces.wrench[: len(found.forces.time)]
        assert_close(found.forces.wrench, sent, rtol=1e-5, atol=1e-3)


def test_a_recording_whose_last_flush_fails_says_so(tmp_path, seed, monkeypatch, caplog):
    """As over a network, where a full disk is known only then: nothing is raised when the estimate is there already."""
    given = trial(np.random.default_rng(seed))
    recorder = recorded(tmp_path / "r", given)
    assert recorder.fault is None
    recorder = Recorder(tmp_path / "s", given.markers.labels, RATE, PLATES, FORCE_RATE)

    def full(_: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", full)
    recorder.close()
    recorder.close()
    assert recorder.fault == os.strerror(errno.ENOSPC) and len(caplog.records) == 1


@contextmanager
def limited(size: int) -> Iterator[None]:
    """No file grows beyond so many bytes, as on a disk that is full by then."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def test_what_a_killed_process_had_taken_is_on_the_disk(tmp_path, seed):
    given, done = trial(np.random.default_rng(seed)), tmp_path / "done"
    child = os.fork()
    if child == 0:
        intake = Intake(RATE, FORCE_RATE, PATIENCE_S)
        recorder = Recorder(tmp_path / "r", given.markers.labels, RATE, PLATES, FORCE_RATE)
        for packet in packets(given)[:4]:
            recorder.add(intake.place(packet))
        done.touch()
        time.sleep(60)
        os._exit(0)
    while not done.exists():
        time.sleep(0.01)
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    found = read_trial("a", tmp_path / "r" / "live.trc", tmp_path / "r" / "live.mot", options=ReadOptions(up="z"))
    assert len(found.markers.time) == 4 * AT_ONCE
    torch.testing.assert_close(found.markers.position, given.markers.position[: 4 * AT_ONCE], rtol=1e-6, atol=1e-6)
