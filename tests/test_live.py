"""Identification while the subject moves finds what a run finds, and no fault of the stream spoils it."""

import errno
import functools
import json
import math
import multiprocessing
import os
import shutil
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace

import numpy as np
import pytest
import small_session
import torch
from inertia_cases import bodies, names, prior
from test_live_stream import limited
from torch.testing import assert_close
from trc_files import write_trc
from typer.testing import CliRunner

from torchid.cli import app
from torchid.config import Config, load_config
from torchid.config.sections import TrialFile
from torchid.contact.options import ContactOptions, OtherContact
from torchid.dynamics.row_equations import NormalEquations
from torchid.dynamics.rows import SHORTEST, WrenchTrial
from torchid.dynamics.whitening import BlockSpectrum, accumulate, block_spectrum
from torchid.errors import ConfigError, DataError
from torchid.inertia.fit import fit_inertia
from torchid.inertia.identify import Identified
from torchid.inertia.options import InertiaOptions, of_whitened_rows
from torchid.inertia.reliability import calibrated, reliability
from torchid.live.estimation.estimator import Estimator
from torchid.live.estimation.identifier import LiveSubject
from torchid.live.estimation.pipeline import Moment, Pipeline
from torchid.live.estimation.pose import PostureFollower
from torchid.live.estimation.refining import MessagePiece, Refining
from torchid.live.estimation.stretches import MOST, Stretches
from torchid.live.estimation.window import Window
from torchid.live.run import prepare_subject, run_live
from torchid.live.sources.intake import Intake
from torchid.live.sources.stream import AT_ONCE, Packet, Replay
from torchid.recording import Forces, Markers, Trial
from torchid.run import run_experiment
from torchid.runs import runs
from torchid.session.fitting import given_mass
from torchid.session.opening import read_recording, setup_of
from torchid.session.standing import standing_weight
from torchid.storage.results import OutputFolder

MOVING, RATE = "squats", 100.0


def subject() -> LiveSubject:
    """Of the small session's run."""
    o = small_session.outcome()
    weight = standing_weight(o.followed.values(), o.session, o.config.subject.mass_kg)
    return LiveSubject(o.config, o.fit, o.prior, given_mass(o.config.inertia, o.config.subject, o), weight, o.cutoff_hz)


def moving() -> Trial:
    """A trial that moves, forces on their own clock."""
    return next(item.trial for item in small_session.session().trials if item.trial.name == MOVING)


def long() -> Trial:
    """All fit trials, one after the other with a pause of a second, as a session would be streamed."""
    position, wrench, time, samples = [], [], [], []
    given = [item.trial for item in small_session.session().trials if item.trial.role == "fit"]
    for k, one in enumerate(given):
        assert one.forces is not None
        position.append(one.markers.position)
        wrench.append(one.forces.wrench)
        time.append(5.0 * k + one.markers.time)
        samples.append(5.0 * k + one.forces.time)
    markers = Markers(given[0].markers.labels, torch.cat(time), torch.cat(position))
    assert given[0].forces is not None
    return Trial("long", markers, Forces(torch.cat(samples), torch.cat(wrench), given[0].forces.plates))


def streamed(given: Trial, spoil: Callable[[Packet], list[Packet]] = lambda packet: [packet]) -> tuple[Identified, int]:
    """What the same stages find in a stream, and how many frames had a posture."""
    who, source, forces = subject(), Replay(given, float("inf")), moving().forces
    assert forces is not None
    intake = Intake(RATE, forces.rate, 0.5)
    follower = PostureFollower(who.fit, source.labels)
    own, known = Refining(who, source.labels, RATE, source.plates, forces.rate), 0
    while (packet := source.take()) is not None:
        for one in spoil(packet):
            placed = intake.place(one)
            if len(placed.index):
                postures = follower(placed.markers)
                known += int(postures.known.sum())
                assert bool(torch.isfinite(postures.q).all())
                own.put(MessagePiece(placed.index, placed.markers.position, postures, placed.sample, placed.wrench))
                own.work()
    return own.finish(), known


@functools.cache
def undisturbed() -> tuple[Identified, int]:
    """What is found in the session when nothing goes wrong, and the number of frames with a posture."""
    return streamed(long())


def off_sd(found: Identified, other: Identified) -> float:
    """Largest distance of segment masses in standard deviations."""
    return float(((found.fit.mass - other.fit.mass).abs() / other.fit.sd.phi[:, 0]).max())


