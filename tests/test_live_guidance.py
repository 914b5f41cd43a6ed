"""Advice is for what is not yet known, within what the subject can do, and the account of it adds up."""

import functools
import json
from dataclasses import replace

import pytest
import small_session
import torch
from test_live import MOVING
from torch.testing import assert_close
from typer.testing import CliRunner

from torchid.cli import app
from torchid.dynamics.whitening import BlockSpectrum, Whitening, initial_whitening
from torchid.errors import ConfigError
from torchid.filters import Smoother
from torchid.geometry.result import GeometryFit
from torchid.inertia.identify import identify_spectra
from torchid.inertia.options import InertiaOptions
from torchid.live.estimation.estimator import Estimator
from torchid.live.exercises import guidance
from torchid.live.exercises.advice import NOTHING, Adviser, make_ledger, promises
from torchid.live.exercises.exercises import LIBRARY, RATE_HZ, Exercise, Possibilities, allowed, perform, stand_in
from torchid.live.exercises.guidance import GOAL, Guide, Knowledge, Rehearsal, make_guide, rehearse, rows_of
from torchid.model.whole_body import lock_bodies
from torchid.simulate.balance import needed_wrench
from torchid.simulate.subject import simulate_subject
from torchid.storage.snapshot import from_bytes, to_bytes

SHORT = 3.0
"""Duration of exercises in these tests [s]."""
RATE = 100.0


def brief(exercise: Exercise) -> Exercise:
    return replace(exercise, seconds=SHORT)


@functools.cache
def rehearsed(possibilities: Possibilities = Possibilities()) -> Guide:
    """A simulated subject's own rehearsals, some of the exercises, briefly."""
    who = simulate_subject(None, small_session.SEED)
    chosen = ("forearms", "head", "leg_circles", "steps", "knee_swings")
    with pytest.MonkeyPatch.context() as patch:
        library = [brief(one) for one in allowed(possibilities) if one.name in chosen]
        patch.setattr(guidance, "allowed", lambda _: tuple(library))
        smoother = Smoother(6.0, RATE_HZ)
        return rehearse(who, who.model.inertia, (who.mass, 0.3), smoother, possibilities)


def begin(guide: Guide) -> Knowledge:
    return Knowledge.begin(guide.prior, guide.mass)


def noise(guide: Guide) -> Whitening:
    """Of a stream: 5 N and 3 N m."""
    first = initial_whitening(guide.prior.mean)
    return Whitening(first.covariance * torch.tensor([0.25] * 3 + [1.0] * 3, dtype=torch.float64).diag())


def test_promises_are_no_less_than_nothing_and_fall_once_an_exercise_was_done(seed):
    guide = rehearsed()
    information = guide.information(noise(guide), RATE)
    outlook, known = guide.outlook(information), begin(guide)
    rng = torch.Generator().manual_seed(seed)
    for _ in range(6):
        before = promises(guide, outlook, known)
        assert all(one.nats > 0.0 and one.worth >= 0.0 and bool((one.rise > -1e-9).all()) for one in before)
        k = int(torch.randint(len(before), (1,), generator=rng))
        known = known.after(guide.rehearsals[k].exercise.seconds * information[k])
        after = promises(guide, outlook, known)
        assert after[k].nats < before[k].nats and all(a.nats <= b.nats for a, b in zip(after, before, strict=True))


def test_what_is_a_multiple_of_the_known_promises_less_than_what_is_new(seed):
    """Two exercises that tell of different axes as much: once the first was done it promises less."""
    guide = rehearsed()
    params = len(guide.prior.covariance)
    order = torch.randperm(params, generator=torch.Generator().manual_seed(seed))[:20]
    inverse = torch.linalg.inv(begin(guide).unit)
    rows = 3.0 * torch.eye(params, dtype=torch.float64)[order] @ inverse
    old, new = rows[:10].mT @ rows[:10], rows[10:].mT @ rows[10:]
    two = replace(guide, rehearsals=guide.rehearsals[:2])
    outlook = two.outlook(torch.stack([old, new]))
    first, second = promises(two, outlook, begin(guide).after(100.0 * old))
    assert first.nats < second.nats and first.worth < second.worth
    assert float(first.rise.sum()) < float(second.rise.sum())


def test_nobody_is_told_to_do_what_is_not_possible():
    for possibilities in (Possibilities(arms=False), Possibilities(seated=True), Possibilities(True, False)):
        names = {one.name for one in allowed(possibilities)}
        needs = {need for one in LIBRARY if one.name in names for need in one.needs}
        assert (
            names and (possibilities.arms or "arms" not in needs) and not (possibilities.seated and "standing" in needs)
        )
        assert ("knee_swings" in names) == possibilities.seated


