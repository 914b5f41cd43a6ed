"""Many subjects: who they are, that one who fails harms nobody else, and what table and page say of all."""

import csv
import json
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import time
from concurrent.futures import Future
from contextlib import nullcontext
from io import StringIO
from pathlib import Path

import pandas as pd
import psutil
import pytest
from typer.testing import CliRunner

from torchid.cli import app
from torchid.cohort import cohort, task
from torchid.cohort.cohort import missing, run_cohort
from torchid.cohort.members import Participant, members_of
from torchid.cohort.page import MEASURES, OUTLYING, outliers, render_cohort
from torchid.cohort.table import COLUMNS, cohort_table
from torchid.cohort.task import RunLimits, content, log_path, looks, perform, row_path, stored
from torchid.errors import ConfigError, InputError
from torchid.simulate.options import SimulateOptions
from torchid.simulate.session import simulate_session
from torchid.storage.table_forms import installed

BAIT = '<script>alert("x")</script>'
QUICK = """
diagnosis: {enabled: false}
geometry: {max_frames: 60, temporal: false}
motion: {cutoff_hz: 6.0}
"""
"""Of a config: what takes longest is not asked."""
SHORT = SimulateOptions(fit=("squats",), heldout=("sway_steps",), duration_s=2.0, rate_hz=50.0)


def tree(folder: Path, *names: str) -> Path:
    """Folders of files that are called recordings."""
    for name in names:
        (folder / name).mkdir(parents=True)
        (folder / name / "walk.c3d").write_bytes(name.encode())
    return folder


def table(folder: Path, *lines: str, name: str = "subjects.csv") -> Path:
    """A table of subjects."""
    path = folder / name
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def row(name: str, **more: object) -> dict:
    """What a task leaves of a subject that is well."""
    figures = {"mass_kg": 70.0, "mass_sd_kg": 0.1, "recorded_kg": 70.0, "marker_rmse_mm": 5.0, "heldout_force_N": 20.0,
               "heldout_moment_Nm": 5.0, "causes": [], "seconds": 60.0}  # fmt: skip
    return {"subject": name, "status": "done", "reason": "", "verdict": "good", "because": "", **figures, **more}


def test_a_table_names_sessions_with_what_is_known_of_them(tmp_path):
    """Whatever separates its cells; what is empty is not given, folders start at the table's own."""
    tree(tmp_path, "a", "b")
    lines = ["Subject,folder,mass_kg,sex,group", 'A,a,"62,5",F,old', "", "B,b,,,young"]
    for name, sign in (("comma.csv", ","), ("semicolon.csv", ";"), ("tab.tsv", "\t")):
        text = [line.replace('"62,5"', "62.5").replace(",", sign) for line in lines]
        found = members_of(table(tmp_path, *text, name=name))
        assert [one.name for one in found] == ["A", "B"] and found[0].source == (tmp_path / "a").resolve()
        assert found[0].person.known == {"name": "A", "mass_kg": 62.5, "sex": "female"}
        assert found[1].person.known == {"name": "B"} and found[1].labels == {"group": "young"}
    if installed(("parquet",)):
        frame = pd.DataFrame({"subject": ["A", "B"], "folder": ["a", "b"], "mass_kg": [62.5, None], "sex": ["F", None],
                              "group": ["old", "young"]})  # fmt: skip
        frame.to_parquet(tmp_path / "table.parquet")
        assert members_of(tmp_path / "table.parquet") == found


def test_all_faults_of_a_table_are_told_at_once(tmp_path):
    """With their lines, before anything is run."""
    tree(tmp_path, "a", "b")
    (tmp_path / "c.yaml").write_text("subject: {}")
    lines = ["subject,folder,config,mass_kg", "A,a,,heavy", "B,nowhere,,60", ",a,,", "C,a,c.yaml,", "D,,c.yaml,60",
             "E,b,,", "E,a,,", "F,a,,nan", "G,a,,62,5"]  # fmt: skip
    with pytest.raises(ConfigError, match=r"cohort\.table") as caught:
        members_of(table(tmp_path, *lines))
    said = str(caught.value)
    for fault in ("line 2: A: mass_kg is no number: heavy", "line 3: B: no folder nowhere", "line 4: no subject",
                  "line 5: C: needs either", "line 6: D: its config says whom", "line 9: F: mass_kg is nobody's: nan",
                  "line 10: G: 5 cells, more than columns"):  # fmt: skip
        assert fault in said
    with pytest.raises(ConfigError, match="no column subject.*unknown column weight"):
        members_of(table(tmp_path, "name,folder,weight".replace("name,", ""), "a,3"))
    for names in (("E", "e"), ("rows", "a"), ("Cohort.csv", "a"), ("laboratories", "a")):
        with pytest.raises(ConfigError, match=r"cohort\.names"):
            members_of(table(tmp_path, "subject,folder", *(f"{name},a" for name in names)))
    with pytest.raises(InputError, match=r"cohort\.absent"):
        members_of(tmp_path / "no.csv")
    with pytest.raises(InputError, match=r"cohort\.empty"):
        members_of(table(tmp_path, "subject,folder"))
    assert CliRunner().invoke(app, ["cohort", str(tmp_path / "no.csv"), "-o", str(tmp_path / "o")]).exit_code == 2