@pytest.mark.slow
def test_a_stream_is_identified_as_a_recording_is():
    """The same postures, masses to half of their standard deviation, and deviations as wide."""
    given, o = moving(), small_session.outcome()
    follower, source, q = PostureFollower(o.fit, given.markers.labels), Replay(given, float("inf")), []
    while (packet := source.take()) is not None:
        q.append(follower(packet.markers).q)
    assert float((torch.cat(q) - o.followed[MOVING].tracked.q)[:, 6:].abs().median()) < 5e-3
    found, known = undisturbed()
    assert known > 0.98 * len(long().markers.time)
    assert o.identified is not None and off_sd(found, o.identified) < 0.5
    assert_close(found.fit.sd.phi[:, 0], o.identified.fit.sd.phi[:, 0], rtol=0.1, atol=0.0)


def lossy(rng: np.random.Generator, markers: Markers) -> Markers:
    """A tenth of the frames is lost, one coordinate in a hundred is no number."""
    kept = torch.from_numpy(rng.random(len(markers.time)) > 0.1)
    position = markers.position.clone()
    position[torch.from_numpy(rng.random(position.shape) < 0.01)] = torch.nan
    return replace(markers, time=markers.time[kept], position=position[kept])


def swapped(rng: np.random.Generator, markers: Markers) -> Markers:
    """Two labels are exchanged for a second."""
    a, b = rng.choice(len(markers.labels), 2, replace=False)
    start = rng.uniform(5.5, 17.5)
    wrong = (markers.time >= start) & (markers.time < start + 1.0)
    position = markers.position.clone()
    position[wrong, a], position[wrong, b] = markers.position[wrong, b], markers.position[wrong, a]
    return replace(markers, position=position)


@pytest.mark.slow
@pytest.mark.parametrize("fault", [lossy, swapped])
def test_faults_of_markers_leave_the_estimate_within_a_standard_deviation(fault, seed):
    rng, given = np.random.default_rng(seed), long()
    spoilt = fault(rng, given.markers)
    by_time = {round(float(t), 6): k for k, t in enumerate(spoilt.time)}

    def spoil(packet: Packet) -> list[Packet]:
        index = [by_time[t] for t in (round(float(t), 6) for t in packet.markers.time) if t in by_time]
        return [replace(packet, markers=spoilt.frames(torch.tensor(index, dtype=torch.long)))]

    found, known = streamed(given, spoil)
    assert known > len(spoilt.time) - 130
    assert off_sd(found, undisturbed()[0]) < 1.0
    wider = found.fit.sd.phi[:, 0] / undisturbed()[0].fit.sd.phi[:, 0]
    assert 0.8 < float(wider.min()) and float(wider.max()) < 1.5


@pytest.mark.slow
def test_a_clock_that_is_set_and_markers_that_vanish_cost_no_more_than_their_time(seed):
    """A second without markers, then all clocks an hour ahead: postures are known again at once."""
    rng, given = np.random.default_rng(seed), long()
    gone, jump = rng.uniform(5.2, 7.0), rng.uniform(8.5, 13.0)

    def spoil(packet: Packet) -> list[Packet]:
        ahead = 3600.0 * (packet.markers.time >= jump)
        hidden = (packet.markers.time >= gone) & (packet.markers.time < gone + 1.0)
        position = torch.where(hidden[:, None, None], torch.nan, packet.markers.position)
        markers = replace(packet.markers, time=packet.markers.time + ahead, position=position)
        forces = packet.forces
        assert forces is not None
        return [Packet(markers, replace(forces, time=forces.time + 3600.0 * (forces.time >= jump)), packet.arrived_s)]

    found, known = streamed(given, spoil)
    assert known >= undisturbed()[1] - 110
    assert off_sd(found, undisturbed()[0]) < 1.0
    wider = found.fit.sd.phi[:, 0] / undisturbed()[0].fit.sd.phi[:, 0]
    assert 0.8 < float(wider.min()) and float(wider.max()) < 1.5


