"""The results folder: whole files, safe names, one run at a time, stages that a later run takes up."""

import hashlib
import io
import json
import os
import signal
import subprocess
import sys
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import torch
import xarray
from hypothesis import given
from hypothesis import strategies as st
from trc_files import write_trc

from torchid.errors import DataError, InputError, Note
from torchid.io.storage import write_storage
from torchid.recording import Event, Markers, Trial
from torchid.storage import files, results, snapshot
from torchid.storage.files import TEMPORARY, atomic_write, file_sha256, nameless_file, safe_name, write_json, write_text
from torchid.storage.netcdf import write_netcdf
from torchid.storage.provenance import code_sha256, provenance, stage_key
from torchid.storage.results import OutputFolder
from torchid.storage.snapshot import (
    SnapshotError,
    from_bytes,
    load_snapshot,
    release,
    swap_out,
    to_bytes,
    write_snapshot,
)

PACKAGE = Path(files.__file__).resolve().parents[1]


class Killed(BaseException):
    """Stands for the end of the process."""


@pytest.mark.parametrize("call", ["open", "fsync", "replace"])
@pytest.mark.parametrize("nth", range(3))
def test_the_old_file_survives_any_failing_call(tmp_path, monkeypatch, call, nth):
    """Whichever system call fails, the file holds the old or the new content in full, and nothing else is left."""
    path = tmp_path / "a.json"
    path.write_bytes(b"old")
    real, calls = getattr(os, call), [0]

    def failing(*args, **kwargs):
        calls[0] += 1
        if calls[0] == nth + 1:
            raise OSError(28, "No space left on device")
        return real(*args, **kwargs)

    monkeypatch.setattr(files.os, call, failing)
    try:
        with atomic_write(path) as file:
            file.write(b"new")
        failed = False
    except InputError as error:
        failed = True
        assert error.code == "results.unwritable"
        assert "No space left" in error.found
    monkeypatch.undo()
    assert failed == (calls[0] > nth)
    assert path.read_bytes() in ((b"old", b"new") if failed else (b"new",))
    assert os.listdir(tmp_path) == ["a.json"]


@pytest.mark.parametrize("error", [ValueError, Killed])
def test_an_error_in_the_block_leaves_the_old_file(tmp_path, error):
    """A writer that fails half-way changes nothing."""
    path = tmp_path / "a"
    path.write_bytes(b"old")
    with pytest.raises(error), atomic_write(path) as file:
        file.write(b"half")
        raise error
    assert path.read_bytes() == b"old"
    assert os.listdir(tmp_path) == ["a"]


def test_new_files_have_the_permissions_of_the_user(tmp_path):
    """A result is as readable as any file of the user's, not private as temporary files are."""
    (tmp_path / "ordinary").write_bytes(b"")
    with atomic_write(tmp_path / "a") as file:
        file.write(b"x")
    assert (tmp_path / "a").stat().st_mode == (tmp_path / "ordinary").stat().st_mode


@given(st.text(max_size=300))
def test_names_from_data_stay_one_plain_component(text: str):
    """Any text becomes one short ASCII component that is no device, no dot name, and its own safe name."""
    name = safe_name(text)
    assert name.isascii() and len(name) <= 64 and Path(name).name == name
    assert not name.startswith(".") and not name.endswith(".")
    assert safe_name(name) == name


def test_plain_names_stay_and_others_stay_distinct():
    """A plain trial name is its own file name; names that share a slug differ by their hash."""
    assert safe_name("squat_2.5-fast") == "squat_2.5-fast"
    hostile = ["../x", "..", "x/", "/x", "\0x", "x ", "ü", "u", "CON", "nul.txt", "", "x" * 300, "x" * 301, "Я", "=x"]
    names = [safe_name(text) for text in hostile]
    assert len(set(names)) == len(names)


def test_json_has_no_nan_and_keeps_order(tmp_path):
    """Tensors, arrays, notes and paths are written; no number is null; half a surrogate pair passes."""
    value = {
        "b": torch.tensor([[1.0, torch.nan], [torch.inf, 2.0]]),
        "a": np.float64(0.1),
        "note": Note("c3d.gap", "a gap"),
        "path": Path("x"),
        "label": "é\udc80",
        "n": np.int64(3),
    }
    write_json(tmp_path / "a.json", value)
    text = (tmp_path / "a.json").read_bytes().decode("utf-8")
    read = json.loads(text, parse_constant=lambda name: pytest.fail(f"{name} in the file"))
    assert list(read) == list(value)
    assert read["b"] == [[1.0, None], [None, 2.0]]
    assert (read["a"], read["n"], read["label"], read["note"]["code"]) == (0.1, 3, "é\udc80", "c3d.gap")
    with pytest.raises(TypeError):
        write_json(tmp_path / "b.json", {"x": object()})
    assert not (tmp_path / "b.json").exists()


