"""No cause is corrected that makes a prediction worse beyond chance, and one that is there is."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
import small_session
import torch
from inertia_cases import bodies, draw, names, prior
from torch.testing import assert_close

from torchid.diagnosis.evidence.adequacy import Adequacy
from torchid.diagnosis.options import DiagnosisOptions
from torchid.diagnosis.testing.heldout import Errors
from torchid.diagnosis.verdict.records import Cause, Diagnosis
from torchid.dynamics.row_equations import NormalEquations
from torchid.dynamics.rows import residual_rms
from torchid.effects.effect import Planted
from torchid.effects.place import Interval
from torchid.extension.block_errors import (
    BLOCK_S,
    FITTED,
    HELD_OUT,
    LEFT_OUT,
    BlockErrors,
    block_errors,
    block_frames,
    cut_blocks,
)
from torchid.extension.diagnosing import forceful
from torchid.extension.never_worse import Growth, compare, growth
from torchid.extension.publishing import RULE, _chosen, least_promised, publishable
from torchid.filters import Smoother
from torchid.inertia.left_out import leave_out_each
from torchid.inertia.options import InertiaOptions
from torchid.motion import Motion
from torchid.session import Outcome
from torchid.session.fitting import identify
from torchid.session.following import Following
from torchid.session.standing import follow_each
from torchid.session.tables import diagnosis_table
from torchid.simulate.options import PlantedOptions
from torchid.simulate.planting import misread, planted
from torchid.storage.results import OutputFolder

OPTIONS = DiagnosisOptions().never_worse
MARGIN = OPTIONS.margin_part
CLEAR = Adequacy(False, 0.5, 0.1, "")


def errors(rms: np.ndarray | list[float]) -> BlockErrors:
    """Of blocks of a hundred frames."""
    values = torch.as_tensor(np.asarray(rms, dtype=float))
    return BlockErrors(values, torch.full_like(values, 100.0))


def worse(ratio: np.ndarray, rng: np.random.Generator, spread: float = 0.0) -> bool:
    """Whether errors that grow by these factors are called worse; their levels spread so far."""
    level = np.exp(rng.normal(3.0, 1.0) + rng.normal(0.0, spread, len(ratio)))
    return growth(("x", "force"), errors(level), errors(level * ratio), OPTIONS).worse


@pytest.mark.parametrize("blocks", [1, 2, 3, 10, 40])
def test_growth_is_judged_beyond_chance(blocks, seed):
    """One block is worse by a tenth, many by a twentieth; within the margin none is, nor is what got better."""
    rng = np.random.default_rng(seed)
    assert worse(np.full(blocks, 1.10), rng)
    assert worse(np.full(blocks, 1.05), rng) == (blocks > 1)
    assert not worse(np.full(blocks, 1.0 + MARGIN), rng)
    assert not worse(np.full(blocks, 1.0), rng) and not worse(np.full(blocks, 0.5), rng)


def test_chance_makes_nothing_worse(seed):
    """Errors that scatter about the same level are seldom called worse, though their scatter is not known before."""
    rng = np.random.default_rng(seed)
    for blocks in (3, 8, 30):
        said = [worse(np.exp(rng.normal(0.0, 0.15, blocks)), rng, 1.0) for _ in range(400)]
        assert np.mean(said) < 0.2, blocks


def test_blocks_count_by_their_energy(seed):
    """Quiet ones, in which little is to be explained, decide little."""
    rng = np.random.default_rng(seed)
    level = np.concatenate([np.full(5, 20.0), np.full(5, 2.0)]) * np.exp(rng.normal(0.0, 1.0))
    quiet, loud = np.where(level < level.mean(), 1.5, 0.95), np.where(level < level.mean(), 0.95, 1.3)
    assert not growth(("x", "force"), errors(level), errors(level * quiet), OPTIONS).worse
    assert growth(("x", "force"), errors(level), errors(level * loud), OPTIONS).worse


def test_models_are_compared_group_by_group():
    """With the numbers of each."""
    before = {("a", "force"): errors([10.0]), ("b", "markers"): errors([0.02, 0.02])}
    after = {("a", "force"): errors([20.0]), ("b", "markers"): errors([0.02, 0.02])}
    first, second = compare(before, after, OPTIONS)
    assert (first.where, first.kind, first.blocks, first.worse) == ("a", "force", 1, True)
    assert first.part == pytest.approx(1.0) and second.part == pytest.approx(0.0) and not second.worse


def moving(period_s: float, rng: np.random.Generator, seconds: float = 9.0) -> Motion:
    """Two joints that repeat themselves, or only tremble where the period is zero."""
    time = torch.arange(round(100.0 * seconds), dtype=torch.float64) / 100.0
    v = torch.as_tensor(rng.normal(scale=0.2, size=(len(time), 8)))
    if period_s:
        phase = 2.0 * math.pi * time / period_s
        v[:, 6:] += torch.stack([phase.sin() + 0.5 * (2.0 * phase).cos(), 0.7 * (phase + rng.uniform()).cos()], 1)
    return Motion(time, torch.zeros_like(v), v, torch.zeros_like(v), Smoother(10.0, 100.0))


def test_a_block_is_a_cycle_or_a_second(seed):
    """Of quick motion several cycles; of what repeats nothing, and of what is short, a second."""
    rng = np.random.default_rng(seed)
    period = float(rng.uniform(1.1, 3.0))
    assert block_frames(moving(period, rng)) == pytest.approx(100.0 * period, rel=0.06)
    quick = float(rng.uniform(0.55, 0.9))
    assert block_frames(moving(quick, rng)) == pytest.approx(100.0 * 2.0 * quick, rel=0.06)
    assert block_frames(moving(0.0, rng)) == block_frames(moving(2.0, rng, 1.7)) == round(100.0 * BLOCK_S)


def test_left_out_is_fitted_without(seed):
    """As a fit of the other blocks' rows alone; one block leaves the prior's mean."""
    rng = np.random.default_rng(seed)
    given = prior(bodies(3), 0.3)
    truth, blocks = draw(given).reshape(-1), []
    for _ in range(3):
        Y = torch.as_tensor(rng.normal(size=(20, 30)))
        blocks.append((Y, Y @ truth + torch.as_tensor(rng.normal(size=20))))
    sums = [NormalEquations.from_rows(*one) for one in blocks]
    omega_2, mass = float(rng.uniform(1.0, 5.0)), (float(given.mean[:, 0].sum()), 0.2)
    found = leave_out_each(sums, given, names(3), InertiaOptions(), omega_2, mass)
    row = torch.zeros(30, dtype=torch.float64)
    row[::10] = 1.0 / mass[1]
    P = omega_2 * torch.linalg.inv(given.covariance) + torch.outer(row, row)
    for k in range(3):
        Y, F = (torch.cat([one[i] for j, one in enumerate(blocks) if j != k]) for i in (0, 1))
        start = given.mean.reshape(-1)
        wanted = start + torch.linalg.solve(P + Y.mT @ Y, Y.mT @ (F - Y @ start))
        assert_close(found[k], wanted, rtol=1e-7, atol=1e-9)
    (alone,) = leave_out_each(sums[:1], given, names(3), InertiaOptions(), omega_2, mass)
    assert_close(alone, given.mean.reshape(-1), rtol=1e-9, atol=1e-9)


def cause(k: int, confidence: float = 0.9, effect: str = "plate_gain", **gain: float) -> Cause:
    """One of which nothing but its gain is known."""
    place = planted(PlantedOptions("plate_gain", (f"plate_{k}",), None, {"gain": 1.0})).place
    return Cause(effect, place.where, None, {}, confidence, (), (), gain, place, torch.zeros(1, 1), (), True)


def grown(kind: str) -> tuple[Growth, ...]:
    """Errors of one kind grow most."""
    return tuple(Growth("x", one, 0.1, 0.2 if one == kind else 0.05, 3, True) for one in ("force", "moment", "markers"))


def test_what_promised_least_leaves_first():
    """By the lesser of both gains on held-out motion, then by its confidence; of those on markers where these err."""
    one, two = cause(1, force_rmse_pct=5.0, moment_rmse_pct=1.0), cause(2, force_rmse_pct=2.0, moment_rmse_pct=2.0)
    moved = cause(3, effect="marker_shift", force_rmse_pct=9.0, moment_rmse_pct=9.0)
    assert least_promised((one, two, moved), grown("force")) is one
    assert least_promised((one, two, moved), grown("markers")) is moved
    assert least_promised((one, two), grown("markers")) is one
    unsure, sure = cause(4, 0.6), cause(5, force_rmse_pct=math.nan)
    assert least_promised((sure, unsure), grown("moment")) is unsure


@pytest.mark.parametrize(
    ("harm", "kept"),
    [("", "abc"), ("a", "bc"), ("b", "ac"), ("c", "ab"), ("ab", "c"), ("abc", "")],
)
def test_what_does_no_harm_is_corrected(harm, kept):
    """Whatever leaves first: each that is left out is tried once more when all is well."""
    causes = {name: cause(k, force_rmse_pct=float(k)) for k, name in enumerate("abc")}
    tried: list[str] = []
    made: dict[int, tuple[Outcome, str]] = {}

    def attempt(some: Sequence[Cause]) -> tuple[Outcome | None, tuple[Growth, ...]]:
        tried.append("".join(name for name, one in causes.items() if any(one is other for other in some)))
        bad = set(harm) & set(tried[-1])
        fitted = object.__new__(Outcome)
        made[id(fitted)] = fitted, tried[-1]
        return fitted, grown("force") if bad else ()

    outcome, left, gone = _chosen(list(causes.values()), attempt, OPTIONS)
    names = {id(one): name for name, one in causes.items()}
    assert "".join(sorted(names[id(one)] for one in left)) == "".join(sorted(kept)) == made[id(outcome)][1]
    assert {names[id(one)] for one, _ in gone} == set("abc") - set(kept) and len(tried) <= 6


def clean() -> Outcome:
    """The small session's, with a verdict that names nothing."""
    nothing = Diagnosis((), Errors(1.0, 1.0), Errors(1.0, 1.0), (), CLEAR)
    return replace(small_session.outcome(), diagnosis=nothing)


