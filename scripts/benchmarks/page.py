"""A stream with page and recording: frames a second, latencies, and what viewers get of it.

PYTHONPATH=.:scripts python -m benchmarks.page --seconds 60                  # 200 frames/s, one viewer
PYTHONPATH=.:scripts python -m benchmarks.page --seconds 60 --viewers 50
PYTHONPATH=.:scripts python -m benchmarks.page --garbage 10000               # instead: messages that are none
"""

import asyncio
import multiprocessing
import tempfile
import time
from dataclasses import replace
from multiprocessing.connection import Connection
from pathlib import Path

import msgspec
import numpy as np
import viser
import zstandard
from harness.command import Command, said_seed
from harness.pool import alone
from harness.rows import listed
from harness.runs import simulated
from websockets.asyncio.client import connect
from websockets.exceptions import ConnectionClosed
from websockets.typing import Subprotocol

from torchid.live.display.page import Address, Page
from torchid.live.estimation.identifier import LiveSubject
from torchid.live.estimation.pipeline import Pipeline
from torchid.live.sources.recorder import Recorder
from torchid.live.sources.stream import Packet, Replay
from torchid.recording import Trial
from torchid.session.fitting import given_mass
from torchid.session.standing import standing_weight
from torchid.simulate.options import SimulateOptions

RATE_HZ = 200.0
SESSION = SimulateOptions(fit=("squats", "arms"), heldout=(), duration_s=6.0, rate_hz=RATE_HZ)
PORT, PROTOCOL = 19500, Subprotocol(f"viser-v{viser.__version__}")
PAUSE_S = 1.0


class Endless:
    """A trial over and over again, with a pause between, at its own pace."""

    def __init__(self, trial: Trial) -> None:
        self._trial, self._turn, self._one = trial, 0, Replay(trial)
        self.labels, self.rate_hz = self._one.labels, self._one.rate_hz
        self.plates, self.force_rate_hz = self._one.plates, self._one.force_rate_hz
        self._begun, self._step = time.monotonic(), float(trial.markers.time[-1] - trial.markers.time[0]) + PAUSE_S

    def take(self) -> Packet:
        """What is due, on a clock that goes on."""
        packet = self._one.take()
        if packet is None and time.monotonic() - self._begun >= (self._turn + 1) * self._step:
            self._turn, self._one = self._turn + 1, Replay(self._trial)
            packet = self._one.take()
        if packet is None:
            part = slice(0, 0)
            assert self._trial.forces is not None
            return Packet(self._trial.markers.frames(part), self._trial.forces.samples(part), time.monotonic())
        late = self._turn * self._step
        assert packet.forces is not None
        markers = replace(packet.markers, time=packet.markers.time + late)
        return Packet(markers, replace(packet.forces, time=packet.forces.time + late), packet.arrived_s)


def prepared(seed: int, folder: Path) -> tuple[LiveSubject, Trial]:
    """A simulated subject, and a trial."""
    _, outcome = simulated(SESSION, seed, folder)
    weight = standing_weight(outcome.followed.values(), outcome.session, outcome.config.subject.mass_kg)
    mass = given_mass(outcome.config.inertia, outcome.config.subject, outcome)
    subject = LiveSubject(outcome.config, outcome.fit, outcome.prior, mass, weight, outcome.cutoff_hz)
    return subject, outcome.session.trials["squats"]