def test_netcdf_reads_back_and_repeats_byte_for_byte(tmp_path, seed):
    """A dataset with text coordinates and NaN comes back equal, in pieces too, and equal datasets give equal bytes."""
    rng = np.random.default_rng(seed)
    q = rng.normal(size=(7, 2))
    q[3, 1] = np.nan
    dataset = xarray.Dataset(
        {"q": (("time", "dof"), q), "used": ("time", q[:, 0] > 0), "rate": ((), 100.0)},
        coords={"time": np.arange(7) / 100, "dof": ["pelvis_x", "knee_é"]},
        attrs={"units": "rad"},
    )
    write_netcdf(tmp_path / "a.nc", [dataset])
    write_netcdf(tmp_path / "b.nc", [dataset])
    with xarray.open_dataset(tmp_path / "a.nc", engine="h5netcdf") as read:
        xarray.testing.assert_identical(read.load(), dataset)
    assert file_sha256(tmp_path / "a.nc") == file_sha256(tmp_path / "b.nc")
    assert sorted(os.listdir(tmp_path)) == ["a.nc", "b.nc"]
    write_netcdf(tmp_path / "c.nc", (dataset.isel(time=part) for part in (slice(0, 3), slice(3, 4), slice(4, 7))))
    with xarray.open_dataset(tmp_path / "c.nc", engine="h5netcdf") as read:
        xarray.testing.assert_identical(read.load(), dataset)


def trial(rng: np.random.Generator) -> Trial:
    position = torch.from_numpy(rng.normal(size=(5, 2, 3)))
    position[1, 0] = torch.nan
    return Trial(
        name="gait é",
        markers=Markers(("LASI", "RASI"), torch.arange(5, dtype=torch.float64) / 100, position),
        events=(Event("strike", "left", 0.02),),
        notes=(Note("c3d.gap", "a gap", "LASI"),),
        parameters={"up": "z"},
    )


def test_snapshots_rebuild_nested_dataclasses(seed):
    """A recording goes through bytes bit for bit: types, tuples, dtypes, NaN."""
    original = trial(np.random.default_rng(seed))
    value = {"trial": original, "list": [1, 2.5, None, True], "array": np.arange(3), "path": Path("a"), "x": ()}
    again = from_bytes(to_bytes(value))
    torch.testing.assert_close(
        again["trial"].markers.position, original.markers.position, rtol=0, atol=0, equal_nan=True
    )
    assert isinstance(again["trial"].events[0], Event)
    assert again["trial"].notes == original.notes
    assert again["trial"].markers.labels == original.markers.labels
    assert (again["list"], again["path"], again["x"]) == (value["list"], value["path"], ())
    np.testing.assert_array_equal(again["array"], value["array"])
    assert again["array"].dtype == value["array"].dtype


@dataclass(frozen=True)
class Foreign:
    """A dataclass that is not torchid's."""

    x: int = 1


def test_snapshots_hold_and_rebuild_nothing_foreign():
    """A foreign class is refused on writing, and a forged class name on reading, before any code of it runs."""
    with pytest.raises(TypeError):
        to_bytes(Foreign())
    with pytest.raises(TypeError):
        to_bytes(lambda: None)
    for name in (
        "os:system",
        "torchid.storage.results:os.system",
        "torchid.storage.files:write_json",
        "torchid.storage.results:OutputFolder",
    ):
        document = json.dumps({"class": name, "fields": {}}).encode()
        content = len(document).to_bytes(8, "little") + document
        with pytest.raises(SnapshotError, match="another version"):
            from_bytes(hashlib.sha256(content).digest() + content)


