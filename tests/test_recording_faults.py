"""The first screen of a report: each fault of the recordings once, whether it is corrected, and what to do about it."""

import re
from dataclasses import replace

import pytest
import torch
from report_run import TRIAL, Run, cause, figure, finished_run

from torchid.checks.marker_tracks.statement import TrackFault, TrackStatement
from torchid.diagnosis.evidence.adequacy import Adequacy
from torchid.diagnosis.testing.heldout import Errors
from torchid.diagnosis.verdict.records import Cause, Diagnosis, Twin
from torchid.diagnosis.verdict.table import verdict_table
from torchid.effects.catalogue import CATALOGUE
from torchid.effects.place import Interval
from torchid.io.mend import ForcesAs, PlateAs
from torchid.report.cause_sentences import told
from torchid.report.glance import LINES, SETTLED, glance, next_step, unnamed
from torchid.report.page import render_report
from torchid.report.read_as import read_as
from torchid.report.recording_faults import LEFT_OUT, MASSES, NOT_DONE, Fault, recording_faults
from torchid.run.scalars import results_table
from torchid.run.sequence import with_torques
from torchid.session import Outcome
from torchid.session.following import limb, torques
from torchid.session.judging import quality_of
from torchid.session.outcome import Quality, QualityLevel
from torchid.session.tables import geometry_table
from torchid.storage.results import OutputFolder
from torchid.terminal import print_lights

QUIET, LOUD = (Adequacy(flag, 1e-9 if flag else 0.5, 0.6, "much") for flag in (False, True))
SWAPPED = ("LKNE", "RKNE")


@pytest.fixture(scope="session")
def run(tmp_path_factory) -> Run:
    """A tiny simulated session with hostile names, identified into a folder."""
    return finished_run(tmp_path_factory.getbasetemp() / "report")


def found(*causes: Cause, rest: Adequacy = QUIET) -> Diagnosis:
    """A verdict with these causes."""
    return Diagnosis((), Errors(1.0, 1.0), Errors(1.0, 1.0), causes, rest)


def with_faults(outcome: Outcome, *causes: Cause, tracks: tuple[TrackStatement, ...] = (), rest=QUIET) -> Outcome:
    """The outcome as if these had been found."""
    session = replace(outcome.session, tracking=tracks)
    return replace(outcome, session=session, diagnosis=found(*causes, rest=rest))


def alone(name: str, confidence: float = 0.995, applied: bool = True) -> Cause:
    """A cause without twins."""
    return replace(cause(name), confidence=confidence, applied=applied, indistinguishable=())


def swap(applied: bool = True) -> Cause:
    """Two labels that are exchanged for a while."""
    when = (Interval(TRIAL, 0.5, 1.25),)
    return replace(alone("marker_swap", applied=applied), where=SWAPPED, when=when, trials=(TRIAL,))


def track(kind: TrackFault, *labels: str, when=(), trial: str = TRIAL, against=("squats",)) -> TrackStatement:
    """One statement on the tracks of markers."""
    return TrackStatement(kind, trial, labels, when, 60.0, 3.0, 0.2, against=against)


def looks(outcome: Outcome) -> tuple[list[str], str]:
    """The lines on recordings, and what comes next, where all figures are within their norms."""
    lights = {one.about: one for one in glance(outcome, good(outcome))}
    recordings = lights["Recordings"]
    return [*(recordings.items or [recordings.text])], lights["Next"].text


def good(outcome: Outcome) -> Quality:
    """All figures within their norms."""
    return Quality(tuple(replace(one, level=QualityLevel.GOOD) for one in quality_of(outcome).criteria))


@pytest.mark.parametrize(
    ("name", "applied", "said"),
    [
        ("plate_gain", True, "corrected here"),
        ("payload", True, MASSES),
        ("soft_tissue", True, "corrected here"),
        ("body_mass", True, "corrected here"),
        ("plate_gain", False, NOT_DONE),
    ],
)
def test_each_fault_says_how_sure_it_is_and_whether_it_is_corrected(run, name, applied, said):
    """Loads are taken out where masses are fitted, not where joint moments are computed."""
    one = alone(name, applied=applied)
    (fault,) = recording_faults(with_faults(run.outcome, one))
    assert fault.line == f"{told(one)} Practically certain (over 99 %); {said}."


