"""Swapped markers get their names back, and nothing else is made of what they bent."""

from dataclasses import replace

import numpy as np
import pytest
import small_session
import torch
from test_tracking import pair

from torchid.config import load_config
from torchid.diagnosis.diagnose import diagnose
from torchid.diagnosis.evidence.adequacy import Adequacy
from torchid.diagnosis.options import DiagnosisOptions
from torchid.diagnosis.testing.heldout import Errors
from torchid.diagnosis.verdict.records import Cause, Diagnosis, Twin
from torchid.effects.place import Interval, Place
from torchid.extension import diagnosing, verdict
from torchid.extension.diagnosing import diagnose_outcome
from torchid.extension.swapped_markers import fitted_anew, merged, put_right, relabel
from torchid.session import Outcome
from torchid.session.session import look_at_session, session_clusters, taken_out
from torchid.storage.results import OutputFolder

BENDING = ("marker_swap", "marker_shift", "soft_tissue", "joint_centre_shift", "missing_dof", "plate_gain", "drag")
"""Effects that could be made of what a swap bends, and two on forces."""
QUIET, LOUD = Adequacy(False, 0.5, 0.1, ""), Adequacy(True, 1e-9, 0.6, "much")


def cause(effect: str, where: tuple[str, ...], when: tuple[Interval, ...] | None = None, sure: float = 1.0) -> Cause:
    """All that matters here."""
    trials = tuple(own.trial for own in when or ())
    return Cause(
        effect, where, when, {}, sure, (), (), {}, Place(where, when), torch.ones(1, 1).double(), trials, False
    )


@pytest.fixture(scope="module")
def swap() -> Cause:
    """Of two markers at random, near each other or not, within a fit trial."""
    rng, markers = np.random.default_rng([small_session.SEED, 31]), small_session.markers("fit")
    trial = str(rng.choice(sorted(markers)))
    own = markers[trial]
    middle = own.position.nanmean(0)
    while True:
        a, b = sorted(rng.choice(len(own.labels), 2, replace=False).tolist())
        if 0.06 < float((middle[a] - middle[b]).norm()) < 0.5:
            break
    start = rng.uniform(1.0, 1.8)
    inside = own.time[(own.time >= start) & (own.time <= start + rng.uniform(0.5, 1.2))]
    when = (Interval(trial, float(inside[0]), float(inside[-1])),)
    return cause("marker_swap", (own.labels[a], own.labels[b]), when)


def test_names_go_back_and_forth(swap):
    """Exchanged within the interval only, and the same again once it is done twice; other trials may lack them."""
    (when,) = swap.when
    trials = {item.trial.name: item.trial for item in small_session.session().trials}
    trial = trials[when.trial]
    once = relabel(trial, [swap])
    a, b = (trial.markers.labels.index(label) for label in swap.where)
    inside = (trial.markers.time >= when.t0) & (trial.markers.time <= when.t1)
    was, now = trial.markers.position, once.markers.position
    assert torch.equal(now[inside][:, a].nan_to_num(), was[inside][:, b].nan_to_num())
    assert torch.equal(now[~inside].nan_to_num(), was[~inside].nan_to_num())
    assert torch.equal(relabel(once, [swap]).markers.position.nan_to_num(), was.nan_to_num())
    other = next(one for name, one in trials.items() if name != when.trial)
    less = replace(other, markers=other.markers.select(tuple(set(other.markers.labels) - set(swap.where))))
    for one in (other, less):
        assert relabel(one, [swap]) is one


