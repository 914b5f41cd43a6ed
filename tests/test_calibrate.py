"""What a calibration varies, counts and concludes; no session is simulated."""

import json
import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from types import SimpleNamespace

import pytest
from pydantic import BaseModel, TypeAdapter

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "scripts"))

from batteries import calibrate
from batteries.calibrate import RESERVED, bounded, counted, decided, document, judged, judged_with, plan, variants
from harness.pool import finished
from harness.rows import read_lines

from torchid.config.sections import DiagnosisSection
from torchid.conventions import Count, NonNegative, Positive, Share
from torchid.diagnosis.options import DiagnosisOptions, ThresholdKind, threshold_kinds
from torchid.effects.catalogue import CATALOGUE

OPTIONS = DiagnosisOptions()
NAMED, VIBRATION = "NamingOptions.named_nats", "AdequacyOptions.vibration_ratio"
RIGHT, FALSE, SILENT = ["drag", ["pelvis"], 0.9], ["tether", ["thorax"], 0.8], []


def flat(options: DiagnosisOptions) -> dict[str, float]:
    """Every threshold by the name that ``threshold_kinds`` has."""
    return {
        f"{type(section).__name__}.{key}": value
        for name in asdict(options)
        for section in [getattr(options, name)]
        for key, value in asdict(section).items()
    }


def test_each_calibrated_threshold_is_halved_and_doubled_alone():
    """No other value is touched, and no calibrated one is forgotten."""
    wanted = {name for name, (kind, _) in threshold_kinds().items() if kind is ThresholdKind.CALIBRATED}
    found, before = variants(OPTIONS, calibrate.calibrated_names()), flat(OPTIONS)
    assert wanted and {one.threshold for one in found} == wanted
    for one in found:
        assert flat(one.options) == before | {one.threshold: one.value}
        asked = {"half": 0.5, "double": 2.0}[one.factor] * before[one.threshold]
        whole, share = isinstance(one.value, int), one.threshold.endswith("_part")
        assert abs(one.value - asked) <= (0.5 if whole else 1e-9) or (share and one.value == 1.0 < asked)
    assert len(found) == 2 * len(wanted)
    assert flat(OPTIONS) == before == flat(DiagnosisOptions())


@pytest.mark.parametrize("name", calibrate.OFF)
def test_a_rule_can_be_put_off(name, monkeypatch):
    """By a value within its bounds; where the rule took no step the verdict is the present one without a run."""
    (one,) = variants(OPTIONS, [name], ("off",))
    assert TypeAdapter(DiagnosisOptions).validate_json(json.dumps(asdict(one.options))) == one.options
    assert one.value == calibrate.OFF[name][0] != flat(OPTIONS)[name]
    runs, steps = [], [SimpleNamespace(rule="evidence")]

    def diagnose(outcome: Outcome) -> SimpleNamespace:
        runs.append(outcome)
        return SimpleNamespace(trace=list(steps))

    monkeypatch.setattr(calibrate, "run_experiment", Outcome)
    monkeypatch.setattr(calibrate, "diagnose_outcome", diagnose)
    said = calibrate.diagnosed(Config(), [one])
    assert (said[0] is said[1], len(runs)) == ((True, 1) if one.rules else (False, 2))
    for rule in one.rules:
        steps[:] = [SimpleNamespace(rule=rule)]
        said = calibrate.diagnosed(Config(), [one])
        assert said[0] is not said[1]


@pytest.mark.parametrize(
    ("kind", "value", "nearest"),
    [(Share, 1.4, 1.0), (Share, 0.4, 0.4), (Count, 0.5, 1), (Count, 1.5, 2), (Positive, 0.1, 0.1), (NonNegative, 0, 0)],
)
def test_a_value_stays_within_its_bounds(kind, value, nearest):
    """Shares up to one, counts whole and from one."""
    found = bounded(kind, value)
    assert found == nearest
    assert kind is not Count or isinstance(found, int)


@dataclass(frozen=True)
class CountedOptions:
    """Stands for a section with a count, a share and a zero."""

    trials: Count = 1
    part: Share = 0.7
    whole: Share = 1.0
    none: NonNegative = 0.0


@dataclass(frozen=True)
class MadeUp:
    """Stands for all options."""

    counted: CountedOptions = field(default_factory=CountedOptions)


def test_what_bounds_leave_as_it_is_is_not_tried():
    """A count of one has no half, a share of one no double, zero neither."""
    found = variants(MadeUp(), [f"CountedOptions.{name}" for name in ("trials", "part", "whole", "none")])
    said = {(one.threshold.split(".")[1], one.factor): one.value for one in found}
    assert said == {("trials", "double"): 2, ("part", "half"): 0.35, ("part", "double"): 1.0, ("whole", "half"): 0.5}
    assert found[0].options == replace(MadeUp(), counted=CountedOptions(trials=2))