def test_what_finds_no_room_on_disk_says_so(tmp_path, monkeypatch):
    """Columns and what is as long as a recording: where the disk is full, the run ends and names the folder."""

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    with OutputFolder(tmp_path / "out") as folder:
        room = folder.room((2, 3))
        room[:, 1:] = torch.ones(2, 2, dtype=torch.float64)
        assert not snapshot.unload(), "few stay"
        monkeypatch.setattr(snapshot, "SPARED", 0)
        assert snapshot.unload()
        assert room.tolist() == [[0.0, 1.0, 1.0]] * 2
        monkeypatch.setattr(results, "make_room", full)
        monkeypatch.setattr(results, "swap_out", full)
        for asked in (lambda: folder.room((2, 3)), lambda: folder.aside(room)):
            with pytest.raises(InputError, match="cannot be written") as caught:
                asked()
            assert str(folder.out) in str(caught.value)


def test_mapped_snapshots_hold_what_was_written(tmp_path, seed, monkeypatch):
    """From a file, named or not, the same values come back, also after their memory was given back."""
    monkeypatch.setattr(snapshot, "SPARED", 0)
    rng = np.random.default_rng(seed)
    wide = torch.from_numpy(rng.normal(size=(3, 70_000)))
    value = {"trial": trial(rng), "turned": wide.T, "again": wide.T, "none": wide[:0], "one": torch.tensor(2.5)}
    with (tmp_path / "a").open("wb") as file:
        write_snapshot(file, value)
    assert (tmp_path / "a").stat().st_size < 1.1 * wide.nbytes + 4096, "a tensor that stands twice is kept once"
    with nameless_file(tmp_path) as file:
        swapped = swap_out(value, file)
    for found in (load_snapshot(tmp_path / "a"), swapped, from_bytes(to_bytes(value))):
        for _ in range(2):
            for name in ("turned", "again", "none", "one"):
                torch.testing.assert_close(found[name], value[name], rtol=0, atol=0)
            release()
    assert os.listdir(tmp_path) == ["a"]


def test_damaged_snapshots_are_recognised(seed):
    """A snapshot that is cut or altered anywhere is refused with the one error that a stage expects."""
    rng = np.random.default_rng(seed)
    content = to_bytes({"x": torch.arange(50.0), "name": "a"})
    for _ in range(200):
        damaged = bytearray(content)
        damaged[rng.integers(len(damaged))] ^= int(rng.integers(1, 256))
        for candidate in (bytes(damaged), content[: rng.integers(len(content))]):
            with pytest.raises(SnapshotError):
                from_bytes(candidate)


def test_stages_are_reused_only_while_their_key_matches(tmp_path):
    """A second run takes the stored result; another key, or a damaged store, computes again."""
    calls = []

    def compute() -> Note:
        calls.append(1)
        return Note("a", "b")

    def run(key: str) -> Note:
        with OutputFolder(tmp_path / "out") as folder:
            result = folder.stage("geometry", key, compute)
            assert folder.times["geometry"].reused == (len(calls) == before)
        return result

    for key, expected in (("k1", 1), ("k1", 1), ("k2", 2), ("k1", 3)):
        before = len(calls)
        assert run(key) == Note("a", "b")
        assert len(calls) == expected
    (stored,) = (tmp_path / "out" / ".torchid" / "stages").iterdir()
    stored.write_bytes(stored.read_bytes()[:-30])
    before = len(calls)
    run("k1")
    assert len(calls) == 4


def test_a_stage_of_another_version_is_computed_again_and_the_log_says_so_plainly(tmp_path, caplog):
    """A layout, a class or a field that this version does not know: one line names the stage and the reason."""
    key = json.dumps({"dict": {"key": "k", "result": {"class": "torchid.errors:Note", "fields": {"gone": 1}}}}).encode()
    with OutputFolder(tmp_path / "out") as folder:
        for body in (len(key).to_bytes(8, "little") + key, bytes(8) + b"PK" + bytes(60), bytes(range(256))):
            file = tmp_path / "out" / ".torchid" / "stages" / "geometry.snapshot"
            file.write_bytes(hashlib.sha256(body).digest() + body)
            assert folder.stage("geometry", "k", lambda: "new") == "new"
            assert folder.stage("geometry", "k", lambda: pytest.fail("computed again")) == "new"
    assert caplog.messages == ["stage geometry is computed again: it was stored by another version of torchid"] * 3