def test_a_tree_names_a_subject_a_folder_or_a_session(tmp_path):
    """Folders without recordings are nobody; with sub-*/ses-* every session is one."""
    plain = tree(tmp_path / "plain", "P.1", "P2/day", ".hidden")
    (plain / "notes").mkdir()
    (plain / "S3.b3d").touch()
    assert [one.name for one in members_of(plain)] == ["P.1", "P2", "S3"]
    (one,) = members_of(table(plain, "subject,folder", "S,S3.b3d"))
    assert one.source == (plain / "S3.b3d").resolve()
    bids = tree(tmp_path / "bids", "sub-01/ses-a", "sub-01/ses-b/motion", "sub-02/ses-a", "sub-03", "derivatives")
    assert [one.name for one in members_of(bids)] == ["sub-01_ses-a", "sub-01_ses-b", "sub-02_ses-a", "sub-03"]
    (plain / "P2" / ".torchid").mkdir()  # results, not recordings
    assert [one.name for one in members_of(plain)] == ["P.1", "S3"]


def test_what_has_changed_is_run_again_and_nothing_else(tmp_path):
    """A copy of the same files is the same; other content, another mass, or a lost row is not."""
    folder, out = tree(tmp_path, "a") / "a", tmp_path / "out"
    one = Participant("A", folder)
    row_path(one, out).parent.mkdir(parents=True)
    kept = row("A", looks=looks(one), content=content(one), again=False, group="old")
    row_path(one, out).write_text(json.dumps(kept))
    assert stored(one, out) is None  # without its results
    (out / "A").mkdir()
    (out / "A" / "report.html").touch()
    assert stored(one, out) is not None and missing([one], out)[1] == []
    grouped = stored(Participant("A", folder, labels={"group": "new"}), out)
    assert grouped is not None and grouped["group"] == "new"
    os.utime(folder / "walk.c3d", (1, 1))
    assert stored(one, out) is not None  # touched, and read again
    assert json.loads(row_path(one, out).read_text())["looks"] == looks(one)
    (heavier,) = members_of(table(tmp_path, "subject,folder,mass_kg", "A,a,70"))
    assert stored(heavier, out) is None
    (folder / "walk.c3d").write_bytes(b"other")
    assert stored(one, out) is None and missing([one], out)[1] == [one]
    for text in ("{", "[]", json.dumps(kept | {"again": True})):
        row_path(one, out).write_text(text)
        assert stored(one, out) is None


def test_a_config_member_depends_on_the_recordings_that_it_names(tmp_path):
    """On their content, wherever they lie."""
    config = simulate_session(SHORT, 1, tmp_path / "A").config
    assert config is not None
    one = Participant("A", config.resolve())
    before = looks(one), content(one)
    os.utime(tmp_path / "A" / "squats.c3d", (1, 1))
    assert looks(one) != before[0] and content(one) == before[1]
    (tmp_path / "A" / "squats.c3d").write_bytes(b"other")
    assert content(one) != before[1]


@pytest.mark.parametrize("where", ["a", "a/out", "."])
def test_results_among_recordings_are_refused(tmp_path, where):
    """They would be recordings for the next call."""
    tree(tmp_path, "a")
    with pytest.raises(ConfigError, match=r"cohort\.inside"):
        run_cohort([Participant("a", (tmp_path / "a").resolve())], tmp_path / where, RunLimits(1.0, 1.0))