@pytest.fixture(scope="module")
def fits(swap, tmp_path_factory) -> dict[str, Outcome]:
    """Of the recordings as they are, with the swap in them, and with it put right by what is found of it."""
    asked = [f"geometry.max_frames={small_session.GEOMETRY.max_frames}", f"diagnosis.include=[{', '.join(BENDING)}]"]
    clean = replace(small_session.outcome(), config=load_config(small_session.config(), asked))
    with OutputFolder(tmp_path_factory.mktemp("bent")) as folder:
        found = {"clean": clean, "bent": fitted_anew(clean, [swap], folder, "bent", _silent)}
    with OutputFolder(tmp_path_factory.mktemp("right")) as folder:
        bent = replace(found["bent"], diagnosis=diagnose_outcome(found["bent"]))
        found["whole"], found["right"] = put_right(bent, diagnose_outcome, folder, "right", _silent)
    return found


def _silent(stage: str, fraction: float) -> None: ...


@pytest.mark.slow
@pytest.mark.battery
def test_a_swap_leaves_nothing_for_skin_and_joints(swap, fits):
    """Planted, it is the only thing named, when it was; nothing is left for the fit with the names put right."""
    (found,) = fits["whole"].diagnosis.causes
    assert (found.effect, set(found.where)) == ("marker_swap", set(swap.where))
    (told,) = found.when
    assert told.trial == swap.when[0].trial
    assert abs(told.t0 - swap.when[0].t0) < 0.06 and abs(told.t1 - swap.when[0].t1) < 0.06
    assert fits["right"].diagnosis.causes == ()


@pytest.mark.slow
def test_a_fit_with_the_names_put_right_is_that_of_clean_recordings(fits):
    """Which the fit with the swap is not."""
    bent, right = ((fits[k].fit.xi - fits["clean"].fit.xi).norm() for k in ("bent", "right"))
    assert float(right) < 0.5 * float(bent)


@pytest.mark.slow
def test_a_swap_that_is_taken_back_changes_nothing(fits, tmp_path):
    """The verdict stays the first."""
    with OutputFolder(tmp_path) as folder:
        assert put_right(fits["whole"], lambda _: fits["whole"].diagnosis, folder, "back", _silent) == (
            fits["whole"],
            fits["whole"],
        )


@pytest.fixture(scope="module")
def misnamed(tmp_path_factory) -> Outcome:
    """Up to the inertia, of recordings in which distances tell that two labels are exchanged throughout a fit trial."""
    clean = replace(small_session.outcome(), diagnosis=None, base=None)
    trials, clusters = dict(clean.session.trials), session_clusters(clean.session.assignment)
    rng = np.random.default_rng([small_session.SEED, 37])
    name, both = str(rng.choice(sorted(clean.session.role("fit")))), pair(rng, trials, clusters, 3)
    when = (Interval(name, float(trials[name].markers.time[0]), float(trials[name].markers.time[-1])),)
    planted = {
        **trials,
        name: relabel(trials[name], [cause("marker_swap", tuple(clusters.labels[k] for k in both), when)]),
    }
    (found,) = look_at_session(planted, clean.session.assignment)
    sound, before = taken_out(planted, (found,), lambda trial: trial)
    session = replace(clean.session, trials=sound, tracking=(found,), as_read=before)
    wanted = load_config(small_session.config(), [f"diagnosis.include=[{', '.join(BENDING)}]"])
    with OutputFolder(tmp_path_factory.mktemp("misnamed")) as folder:
        return fitted_anew(replace(clean, session=session, config=wanted), [], folder, "misnamed", _silent)


def counted(monkeypatch) -> list[int]:
    """Number of effects that each diagnosis from now on searches."""
    searched = []

    def one(observed, heldout, plates, effects, *others):
        searched.append(len(effects))
        return diagnose(observed, heldout, plates, effects, *others)

    monkeypatch.setattr(diagnosing, "diagnose", one)
    return searched


@pytest.mark.slow
def test_names_that_distances_tell_are_put_right_before_anything_is_searched(misnamed, tmp_path, monkeypatch):
    """All is searched once, and the exchange is named and corrected."""
    searched, (statement,) = counted(monkeypatch), misnamed.session.tracking
    with OutputFolder(tmp_path) as folder:
        found = verdict.with_verdict(misnamed, folder, "first", _silent).diagnosis
    assert searched == [0, len(BENDING)]
    assert ("marker_swap", statement.labels, "certain", True) in named(found)