@pytest.mark.slow
def test_blocks_that_come_one_by_one_give_the_batch_solution(seed):
    """In any order, by any grouping: the fit on the sums is that on all rows at once."""
    o, who, rng = small_session.outcome(), subject(), np.random.default_rng(seed)
    blocks = [block for one in o.followed.values() if one.wrench is not None for block in pieces(one.wrench)]
    estimator, names_ = Estimator(o.fit.model.tree.names, o.prior, who.config.inertia, who.mass), o.fit.model.tree.names
    order = rng.permutation(len(blocks)).tolist()
    while order:
        some, order = order[: (n := int(rng.integers(1, 4)))], order[n:]
        estimator.add([(float(k), blocks[k]) for k in some])
    options = replace(of_whitened_rows(who.config.inertia), refuse=False, base_parameters=False)
    batch = fit_inertia(accumulate(blocks, estimator.whitening), o.prior, names_, options, mass=who.mass)
    assert estimator.fit is not None
    assert_close(estimator.fit.phi, batch.phi, rtol=1e-8, atol=1e-8 * float(batch.phi.abs().max()))
    scale = batch.covariance.diagonal().sqrt()
    scale = scale[:, None] * scale
    assert_close(estimator.fit.covariance / scale, batch.covariance / scale, rtol=0, atol=1e-6)


@pytest.mark.slow
@pytest.mark.usefixtures("quick_children", "tables_alone")
def test_a_finished_run_gives_its_geometry(tmp_path):
    """As long as its files and options are the stream's; otherwise standing does, whatever lies in the folder."""

    def config(*more: str) -> Config:
        return load_config(small_session.config(), [*small_session.overrides(tmp_path / "out"), *more])

    def prepared(given: Config) -> LiveSubject:
        with OutputFolder(given.out, beside=True) as folder:
            return prepare_subject(given, folder, lambda stage, share: None)[0]

    run = small_session.outcome()
    shutil.copytree(small_session.folder() / "out", tmp_path / "out")
    run_experiment(config())  # takes up the stages
    assert run_live(config(), f"replay:{MOVING}", math.inf)["geometry"] == "run"
    found = prepared(config())
    assert torch.equal(found.fit.xi, run.fit.xi) and found.static is None
    assert prepared(config("seed=1")).static is not None


@pytest.mark.slow
def test_with_a_half_life_old_rows_count_less(seed):
    """The estimate is the batch solution of weighted rows, and goes with a body that has taken up a load."""
    o, who, rng = small_session.outcome(), subject(), np.random.default_rng(seed)
    names_, half_life_s = o.fit.model.tree.names, float(rng.uniform(5.0, 15.0))
    blocks = [block for one in o.followed.values() if one.wrench is not None for block in pieces(one.wrench)]
    before = o.prior.mean.reshape(-1)
    after = before.clone()
    load = float(rng.uniform(3.0, 8.0))
    after[0] += load
    rows = [replace(one, F=before @ one.Y) for one in blocks * 4] + [
        replace(one, F=after @ one.Y) for one in blocks * 4
    ]
    estimator = Estimator(names_, o.prior, who.config.inertia, None, None, half_life_s)
    for k, one in enumerate(rows):
        estimator.add([(k + 0.5, one)], None, k + 1.0)
    weighted = [
        accumulate([one], estimator.whitening).faded(0.5 ** ((len(rows) - k - 0.5) / half_life_s))
        for k, one in enumerate(rows)
    ]
    options = replace(of_whitened_rows(who.config.inertia), refuse=False, base_parameters=False)
    batch = fit_inertia(sum(weighted[1:], weighted[0]), o.prior, names_, options)
    found = estimator.finished()
    assert_close(found.fit.phi, batch.phi, rtol=1e-8, atol=1e-8 * float(batch.phi.abs().max()))
    every = accumulate(rows, estimator.whitening)
    noise = 0.2 * every.gram.diagonal().diag()
    R = reliability([every], noise, o.prior.covariance)
    without = fit_inertia(calibrated(sum(weighted[1:], weighted[0]), R), o.prior, names_, options)
    taken_out = estimator.finished(lambda whitening: noise)
    assert_close(taken_out.fit.phi, without.phi, rtol=1e-8, atol=1e-8 * float(batch.phi.abs().max()))
    assert float((taken_out.fit.phi - batch.phi).abs().max()) > 1e-3 * float(batch.phi.abs().max())
    assert estimator.share == pytest.approx(sum(one.rows for one in weighted) / every.rows)
    gone = 0.5 ** (4 * len(blocks) / half_life_s)
    assert abs(float(found.fit.mass.sum() - o.prior.mean[:, 0].sum()) - load) < (0.1 + 2.0 * gone) * load


def pieces(rows: WrenchTrial) -> list[BlockSpectrum]:
    """A trial's rows in blocks of a second."""
    found = [slice(a + k, min(a + k + 100, b)) for a, b in runs(rows.used) for k in range(0, b - a, 100)]
    return [block_spectrum(rows, part) for part in found if part.stop - part.start >= SHORTEST]