class Here:
    """A cluster that is this process."""

    dashboard_link = ""

    def submit(self, work, *args, **more):
        """What is asked, done."""
        future = Future()
        future.set_result(work(*args))
        future.release = lambda: None
        return future


@pytest.mark.parametrize("scheme", ["alone", "clash"])
def test_a_folder_of_several_people_is_a_subject_for_each(tmp_path, monkeypatch, scheme):
    """Found when it is run, and known to the next call; a person who is called as another member is refused."""
    script = tmp_path / "shared.py"
    script.write_text(
        "import json, os, sys\n"
        "order = json.load(open(sys.argv[1]))\n"
        "who = order['person'].get('name')\n"
        "said = {'status': 'set aside', 'reason': 'several', 'code': 'folder.people', 'people': ['P', 'Q']}\n"
        "if who or not order['source'].endswith('many'): said = {'status': 'done', 'reason': '', 'causes': [], "
        "'verdict': 'good'}\n"
        "os.makedirs(order['out'], exist_ok=True); open(order['out'] + '/report.html', 'w')\n"
        "json.dump(said | {'cpu_s': 0.0}, open(order['row'], 'w'))\n"
    )
    monkeypatch.setattr(task, "COMMAND", (sys.executable, str(script)))
    monkeypatch.setattr(cohort, "workers", lambda *asked: nullcontext(Here()))
    monkeypatch.setattr(cohort, "ended", list)
    where = tree(tmp_path / "in", "many", "one", *(["many_P"] if scheme == "clash" else []))
    out, told = tmp_path / "out", []
    if scheme == "clash":
        with pytest.raises(ConfigError, match="many_p names 2"):
            run_cohort(members_of(where), out, RunLimits(1.0, 60.0), 1)
        return
    for ran in (3, 0):
        told.clear()
        before = len(list((out / "logs").glob("*"))) if out.exists() else 0
        rows = run_cohort(members_of(where), out, RunLimits(1.0, 60.0), 1, on_row=lambda *seen: told.append(seen))
        assert [one["subject"] for one in rows] == ["many_P", "many_Q", "one"]
        assert [one["status"] for one in rows] == ["done"] * 3
        assert len(told) == 3 and told[-1][1:] == (3, 3)
        assert (len(list((out / "logs").glob("*"))) > before) == bool(ran)
    assert missing(members_of(where), out)[1] == []


POISON = """
import json, os, sys, time
order = json.load(open(sys.argv[1]))
kind = os.path.basename(order["out"])
tried = order["out"] + ".tries"
open(tried, "a").write("x")
if kind == "hang": time.sleep(600)
if kind == "hog": held = [bytearray(1 << 26) for _ in range(64)]; time.sleep(600)
if kind == "crash": os.kill(os.getpid(), 11)
if kind == "mute": sys.exit(7)
if kind == "once" and len(open(tried).read()) == 1: os.kill(os.getpid(), 9)
said = {"status": "done", "reason": ""}
if kind == "refused": said = {"status": "set aside", "reason": "no plates", "code": "x.y"}
os.makedirs(order["out"], exist_ok=True)
open(order["out"] + "/report.html", "w")
json.dump(said | {"cpu_s": 0.0}, open(order["row"], "w"))
"""


def test_who_fails_is_tried_again_where_that_may_help_and_set_aside_with_the_reason(tmp_path, monkeypatch):
    """What crashes, hangs or exhausts memory is run twice; what is refused, once; a second call runs nothing."""
    script = tmp_path / "poison.py"
    script.write_text(POISON)
    monkeypatch.setattr(task, "COMMAND", (sys.executable, str(script)))
    monkeypatch.setattr(task, "PAUSE_S", 0.1)
    tree(tmp_path, *(kinds := ("hang", "hog", "crash", "mute", "once", "refused", "well")))
    out = tmp_path / "out"
    found = {}
    for kind in kinds:
        seconds = 2.0 if kind == "hang" else 60.0
        found[kind] = perform(Participant(kind, tmp_path / kind), out, RunLimits(1.0, seconds))
    tries = {kind: len((out / f"{kind}.tries").read_text()) for kind in kinds}
    assert tries == dict.fromkeys(kinds, 2) | {"refused": 1, "well": 1}
    reasons = {kind: one["reason"] for kind, one in found.items() if one["status"] != "done"}
    assert set(reasons) == {"hang", "hog", "crash", "mute", "refused"} and reasons["refused"] == "no plates"
    for kind, said in (("hang", "took longer than 2 s"), ("hog", "needed more than 1.0 GiB"),
                       ("crash", "was ended by signal 11"), ("mute", "ended with 7 and without a result")):  # fmt: skip
        assert reasons[kind].startswith(said) and str(log_path(Participant(kind, tmp_path), out)) in reasons[kind]
    for kind in ("well", "refused", "mute"):
        again = perform(Participant(kind, tmp_path / kind), out, RunLimits(1.0, 60.0))
        assert (again == found[kind]) == (kind != "mute")
    tries = {kind: len((out / f"{kind}.tries").read_text()) for kind in kinds}
    assert (tries["well"], tries["refused"], tries["mute"]) == (1, 1, 4)
    left = [one for one in psutil.Process().children(recursive=True) if str(script) in one.cmdline()]
    assert not left


