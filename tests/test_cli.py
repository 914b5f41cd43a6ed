"""The command line: exit codes, one line per error, speed of the help."""

import logging
import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest
import torch
from trc_files import write_trc
from typer.testing import CliRunner

from torchid.cli import app
from torchid.config import load_config
from torchid.errors import DataError, InputError
from torchid.recording import Markers
from torchid.report.blocks import Light
from torchid.session.outcome import Criterion, Quality, QualityLevel
from torchid.storage.logs import configure_logging
from torchid.terminal import progress_bars

runner = CliRunner()
CONFIG = "{subject: {name: S01}, markers: plug_in_gait, trials: [{name: a, file: a.c3d}]}"


@pytest.fixture
def config(tmp_path: Path) -> str:
    (tmp_path / "a.c3d").write_bytes(b"")
    (tmp_path / "c.yaml").write_text(CONFIG)
    return str(tmp_path / "c.yaml")


LIGHTS = (
    Light("Forces", QualityLevel.CARE, "Held-out force residual 11 % of peak."),
    Light("Next", None, "Look [there]."),
)


@pytest.fixture
def experiment(monkeypatch):
    """Replaces the run itself: what is tested here is what the command makes of its end."""
    seen: list = []
    module = type(sys)("torchid.run")
    outcome: list[BaseException] = []

    def run_experiment(loaded, progress) -> SimpleNamespace:
        seen.append(loaded)
        progress("geometry", 0.5)
        if outcome:
            raise outcome[0]
        verdict = Criterion(
            "force", QualityLevel.CARE, 0.11, 0.05, "held-out force residual 11 % of peak", "norm 5 %", ""
        )
        return SimpleNamespace(quality=Quality((verdict,)))

    module.run_experiment = run_experiment
    monkeypatch.setitem(sys.modules, "torchid.run", module)
    monkeypatch.setattr("torchid.report.glance.glance", lambda *_: LIGHTS)
    return seen, outcome


def test_help_names_every_command_within_half_a_second():
    """``torchid --help`` answers at once: processor time of the best of three, for other programs share the machine."""
    script = "import sys; sys.argv[1:] = ['--help']; from torchid.cli import app; app()"
    costs = []
    for _ in range(3):
        before = os.times()
        done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=60, check=True)
        after = os.times()
        costs.append(after.children_user + after.children_system - before.children_user - before.children_system)
        assert {"run", "check", "simulate"} <= set(done.stdout.split())
    assert min(costs) < 0.5


def test_the_command_line_imports_nothing_heavy():
    """Neither torch nor numpy nor pydantic is loaded until a command needs it."""
    script = "import sys, torchid.cli; print(sorted({'torch', 'numpy', 'pydantic', 'xarray'} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=60, check=True)
    assert done.stdout.strip() == "[]"


def test_a_run_gets_the_config_with_its_overrides(config, experiment):
    """Extra ``key=value`` arguments reach the run; the end says where the results are and what they are worth."""
    result = runner.invoke(app, ["run", config, "geometry.solver=adam"])
    assert result.exit_code == 0, result.output
    (loaded,), _ = experiment
    assert loaded == load_config(config, ["geometry.solver=adam"])
    verdict = "usable with care: held-out force residual 11 % of peak (norm 5 %)"
    forces, after, done = result.stdout.splitlines()
    assert forces.split() == "▲ Forces Held-out force residual 11 % of peak.".split()
    assert after.split() == "→ Next Look [there].".split()
    assert done == f"Done: {loaded.out / 'report.html'}, {verdict}"
    assert runner.invoke(app, ["run", config, "--quiet"]).stdout.splitlines()[0].startswith("Done: ")


@pytest.mark.parametrize(
    ("error", "code"),
    [
        (InputError("c3d.truncated", "cut short", source="a.c3d", remedy="Copy it again"), 2),
        (DataError("inertia.motion", "too little motion", remedy="Move more"), 3),
        (ZeroDivisionError("a\nb"), 1),
        (KeyboardInterrupt(), 130),
    ],
)
def test_every_end_has_its_exit_code_and_one_line(config, experiment, error, code):
    """Errors of the input, of the data and of torchid, and Ctrl-C, end with one line on stderr and no traceback."""
    experiment[1].append(error)
    result = runner.invoke(app, ["run", config])
    assert result.exit_code == code
    assert result.stdout == ""
    assert len(result.stderr.strip().splitlines()) == 1
    assert result.stderr.startswith("torchid: ")
    assert "Traceback" not in result.stderr


def test_debug_shows_the_traceback(config, experiment):
    """``--debug`` adds the traceback and keeps the exit code."""
    experiment[1].append(ZeroDivisionError("x"))
    result = runner.invoke(app, ["run", "--debug", config])
    assert result.exit_code == 1
    assert "Traceback" in result.stderr