def test_a_killed_run_is_continued(tmp_path):
    """After kill -9 the finished stage is reused, the lock is free, and what was half written is gone."""
    script = """
import os, signal, sys
from contextlib import ExitStack
from torchid.storage.results import OutputFolder
from torchid.storage.files import atomic_write, write_json
with OutputFolder(sys.argv[1]) as folder, ExitStack() as stack:
    folder.stage("one", "k", lambda: [1.5])
    write_json(folder.path("one.json"), folder.times)
    for place in (folder.staging, folder.state, folder.state / "stages"):
        stack.enter_context(atomic_write(place / "half")).write(b"half")
    os.kill(os.getpid(), signal.SIGKILL)
"""
    out = tmp_path / "out"
    ended = subprocess.run([sys.executable, "-c", script, str(out)], capture_output=True, timeout=60, check=False)
    assert ended.returncode == -signal.SIGKILL, ended.stderr.decode()
    assert os.listdir(out) == [".torchid"] and len(list(out.rglob(TEMPORARY))) == 3
    with OutputFolder(out) as folder:
        assert not list(out.rglob(TEMPORARY)) and not list(folder.staging.iterdir())
        assert folder.stage("one", "k", lambda: pytest.fail("computed again")) == [1.5]
        assert folder.stage("two", "k", lambda: "new") == "new"


def test_a_second_run_on_the_same_folder_is_refused_with_the_process(tmp_path):
    """While one run writes, another one is told which process holds the folder; afterwards it may."""
    with OutputFolder(tmp_path / "out"):
        with pytest.raises(InputError) as caught:
            OutputFolder(tmp_path / "out").__enter__()
        assert caught.value.code == "results.locked"
        assert str(os.getpid()) in caught.value.found
    with OutputFolder(tmp_path / "out"):
        pass


def test_an_impossible_folder_is_refused(tmp_path):
    """A file in the place of the folder is an input error."""
    (tmp_path / "out").write_bytes(b"")
    with pytest.raises(InputError) as caught:
        OutputFolder(tmp_path / "out").__enter__()
    assert caught.value.code == "results.unwritable"


@pytest.mark.parametrize("name", ["../x", "/etc/x", "a/../../x", ".", "", ".torchid/lock", "link/x"])
def test_results_stay_below_the_folder(tmp_path, name):
    """No name, and no link inside the folder, leads a result out of it or into the folder's own state."""
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "link").symlink_to(tmp_path)
    with OutputFolder(tmp_path / "out") as folder, pytest.raises(InputError) as caught:
        folder.path(name)
    assert caught.value.code == "results.outside"


def test_files_of_an_earlier_run_do_not_stand_beside_new_results(tmp_path):
    """A run that ends replaces what an earlier one wrote, one that breaks changes nothing; the user's files stay."""
    out = tmp_path / "out"

    def run(*names: str, error: BaseException | None = None) -> set[str]:
        with suppress(DataError, KeyboardInterrupt), OutputFolder(out) as folder:
            for name in names:
                write_json(folder.path(name), name)
            if error is not None:
                raise error
        return {path.name for path in out.iterdir() if path.is_file()}

    assert run("a.json", "b.json") == {"a.json", "b.json"}
    (out / "notes.txt").write_text("mine")
    assert run("c.json", error=KeyboardInterrupt()) == {"a.json", "b.json", "notes.txt"}
    assert run("a.json", error=DataError("data.poor", "too little", remedy="more")) == {"a.json", "notes.txt"}
    assert run("d.json") == {"d.json", "notes.txt"}
    assert run() == {"notes.txt"}
    assert not (out / ".torchid" / "publishing.json").exists()


def write_results(folder: OutputFolder, *names: str, text: str = "") -> None:
    for name in names:
        write_text(folder.path(name), text or name)


def test_what_is_not_torchids_is_neither_overwritten_nor_removed(tmp_path):
    """A user's file, folder, link, or a result that was edited: refused before the work and at its end."""
    out = tmp_path / "out"
    with OutputFolder(out) as folder:
        write_results(folder, "a.txt", "edited.txt", "gone.txt")
    (out / "edited.txt").write_text("mine")
    (out / "file.txt").write_text("mine")
    (out / "folder.txt").mkdir()
    (out / "link.txt").symlink_to(out / "a.txt")
    (out / "dangling.txt").symlink_to(out / "nowhere")
    (out / "gone.txt").unlink()
    for name in ("edited.txt", "file.txt", "folder.txt", "link.txt", "dangling.txt"):
        with pytest.raises(InputError) as early, OutputFolder(out) as folder:
            folder.claim(["a.txt", "gone.txt", "new.txt"])
            folder.claim(["new.txt", name])
        late = early
        if "link" not in name and "dangling" not in name:  # path() itself goes where a link leads
            with pytest.raises(InputError) as late, OutputFolder(out) as folder:
                write_results(folder, "a.txt", "new.txt", name, text="ours")
        for caught in (early, late):
            assert caught.value.code == "results.foreign" and name in str(caught.value) and caught.value.remedy
        assert (out / "a.txt").read_text() == "a.txt" and not (out / "new.txt").exists()
    with OutputFolder(out) as folder:
        write_results(folder, "new.txt")
    left = {path.name for path in out.iterdir()} - {".torchid"}
    assert left == {"new.txt", "edited.txt", "file.txt", "folder.txt", "link.txt", "dangling.txt"}
    assert (out / "edited.txt").read_text() == (out / "file.txt").read_text() == "mine"