def test_moments_of_joints_are_of_forces_that_are_put_right(run, tmp_path):
    """What ``corrected here`` rests on; loads are taken off the total alone, which moments of joints do not ask."""
    trial, tree = run.outcome.session.trials[TRIAL], run.outcome.fit.model.tree
    assert trial.forces is not None
    half = replace(trial, forces=replace(trial.forces, wrench=0.5 * trial.forces.wrench))
    with OutputFolder(tmp_path / "out") as folder:
        as_read, right = (with_torques(replace(run.outcome, corrected=own), folder) for own in ({}, {TRIAL: half}))
        rows = limb(tree, "foot_l")
        before, after = (one.torque[TRIAL][:, rows] for one in (as_read, right))
        assert float((before - after).nan_to_num().abs().max()) > 1.0
        torch.testing.assert_close(right.torque["squats"], as_read.torque["squats"], equal_nan=True)
        torch.testing.assert_close(right.torque_scaled[TRIAL], as_read.torque_scaled[TRIAL], equal_nan=True)

    followed, fit = run.outcome.followed[TRIAL], run.outcome.fit
    assert followed.wrench is not None
    taken_off = replace(followed, wrench=replace(followed.wrench, wrench=0.5 * followed.wrench.wrench))
    own = [torques(one, tree, fit.geometry, run.outcome.phi, trial) for one in (followed, taken_off)]
    torch.testing.assert_close(*own, equal_nan=True)


def test_sizes_of_every_effect_are_numbers_of_the_table(run):
    """Vectors and matrices, too: a line for each of their numbers."""
    every = tuple(replace(alone(name), where=("x",)) for name in CATALOGUE)
    table = results_table(run.outcome, {
        "geometry.json": geometry_table(run.outcome), "diagnosis.json": verdict_table(found(*every)),
    }, None)  # fmt: skip
    sizes = table[(table.group == "cause") & (table.quantity != "confidence")]
    asked = sum(int(entry["value"].numel()) for one in every for entry in one.parameters.values())
    assert len(sizes) == asked > len(CATALOGUE) and bool(sizes.value.notna().all())


def test_what_cannot_be_told_apart_is_certain_and_its_cause_is_not(run):
    """The delay is there; which of two makes it is asked for next."""
    twin = Twin("time_offset", ("session",), 0.4)
    lag = replace(alone("body_lag"), indistinguishable=(twin,))
    (line,), after = looks(with_faults(run.outcome, lag))
    assert "Practically certain (over 99 %); its cause is one of two, which the recordings do not tell apart: " in line
    assert "a body that follows its bones late or a clock that is off; " in line and "may as well" not in line
    assert after.startswith("To tell a body that follows its bones late from a clock that is off, record ")
    assert SETTLED not in after


def test_exchanged_labels_are_told_once_with_what_the_run_did(run):
    """Diagnosis and distances tell of the same; labels are put right where their samples are used, else left out."""
    other = track(TrackFault.EXCHANGED, *SWAPPED, when=((0.4, 1.3),))
    (line,), after = looks(with_faults(run.outcome, swap(), tracks=(other,)))
    assert line == f"{told(swap())} Practically certain (over 99 %); names put right here." and SETTLED in after

    outcome = with_faults(run.outcome, swap(), tracks=(other,))
    item = outcome.followed[TRIAL]
    blind = replace(item, tracked=replace(item.tracked, error=torch.full_like(item.tracked.error, torch.nan)))
    (gone,) = recording_faults(replace(outcome, followed={**outcome.followed, TRIAL: blind}))
    assert gone.line.endswith(f"; {LEFT_OUT}.") and gone.step.startswith("Give LKNE and RKNE their own names in")
    (kept,) = recording_faults(with_faults(run.outcome, swap(applied=False)))
    assert kept.line.endswith(f"; {NOT_DONE}.") and kept.step == gone.step

    later, elsewhere = replace(other, when=((1.5, 1.8),)), replace(other, trial="squats")
    for apart in (later, elsewhere):
        assert len(recording_faults(with_faults(run.outcome, swap(), tracks=(apart,)))) == 2


