"""A small default run, again and again: undisturbed, disturbed, and after that."""

import os
import re
import shutil
import signal
import sys
import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import torch
import yaml

import torchid.run.sequence
from torchid.cli import app
from torchid.simulate.options import PlantedOptions, SimulateOptions
from torchid.simulate.session import simulate_session
from torchid.storage.files import TEMPORARY, file_sha256, write_text

EFFECT = PlantedOptions("plate_gain", ("plate_1",), parameters={"gain": 1.1})
"""Hidden in the recordings, so that the diagnosis has something to name and the recordings are corrected."""
OPTIONS = SimulateOptions(fit=("squats", "sway_steps"), heldout=(), duration_s=2.5, effects=(EFFECT,))
GEOMETRY = {"max_frames": 25}
MINE = {"notes.txt": "mine", "figures/one.csv": "1,2", ".torchid/mine.txt": "mine", "report.html.bak": "mine"}
"""Files of a user's in the folder of the results."""
STATE = {"lock", "pid", "stages", "files.json", "mine.txt"}
_TIME = re.compile(rb"<details>\s*<summary>Time: .*?</details>", re.S)


@dataclass(frozen=True)
class Attempt:
    """How a run ended."""

    code: int
    said: str


class Bench:
    """Recordings, a run of an earlier config and the undisturbed run in ``folder``; the runs are forked processes."""

    def __init__(self, folder: Path, seed: int) -> None:
        self.folder, self.out = folder, folder / "out"
        self.config, self.before = folder / "recordings" / "config.yaml", folder / "recordings" / "before.yaml"
        self.report = True
        shutil.rmtree(folder, ignore_errors=True)
        _sound(run_forked(lambda: _simulate(folder / "recordings", seed), folder))
        _sound(self.run(self.before))
        self.out.rename(folder / "earlier")
        start = time.perf_counter()
        _sound(self.run(self.config))
        self.seconds = time.perf_counter() - start
        self.out.rename(folder / "reference")
        self.stages = sorted(path.name for path in (folder / "reference" / ".torchid" / "stages").iterdir())
        self._earlier, self._reference = _sums(folder / "earlier"), _sums(folder / "reference")

    def run(
        self,
        config: Path | None = None,
        prepare: Callable[[], None] = lambda: None,
        kill_after: float | None = None,
    ) -> Attempt:
        """``torchid run`` into ``out``; ``prepare`` is called in its process, which may be killed."""

        def command() -> None:
            if not self.report:
                without_report()
            prepare()
            app(["run", str(config or self.config), f"out={self.out}"])

        return run_forked(command, self.folder, kill_after)

    def lay_out(self, stages: set[str]) -> None:
        """``out`` as after the earlier run, with the user's files and some stages of the undisturbed run stored."""
        shutil.rmtree(self.out, ignore_errors=True)
        shutil.copytree(self.folder / "earlier", self.out)
        for name in stages:
            shutil.copy2(
                self.folder / "reference" / ".torchid" / "stages" / name, self.out / ".torchid" / "stages" / name
            )
        self.plant()

    def plant(self) -> None:
        """The user's files."""
        for name, text in MINE.items():
            (self.out / name).parent.mkdir(parents=True, exist_ok=True)
            (self.out / name).write_text(text)

    def faults_now(self) -> list[str]:
        """What is wrong with the folder that a disturbed run left: foreign files touched, results mixed."""
        found = [f"{name} touched" for name, text in MINE.items() if _content(self.out / name) != text.encode()]
        now = _sums(self.out)
        known = {name: (self._earlier.get(name), self._reference.get(name)) for name in now}
        old = {name for name, (a, b) in known.items() if now[name] == a != b}
        new = {name for name, (a, b) in known.items() if now[name] != a}
        if old and new:
            found.append(f"results of two runs: {min(old)} beside {min(new)}")
        return found

    def faults_after(self) -> list[str]:
        """What is wrong with the folder after the next run: other values than the undisturbed run's, leftovers."""
        found, now = self.faults_now(), _sums(self.out)
        found += [f"{name} differs" for name in sorted(set(now) | set(self._reference)) if not self._same(name)]
        state = self.out / ".torchid"
        found += [f"{path.name} left" for path in self.out.rglob(TEMPORARY)]
        found += [f"{path.name} left" for path in state.iterdir() if path.name not in STATE]
        return found

    def _same(self, name: str) -> bool:
        if name == "provenance.json" or (name == "report.html" and not self.report):  # hours and costs
            return (self.out / name).is_file()
        here, there = _content(self.out / name), _content(self.folder / "reference" / name)
        return None is not here == there


def _sound(attempt: Attempt) -> None:
    if attempt.code:
        raise SystemExit(f"the undisturbed run ended with {attempt.code}: {attempt.said}")


def _simulate(folder: Path, seed: int) -> None:
    written = simulate_session(OPTIONS, seed, folder).config
    assert written is not None
    content = yaml.safe_load(written.read_text()) | {"geometry": GEOMETRY}
    written.write_text(yaml.safe_dump(content))
    (folder / "before.yaml").write_text(yaml.safe_dump(content | {"inertia": {"enabled": False}}))


def _content(path: Path) -> bytes | None:
    """Of a file, without the costs that the report tells of."""
    return _TIME.sub(b"", path.read_bytes()) if path.is_file() else None


def _sums(out: Path) -> dict[str, str]:
    """Hashes of torchid's results in a folder."""
    paths = [path for path in out.iterdir() if path.is_file() and path.name not in MINE]
    return {path.name: file_sha256(path) for path in paths}


def without_report() -> None:
    """The page, which is one write like any other but takes longest, is left almost empty in this process."""
    torchid.run.sequence.write_report = lambda outcome, path, failure=None: write_text(path, "report")


def run_forked(command: Callable[[], None], folder: Path, kill_after: float | None = None) -> Attempt:
    """``command`` in a forked process: its exit code, or minus the signal that ended it, and what it printed."""
    folder.mkdir(parents=True, exist_ok=True)
    said = folder / "said.txt"
    child = os.fork()
    if child == 0:
        _become(command, said)
    if kill_after is not None:
        time.sleep(kill_after)
        os.kill(child, signal.SIGKILL)  # not yet waited for, so the number is still its own
    status = os.waitpid(child, 0)[1]
    return Attempt(os.waitstatus_to_exitcode(status), said.read_text(errors="replace"))


def _become(command: Callable[[], None], said: Path) -> None:
    code = 1
    try:
        torch.set_num_threads(1)
        file = os.open(said, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        os.dup2(file, 1)
        os.dup2(file, 2)
        command()
        code = 0
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else 0 if end.code is None else 1
    except BaseException:
        traceback.print_exc()
    finally:
        sys.stderr.flush()
        os._exit(code)