def named(found: Diagnosis | None) -> list[tuple]:
    """What is said of each cause."""
    assert found is not None
    return [(one.effect, one.where, one.level, one.applied) for one in found.causes]


@pytest.mark.slow
@pytest.mark.battery
def test_one_search_finds_what_two_find(misnamed, tmp_path, monkeypatch):
    """As if nobody had put names right before the first."""
    with OutputFolder(tmp_path / "first") as folder:
        first = verdict.with_verdict(misnamed, folder, "first", _silent).diagnosis
    searched = counted(monkeypatch)
    monkeypatch.setattr(verdict, "_names_first", lambda *_: None)
    with OutputFolder(tmp_path / "after") as folder:
        after = verdict.with_verdict(misnamed, folder, "after", _silent).diagnosis
    assert searched == [len(BENDING)] * 2
    assert named(first) == named(after)


@pytest.mark.slow
@pytest.mark.battery
@pytest.mark.parametrize("more", [False, True])
def test_names_that_a_search_takes_back_are_searched_as_labelled(misnamed, tmp_path, monkeypatch, more):
    """Once; where the search behind them names other exchanges, these are put right too, and all is searched again."""
    searched, (statement,) = [], misnamed.session.tracking
    labels = misnamed.fit.attachment.labels
    others = tuple([label for label in labels if label not in statement.labels][:2])

    def once_back(observed, heldout, plates, effects, *rest):
        searched.append(len(effects))
        found = diagnose(observed, heldout, plates, effects, *rest)
        times = misnamed.session.trials[statement.trial].markers.time
        when = (Interval(statement.trial, float(times[0]), float(times[-1])),)
        again = cause("marker_swap", others if more else statement.labels, when)
        named = len(searched) in ((2, 3) if more else (2,))
        return replace(found, causes=(*found.causes, again)) if named else found

    monkeypatch.setattr(diagnosing, "diagnose", once_back)
    with OutputFolder(tmp_path) as folder:
        assert verdict.with_verdict(misnamed, folder, "back", _silent).diagnosis is not None
    some = len(BENDING)
    assert searched == ([0, some, some, some] if more else [0, some, some])


def test_doubt_is_that_of_what_is_contradicted_now(swap):
    """What a swap had contradicted is no reason for doubt once it is put right, what is left is."""
    empty = Diagnosis((), Errors(9.0, 3.0), Errors(8.0, 2.0), (), QUIET)
    before = replace(empty, unexplained=LOUD)
    twins = (Twin("marker_swap", ("RANK", "RHEE"), 0.2),)
    doubted = replace(swap, confidence=0.7, indistinguishable=twins, doubted=True)
    others = (cause("plate_gain", ("plate_1",)), cause("soft_tissue", ("thigh_l",)))
    found = merged(before, replace(empty, causes=others, baseline=Errors(1.0, 1.0)), [doubted], DiagnosisOptions())
    assert [c.effect for c in found.causes] == ["plate_gain", "marker_swap", "soft_tissue"]
    assert found.causes[1].confidence == pytest.approx(1.0) and not found.causes[1].doubted
    assert found.causes[1].indistinguishable[0].confidence == pytest.approx(0.2 / 0.7)
    assert found.baseline == before.baseline
    beyond = replace(empty, unexplained=replace(LOUD, beyond=True))
    assert merged(before, beyond, [doubted], DiagnosisOptions()).causes[0].confidence == pytest.approx(1.0)
    still = merged(before, before, [doubted], DiagnosisOptions())
    assert still.causes[0].confidence == pytest.approx(0.7) and still.causes[0].doubted
    assert [(step.kind, step.effect, step.rule) for step in still.trace] == [
        ("discount", "marker_swap", "residual_structure")
    ]
    assert not found.trace