def test_a_moved_marker_is_told_once_in_the_trial_where_it_sits_elsewhere(run):
    """It is used as it is, so that somebody has to look; a cause that says the same takes its place."""
    moved = track(TrackFault.MOVED, "LTHI")
    (_, line), after = looks(with_faults(run.outcome, tracks=(moved,)))
    assert line.endswith("sits elsewhere than in squats, by 60 mm (sd 3 mm); without it, distances on the segment "
                         "agree within 1 mm; used as it is.")  # fmt: skip
    assert line.startswith(f"{TRIAL}: LTHI ") and after.startswith("See whether LTHI was knocked or stuck on anew for")
    shift = replace(alone("marker_shift"), when=(Interval(TRIAL, 0.0, 2.0),), trials=(TRIAL,))
    (fault,) = recording_faults(with_faults(run.outcome, shift, tracks=(moved,)))
    assert fault.line.startswith(told(shift)) and fault.settled


def test_leaps_that_differ_in_numbers_alone_are_one_line(run):
    """With their trials, and left out."""
    leaps = tuple(
        track(TrackFault.JUMP, "LTHI", when=((t, t),), trial=name) for name, t in (("squats", 0.1), (TRIAL, 0.12))
    )
    (fault,) = recording_faults(with_faults(run.outcome, tracks=leaps))
    assert fault.line.startswith("squats and ") and fault.line.endswith(f"at 0.10 to 0.12 s; {LEFT_OUT}.")
    assert fault.settled and not fault.step


def test_next_mends_the_surest_fault_before_it_mends_a_figure(run):
    """What kept the run from its end, the surest fault that is not corrected, twins, then the worst figure."""
    late = replace(alone("time_offset", 0.9), where=("session",))
    weak, sure = alone("plate_offset", 0.7, applied=False), alone("plate_gain", 0.98, applied=False)
    twins = replace(alone("drag"), indistinguishable=(Twin("body_mass", ("session",), 0.3),))
    worst = Quality((figure("force", 0.06, 0.05),))

    def after(some: tuple[Fault, ...], quality: Quality = worst) -> str:
        return next_step(some, some, quality)

    faults = recording_faults(with_faults(run.outcome, weak, twins, sure))
    assert after(faults).startswith("To be sure of a wrong gain of plate 1, record a known weight")
    failed = Quality((*worst.criteria, figure("result.mass", float("nan"), float("nan"))))
    assert after(faults, failed) == "Mend result.mass"
    assert after(recording_faults(with_faults(run.outcome, twins))).startswith("To tell a drag on the thorax from")
    settled = recording_faults(with_faults(run.outcome, swap()))
    assert after(settled) == "Mend force" and after(()) == "Mend force"
    line = after(recording_faults(with_faults(run.outcome, late)))
    assert line.startswith("Add `forces_as: {lag_ms:") and line.endswith("`evaluate` and `live` are without it, too")
    kept = after(recording_faults(with_faults(run.outcome, alone("filter_lag"))))
    assert kept.startswith("Joint moments still have markers that were low-passed: to mend it, record a quick motion")
    other = after(recording_faults(with_faults(run.outcome, alone("plate_gain"))))
    assert other.startswith("`evaluate` and `live` still have a wrong gain of plate 1: to mend it, record a known")
    assert " to squats of the config" in after(
        recording_faults(with_faults(run.outcome, replace(late, where=("squats",))))
    )
    assert next_step(recording_faults(with_faults(run.outcome, twins)), (), worst) == "Mend force"


