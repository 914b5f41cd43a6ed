"""No cause is published that makes a prediction worse beyond chance, and one that is there stays."""

import math
from dataclasses import replace
from typing import Any

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
    LEFT_OUT,
    BlockErrors,
    block_errors,
    block_frames,
    cut_blocks,
)
from torchid.extension.diagnosing import forceful
from torchid.extension.never_worse import Growth, compare, growth
from torchid.extension.publishing import RULE, Attempts, publishable, select
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


def worse(ratio: np.ndarray, rng: np.random.Generator) -> bool:
    """Whether errors that grow by these factors, from any level, are called worse."""
    level = np.exp(rng.normal(3.0, 1.0, len(ratio)))
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
        said = [worse(np.exp(rng.normal(0.0, 0.15, blocks)), rng) for _ in range(400)]
        assert np.mean(said) < 0.2, blocks


def test_one_block_that_errs_threefold_is_no_chance(seed):
    """The error of the whole trial counts, not only the usual block."""
    rng = np.random.default_rng(seed)
    level = np.full(10, np.exp(rng.normal(3.0, 1.0)))
    ratio = np.full(10, 0.93)
    ratio[rng.integers(10)] = 3.0
    assert growth(("x", "force"), errors(level), errors(level * ratio), OPTIONS).worse


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


class Table(Attempts):
    """Attempts whose errors are a sum over causes and pairs of them, in place of fits."""

    def __init__(
        self,
        harm: dict[frozenset[int], float],
        movers: frozenset[int] = frozenset(),
        most: int = 99,
        possible: frozenset[int] = frozenset(),
    ) -> None:
        count = max(max(some) for some in harm) + 1
        self.causes = tuple(cause(k, 0.5 if k in possible else 0.9) for k in range(count))
        self._harm, self._movers, self._most, self.fitted = harm, movers, most, {frozenset()}
        self.options = OPTIONS

    def movers(self, chosen: frozenset[int]) -> frozenset[int]:
        return chosen & self._movers

    def affordable(self, chosen: frozenset[int]) -> bool:
        return self.movers(chosen) in self.fitted or len(self.fitted) <= self._most

    def growth(self, chosen: frozenset[int], other: frozenset[int] | None = None) -> tuple[Growth, ...]:
        self.fitted.add(self.movers(chosen))
        log = self._log(chosen) - self._log(other or frozenset())
        return (Growth("x", "force", log, log, 3, log > MARGIN),)

    def _log(self, chosen: frozenset[int]) -> float:
        return sum((own for some, own in self._harm.items() if some <= chosen), start=0.0)


def cause(k: int, confidence: float = 0.9) -> Cause:
    """One that nothing else is asked of."""
    place = planted(PlantedOptions("plate_gain", (f"plate_{k}",), None, {"gain": 1.0})).place
    return Cause("plate_gain", place.where, None, {}, confidence, (), (), {}, place, torch.zeros(1, 1), (), True)


def left(table: Table) -> tuple[set[int], list[str]]:
    found = select(table)
    assert not found.unproven
    return set(found.kept), [one.where[0] for one, _ in found.refused]


def test_what_is_only_possible_has_to_show_a_gain():
    """A likely cause stays unless it harms, a possible one leaves unless the model is worse without it."""
    one, two, three = (frozenset({k}) for k in range(3))

    def fate(harm: dict[frozenset[int], float], possible: frozenset[int], **kwargs: Any) -> tuple[set[int], ...]:
        table = Table(harm, possible=possible, **kwargs)
        found = select(table)
        named = [{table.causes.index(cause) for cause, _ in some} for some in (found.refused, found.unproven)]
        return set(found.kept), *named

    assert fate({one: -0.5, two: 0.0}, one | two) == ({0}, set(), {1})
    assert fate({one: 0.0, two: 0.0}, one) == ({1}, set(), {0})
    assert fate({one: 0.1, two: 0.0}, one | two) == (set(), {0}, {1}), "what harms is refuted, not withheld"
    # Those on markers together: one that gains keeps both.
    both = one | two | three
    assert fate({one: -0.5, two: 0.0, three: 0.0}, both, movers=one | two) == ({0, 1}, set(), {2})
    # One that gains only beside another stays with it.
    assert fate({one: -0.5, two: 0.0, one | two: -0.5}, two) == ({0, 1}, set(), set())


def test_causes_leave_until_nothing_is_worse():
    """The one that does most harm first; one that only another made harmful stays once that has left."""
    one, two, three = (frozenset({k}) for k in range(3))
    assert left(Table({one: -0.5, two: -0.1, three: -0.1})) == ({0, 1, 2}, [])
    assert left(Table({one: -0.5, two: 0.1, three: -0.1})) == ({0, 2}, ["plate_1"])
    assert left(Table({one: 0.5, two: 0.3, three: 0.1})) == (set(), ["plate_0", "plate_1", "plate_2"])
    assert left(Table({one: 0.6, two: -0.2, one | two: 0.3})) == ({1}, ["plate_0"])
    assert left(Table({one: -0.6, two: 0.1, one | two: -0.3})) == ({0, 1}, [])