@pytest.mark.slow
def test_a_million_updates_are_a_million_rows(seed):
    """No digit that matters is lost by adding, and the covariance is positive definite."""
    rng = np.random.default_rng(seed)
    given = prior(bodies(2), 0.3)
    phi = given.mean.reshape(-1)
    Y = torch.from_numpy(rng.normal(size=(100, 1, 20)) * 10 ** rng.uniform(-3, 3, (100, 1, 1)))
    rows = [NormalEquations.from_rows(y, y @ phi + torch.from_numpy(rng.normal(size=1))) for y in Y]
    total = rows[0]
    for k in range(1, 1_000_000):
        total = total + rows[k % 100]
    once = sum(rows[1:], rows[0])
    assert_close(total.gram, 1e4 * once.gram, rtol=1e-10, atol=1e-10 * float(total.gram.abs().max()))
    found = fit_inertia(total, given, names(2), replace(InertiaOptions(), noise="known", refuse=False))
    assert total.rows == 1_000_000
    assert float(torch.linalg.eigvalsh(0.5 * (found.covariance + found.covariance.mT))[0]) > 0.0


def test_stretches_lie_evenly_over_a_stream():
    """However long it lasts, no more are kept than stand for it, as far from each other as any two."""
    nothing = Window(torch.zeros(1), torch.zeros(1, 1), torch.zeros(1, 1), torch.zeros(1, 1, 3), None)
    for count in (1, MOST, MOST + 1, 100, 1000):
        own = Stretches()
        for k in range(count):
            own.add(replace(nothing, time=torch.tensor([float(k)])))
        at = [int(one.time[0]) for one in own.kept]
        apart = {b - a for a, b in zip(at, at[1:], strict=False)}
        assert len(at) <= MOST and len(apart) <= 1 and at[0] == 0 and count - at[-1] <= max(apart, default=1)
        assert len(at) > MOST // 2 or len(at) == count


def test_no_rows_are_no_estimate():
    with pytest.raises(DataError, match=r"live\.no_rows"):
        Estimator(names(1), prior(bodies(1), 0.3), InertiaOptions(), None).finished()


@pytest.mark.slow
@pytest.mark.usefixtures("quick_children")
def test_an_identifier_that_dies_is_said():
    """Killed from outside, as by a machine without memory: an error with a code, and no wait for ever."""
    who, source = subject(), Replay(moving(), float("inf"))
    with Pipeline(who, source) as pipeline:
        (child,) = [one for one in multiprocessing.active_children() if one.is_alive()]
        child.kill()
        child.join()
        with pytest.raises(DataError, match=r"live\.gone"):
            pipeline.run()
            pipeline.finish()


@pytest.mark.slow
def test_the_command_streams_a_trial_and_leaves_an_estimate(tmp_path):
    """With the identifier in a process of its own, and the recording on the disk."""
    out, record = tmp_path / "out", tmp_path / "recording"
    words = ["live", str(small_session.config()), f"out={out}", "--source", f"replay:{MOVING}", "--speed", "inf"]
    done = CliRunner().invoke(app, [*words, "--record", str(record)])
    assert done.exit_code == 0, done.output
    said = json.loads(done.stdout.strip().splitlines()[-1])
    frames = len(moving().markers.time)
    assert said["geometry"] == "static", "no run has left one"
    assert said["frames"] == frames and said["lost"] == said["again"] == said["late"] == 0
    assert said["latency_ms"]["pose"]["p99"] > 0.0 and said["latency_ms"]["parameters"]["delay_ms"] > 1000.0
    table = json.loads((out / "live.json").read_text())
    assert set(table["segments"]) == set(said["progress"])
    assert table["total_mass"]["value_kg"] == pytest.approx(said["mass_kg"]["value"])
    truth = float(small_session.session().subject.phi[:, 0].sum())
    assert said["mass_kg"]["value"] == pytest.approx(truth, rel=0.02)
    assert (record / "live.trc").stat().st_size > 1000 and (record / "live.mot").stat().st_size > 1000


class Shown:
    """What a page would have been told; while it is open, no file grows beyond some bytes."""

    address = ""

    def __init__(self, room: AbstractContextManager[None]) -> None:
        self.notices: set[tuple[str, str]] = set()
        self._room = room

    def show(self, moment: Moment) -> None:
        """Keep what is said to be wrong."""
        self.notices |= {(one.what, one.text) for one in moment.notices}

    def __enter__(self) -> "Shown":
        self._room.__enter__()
        return self

    def __exit__(self, *_: object) -> None:
        self._room.__exit__(None, None, None)