def bench_page(seed: int, seconds: float, viewers: int) -> dict[str, float]:
    """Figures of a stream with a page, viewers and a recording."""
    with tempfile.TemporaryDirectory() as place:
        subject, trial = prepared(seed, Path(place))
        source = Endless(trial)
        stream = (source.labels, source.rate_hz, source.plates, source.force_rate_hz)
        with (
            Page(subject, source.labels, source.plates, Address(PORT, "127.0.0.1")) as page,
            Recorder(Path(place) / "recorded", *stream) as recorder,
            Pipeline(subject, source, recorder) as pipeline,
        ):
            pipe, theirs = multiprocessing.get_context("spawn").Pipe(duplex=False)
            watching = multiprocessing.get_context("spawn").Process(
                target=watch, args=(theirs, page.address, viewers, seconds), daemon=True
            )
            watching.start()
            assert pipe.poll(60) and pipe.recv() == "watching"
            pipeline.run(seconds, page.show)
            found = pipeline.performance()
            gaps = np.array(pipe.recv()) if pipe.poll(30) else np.full(1, np.nan)
            gaps = gaps[gaps < 0.5 * PAUSE_S]
            pose, parameters = found["latency_ms"]["pose"], found["latency_ms"]["parameters"]
            return {
                "frames that came [1/s]": len(trial.markers.time) / source._step, "frames taken [1/s]": found["fps"],
                "pose p50 [ms]": pose["p50"], "pose p99 [ms]": pose["p99"],
                "parameters beyond the stated delay p50 [ms]": parameters["p50"],
                "parameters beyond the stated delay p99 [ms]": parameters["p99"],
                "packets not worked off at the end": found["backlog"], "pictures dropped": page.dropped,
                "updates for a viewer while frames come [1/s]": 1.0 / float(np.mean(gaps)),
                "between two updates p50 [ms]": 1e3 * float(np.quantile(gaps, 0.5)),
                "between two updates p99 [ms]": 1e3 * float(np.quantile(gaps, 0.99)),
                "recorded [MB]": recorder.markers.stat().st_size / 1e6,
            }  # fmt: skip


def watch(pipe: Connection, address: str, viewers: int, seconds: float) -> None:
    """Look at a page from a process of its own; send back the times between updates of the body."""
    pipe.send(asyncio.run(_watched(pipe, address, viewers, seconds)))


async def _watched(pipe: Connection, address: str, viewers: int, seconds: float) -> list[float]:
    first = asyncio.Event()
    looking = [asyncio.create_task(_look(address, seconds, first)) for _ in range(viewers)]
    await first.wait()
    pipe.send("watching")
    return [gap for one in await asyncio.gather(*looking) for gap in one]


async def _look(address: str, seconds: float, first: asyncio.Event) -> list[float]:
    """One viewer that reads all it gets."""
    times, end, tool = list[float](), time.monotonic() + seconds, zstandard.ZstdDecompressor()
    async with connect(address.replace("http", "ws"), subprotocols=[PROTOCOL], proxy=None, max_size=None) as one:
        while (left := end - time.monotonic()) > 0.0:
            try:
                raw = bytes(await asyncio.wait_for(one.recv(decode=False), left))
            except TimeoutError:
                break
            first.set()
            size = int.from_bytes(raw[8:16], "little")
            messages = msgspec.msgpack.decode(tool.decompress(raw[16 : 16 + size]))["messages"]
            if any(m["type"] == "SceneNodeUpdateMessage" and m["name"] == "/body" for m in messages):
                times.append(time.monotonic())
    return np.diff(times).tolist()


def bench_garbage(seed: int, count: int) -> dict[str, float]:
    """A page after messages that are none."""
    with tempfile.TemporaryDirectory() as place:
        subject, trial = prepared(seed, Path(place))
        assert trial.forces is not None
        with Page(subject, trial.markers.labels, trial.forces.plates, Address(PORT, "127.0.0.1")) as page:
            sent = asyncio.run(_litter(page.address, count, seed))
            alive = asyncio.run(_alive(page.address))
            return {"messages that are none": sent, "page still answers": float(alive)}


async def _litter(address: str, count: int, seed: int) -> int:
    rng, sent = np.random.default_rng(seed), 0
    while sent < count:
        async with connect(address.replace("http", "ws"), subprotocols=[PROTOCOL], proxy=None, max_size=None) as one:
            try:
                for _ in range(20):
                    await one.send(rng.bytes(int(rng.integers(1, 2000))))
                    sent += 1
            except ConnectionClosed:  # as it may be
                sent += 1
    return sent


async def _alive(address: str) -> bool:
    async with connect(address.replace("http", "ws"), subprotocols=[PROTOCOL], proxy=None, max_size=None) as one:
        return len(await asyncio.wait_for(one.recv(decode=False), 10)) > 0


if __name__ == "__main__":
    alone()
    asked = Command(__doc__, seed=int, seconds=60.0, viewers=1, garbage=0).asked()
    own = said_seed(asked.seed, 10**6)
    listed(bench_garbage(own, asked.garbage) if asked.garbage else bench_page(own, asked.seconds, asked.viewers), 50)