def alone(outcome: Outcome) -> Outcome:
    """Without what is held out."""
    trials = {n: t for n, t in outcome.session.trials.items() if t.role != "heldout"}
    followed = {name: outcome.followed[name] for name in trials}
    return replace(outcome, session=replace(outcome.session, trials=trials), followed=followed)


def measured_with(outcome: Outcome, one: Planted) -> Outcome:
    """As if plates had read so: all from the contacts on is found anew."""
    trials = {n: misread(t, (one,)) if t.role != "static" else t for n, t in outcome.session.trials.items()}
    session = replace(outcome.session, trials=trials)
    each = follow_each(
        outcome.fit,
        session,
        lambda n: outcome.followed[n].tracked,
        Following.of(outcome.config, outcome.cutoff_hz),
        outcome.prior,
    )
    found = replace(outcome, session=session, followed={own.name: own for own in each})
    return replace(
        found, identified=identify(found.config.inertia, found.config.subject, found, lambda stage, share: None)
    )


def drawn(rng: np.random.Generator) -> Planted:
    """An error of plates or clock that nobody overlooks, at a random place and of a random size and sign."""
    where, sign = (f"plate_{rng.integers(1, 3)}",), float(rng.choice([-1.0, 1.0]))
    shift = [*(rng.uniform(0.02, 0.04) * np.array([math.cos(a := rng.uniform(0, 6.28)), math.sin(a)])), 0.0]
    return planted([
        PlantedOptions("plate_gain", where, None, {"gain": 1.0 + sign * rng.uniform(0.04, 0.08)}),
        PlantedOptions("time_offset", ("session",), None, {"lag_s": sign * rng.uniform(0.015, 0.03)}),
        PlantedOptions("plate_pose", where, None, {"shift_m": shift, "rotation_rad": [0.0, 0.0, 0.0]}),
    ][rng.integers(3)])  # fmt: skip