def test_at_most_four_lines_and_how_many_more(run):
    """What asks for something stands first; sections that have the rest are named."""
    bodily = [replace(alone("drag", 0.9 - 0.01 * k)) for k in range(5)]
    leap = track(TrackFault.JUMP, "LTHI", when=((0.1, 0.1),))
    sure, doubtful = alone("plate_gain", 0.6, applied=False), replace(cause("payload"), confidence=0.3)
    outcome = with_faults(run.outcome, *bodily, sure, doubtful, tracks=(leap,), rest=LOUD)
    lines, _ = looks(outcome)
    assert len(lines) == 4 and lines[0].startswith(told(sure)) and "LTHI" in lines[1]
    assert lines[2] == "And 5 more and 1 possible cause: see “What the model gets wrong”."
    assert lines[3].startswith("More remains")
    many = [replace(sure, where=(f"plate_{k}",), confidence=0.6 + 0.01 * k) for k in range(6)]
    lines, _ = looks(with_faults(run.outcome, *many, tracks=(leap,)))
    assert [line[:7] for line in lines[:LINES]] == ["Plate 5", "Plate 4", "Plate 3", "Plate 2"]
    assert (
        lines[LINES] == "And 3 more: see “What the model gets wrong” and “Data handling”." and len(lines) == LINES + 1
    )
    lines, _ = looks(with_faults(run.outcome, *bodily))
    assert len(lines) == 3 and lines[2].startswith("And 3 more")
    only, _ = looks(with_faults(run.outcome, doubtful))
    assert only[0].startswith("No fault confirmed") and only[1].startswith("And 1 possible cause: see")
    quiet, _ = looks(with_faults(run.outcome))
    assert len(quiet) == 1 and quiet[0].startswith("No fault found")
    assert unnamed(found(), True, others=True).startswith("No other fault found")
    assert unnamed(found(), False, others=False).startswith("None of the")


def test_the_list_is_a_list_on_the_page_and_on_the_terminal(run, capsys):
    """One line a fault."""
    outcome = with_faults(run.outcome, swap(), alone("plate_gain", applied=False))
    page = render_report(outcome)
    (listed,) = re.findall(r"<dd><ul>(.*?)</ul></dd>", page)
    assert listed.count("<li>") == 2 == listed.count("Practically certain")
    print_lights(glance(outcome, quality_of(outcome)))
    printed = [line.split(maxsplit=2) for line in capsys.readouterr().out.splitlines()]
    assert ["▲", "Recordings"] in [line[:2] for line in printed]
    assert sum("Practically certain" in " ".join(line) for line in printed) == 2


def test_what_the_config_changes_is_said_in_one_sentence(run):
    """By key, with the trials; lines for all trials stand beside those of single ones."""
    files = dict(run.outcome.session.files)
    assert read_as(run.outcome) == ""

    def reads(own: dict[str, ForcesAs | None], plates=None, everywhere=ForcesAs()) -> str:  # noqa: B008
        changed = {n: f.model_copy(update={"forces_as": own.get(n), "plates": plates}) for n, f in files.items()}
        config = run.outcome.config.model_copy(update={"forces_as": everywhere})
        return read_as(replace(run.outcome, config=config, session=replace(run.outcome.session, files=changed)))

    first, second = list(files)[:2]
    two = reads({first: ForcesAs(lag_ms=63.0), second: ForcesAs(lag_ms=50.0)})
    assert two == f"Read with forces_as lag_ms 63 in {first} and 50 in {second}."
    assert reads({}, {2: PlateAs(gain=0.93)}) == "Read with plate 2 gain 0.93 in all trials."
    assert reads({first: ForcesAs()}, everywhere=ForcesAs(gain=2.0)).startswith("Read with forces_as gain 2 in ")
    assert first not in reads({first: ForcesAs()}, everywhere=ForcesAs(gain=2.0))
    without = replace(run.outcome, diagnosis=None, session=replace(run.outcome.session, tracking=()))
    assert "Recordings" not in [one.about for one in glance(without, good(without))]
