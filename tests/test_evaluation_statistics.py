"""Permutation tests that are as wrong as they say, and find what is hidden."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy import stats

from torchid.config.conditions import EvaluateOptions
from torchid.evaluation.loads import beyond_need
from torchid.evaluation.statistics.arrangements import (
    COURSE_COUNTS,
    correlations,
    counted_as_many,
    deal,
    flip,
    sign_means,
    step_down,
)
from torchid.evaluation.statistics.comparing import MeasureColumn, Sample, compare, spans
from torchid.evaluation.statistics.effects import Estimate, difference_of, hedges
from torchid.evaluation.statistics.units import choose_units, least_units, memory, trial_units, unit_means

OPTIONS = EvaluateOptions(permutations=999)


def sample(
    rng: np.random.Generator, trials: int, cycles: int, columns: int, effect: dict[int, float] | None = None
) -> Sample:  # fmt: skip
    """Two conditions whose trials scatter, with cycles that scatter about them; effects in standard deviations."""
    between = (
        rng.normal(size=(2 * trials, 1, columns)) @ np.linalg.cholesky(0.6 * np.ones(columns) + 0.4 * np.eye(columns)).T
    )
    values = (between + 0.7 * rng.normal(size=(2 * trials, cycles, columns))).reshape(-1, columns)
    for column, size in (effect or {}).items():
        values[trials * cycles :, column] += size
    names = tuple(f"t{k // cycles}" for k in range(len(values)))
    conditions = tuple("on" if k >= trials * cycles else "off" for k in range(len(values)))
    return Sample(
        names, conditions, tuple(MeasureColumn(f"c{k}", "m") for k in range(columns)), torch.as_tensor(values)
    )


def test_all_arrangements_or_as_many_as_asked(seed):
    """The observed one first, none twice where they are all there are, sizes kept."""
    second = torch.tensor([True, False, True, False, False])
    every = deal(second, 999, seed)
    assert every.complete and len(every.ways) == math.comb(5, 2) == len({tuple(w) for w in every.ways.tolist()})
    assert torch.equal(every.ways[0], second) and every.least_p == 0.1
    some = deal(torch.arange(30) % 2 == 0, 200, seed)
    assert not some.complete and len(some.ways) == 200 and bool((some.ways.sum(1) == 15).all())
    assert deal(torch.arange(6) % 2 == 0, 999, 0).least_p == 2 / 20
    assert len(flip(4, 999, 0).ways) == 16 and bool((flip(12, 100, seed).ways[0] == 1.0).all())


def test_the_statistic_is_a_monotone_function_of_students_t(seed):
    """Column by column, also where a unit has no value."""
    rng = np.random.default_rng(seed)
    values = rng.normal(size=(9, 5))
    values[2, 3] = np.nan
    second = np.arange(9) >= 4
    r = correlations(torch.as_tensor(values), torch.as_tensor(second)[None])[0].numpy()
    for k in range(5):
        own = np.isfinite(values[:, k])
        t = stats.ttest_ind(values[own & second, k], values[own & ~second, k]).statistic
        n = own.sum()
        assert math.sqrt(n - 2) * r[k] / math.sqrt(1.0 - r[k] ** 2) == pytest.approx(t)


def test_p_values_are_uniform_without_an_effect(seed):
    """Chance of a p at most alpha is alpha, to within what 200 evaluations tell (exact for complete arrangements)."""
    rng = np.random.default_rng(seed)
    p = np.array([float(compare(sample(rng, 5, 3, 1), "off", "on", OPTIONS, k).tested.p[0]) for k in range(200)])
    for alpha in (0.1, 0.3, 0.5, 0.8):
        reach = 4.5 * math.sqrt(alpha * (1.0 - alpha) / len(p))
        assert abs((p <= alpha + 1e-9).mean() - alpha) < reach + 2 / math.comb(10, 5), alpha


def test_the_family_is_wrong_as_rarely_as_any_member(seed):
    """Twelve correlated measures: some finding in at most 5 % of 200 evaluations, within chance."""
    rng = np.random.default_rng(seed)
    wrong = sum(bool(compare(sample(rng, 5, 3, 12), "off", "on", OPTIONS, k).found(0.05)) for k in range(200))
    assert wrong <= stats.binom.ppf(1 - 1e-5, 200, 0.05)


def test_a_hidden_assistance_is_found_where_it_is(seed):
    """Place and size drawn; its interval holds the truth and its sign is right."""
    rng = np.random.default_rng(seed)
    place, size = int(rng.integers(10)), float(rng.choice([-1.0, 1.0]) * rng.uniform(5.0, 9.0))
    found = compare(sample(rng, 7, 4, 10, {place: size}), "off", "on", OPTIONS, seed)
    assert place in found.found(0.05)
    assert math.copysign(1.0, size) == float(found.tested.statistic[place].sign())
    assert abs(float(found.difference.value[place]) - size) < 6.0 * float(found.difference.sd[place])


def test_adjusting_is_single_step_for_the_largest_and_never_falls(seed):
    """Step-down: the largest statistic against the largest of all, later ones never below earlier ones."""
    rng = np.random.default_rng(seed)
    values = torch.as_tensor(rng.normal(size=(8, 6)))
    statistic = correlations(values, deal(torch.arange(8) < 4, 999, 0).ways)
    tested = step_down(statistic)
    size = statistic.abs()
    first = int(size[0].argmax())
    assert float(tested.adjusted[first]) == pytest.approx(
        float((size.amax(1) >= size[0, first] - 1e-9).double().mean())
    )
    ordered = tested.adjusted[size[0].argsort(descending=True)]
    assert bool((ordered.diff() >= 0.0).all()) and bool((tested.adjusted >= tested.p - 1e-12).all())
    alone = step_down(correlations(values[:, :1].expand(-1, 3), deal(torch.arange(8) < 4, 999, 0).ways))
    torch.testing.assert_close(alone.adjusted, alone.p)


def test_units_are_trials_unless_blocks_are_asked_for():
    """Too few trials are said to be so; blocks say what they take for granted."""
    rng = np.random.default_rng(0)
    assert compare(sample(rng, 4, 3, 2), "off", "on", OPTIONS, 0).units.kind == "trials"
    few = compare(sample(rng, 1, 12, 2), "off", "on", replace(OPTIONS, units="blocks"), 0)
    assert few.units.kind == "blocks" and "takes for granted" in few.units.granted
    none = compare(sample(rng, 3, 8, 2), "off", "on", OPTIONS, 0)
    assert not none.testable and "4 trials of each condition are the least" in none.needed.said and not none.found(0.99)
    assert bool(torch.isnan(none.effect.value).all())
    assert bool(torch.isnan(none.tested.adjusted).all()) and bool(torch.isfinite(none.difference.value).all())
    assert least_units(0.05) == 4 and least_units(0.001) == 7


def test_blocks_are_as_long_as_cycles_remember(seed):
    """Cycles that are alike for long make longer blocks than independent ones."""
    rng = np.random.default_rng(seed)
    white = rng.normal(size=(200, 4))
    slow = np.cumsum(white, axis=0) - 0.0
    for k in range(1, len(slow)):
        slow[k] = 0.9 * slow[k - 1] + white[k]
    trials = ["a"] * 100 + ["b"] * 100
    assert memory(torch.as_tensor(white), trials) <= 2 < memory(torch.as_tensor(slow), trials)
    labels = [False] * 100 + [True] * 100
    units = choose_units(torch.as_tensor(slow), trials, labels, "blocks")
    assert units.cycles_per_block > 2 and len(units.second) < 100


def test_means_of_units_leave_out_what_a_cycle_does_not_tell():
    """Draws in front pass through."""
    values = torch.tensor([[1.0, torch.nan], [3.0, 5.0], [7.0, torch.nan]], dtype=torch.float64)
    means = unit_means(values.expand(2, -1, -1), trial_units(["a", "a", "b"]))
    assert means[1, :, 0].tolist() == [2.0, 7.0] and float(means[0, 0, 1]) == 5.0 and bool(torch.isnan(means[0, 1, 1]))


def test_intervals_are_welchs_and_widen_with_the_body(seed):
    """As scipy's without draws; an error that both conditions share cancels, one of the condition alone does not."""
    rng = np.random.default_rng(seed)
    units, second = torch.as_tensor(rng.normal(size=(11, 3))), torch.arange(11) >= 5
    plain = difference_of(units, second, None)
    known = stats.ttest_ind(units[5:, 1], units[:5, 1], equal_var=False).confidence_interval(0.95)
    assert (float(plain.low[1]), float(plain.high[1])) == pytest.approx((known.low, known.high))
    common = torch.as_tensor(rng.normal(size=(50, 1, 3)))
    torch.testing.assert_close(difference_of(units, second, units + common).sd, plain.sd)
    own = difference_of(units, second, units + common * second[:, None])
    assert bool((own.high - own.low > plain.high - plain.low).all())
    one = difference_of(units[4:], torch.arange(7) >= 1, None)
    assert bool(torch.isnan(one.low).all()) and bool(torch.isfinite(one.value).all())
    g = hedges(units, second)
    t = stats.ttest_ind(units[5:, 0], units[:5, 0]).statistic
    assert float(g.value[0]) == pytest.approx((1 - 3 / (4 * 9 - 1)) * t * math.sqrt(1 / 5 + 1 / 6))