def test_without_its_list_nothing_is_torchids(tmp_path):
    """A list that is lost or damaged makes results foreign: refused, not overwritten."""
    for damage in (b"", b"[1", b'["a.txt"]', b'{"a.txt": 3}', None):
        out = tmp_path / repr(damage)
        with OutputFolder(out) as folder:
            write_results(folder, "a.txt")
        file = out / ".torchid" / "files.json"
        file.unlink() if damage is None else file.write_bytes(damage)
        with pytest.raises(InputError, match=r"results\.foreign"), OutputFolder(out) as folder:
            write_results(folder, "a.txt", text="new")
        assert (out / "a.txt").read_text() == "a.txt"


def told(out: Path) -> set[tuple[str, str]]:
    return {(path.name, path.read_text()[:1]) for path in out.iterdir() if path.is_file()}


@pytest.mark.parametrize(("kind", "resolved"), [(Killed, "config.yaml"), (OSError, "config.resolved.yaml")])
def test_a_publication_that_is_cut_is_finished_by_the_next_run(tmp_path, monkeypatch, kind, resolved):
    """Cut at every call of the system, it leaves results of one run only, its config last; then all or nothing."""
    cut, seen = 0, set()
    names = ("a.json", "z.json", resolved)
    while True:
        cut += 1
        out = tmp_path / str(cut)
        with OutputFolder(out) as folder:
            write_results(folder, "old.json", *names, text="A")
        (out / "mine.txt").write_text("M")
        calls = [0]

        def counted(real, *args, calls=calls, cut=cut, **kwargs):
            calls[0] += 1
            if calls[0] == cut:
                raise kind(28, "No space left on device")
            return real(*args, **kwargs)

        try:
            with OutputFolder(out) as folder:
                write_results(folder, *names, text="B")
                for name in ("replace", "unlink", "fsync", "open", "mkdir"):
                    monkeypatch.setattr(os, name, partial(counted, getattr(os, name)))
        except (Killed, InputError) as error:
            assert not isinstance(error, InputError) or error.code == "results.unwritable"
        monkeypatch.undo()
        found = told(out) - {("mine.txt", "M")}
        assert len({run for _, run in found}) <= 1, "results of two runs stand side by side"
        if (resolved, "B") in found:
            assert found == {(name, "B") for name in names}
        seen.add(frozenset(found))
        with suppress(KeyboardInterrupt), OutputFolder(out):
            found = told(out) - {("mine.txt", "M")}
            raise KeyboardInterrupt
        assert found in ({(name, "A") for name in ("old.json", *names)}, {(name, "B") for name in names})
        assert ("mine.txt", "M") in told(out)
        assert {path.name for path in (out / ".torchid").iterdir()} <= {"lock", "pid", "stages", "files.json"}
        if calls[0] < cut:
            break
    assert len(seen) > 4


def test_netcdf_on_a_disk_that_fills_is_an_error_with_its_path(tmp_path, monkeypatch, seed):
    """Whichever write fails first, from then on all do: HDF5 must not meet it, for there it ends the process."""
    rng = np.random.default_rng(seed)
    dataset = xarray.Dataset(
        {"q": (("time", "dof"), rng.normal(size=(300, 4))), "used": ("time", rng.normal(size=300) > 0)},
        coords={"time": np.arange(300) / 100, "dof": list("abcd")},
    )
    pieces = [dataset.isel(time=slice(k, k + 110)) for k in range(0, 300, 110)]
    calls, room = [0], [10**6]

    def write(self, content):
        calls[0] += 1
        if calls[0] > room[0]:
            raise OSError(28, "No space left on device")
        return io.FileIO.write(self, content)

    monkeypatch.setattr(files.NewFile, "write", write, raising=False)
    write_netcdf(tmp_path / "a.nc", pieces)
    needed = calls[0]
    assert needed > 10
    (tmp_path / "a.nc").unlink()
    for room[0] in sorted({0, needed - 1, *rng.choice(needed, 15).tolist()}):
        calls[0] = 0
        with pytest.raises(InputError, match=r"a\.nc: cannot be written .found: No space"):
            write_netcdf(tmp_path / "a.nc", pieces)
        assert not os.listdir(tmp_path)