def test_a_run_that_nobody_waits_for_ends(tmp_path):
    """Who started it was killed: another worker may be at the same subject by then."""
    code = ("import subprocess, sys; p = subprocess.Popen([sys.executable, '-c', "
            "'import os, threading, time; from torchid.cohort.process import end_with; "
            "threading.Thread(target=end_with, args=(os.getppid(),), daemon=True).start(); "
            "print(os.getpid(), flush=True); time.sleep(600)']); p.wait()")  # fmt: skip
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True) as parent:
        assert parent.stdout is not None
        child = psutil.Process(int(parent.stdout.readline()))
        parent.kill()
    child.wait(timeout=60)
    assert not child.is_running()


def test_table_and_page_have_everybody_and_obey_nobody(tmp_path, seed):
    """Names are shown, not run; figures that stand out are found, wherever they are; links lead to reports."""
    rng = random.Random(seed)  # noqa: S311 - a lot
    rows = [row(f"S{k}", marker_rmse_mm=rng.gauss(5.0, 0.3)) for k in range(30)]
    who, how = rng.randrange(30), rng.choice([-1, 1])
    rows[who] |= {"marker_rmse_mm": 5.0 + how * rng.uniform(0.5, 0.9) * 5.0, "because": "markers off"}
    rows += [row(BAIT, laboratory=BAIT, causes=[BAIT]), {"subject": "gone", "status": "set aside", "reason": BAIT}]
    (tmp_path / "S3").mkdir()
    (tmp_path / "S3" / "report.html").touch()
    page = render_cohort(rows, tmp_path)
    assert BAIT not in page and page.count("<script>") == 1 and 'href="S3/report.html"' in page
    assert [(one["subject"], m.key) for one, m, value, _ in outliers(rows[:30])
            if abs(value - 5.0) > 2.0] == [(f"S{who}", "marker_rmse_mm")]  # fmt: skip
    assert "31 of 32 subjects done" in page and "1 subject set aside" in page
    read = list(csv.DictReader(StringIO(cohort_table(rows, tmp_path).to_csv(index=False))))
    assert len(read) == 32 and tuple(read[0]) == tuple(one.name for one in COLUMNS)
    assert read[3]["report"] == "S3/report.html" and read[-1]["mass_kg"] == "" and read[-1]["reason"] == BAIT
    alike = [row(f"S{k}") for k in range(30)]
    assert not list(outliers(alike)) and len(MEASURES) == 4 and OUTLYING > 3.0
    outline = {"sticks": [[rng.randrange(-90, 90) for _ in range(4)] for _ in range(20)], "arrows": [[0, 0, 5, -80]]}
    many = [row(f"S{k:04d}", causes=["plate_gain plate_1"] * rng.randrange(2), outline=outline) for k in range(1000)]
    page = render_cohort(many, tmp_path)
    assert len(page) < 10_000_000 and page.count("<svg") == 1000 and "M0,0L5,-80" in page