def test_courses_say_when(seed):
    """A difference in the middle of the cycle is marked there and hardly anywhere else."""
    rng = np.random.default_rng(seed)
    t = np.linspace(0, 1, 51)
    smooth = np.stack([np.sin(np.pi * (k + 1) * t) for k in range(4)])
    curves = rng.normal(size=(16, 4)) @ smooth * 0.3 + 0.05 * rng.normal(size=(16, 51))
    curves[8:] += 3.0 * np.exp(-(((t - 0.5) / 0.08) ** 2))
    own = replace(
        sample(rng, 8, 1, 1), courses=(MeasureColumn("c", "torque_Nm"),), curves=torch.as_tensor(curves)[..., None]
    )
    found = compare(own, "off", "on", OPTIONS, seed)
    assert found.found_courses(0.05) == [0] and not found.found(1e-9)
    (start, stop), *_ = spans(found.tested.points[:, 0] <= 0.05)
    assert 20.0 < start < 50.0 < stop < 80.0


def test_more_comparisons_cost(seed):
    """Adjusted p-values are multiplied by their number, one at most."""
    own = sample(np.random.default_rng(seed), 5, 2, 3)
    one, three = (compare(own, "off", "on", OPTIONS, 0, count) for count in (1, 3))
    torch.testing.assert_close(three.tested.adjusted, (3.0 * one.tested.adjusted).clamp(max=1.0))
    few = compare(sample(np.random.default_rng(seed), 4, 2, 3), "off", "on", OPTIONS, 0, 2)
    assert not few.testable and few.needed.units == 5  # 2/70 twice is above 5 %