def test_geometries_are_fitted_as_often_as_stated():
    """Where no more of them may be fitted, causes on markers leave together."""
    harm = {frozenset({0}): -0.5, frozenset({1}): 0.1, frozenset({2}): 0.2, frozenset({3}): 0.3}
    table = Table(harm, frozenset({1, 2, 3}), most=1)
    assert left(table)[0] == {0} and len(table.fitted) <= 3
    # Once the whole is no worse, those on markers stay: each would ask for another geometry.
    assert left(Table(harm, frozenset({1, 2, 3})))[0] == {0, 1, 2}
    assert left(Table(harm))[0] == {0}


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
def test_a_cause_that_is_not_there_is_refuted_and_the_base_model_published(tmp_path, heldout):
    """By held-out motion, and by the blocks alone where there is none."""
    one = drawn(np.random.default_rng([small_session.SEED, 51, heldout]))
    print(one)  # noqa: T201
    base = named(clean() if heldout else alone(clean()), one)
    found = published(base, tmp_path)
    assert found.diagnosis is not None and found.diagnosis.causes == () and found.base is None
    assert found.fit is base.fit and found.identified is base.identified and found.residuals == base.residuals
    (refuted,), (step,) = found.diagnosis.refuted, found.diagnosis.trace
    assert (refuted.effect, refuted.where, refuted.rule) == (one.effect.name, one.place.where, RULE)
    assert step.rule == RULE and step.numbers == refuted.numbers and refuted.heldout_log_likelihood == 9.0
    grown = [refuted.numbers[f"{kind}_growth_part"] for kind in ("force", "moment", "markers")]
    assert max(grown) > MARGIN and grown[2] == pytest.approx(0.0) and refuted.numbers["base_growth_part"] > MARGIN
    table = diagnosis_table(found)
    assert table["causes"] == [] and str(table["baseline"]["heldout"]) == str(table["extended"]["heldout"])


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


@pytest.mark.slow
def test_a_possible_cause_is_listed_and_corrects_nothing_where_it_gains_nothing(tmp_path):
    """One that is there is corrected at any confidence; one too small to be seen in any prediction is not."""
    rng = np.random.default_rng([small_session.SEED, 53])
    read = {"force_plate_N": [0.0, 0.0, rng.uniform(0.1, 0.3)], "moment_plate_Nm": [0.0, 0.0, 0.0]}
    small = planted(PlantedOptions("plate_offset", ("plate_1",), None, read))
    (kept,) = verdict_on(published(named(clean(), small, 0.5), tmp_path / "small"), base=True)
    assert kept.effect == "plate_offset" and not kept.applied
    large = drawn(rng)
    (kept,) = verdict_on(published(named(measured_with(clean(), large), large, 0.5), tmp_path / "large"), base=False)
    assert kept.applied


def verdict_on(found: Outcome, base: bool) -> tuple[Cause, ...]:
    """The causes, where the base model or the extended one is published."""
    assert found.diagnosis is not None and not found.diagnosis.refuted and (found.base is None) is base
    steps = [step.rule for step in found.diagnosis.trace]
    table = diagnosis_table(found)
    assert (steps == ["no_gain"]) is base and table["published"] == ("base" if base else "extended")
    assert [one["applied"] for one in table["causes"]] == [not base]
    return found.diagnosis.causes


@pytest.mark.slow
def test_frames_that_an_extension_leaves_out_win_nothing(tmp_path):
    """The blocks' errors are those of all frames that counted; only what a verdict sets aside is judged for none."""
    base = clean()
    blocks = cut_blocks(base)
    whole = block_errors(base, base, base.config, blocks)
    assert {where for where, _ in whole} == {LEFT_OUT, FITTED, "sway_steps"}
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
    """Swaps are judged before everything else; if they are refuted, the recordings stay as they were."""
    base = clean()
    when = (Interval("squats", 1.0, 2.0),)
    swap = replace(
        cause(1), effect="marker_swap", where=("LHEE", "LTOE"), when=when, gain={"heldout_log_likelihood": 1.0}
    )
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
    assert [own.effect for own in found.diagnosis.causes] == (["marker_swap"] if factor < 1.0 else [])
    assert [own.effect for own in found.diagnosis.refuted] == ([] if factor < 1.0 else ["marker_swap"])
    assert (found.base is None) == (factor > 1.0)
    if found.base is not None:
        assert found.base.diagnosis is found.diagnosis and found.tracked("squats").rmse < base.tracked("squats").rmse