class Config(BaseModel):
    """Stands for a config."""

    diagnosis: DiagnosisSection = DiagnosisSection()


@dataclass(frozen=True)
class Outcome:
    """Stands for an outcome."""

    config: Config


def test_one_run_is_diagnosed_with_each_variant(monkeypatch):
    """Without a diagnosis in the run; its outcome has the thresholds of the config that it is diagnosed with."""
    runs, seen = [], []

    def experiment(config: Config) -> Outcome:
        runs.append(config)
        return Outcome(config)

    def diagnose(outcome: Outcome) -> None:
        assert outcome.config.diagnosis.enabled
        seen.append(outcome.config.diagnosis.thresholds)

    monkeypatch.setattr(calibrate, "run_experiment", experiment)
    monkeypatch.setattr(calibrate, "diagnose_outcome", diagnose)
    some = variants(OPTIONS, [NAMED])
    said = calibrate.diagnosed(Config(), some)
    assert [one.diagnosis.enabled for one in runs] == [False]
    assert seen == [OPTIONS, *(one.options for one in some)]
    found = calibrate.row([], said, some)
    assert found["verdict"] == judged([], [], False)
    assert [(v["factor"], v["value"]) for v in found["variants"]] == [("half", 1.25), ("double", 5.0)]


def verdict(*named: list, flagged: bool = False) -> dict:
    """Of a session that hides drag at the pelvis."""
    causes = [{"effect": e, "where": tuple(w), "confidence": c, "indistinguishable": []} for e, w, c in named]
    return judged([{"effect": "drag", "where": ["pelvis"]}], causes, flagged)


def test_a_verdict_is_right_by_its_first_cause_and_false_by_sure_ones():
    """A doubtful false cause does not count, a twin is as good as the cause."""
    assert verdict(RIGHT, FALSE) == {
        "named": [RIGHT, FALSE], "first": True, "false": [FALSE[:2]], "flagged": False,
    }  # fmt: skip
    doubtful = verdict([*FALSE[:2], 0.5], RIGHT)
    assert not doubtful["first"] and not doubtful["false"]
    twin = {"effect": "tether", "where": ("thorax",), "confidence": 0.9,
            "indistinguishable": [{"effect": "drag", "where": ("pelvis",)}]}  # fmt: skip
    assert judged([{"effect": "drag", "where": ["pelvis"]}], [twin], False)["first"]
    assert judged([], [twin], True) == {
        "named": [["tether", ["thorax"], 0.9]], "first": False, "false": [["tether", ["thorax"]]], "flagged": True,
    }  # fmt: skip


def made_row(seed: int, before: dict, half: dict, double: dict, name: str = NAMED) -> dict:
    """A row of one threshold."""
    changed = [{"threshold": name, "factor": f, "value": 0.0} | v for f, v in (("half", half), ("double", double))]
    return {"seed": seed, "key": str(seed), "verdict": before, "variants": changed}


def tried(*rows: dict, name: str = NAMED) -> list[calibrate.Line]:
    """The two lines of a threshold."""
    return counted(rows, variants(OPTIONS, [name]))


def test_what_changes_is_counted():
    """Right ones and false ones, won and lost; flags; other thresholds and failed sessions do not count."""
    rows = [
        made_row(1, verdict(RIGHT), verdict(RIGHT, FALSE), verdict()),
        made_row(2, verdict(), verdict(RIGHT), verdict(flagged=True)),
        made_row(3, verdict(FALSE), verdict(["payload", ["head"], 0.9], FALSE), verdict([*FALSE[:2], 0.4])),
        made_row(4, verdict(RIGHT), verdict([*RIGHT[:2], 0.6]), verdict(RIGHT)),
        made_row(5, verdict(), verdict(FALSE), verdict(FALSE), VIBRATION),
        {"seed": 6, "key": "6", "failed": "ValueError: no"},
    ]
    half, double = tried(*rows)
    assert (half.factor, half.value, half.sessions) == ("half", 1.25, 4) and double.value == 5.0
    assert (half.changed, half.right, half.false, half.flagged, half.net) == (3, (1, 0), (2, 0), (0, 0), -1)
    assert (double.changed, double.right, double.false, double.flagged) == (3, (0, 1), (0, 1), (1, 0))
    assert double.net == 0


def test_a_cause_at_another_place_is_another_verdict():
    """Though as many are right and false; one that is only less sure is none."""
    moved, same = verdict(RIGHT, ["tether", ["head"], 0.3]), verdict(RIGHT, ["tether", ["thorax"], 0.4])
    half, double = tried(made_row(1, verdict(RIGHT, ["tether", ["thorax"], 0.3]), moved, same))
    assert (half.changed, half.net, double.changed) == (1, 0, 0)