@pytest.mark.parametrize("writer", ["storage", "trc", "json", "snapshot"])
def test_every_other_writer_says_that_the_disk_is_full(tmp_path, monkeypatch, writer):
    """Text, tables and stored stages end as InputError with the path, and leave nothing."""

    def write(self, content):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(files.NewFile, "write", write, raising=False)
    path, time = tmp_path / "a", np.arange(5) / 100
    with pytest.raises(InputError, match=r"/a: cannot be written .found: No space"):
        if writer == "storage":
            write_storage(path, ("x",), time, np.ones((5, 1)))
        elif writer == "trc":
            write_trc(path, trial(np.random.default_rng(0)).markers)
        elif writer == "json":
            write_json(path, [1])
        else:
            with atomic_write(path) as file:
                write_snapshot(file, {"x": torch.ones(100_000)})
    assert not os.listdir(tmp_path)


def test_keys_change_with_everything_that_matters(seed):
    """Any change of a tensor, an option, a type or a name gives another key; equal parts give the same."""
    rng = np.random.default_rng(seed)
    base = trial(rng)
    x = torch.from_numpy(rng.normal(size=6))
    parts = [
        {"x": x},
        {"y": x},
        {"x": x.reshape(2, 3)},
        {"x": x.float()},
        {"x": x + 1e-15 * x.abs().max()},
        {"x": base},
        {"x": base.markers},
        {"x": 1},
        {"x": 1.0},
        {"x": "1"},
        {"x": (1, 2)},
        {"x": ((1,), 2)},
        {"x": {"a": 1}},
        {"x": None},
        {"x": float("nan")},
    ]
    keys = [stage_key(**part) for part in parts]
    assert len(set(keys)) == len(keys)
    assert keys == [stage_key(**part) for part in parts]


def test_a_stage_depends_on_all_of_torchids_code():
    """The hash of the code is that of every module and table of the package, whatever room it is in."""
    files = sorted(path for path in PACKAGE.rglob("*") if path.suffix in (".py", ".yaml"))
    assert {"cli.py", "session", "model"} <= {path.relative_to(PACKAGE).parts[0] for path in files}
    text = "".join(f"{path.relative_to(PACKAGE)}{file_sha256(path)}" for path in files)
    assert code_sha256() == hashlib.sha256(text.encode()).hexdigest()


def test_provenance_names_inputs_versions_and_costs(tmp_path):
    """The record holds the hash of each input file, the versions and what each stage cost."""
    (tmp_path / "a.c3d").write_bytes(b"abc")
    with OutputFolder(tmp_path / "out") as folder:
        folder.stage("one", "k", lambda: 1)
        record = provenance([tmp_path / "a.c3d"], 7, folder.times)
        write_json(folder.path("provenance.json"), record)
    read = json.loads((tmp_path / "out" / "provenance.json").read_text())
    expected = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"  # FIPS 180-2, example B.1
    assert read["inputs"] == {str(tmp_path / "a.c3d"): expected}
    assert read["seed"] == 7
    assert read["versions"]["torch"] == torch.__version__
    assert read["stages"]["one"]["reused"] is False


def test_results_beside_those_of_a_run_take_nothing_away(tmp_path):
    """They are torchid's all the same: the next run replaces both."""
    out = tmp_path / "out"
    with OutputFolder(out) as folder:
        folder.path("one.json").write_text("1")
    with OutputFolder(out, beside=True) as folder:
        folder.path("two.json").write_text("2")
    assert {path.name for path in out.glob("*.json")} == {"one.json", "two.json"}
    with OutputFolder(out) as folder:
        folder.path("one.json").write_text("3")
    assert [path.name for path in out.glob("*.json")] == ["one.json"]