def named(outcome: Outcome, one: Planted, confidence: float = 0.9) -> Outcome:
    """With that as the verdict."""
    trials = tuple(outcome.session.trials)
    gain = {"heldout_log_likelihood": 9.0}
    sizes = one.effect.named(one.place, one.theta).items()
    sure = {key: {"value": value.reshape(-1), "sd": torch.zeros_like(value).reshape(-1)} for key, value in sizes}
    own = Cause(one.effect.name, one.place.where, None, sure, confidence, (), (), gain, one.place, one.theta[None],
                trials, True)  # fmt: skip
    assert outcome.diagnosis is not None
    return replace(outcome, diagnosis=replace(outcome.diagnosis, causes=(own,)))


def published(outcome: Outcome, tmp_path) -> Outcome:
    with OutputFolder(tmp_path) as folder:
        return publishable(outcome, outcome, folder, "key", lambda stage, share: None)


@pytest.mark.slow
@pytest.mark.parametrize("heldout", [True, False])
def test_a_cause_that_is_not_there_keeps_its_name_and_corrects_nothing(tmp_path, heldout):
    """By held-out motion, and by the blocks alone where there is none."""
    one = drawn(np.random.default_rng([small_session.SEED, 51, heldout]))
    print(one)  # noqa: T201
    base = named(clean() if heldout else alone(clean()), one)
    found = published(base, tmp_path)
    assert found.diagnosis is not None and found.base is None and not found.diagnosis.refuted
    assert found.fit is base.fit and found.identified is base.identified and found.residuals == base.residuals
    (kept,), (step,) = found.diagnosis.causes, found.diagnosis.trace
    assert (kept.effect, kept.where, kept.applied) == (one.effect.name, one.place.where, False)
    assert (step.kind, step.rule) == ("leave", RULE)
    grown = [step.numbers[f"{kind}_growth_part"] for kind in ("force", "moment", "markers")]
    assert max(grown) > step.numbers["least_growth_part"] > MARGIN and grown[2] == pytest.approx(0.0)
    table = diagnosis_table(found)
    assert [row["applied"] for row in table["causes"]] == [False] and table["published"] == "base"
    assert str(table["baseline"]["heldout"]) == str(table["extended"]["heldout"])