@pytest.mark.parametrize(
    ("half", "double", "said"),
    [
        ((RIGHT,), (RIGHT,), "keep"),
        ((RIGHT, FALSE), (FALSE,), "keep"),
        ((RIGHT,), (FALSE,), "half is better"),
        ((RIGHT, FALSE), (RIGHT,), "double is better"),
        ((), ([*FALSE[:2], 0.2],), "keep"),
        ((), (), "nothing hangs on it in 2 sessions: remove it or record sessions that need it"),
    ],
)
def test_a_threshold_is_kept_unless_another_value_alone_is_better(half, double, said):
    """By right causes minus false ones; ties keep."""
    idle = made_row(2, verdict(RIGHT), verdict(RIGHT), verdict(RIGHT))
    assert decided(tried(made_row(1, verdict(), verdict(*half), verdict(*double)), idle)) == said


def test_the_document_has_what_it_was_made_of():
    """Date, seeds and present values, and a text with each threshold; it can be written as it is."""
    rows = [made_row(700_003, verdict(), verdict(RIGHT), verdict()), {"seed": 700_001, "key": "a", "failed": "no"}]
    found = document(rows, OPTIONS, [NAMED, VIBRATION], tuple(calibrate.FACTORS), "2026-01-02")
    assert found == json.loads(json.dumps(found)) | {"lines": found["lines"]}
    assert (found["date"], found["seeds"], found["failed"]) == ("2026-01-02", [700_001, 700_003], 1)
    assert found["present"] == {NAMED: 2.5, VIBRATION: 3.0}
    assert found["verdicts"][NAMED] == "half is better" and "in 0 sessions" in found["verdicts"][VIBRATION]
    assert f"{NAMED} = 2.5: half is better" in found["text"]
    assert "2 sessions, of which 1 failed" in found["text"]


def test_half_of_the_sessions_hide_nothing_and_the_others_each_effect():
    """A quarter is of each simulator; where a calibration begins does not change what a seed is."""
    sessions = plan(RESERVED.start, 4 * len(CATALOGUE))
    hidden = [one.effect for one in sessions if one.effect]
    assert hidden == 2 * list(CATALOGUE)
    assert sum(one.own for one in sessions) == len(CATALOGUE)
    assert not any(one.own and one.effect for one in sessions)
    assert plan(RESERVED.start + 7, 5) == sessions[7:12]


@pytest.mark.parametrize(
    ("first", "sessions"), [(1, 1), (RESERVED.start - 1, 4), (RESERVED.stop - 1, 2), (RESERVED.start, 0)]
)
def test_seeds_that_are_not_reserved_are_refused(first, sessions):
    """The message has the range."""
    with pytest.raises(ValueError, match=f"--first {first} .* from 700000 to 799999"):
        plan(first, sessions)


@pytest.mark.parametrize(("options", "said"), [(["--calibrate", "--first", "5"], "700000 to 799999"),
                                               (["--first", "699990"], "reserved for --calibrate")])  # fmt: skip
def test_the_command_refuses_the_seeds_of_the_other_kind(options, said, monkeypatch, capsys, tmp_path):
    """A battery has none of the reserved ones, a calibration no others; nothing is written."""
    pytest.importorskip("mujoco", reason="the battery's physics is MuJoCo's")
    run = pytest.importorskip("batteries.run")
    monkeypatch.setattr(sys, "argv", ["battery", *options, "--out", str(tmp_path / "out")])
    with pytest.raises(SystemExit):
        run.main()
    assert said in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_a_stopped_calibration_goes_on(tmp_path):
    """A session with a row is not run again, unless its row is of other present values or lacks a threshold."""
    path, run = tmp_path / "rows.jsonl", []

    def go(jobs: range, present: dict[str, float]) -> list[str]:
        def perform(job: int) -> dict:
            run.append(job)
            return {"key": f"key{job}", "seed": job, "verdict": verdict(), "variants": [], "present": present}

        done = {row["key"]: row for row in read_lines(path) if judged_with(present, row)}
        with ThreadPoolExecutor(1) as pool:
            return [r["key"] for r in finished({f"key{k}": k for k in jobs}, perform, pool, path, done)]

    both = {NAMED: 2.5, VIBRATION: 3.0}
    assert go(range(2), both) == ["key0", "key1"]
    assert sorted(go(range(4), both)) == ["key0", "key1", "key2", "key3"]
    assert run == [0, 1, 2, 3] and len(path.read_text().splitlines()) == 4
    go(range(4), {NAMED: 2.5})
    assert len(run) == 4, "rows of more thresholds will do"
    go(range(1), {NAMED: 3.0})
    go(range(1), both | {"AdequacyOptions.position_part": 0.05})
    assert run[4:] == [0, 0]