@pytest.mark.slow
def test_a_cohort_runs_whoever_is_killed_meanwhile(tmp_path):
    """A worker and then the command are killed: a second call ends well, and a third has nothing left to do."""
    lines = ["subject,config,laboratory"]
    for name in ("A", "B", "C"):
        config = simulate_session(SHORT, len(lines), tmp_path / name).config
        assert config is not None
        config.write_text(config.read_text() + QUICK)
        lines.append(f"{name},{config.relative_to(tmp_path)},L")
    shutil.copytree(tmp_path / "A", tmp_path / "D")
    broken = next((tmp_path / "D").glob("**/squats.c3d"))
    broken.write_bytes(broken.read_bytes()[:600])
    config = next((tmp_path / "D").glob("**/*.yaml"))
    where, out = table(tmp_path, *lines, f"D,{config.relative_to(tmp_path)},L"), tmp_path / "out"
    command = [sys.executable, "-m", "torchid.cli", "cohort", str(where), "-o", str(out), "--workers", "2"]

    first = subprocess.Popen(command, stderr=subprocess.DEVNULL)
    _until(lambda: len(_runs(first.pid)) >= 2)
    os.kill(psutil.Process(_runs(first.pid)[0]).ppid(), signal.SIGKILL)  # a worker
    _until(lambda: len(list((out / "rows").glob("[A-D].json"))) >= 1)
    begun = {file.name: file.stat().st_mtime_ns for file in (out / "rows").glob("[A-D].json")}
    orphans = _runs(first.pid)
    first.kill()
    first.wait()
    _until(lambda: not any(map(_runs_on, orphans)))

    second = subprocess.run(command, capture_output=True, text=True, check=False)
    assert second.returncode == 4 and "D: " in second.stderr and "3 of 4 subjects" in second.stdout
    read = {one["subject"]: one for one in csv.DictReader(StringIO((out / "cohort.csv").read_text()))}
    assert [read[name]["status"] for name in "ABCD"] == ["done"] * 3 + ["set aside"] and "squats.c3d" in read["D"][
        "reason"
    ]
    assert all((out / name / "report.html").is_file() for name in "ABC")
    assert {name: (out / "rows" / name).stat().st_mtime_ns for name in begun} == begun
    rows = {file.name: file.stat().st_mtime_ns for file in (out / "rows").iterdir()}
    begin = time.monotonic()
    assert subprocess.run(command, capture_output=True, check=False).returncode == 4 and time.monotonic() - begin < 60.0
    assert {file.name: file.stat().st_mtime_ns for file in (out / "rows").iterdir()} == rows
    assert re.search(r"3 of 4 subjects done", (out / "cohort.html").read_text())
    if installed(("parquet",)):
        assert pd.read_parquet(out / "cohort.parquet").subject.tolist() == list("ABCD")


@pytest.mark.slow
def test_the_job_script_of_slurm_runs_a_cohort(tmp_path):
    """As the page has it, with an ``srun`` that starts two tasks on this machine."""
    page = (Path(__file__).parents[1] / "docs" / "cohort.md").read_text(encoding="utf-8")
    (script,) = re.findall(r'```bash title="cohort.sbatch"\n(.*?)```', page, re.DOTALL)
    tree(tmp_path, "a", "b")
    table(tmp_path, "subject,folder", "A,a", "B,b")
    (tmp_path / "bin").mkdir()
    srun = tmp_path / "bin" / "srun"
    srun.write_text('#!/bin/sh\n"$@" &\n"$@" &\nwait\n')
    srun.chmod(0o755)
    path = os.pathsep.join((str(srun.parent), str(Path(sys.executable).parent), os.environ["PATH"]))
    with (tmp_path / "job.log").open("wb") as log:
        job = subprocess.Popen(["bash", "-c", script], cwd=tmp_path, env=os.environ | {"PATH": path}, stdout=log,
                               stderr=log, start_new_session=True)  # fmt: skip
        try:
            code = job.wait(timeout=300)
        finally:
            os.killpg(job.pid, signal.SIGKILL)  # as Slurm ends what a job leaves
    assert code == 4, (tmp_path / "job.log").read_text()  # neither is a recording
    with (tmp_path / "out/laboratory/cohort.csv").open() as file:
        assert [one["status"] for one in csv.DictReader(file)] == ["set aside"] * 2


def _runs(pid: int) -> list[int]:
    """Processes of members' runs below a command."""
    found = []
    for one in psutil.Process(pid).children(recursive=True):
        try:
            found += [one.pid] if "torchid.cohort.process" in one.cmdline() else []
        except psutil.Error:
            continue
    return found


def _runs_on(pid: int) -> bool:
    """Whether a process is there and not only waits for somebody to ask how it ended."""
    try:
        return psutil.Process(pid).status() != psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return False


def _until(holds) -> None:
    for _ in range(6000):
        if holds():
            return
        time.sleep(0.1)
    raise AssertionError("waited for ten minutes")