def test_faults_of_the_config_come_one_per_line(config, experiment):
    """Two faults are two lines, each with file and key, exit code 2, and nothing was run."""
    result = runner.invoke(app, ["run", config, "geometry.solvr=adam", "inertia.lmi=no"])
    assert result.exit_code == 2
    lines = result.stderr.strip().splitlines()
    assert len(lines) == 2
    assert all(config in line for line in lines)
    assert "Did you mean 'solver'?" in result.stderr
    assert experiment[0] == []


@pytest.mark.parametrize("arguments", [["run"], ["run", "nowhere.yaml"], ["nonsense"], ["check", "notes.txt"]])
def test_wrong_use_ends_with_two(arguments):
    """A missing argument, file or command is the caller's fault."""
    assert runner.invoke(app, arguments).exit_code == 2


def test_terminal_escapes_in_messages_are_shown_not_obeyed(config, experiment):
    """A label that holds an escape sequence cannot write to the terminal."""
    experiment[1].append(InputError("m", "bad label \x1b[2J\x07[red]", remedy="Rename it"))
    result = runner.invoke(app, ["run", config])
    assert "\x1b" not in result.stderr and "\x07" not in result.stderr
    assert "[2J" in result.stderr and "[red]" in result.stderr


HOSTILE = "\x1b[2J\x1b]0;title\x07\x9b31m\u202eLASI"


def test_check_prints_no_terminal_escapes(tmp_path):
    """Labels and names of files are printed by one terminal, which shows control characters and loses no letter."""
    labels = (HOSTILE, "RASI", "LPSI", "RPSI", "LHEE", "RHEE")
    place = torch.tensor([[0.3 * (k % 2), 0.0, 0.3 * k] for k in range(6)], dtype=torch.float64)
    position = place + 1e-3 * torch.randn(20, 6, 3, dtype=torch.float64)
    position[:15, 0] = torch.nan
    path = tmp_path / f"{HOSTILE[0]}a.trc"
    write_trc(path, Markers(labels, torch.arange(20, dtype=torch.float64) / 100, position))
    result = runner.invoke(app, ["check", str(path)])
    assert "75 %" in result.stdout and "LASI" in result.stdout and "Cure" in result.stdout, result.output
    assert "label them again" in " ".join(result.stdout.split())
    assert not [c for c in result.output if c != "\n" and (ord(c) < 32 or 0x7F <= ord(c) < 0xA0 or c == "\u202e")]


def test_the_log_prints_no_terminal_escapes(capsys):
    """A warning that quotes a label is shown too, not obeyed."""
    configure_logging()
    logging.getLogger("torchid.test").warning("label %s", HOSTILE)
    printed = capsys.readouterr().err
    assert "LASI" in printed and "\x1b" not in printed and "\x07" not in printed


@pytest.mark.data
def test_check_describes_real_recordings_and_refuses_what_it_cannot_read(data_dir, tmp_path):
    """Each readable file is described, each unreadable one gets its line, and one refusal makes the exit code 2."""
    good = data_dir / "schreiber_moissenet_2014001" / "2014001_C1_01.c3d"
    bad = tmp_path / "bad.c3d"
    bad.write_bytes(b"<html>")
    result = runner.invoke(app, ["check", str(bad), str(good)])
    assert result.exit_code == 2, result.output
    assert str(bad) in result.stderr and "Traceback" not in result.stderr
    assert good.stem in result.stdout
    assert runner.invoke(app, ["check", str(good)]).exit_code == 0


def test_version_is_the_package_version(monkeypatch):
    """``torchid --version`` prints what is installed."""
    monkeypatch.setattr("importlib.metadata.version", lambda name: f"{name} 1.2.3")
    result = runner.invoke(app, ["--version"])
    assert (result.exit_code, result.stdout.strip()) == (0, "torchid 1.2.3")


def test_progress_survives_any_order_of_stages():
    """Stages may come, go and come again; a name with markup is text."""
    with progress_bars() as progress:
        for stage, fraction in (("a[b]", 0.0), ("c", 1.0), ("a[b]", 0.5), ("[/red]", 0.1)):
            progress(stage, fraction)
    assert set(progress.tasks) == {"a[b]", "c", "[/red]"}


@pytest.mark.parametrize("command", ["run", "evaluate", "simulate"])
@pytest.mark.parametrize("name", ["S1.b3d/walk", "sub-01_motion.tsv", "walk.c3d", "walk.TRC", "walk_grf.mot"])
def test_a_recording_in_place_of_a_config_is_refused(command: str, name: str, tmp_path: Path):
    """Whatever its kind, with what there is to do."""
    file = tmp_path / name
    (tmp_path / "S1.b3d").touch()
    if file.parent == tmp_path:
        file.write_text("a\tb: [\n")
    said = " ".join(runner.invoke(app, [command, str(file)]).output.split())
    assert "a recording is no config" in said and f"torchid new {file.parent}`" in said
