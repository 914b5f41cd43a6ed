"""Every ``torchid`` command that a page prints runs up to where work begins: options, config, sources, files."""

import functools
import os
import re
import shlex
import shutil
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
import yaml
from b3d_bytes import B3dTrial, write_b3d
from typer.testing import CliRunner

from torchid import run
from torchid.checks import report as check_report
from torchid.cli import app
from torchid.cohort import cohort
from torchid.evaluation import evaluate
from torchid.evaluation.groups import write as groups
from torchid.evaluation.study import write
from torchid.folder import survey as folder_survey
from torchid.live import run as live
from torchid.run import demo
from torchid.scene import finished
from torchid.session import checking

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "scripts"))

from documentation.examples import blocks

PROJECT = Path(__file__).resolve().parents[1]
README = PROJECT / "README.md"
PLACEHOLDER = re.compile(r"[A-Z]+")
"""A word such as FILE, for which there is nothing to put."""


class Begun(BaseException):
    """Work would begin now."""


@dataclass(frozen=True)
class Command:
    """A command as a page prints it."""

    page: str
    line: int
    words: tuple[str, ...]


def commands() -> list[Command]:
    """Lines of indented blocks, and code within sentences that has more than the command's name."""
    found = []
    for page in (README, *sorted((PROJECT / "docs").glob("*.md"))):
        for k, text in enumerate(page.read_text(encoding="utf-8").splitlines(), 1):
            said = [text.strip()] if text.startswith("    torchid ") else re.findall(r"`(torchid [^`]+)`", text)
            for one in said:
                words = tuple(shlex.split(one, comments=True)[1:])
                if len(words) > 1 and not any(PLACEHOLDER.fullmatch(word) for word in words):
                    found.append(Command(page.name, k, words))
    return found


def begin(*_: object, **__: object) -> None:
    raise Begun


def laid_out(folder: Path) -> None:
    """What README asks for: its config beside a folder of recordings, and the project's configs."""
    (text,) = (block.code for block in blocks(README, "yaml"))
    (folder / "S04.yaml").write_text(text)
    for trial in yaml.safe_load(text)["trials"]:
        for key in ("file", "forces"):
            path = folder / trial[key]
            path.parent.mkdir(exist_ok=True)
            path.touch()
    shutil.copytree(PROJECT / "configs", folder / "configs")
    (folder / "session.xdf").touch()
    force, point, torque = np.ones((3, 10, 2, 3))
    walk = B3dTrial("walk", np.ones((10, 3, 3)), force, point, torque)
    write_b3d(folder / "S1.b3d", ("LASI", "RASI", "SACR"), [walk], 100.0)
    (folder / "subjects.csv").write_text("subject,folder\nS04,OpenCapSubject\n")
    shutil.copytree(folder / "OpenCapSubject", folder / "recordings" / "S04")
    (folder / "out" / "laboratory").mkdir(parents=True)
    (folder / "out" / "laboratory" / "cohort.csv").touch()


@pytest.mark.parametrize("command", commands(), ids=lambda one: f"{one.page}:{one.line}")
def test_a_command_of_a_page_reaches_its_work(command, tmp_path, monkeypatch):
    """As printed, from the folder that README describes; recordings that are not on this machine are stood in for."""
    laid_out(tmp_path)
    monkeypatch.chdir(tmp_path)
    if "TORCHID_DATA" not in os.environ and any(word.startswith("configs/") for word in command.words):
        monkeypatch.setenv("TORCHID_DATA", str(tmp_path / "data"))
        for text in (path.read_text() for path in (tmp_path / "configs").glob("*.yaml")):
            for name in re.findall(r"\$\{TORCHID_DATA\}/([^\s\",}]+)", text):
                (tmp_path / "data" / name).parent.mkdir(parents=True, exist_ok=True)
                (tmp_path / "data" / name).touch()
    for where, name in (
        (run, "run_experiment"), (run, "run_simulation"), (demo, "run_simulation"), (evaluate, "evaluate"),
        (live, "prepare_subject"), (live, "open_as_recorded"), (finished.FinishedRun, "__init__"),
        (cohort, "run_cohort"), (cohort, "missing"), (groups, "compare_groups"),
        (check_report, "check_recordings"),
        (checking, "check_recordings"),
        (folder_survey, "check_recordings"),
    ):  # fmt: skip
        monkeypatch.setattr(where, name, begin)
    monkeypatch.setattr(write, "evaluate_study", functools.partial(write.evaluate_study, make=begin))
    try:
        done = CliRunner().invoke(app, list(command.words))
    except Begun:
        return
    pytest.fail(f"exit code {done.exit_code}: {done.output}")


def test_commands_are_found():
    """Each of the program's, in README at least."""
    named = {command.words[0] for command in commands() if command.page == README.name}
    assert {"check", "run", "evaluate", "live", "view"} <= named