def test_paired_signs(seed):
    """Over subjects: differences that are all of one sign have the smallest p that there is."""
    rng = np.random.default_rng(seed)
    values = torch.as_tensor(np.abs(rng.normal(size=(6, 1))) + 0.5)
    tested = step_down(sign_means(values, flip(6, 999, 0).ways))
    assert float(tested.p[0]) == pytest.approx(2 / 64)


def test_a_torque_that_changes_sign_is_found_by_its_course_alone(seed):
    """Peaks of size are the same; the course and the signed extremes are not."""
    rng = np.random.default_rng(seed)
    sign = np.where(np.arange(12) < 6, 1.0, -1.0)
    curves = sign[:, None] * 13.0 * np.sin(np.pi * np.linspace(0, 1, 31)) + 0.5 * rng.normal(size=(12, 31))
    peaks = np.abs(curves).max(1)[:, None]
    courses = (MeasureColumn("ankle", "torque_Nm"), MeasureColumn("knee", "torque_Nm"))
    both = np.stack([curves, 20.0 * rng.normal(size=(12, 1)) + rng.normal(size=(12, 31))], -1)
    names, conditions = tuple(f"t{k}" for k in range(12)), tuple("off" if s > 0 else "on" for s in sign)
    own = Sample(names, conditions, (MeasureColumn("ankle", "peak_torque_Nm"),), torch.as_tensor(peaks),
                 courses=courses, curves=torch.as_tensor(both))  # fmt: skip
    found = compare(own, "off", "on", OPTIONS, seed)
    assert 0 in found.found_courses(0.05) and float(found.tested.courses[0]) <= float(found.tested.courses[1])
    assert bool((found.tested.points[5:26, 0] <= 0.05).all())
    torch.testing.assert_close(found.tested.points.amin(0), found.tested.courses)


def test_courses_and_measures_are_wrong_as_rarely_as_any_family(seed):
    """Five measures and four smooth courses without an effect: some finding in at most 5 % of 200, within chance."""
    rng, wrong = np.random.default_rng(seed), 0
    waves = np.stack([np.cos(np.pi * k * np.linspace(0, 1, 21)) for k in range(6)])
    courses = tuple(MeasureColumn(f"c{k}", "torque_Nm") for k in range(4))
    for k in range(200):
        curves = np.einsum("nck,kp->npc", rng.normal(size=(10, 4, 6)), waves)
        own = replace(sample(rng, 5, 1, 5), courses=courses, curves=torch.as_tensor(curves))
        found = compare(own, "off", "on", OPTIONS, k)
        wrong += bool(found.found(0.05) or found.found_courses(0.05))
    assert wrong <= stats.binom.ppf(1 - 1e-5, 200, 0.05)


def test_a_course_counts_as_eight_measures(seed):
    """The chance of a statistic by Student's t is eight times its own, one at most, for labels and for signs."""
    rng = np.random.default_rng(seed)
    r, freedom = torch.as_tensor(rng.uniform(0.0, 0.999, 50)), torch.full((50,), 7.0, dtype=torch.float64)
    for largest in (1.0, math.sqrt(8.0)):
        less = counted_as_many(largest * r, torch.full_like(r, largest), freedom) / largest
        before, after = (2.0 * stats.t.sf(x * np.sqrt(7.0 / (1.0 - x**2)), 7) for x in (r.numpy(), less.numpy()))
        np.testing.assert_allclose(after, np.minimum(COURSE_COUNTS * before, 1.0), rtol=1e-6)


def test_more_than_a_joint_needs_is_where_the_human_changes_sign():
    """Half a cycle of a device that gives 20 of 10 N m; not where it gives 5, nor where the band holds zero."""
    demand = torch.full((10, 3), 10.0, dtype=torch.float64)
    device = torch.full_like(demand, 5.0)
    device[:5, 1:] = 20.0
    human = (demand - device).flatten()
    wide = torch.tensor([1.0, 1.0, 30.0], dtype=torch.float64).repeat(10)
    part, back = beyond_need(
        Estimate(human, wide, human - wide, human + wide), demand.flatten(), device.flatten(), 10
    )  # fmt: skip
    assert part.tolist() == [0.0, 0.5, 0.0] and back.tolist() == [0.0, 10.0, 0.0]