@pytest.mark.slow
@pytest.mark.parametrize("heldout", [True, False])
def test_a_cause_that_is_there_is_published(tmp_path, heldout):
    """With it, forces are predicted better, and every figure is the extended model's."""
    one = drawn(np.random.default_rng([small_session.SEED, 52, heldout]))
    print(one)  # noqa: T201
    base = named(measured_with(clean() if heldout else alone(clean()), one), one)
    found = published(base, tmp_path)
    assert found.diagnosis is not None and found.base is not None
    assert [own.effect for own in found.diagnosis.causes] == [one.effect.name] and not found.diagnosis.refuted
    before, after = (residual_rms(list(forceful(o, "fit").values()), o.phi) for o in (found.base, found))
    assert max(b / a for a, b in zip(before, after, strict=True)) < 1.02
    assert min(b / a for a, b in zip(before, after, strict=True)) < 0.8
    for name in forceful(base, "fit"):  # joint moments are of what plates bore
        true, read = clean().session.trials[name].forces, base.session.trials[name].forces
        right = found.right(name).forces
        assert true is not None and read is not None and right is not None
        off, left = ((some.wrench - true.wrench).nan_to_num().norm() for some in (read, right))
        assert float(left) < 0.1 * float(off) and off > 0


@pytest.mark.slow
def test_a_possible_cause_is_listed_and_corrects_nothing(tmp_path):
    """Even where it is there: what is no likelier than not changes no model."""
    one = drawn(np.random.default_rng([small_session.SEED, 53]))
    found = published(named(measured_with(clean(), one), one, 0.5), tmp_path)
    assert found.diagnosis is not None and found.base is None and not found.diagnosis.trace
    assert [(own.effect, own.applied) for own in found.diagnosis.causes] == [(one.effect.name, False)]
    table = diagnosis_table(found)
    assert table["published"] == "base" and [row["applied"] for row in table["causes"]] == [False]


@pytest.mark.slow
def test_frames_that_an_extension_leaves_out_win_nothing(tmp_path):
    """The blocks' errors are those of all frames that counted; only what a verdict sets aside is judged for none."""
    base = clean()
    blocks = cut_blocks(base)
    whole = block_errors(base, base, base.config, blocks)
    assert {where for where, _ in whole} == {LEFT_OUT, FITTED, HELD_OUT}
    used = {name: one.used for role in ("fit", "heldout") for name, one in forceful(base, role).items()}
    for name in ("squats", "sway_steps"):
        covered = torch.zeros_like(blocks.judged[name])
        for part in blocks.wrench[name]:
            assert not bool(covered[part].any())
            covered[part] = True
        assert int((used[name] & ~covered).sum()) < 0.1 * int(covered.sum())
    item, rows = base.followed["squats"], forceful(base, "fit")["squats"]
    fewer = replace(item, wrench=replace(rows, used=rows.used & (torch.arange(len(rows.used)) % 200 > 60)))
    less = block_errors(replace(base, followed={**base.followed, "squats": fewer}), base, base.config, blocks)
    assert torch.equal(less[FITTED, "force"].rms, whole[FITTED, "force"].rms)
    assert base.diagnosis is not None
    aside = replace(base.diagnosis, aside=(Interval("squats", 0.0, 99.0),))
    kept = cut_blocks(replace(base, diagnosis=aside))
    assert not bool(kept.judged["squats"].any()) and kept.wrench == blocks.wrench


@pytest.mark.slow
@pytest.mark.parametrize("factor", [0.5, 2.0])
def test_names_that_are_given_back_must_not_make_markers_worse(tmp_path, factor):
    """Swaps are judged before everything else; if they are not applied, the recordings stay as they were."""
    base = clean()
    when = (Interval("squats", 1.0, 2.0),)
    swap = replace(cause(1), effect="marker_swap", where=("LHEE", "LTOE"), when=when)
    assert base.diagnosis is not None
    base = replace(base, diagnosis=replace(base.diagnosis, causes=(swap,)))
    followed = {
        name: replace(own, tracked=replace(own.tracked, error=factor * own.tracked.error))
        for name, own in base.followed.items()
    }
    relabelled = replace(base, followed=followed, diagnosis=clean().diagnosis)
    with OutputFolder(tmp_path) as folder:
        found = publishable(base, relabelled, folder, "key", lambda stage, share: None)
    assert found.diagnosis is not None
    assert [(own.effect, own.applied) for own in found.diagnosis.causes] == [("marker_swap", factor < 1.0)]
    assert [step.rule for step in found.diagnosis.trace] == ([] if factor < 1.0 else [RULE])
    assert (found.base is None) == (factor > 1.0)
    if found.base is not None:
        assert found.base.diagnosis is found.diagnosis and found.tracked("squats").rmse < base.tracked("squats").rmse