def test_arms_that_may_not_be_moved_hang_still(seed):
    who, possibilities = simulate_subject(None, seed), Possibilities(arms=False)
    rows = [k for k, name in enumerate(who.model.tree.dof_names) if name.startswith(("shoulder", "elbow", "wrist"))]
    for exercise in allowed(possibilities):
        motion = perform(brief(exercise), who, possibilities, seed % 1000)
        if motion is not None:
            assert float((motion.q[:, rows] - motion.q[0, rows]).abs().max()) < 1e-9, exercise.name


def test_an_exercise_moves_what_it_is_for_and_is_drawn_in_three_postures(seed):
    guide = rehearsed()
    for one in guide.rehearsals:
        assert one.postures.shape == (3, one.postures.shape[1])
        assert float((one.postures[0] - one.postures[1]).abs().max()) > 0.1
        assert len(one.blocks) == guidance.SEEDS * SHORT
    outlook = guide.outlook(guide.information(noise(guide), RATE))
    found = {one.name: one for one in promises(guide, outlook, begin(guide))}
    hand = guide.names.index("hand_l")
    assert found["forearms"].rise[hand] == max(one.rise[hand] for one in found.values())


def recorded(guide: Guide, seed: int) -> list[BlockSpectrum]:
    """Rows of a subject who does all exercises of the guide."""
    who, found = simulate_subject(None, small_session.SEED), []
    for one in guide.rehearsals:
        motion = perform(one.exercise, who, Possibilities(), seed % 1000, RATE)
        if motion is not None:
            wrench = needed_wrench(who, motion)
            wrench = wrench + 2.0 * torch.randn_like(wrench)
            found += list(rows_of(who.model.tree, who.geometry, motion, Smoother(6.0, RATE), wrench))
    return found


def test_the_account_adds_up_to_all_that_is_known(seed):
    """Nats of all intervals are those of all rows; of a smaller progress each has the part that it has of theirs."""
    guide = rehearsed()
    blocks, options = recorded(guide, seed), InertiaOptions(refuse=False)
    estimator, adviser = Estimator(guide.names, guide.prior, options, guide.mass), Adviser(guide, RATE)
    first = adviser.after(estimator, 0.0)
    assert first.gain_nats > 0.0 and first.segments and first.text
    advised = [first.name]
    for k, block in enumerate(blocks):
        estimator.add([(k + 0.5, block)])
        advised.append(adviser.after(estimator, float(k + 1)).name)
    assert len(set(advised)) > 1, "what is told already is not asked for again and again"
    identified = identify_spectra([blocks], guide.names, guide.prior, options, guide.mass)
    account = adviser.account(estimator, identified)
    total = Knowledge.begin(guide.prior, guide.mass, identified.fit.omega_2)
    _, known = make_ledger(["all"] * len(blocks), blocks, identified.whitening, total)
    assert sum(one.nats for one in account.entries) == pytest.approx(known.nats, rel=1e-9)
    assert sum(one.blocks for one in account.entries) == len(blocks)
    assert all(one.nats > 0.0 and one.exercise != NOTHING for one in account.entries)
    progress = torch.stack([one.progress for one in account.entries])
    assert_close(progress.sum(0), identified.fit.progress.segment, rtol=1e-6, atol=1e-8)
    less = replace(identified.fit.progress, segment=0.3 * identified.fit.progress.segment)
    smaller = adviser.account(estimator, replace(identified, fit=replace(identified.fit, progress=less)))
    assert_close(torch.stack([one.progress for one in smaller.entries]), 0.3 * progress, rtol=1e-6, atol=1e-8)
    assert set(account.table) == {"determined", "exercises", "notes"} and json.dumps(account.table)


def test_an_advice_stands_for_its_time_unless_it_has_become_useless(seed):
    guide = rehearsed()
    estimator, adviser = (
        Estimator(guide.names, guide.prior, InertiaOptions(refuse=False), guide.mass),
        Adviser(guide, RATE),
    )
    first = adviser.after(estimator, 0.0)
    assert adviser.after(estimator, 1.0) is first
    estimator.add([(1.5, recorded(guide, seed)[0])])
    (k,) = (k for k, one in enumerate(guide.rehearsals) if one.exercise.name == first.name)
    assert estimator.sums is not None
    estimator.sums = replace(estimator.sums, gram=estimator.sums.gram + 1e6 * guide.information(noise(guide), RATE)[k])
    assert adviser.after(estimator, 2.0).name != first.name