@pytest.mark.slow
@pytest.mark.usefixtures("quick_children")
def test_a_disk_that_gets_full_costs_the_recording_and_nothing_else(tmp_path, seed, caplog):
    """The estimate is the undisturbed one, within rounding; what was on the disk is a trial that a run reads."""
    config = load_config(small_session.config(), [f"out={tmp_path / 'out'}"])
    source, free = f"replay:{MOVING}", Shown(nullcontext())
    undisturbed_ = run_live(config, source, math.inf, record=tmp_path / "whole", page=lambda *_: free)
    room = (tmp_path / "whole" / "live.trc").stat().st_size * np.random.default_rng(seed).uniform(0.3, 0.9)
    caplog.clear()
    full = Shown(limited(int(room)))
    found = run_live(config, source, math.inf, record=tmp_path / "part", page=lambda *_: full)
    assert found["frames"] == undisturbed_["frames"]
    assert found["mass_kg"]["value"] == pytest.approx(undisturbed_["mass_kg"]["value"], rel=1e-4)
    assert found["progress"] == pytest.approx(undisturbed_["progress"], abs=0.01)
    assert undisturbed_["recording"]["fault"] is None and found["recording"]["fault"] == os.strerror(errno.EFBIG)
    said = [text for what, text in full.notices if what == "recording"]
    assert len(said) == 1 and found["recording"]["fault"] in said[0]
    assert not [what for what, _ in free.notices if what == "recording"]
    assert len([one for one in caplog.records if one.name == "torchid.live.sources.recorder"]) == 1
    given = TrialFile(name="part", file=tmp_path / "part" / "live.trc", forces=tmp_path / "part" / "live.mot", up="z")
    read, sent = read_recording(given, setup_of(config)), moving()
    frames = len(read.markers.time)
    assert abs(frames / RATE - found["recording"]["until_s"]) < 1.1 * AT_ONCE / RATE
    assert read.forces is not None and sent.forces is not None
    assert_close(read.markers.select(sent.markers.labels).position, sent.markers.position[:frames], atol=1e-5, rtol=0,
                 equal_nan=True)  # fmt: skip
    assert_close(read.forces.wrench[:, :, :3], sent.forces.wrench[: len(read.forces.time), :, :3], atol=0.01, rtol=1e-4)


def test_what_is_no_source_is_said(tmp_path):
    config = load_config(small_session.config(), [f"out={tmp_path / 'out'}"])
    for source in ("replay:nobody", "lslx", "replay", "xdf:nowhere.xdf"):
        with pytest.raises(ConfigError, match=r"live\.source"):
            run_live(config, source)
    static = config.model_copy(update={"trials": tuple(t for t in config.trials if t.role != "static")})
    with pytest.raises(ConfigError, match=r"live\.static"):
        run_live(static, f"replay:{MOVING}")
    trial = next(t for t in config.trials if t.name == MOVING)
    bare = tmp_path / "bare.trc"
    write_trc(bare, moving().markers)
    alone = trial.model_copy(update={"file": bare, "forces": None})
    with pytest.raises(DataError, match=r"live\.no_forces"):
        run_live(config.model_copy(update={"trials": (*static_of(config), alone)}), f"replay:{MOVING}")


def static_of(config: Config) -> tuple[TrialFile, ...]:
    return tuple(t for t in config.trials if t.role == "static")


def test_contacts_that_a_stream_cannot_tell_are_refused(tmp_path, monkeypatch):
    """Intervals, which are of recorded trials, and a plate that does not come: a hand would be taken for mass."""
    config = load_config(small_session.config(), [f"out={tmp_path / 'out'}"])
    hand = {"rail": OtherContact("hand_r", {MOVING: ((0.5, 1.0),)})}
    with pytest.raises(ConfigError, match=r"contact\.live"):
        run_live(config.model_copy(update={"contact": ContactOptions(others=hand)}), f"replay:{MOVING}")
    handle = config.model_copy(update={"contact": ContactOptions(others={"rail": OtherContact("hand_r", plate=9)})})
    monkeypatch.setattr("torchid.live.run.prepare_subject", lambda *_: (subject(), small_session.outcome()))
    with pytest.raises(ConfigError, match=r"contact\.plate"):
        run_live(handle, f"replay:{MOVING}")