def test_what_is_known_calls_for_nothing_and_then_information_counts():
    guide = rehearsed()
    information = guide.information(noise(guide), RATE)
    outlook = guide.outlook(information)
    known = begin(guide).after(1e5 * information.sum(0))
    assert bool((outlook.share(known) > GOAL).all())
    assert all(one.worth > 0.0 for one in promises(guide, outlook, known))


def test_a_guide_travels_to_another_process():
    guide = rehearsed()
    again = from_bytes(to_bytes(guide))
    assert isinstance(again.rehearsals[0], Rehearsal) and again.rehearsals[0].exercise == guide.rehearsals[0].exercise
    assert_close(again.information(noise(guide), RATE), guide.information(noise(guide), RATE))


def unfitted() -> GeometryFit:
    """The template on the small session's markers, before any fit."""
    given = small_session.assignment()
    model, count = given.model, len(given.attachment.labels)
    xi = torch.cat([model.geometry.mean, torch.zeros(3 * count, dtype=torch.float64)])
    sigma = torch.full((count,), 1e-3, dtype=torch.float64)
    return GeometryFit(model, given.attachment, model.geometry, xi, sigma, small_session.GEOMETRY)


def test_bodies_for_which_there_is_no_exercise_are_said(monkeypatch):
    fit = unfitted()
    tree, prior = fit.model.tree, fit.model.inertia
    legless = replace(tree, dofs=tuple(replace(dof, name=dof.name.replace("knee", "other")) for dof in tree.dofs))
    with pytest.raises(ConfigError, match=r"guidance\.model"):
        stand_in(replace(fit, model=replace(fit.model, tree=legless)), prior.mean, "male")
    monkeypatch.setattr(guidance, "perform", lambda *_: None)
    with pytest.raises(ConfigError, match=r"guidance\.none"):
        make_guide(fit, prior, None, "male", 6.0, Possibilities())


LACKING = {"head": ("head",), "hands": ("hand_l", "hand_r"), "both": ("head", "hand_l", "hand_r")}


@pytest.mark.parametrize("without", LACKING)
def test_exercises_are_rehearsed_with_the_joints_that_a_body_has(without, caplog):
    """Marker sets without a head or hands lock their joints; every exercise of the library is gone through."""
    fit = unfitted()
    model, _ = lock_bodies(fit.model, LACKING[without])
    xi = torch.cat([model.geometry.mean, fit.xi[len(fit.model.geometry.mean) :]])
    locked = replace(fit, model=model, prior=model.geometry, xi=xi)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(guidance, "allowed", lambda chosen: tuple(map(brief, allowed(chosen))))
        patch.setattr(guidance, "SEEDS", 1)
        guide = make_guide(locked, fit.model.inertia, None, "male", 6.0, Possibilities())
    names = {one.exercise.name for one in guide.rehearsals}
    head, hands = "head" in LACKING[without], "hand_l" in LACKING[without]
    assert {"squats", "forearms"} <= names and ("head" in names) != head
    assert any(note.startswith("head is not asked for") for note in guide.notes) == head
    assert any("forearms is rehearsed without a part" in note and "wrist" in note for note in guide.notes) == hands
    assert all(note in caplog.text for note in guide.notes)


def test_every_joint_that_an_exercise_is_for_is_one_of_the_template_and_of_its_ranges():
    tree = unfitted().model.tree
    for exercise in LIBRARY:
        assert not exercise.lacking(tree), exercise.name
        assert not exercise.ranges or all(any(x.startswith(j) for x in exercise.ranges) for j in exercise.joints)


@pytest.mark.slow
@pytest.mark.usefixtures("quick_children")
def test_the_command_advises_and_says_what_each_exercise_told(tmp_path, monkeypatch):
    monkeypatch.setattr(guidance, "allowed", lambda chosen: tuple(map(brief, allowed(chosen))))
    out = tmp_path / "out"
    words = ["live", str(small_session.config()), f"out={out}", "--source", f"replay:{MOVING}", "--speed", "inf"]
    done = CliRunner().invoke(app, [*words, "--no-arms"])
    assert done.exit_code == 0, done.output
    said = json.loads(done.stdout.strip().splitlines()[-1])
    guidance_ = said["guidance"]
    assert set(guidance_["determined"]) == set(said["progress"])
    assert guidance_["exercises"][0]["exercise"] in {one.name for one in allowed(Possibilities(arms=False))}
    for name, progress in said["progress"].items():
        assert sum(one["progress"][name] for one in guidance_["exercises"]) == pytest.approx(progress, abs=2e-3)
