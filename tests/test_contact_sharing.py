"""Contacts that share a plate: exact sums, forces within cones, the optimum that Clarabel finds, flags of sources."""

import sys
from dataclasses import replace
from pathlib import Path

import pytest
import torch

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "scripts"))

import small_session
from benchmarks.contact_baselines import lever_rule, smooth_transition
from benchmarks.contact_measures import merged
from benchmarks.sharing_problem import FRICTION, random_problem
from sharing_by_clarabel import share_by_clarabel

from torchid.contact.contact import Contact, find_contact
from torchid.contact.options import ContactOptions, SolverOptions
from torchid.contact.sharing.expected import spread_of_shares
from torchid.contact.sharing.problem import drawn_to_cones, project_on_cones, summed
from torchid.contact.sharing.records import Needed, WrenchSource
from torchid.contact.sharing.solver import SharingStatus, share
from torchid.contact.sharing.wrenches import contact_wrenches
from torchid.errors import DataError
from torchid.filters import Smoother
from torchid.geometry.result import GeometryFit
from torchid.recording import Forces, Plate
from torchid.report.contacts import contacts_figure
from torchid.session.contact_wrenches import sharing_notes, wrenches_under
from torchid.session.following import Following, follow, legs, torques

TOLERANCE_N = 0.2
"""Of a solution at the default tolerance: some 3e-4 of the weight."""


def centre_of(wrench: torch.Tensor) -> torch.Tensor:
    """Centre of pressure (..., 2) of wrenches on the floor."""
    return torch.stack([-wrench[..., 4], wrench[..., 3]], -1) / wrench[..., 2:3]


@pytest.mark.parametrize("bend", [False, True])
def test_the_batched_solver_finds_clarabels_optimum(bend: bool, seed: int) -> None:
    """Wrenches agree, frame by frame, with coupled frames and without.

    Where the optimum is flat, the solver's own tolerance may end before it for single forces (seed 26500066 in
    ``draws.jsonl``); how far, it does not promise, and five times is a choice.
    """
    for k in range(2):
        problem, _ = random_problem(6, seed + k, bend)
        reference = share_by_clarabel(problem)
        fine = share(problem, SolverOptions(tolerance=1e-7, iterations=10000), throw=False)
        torch.testing.assert_close(fine.wrench[..., :3], reference[..., :3], atol=0.02, rtol=1e-5)
        off = (share(problem).wrench - fine.wrench)[..., :3].abs() - 1e-3 * fine.wrench[..., :3].abs()
        assert float(off.quantile(0.9)) < TOLERANCE_N and float(off.max()) < 5.0 * TOLERANCE_N


def test_sums_are_exact_and_forces_stay_in_their_cones(seed: int) -> None:
    """The base rows hold to 1e-6 of the load, whatever the tolerance; pressure and friction to the solver's."""
    problem, _ = random_problem(60, seed)
    for options in (SolverOptions(), SolverOptions(iterations=10)):
        found = share(problem, options, throw=False)
        total = problem.total[:, 0]
        torch.testing.assert_close(found.wrench.sum(1), total, atol=1e-6 * float(total.abs().max()), rtol=0.0)
    found = share(problem)
    assert found.status is SharingStatus.SOLVED
    slack = 0.1
    assert float(found.wrench[..., 2].min()) > -slack
    slip = found.wrench[..., :2].norm(dim=-1) - FRICTION * found.wrench[..., 2]
    assert float(slip.max()) < slack
    loaded = found.wrench[..., 2] > 20.0
    centre = centre_of(found.wrench)
    corners = problem.points.unflatten(1, (2, 4))[..., :2]
    low, high = corners.amin(2) - 0.005, corners.amax(2) + 0.005
    assert bool(((centre > low) & (centre < high)).all(dim=-1)[loaded].all())


def test_frames_do_not_depend_on_the_frames_shared_with_them(seed: int) -> None:
    """Without coupling, halves of the frames give what all of them give."""
    problem, _ = random_problem(40, seed, bend=False)
    whole = share(problem).wrench
    halves = torch.cat([share(problem.frames(slice(0, 20))).wrench, share(problem.frames(slice(20, 40))).wrench])
    torch.testing.assert_close(halves[..., :3], whole[..., :3], atol=TOLERANCE_N, rtol=1e-4)


def test_coupled_frames_bend_less(seed: int) -> None:
    """The cost of bending lowers the second differences of forces."""
    problem, _ = random_problem(60, seed)
    smooth, rough = share(problem).wrench, share(replace(problem, bend_sd=None)).wrench
    bent = [w[:, 0, :3].diff(n=2, dim=0).square().sum() for w in (smooth, rough)]
    assert bent[0] < bent[1]


def test_frames_that_are_not_sought_keep_what_is_given(seed: int) -> None:
    """Given wrenches come out as they went in, and only steer the others' smoothness."""
    problem, truth = random_problem(40, seed)
    open_ = torch.zeros(40, dtype=torch.bool)
    open_[10:30] = True
    found = share(replace(problem, given=truth, open=open_))
    torch.testing.assert_close(found.wrench[~open_], truth[~open_], atol=0.0, rtol=0.0)
    torch.testing.assert_close(found.wrench.sum(1), problem.total[:, 0], atol=1e-6, rtol=1e-9)


def test_totals_beyond_the_patches_are_said(seed: int) -> None:
    """A total that pulls cannot be borne by soles: the sum holds, the cones give, the status says so."""
    problem, _ = random_problem(10, seed, bend=False)
    total = problem.total.clone()
    total[3] *= -0.2
    found = share(replace(problem, total=total), throw=False)
    assert found.status is not SharingStatus.SOLVED and float(found.violation[3]) > 10.0
    torch.testing.assert_close(found.wrench.sum(1), total[:, 0], atol=1e-6, rtol=1e-9)


def test_a_grip_may_pull(seed: int) -> None:
    """A hand on a rail, of infinite friction, takes what soles cannot."""
    problem, truth = random_problem(10, seed, bend=False)
    total = (truth[:, 0] - 2.0 * truth[:, 1])[:, None]
    friction = torch.where(problem.owner == 1, torch.inf, problem.friction)
    found = share(replace(problem, total=total, friction=friction))
    assert found.status is SharingStatus.SOLVED
    assert float(found.wrench[:, 1, 2].min()) < 0.0 <= float(found.wrench[:, 0, 2].min()) + 0.1


def test_each_plate_is_summed_by_its_own_contacts(seed: int) -> None:
    """With two totals, each contact bears its own."""
    problem, truth = random_problem(10, seed, bend=False)
    two = replace(problem, total=truth, group=torch.tensor([0, 1]))
    torch.testing.assert_close(share(two).wrench, truth, atol=1e-5, rtol=1e-6)


@pytest.mark.parametrize(
    ("code", "change"),
    [
        ("sharing.unknown", lambda p: {"total": p.total * torch.nan}),
        ("sharing.groups", lambda p: {"group": p.group + 1}),
        ("sharing.groups", lambda p: {"owner": p.owner - 1}),
        ("sharing.friction", lambda p: {"friction": -p.friction}),
    ],
)
def test_what_cannot_be_posed_is_refused(code: str, change) -> None:
    """Unknown totals, contacts without one and negative friction say what to do."""
    problem, _ = random_problem(5, 0)
    with pytest.raises(DataError) as refusal:
        share(replace(problem, **change(problem)))
    assert refusal.value.code == code


def test_an_unsettled_solution_raises_unless_asked_otherwise() -> None:
    """Too few iterations end as an error, or as a status."""
    problem, _ = random_problem(30, 0)
    few = SolverOptions(iterations=2, tolerance=1e-9)
    with pytest.raises(DataError) as refusal:
        share(problem, few)
    assert refusal.value.code == "sharing.unconverged"
    assert share(problem, few, throw=False).status is SharingStatus.UNCONVERGED


def test_projection_on_cones_is_the_nearest_point(seed: int) -> None:
    """It lies in the cone, what is taken off is orthogonal to it, and no other point of the cone is nearer."""
    normal = torch.Generator().manual_seed(seed)
    force = torch.randn(200, 4, 3, generator=normal, dtype=torch.float64)
    friction = torch.tensor([0.3, 0.8, 1.5, torch.inf], dtype=torch.float64)
    near = project_on_cones(force, friction)
    inside = near[..., :2].norm(dim=-1) <= friction * near[..., 2] + 1e-12
    assert bool((inside | torch.isinf(friction)).all())
    torch.testing.assert_close(((force - near) * near).sum(-1), torch.zeros(200, 4).double(), atol=1e-12, rtol=0.0)
    other = project_on_cones(torch.randn(200, 4, 3, generator=normal, dtype=torch.float64), friction)
    assert bool(((force - near).norm(dim=-1) <= (force - other).norm(dim=-1) + 1e-12).all())
    torch.testing.assert_close(drawn_to_cones(force, friction, 1e9), near)
    step = (drawn_to_cones(force, friction, 0.1) - force).flatten(1).norm(dim=1)
    assert bool((step <= 0.1 + 1e-12).all())


def test_deviations_are_those_of_the_least_squares(seed: int) -> None:
    """Without cones, solutions scatter by their deviations when what is expected scatters by its own."""
    generator = torch.Generator().manual_seed(seed)
    problem, _ = random_problem(1, seed, bend=False)
    sums, rows = summed(problem), problem.rows
    factor = spread_of_shares(rows, sums, problem.bearing)[0]
    sd = factor.square().sum(1).sqrt()
    R = rows[0].flatten(1)
    E = torch.cat([torch.eye(6, dtype=torch.float64)] * 2, dim=1)
    null = torch.cat([torch.eye(6, dtype=torch.float64), -torch.eye(6, dtype=torch.float64)])
    aims = torch.randn(len(R), 4000, generator=generator, dtype=torch.float64)
    moved = null @ torch.linalg.lstsq(R @ null, aims).solution
    assert float((E @ moved).abs().max()) < 1e-6
    # A root turns a covariance's rounding, 1e-16, into 1e-8 of its largest entry, and scales of contacts differ.
    assert float((E @ factor).abs().max()) < 1e-5 * float(factor.abs().max())
    torch.testing.assert_close(moved.std(dim=1), sd, rtol=0.1, atol=1e-9)


FRAMES, RATE = 100, 100.0
FLAT = torch.tensor([[0.0, 0.0, 0.01], [0.17, 0.03, 0.01], [0.18, -0.03, 0.01], [0.24, 0.0, 0.01]]).double()


def standing(lean: float = 0.0) -> tuple[dict[str, torch.Tensor], torch.Tensor, torch.Tensor]:
    """Soles side by side, a load that moves from one to the other, and what each bears (frames, 2, 6)."""
    places = {"foot_l": (0.0, 0.15), "foot_r": (0.0, -0.15)}
    soles = {
        name: (FLAT + torch.tensor([x, y, 0.0]).double()).expand(FRAMES, -1, -1) for name, (x, y) in places.items()
    }
    share_l = 0.5 + 0.3 * torch.sin(torch.linspace(0.0, 6.0, FRAMES, dtype=torch.float64))
    both = []
    for y, part in ((0.15, share_l), (-0.15, 1.0 - share_l)):
        p = torch.tensor([0.11, y, 0.0]).double().expand(FRAMES, 3)
        f = 700.0 * part[:, None] * torch.tensor([lean, 0.0, 1.0]).double()
        both.append(torch.cat([f, torch.linalg.cross(p, f)], dim=1))
    com = torch.tensor([0.11, 0.0, 1.0]).double().expand(FRAMES, 3).clone()
    return soles, torch.stack(both, dim=1), com


def one_plate(wrench: torch.Tensor, corners: float | None = 0.5) -> Forces:
    """A plate that bears everything, or the right foot's part of nothing."""
    square = None
    if corners is not None:
        square = torch.tensor(
            [[a * corners, b * corners, 0.0] for a, b in ((1, 1), (1, -1), (-1, -1), (-1, 1))]
        ).double()
    return Forces(torch.arange(FRAMES, dtype=torch.float64) / RATE, wrench, (Plate("only", square, number=1),))


def judged(soles: dict[str, torch.Tensor], forces: Forces) -> Contact:
    return find_contact(soles, forces, torch.ones(FRAMES, dtype=torch.bool), RATE, 0.0)


def test_two_feet_on_one_plate_are_shared() -> None:
    """Standing load is split to a few percent of weight, flagged, with deviations; the sum is the plate's."""
    soles, truth, com = standing()
    forces, smoother = one_plate(truth.sum(1, keepdim=True)), Smoother(10.0, RATE)
    found = contact_wrenches(judged(soles, forces), soles, forces, com, smoother)
    assert bool((found.source == WrenchSource.SHARED).all())
    torch.testing.assert_close(found.wrench.sum(1), smoother(truth.sum(1)), atol=1e-6, rtol=1e-9)
    gap = (found.wrench - smoother(truth))[..., 2]
    assert float(gap.square().mean().sqrt()) < 0.04 * 700.0
    assert bool((found.sd[..., :3] > 0.0).all())
    assert not sharing_notes({"a": replace(found, source=torch.zeros_like(found.source))})
    assert [note.code for note in sharing_notes({"a": found})] == ["contact.shared"]


def test_feet_over_one_plate_share_it_wherever_it_presses() -> None:
    """Pressure under one foot is no proof that it bears alone, where the other stands on the same plate."""
    soles, truth, com = standing()
    leaning = torch.stack([truth.sum(1), 0.0 * truth[:, 0]], dim=1)
    p = torch.tensor([0.11, 0.12, 0.0]).double().expand(FRAMES, 3)
    leaning[:, 0, 3:] = torch.linalg.cross(p, leaning[:, 0, :3])
    forces = one_plate(leaning.sum(1, keepdim=True))
    contact = judged(soles, forces)
    assert bool((contact.plate == 0).all())
    found = contact_wrenches(contact, soles, forces, com, Smoother(10.0, RATE))
    assert bool((found.source == WrenchSource.SHARED).all())
    assert 0.0 < float(found.wrench[:, 1, 2].mean()) < 0.25 * 700.0


def test_a_foot_beside_the_plate_is_unknown_or_predicted() -> None:
    """Without the body its wrench is not known; with it, it bears what the plate does not."""
    soles, truth, com = standing()
    forces, smoother = one_plate(truth[:, :1], None), Smoother(10.0, RATE)
    contact = judged(soles, forces)
    found = contact_wrenches(contact, soles, forces, com, smoother)
    assert bool((found.source[:, 1] == WrenchSource.UNKNOWN).all()) and bool(torch.isnan(found.sd[:, 1]).all())
    assert bool((found.source[:, 0] == WrenchSource.MEASURED).all())
    needed = Needed(smoother(truth.sum(1)), torch.ones(FRAMES, dtype=torch.bool), torch.full((6,), 5.0).double())
    found = contact_wrenches(contact, soles, forces, com, smoother, needed)
    assert bool((found.source[:, 1] == WrenchSource.PREDICTED).all())
    torch.testing.assert_close(found.wrench, smoother(truth), atol=1e-5, rtol=1e-6)
    assert bool((found.sd[:, 1] >= 5.0).all())
    assert [note.code for note in sharing_notes({"a": found})] == ["contact.predicted"]


def test_without_plates_the_body_is_all_there_is() -> None:
    """Contact comes from the soles' motion, the total from the body."""
    soles, truth, com = standing()
    forces = Forces(torch.arange(FRAMES, dtype=torch.float64) / RATE, truth.new_zeros(FRAMES, 0, 6), ())
    smoother, contact = Smoother(10.0, RATE), judged(soles, forces)
    assert bool(contact.touching.all())
    needed = Needed(smoother(truth.sum(1)), torch.ones(FRAMES, dtype=torch.bool), torch.full((6,), 5.0).double())
    found = contact_wrenches(contact, soles, forces, com, smoother, needed)
    assert bool((found.source == WrenchSource.PREDICTED).all())
    torch.testing.assert_close(found.wrench.sum(1), smoother(truth.sum(1)), atol=1e-5, rtol=1e-9)


def test_an_unsettled_share_is_unknown() -> None:
    """Shares that did not settle are flagged, not published."""
    soles, truth, com = standing()
    forces = one_plate(truth.sum(1, keepdim=True))
    few = SolverOptions(iterations=1, tolerance=1e-12)
    found = contact_wrenches(judged(soles, forces), soles, forces, com, Smoother(10.0, RATE), solver=few)
    assert found.status is SharingStatus.UNCONVERGED
    assert bool((found.source == WrenchSource.UNKNOWN).all())
    assert "contact.unsettled" in [note.code for note in sharing_notes({"a": found})]


def test_feet_on_plates_of_their_own_are_measured() -> None:
    """Nothing is shared where every plate bears one foot."""
    soles, truth, com = standing()
    plates = (Plate("left", None), Plate("right", None))
    forces, smoother = Forces(torch.arange(FRAMES, dtype=torch.float64) / RATE, truth, plates), Smoother(10.0, RATE)
    found = contact_wrenches(judged(soles, forces), soles, forces, com, smoother)
    assert bool((found.source == WrenchSource.MEASURED).all())
    torch.testing.assert_close(found.wrench, smoother(truth), atol=1e-9, rtol=1e-12)
    assert float(found.sd.abs().max()) == 0.0


def test_the_lever_rule_splits_by_distance() -> None:
    """Load midway between the soles is halved; over one of them it is that one's."""
    soles, truth, _ = standing()
    both = lever_rule((soles["foot_l"], soles["foot_r"]), truth.sum(1))
    torch.testing.assert_close(both[..., 2], truth[..., 2], atol=1e-6, rtol=1e-9)


def test_the_smooth_transition_begins_with_the_trailing_foot_and_ends_with_the_leading_one() -> None:
    """At the strike the trailing foot has all, at the toe-off next to nothing; the sum is the total throughout."""
    _, truth, com = standing(lean=0.1)
    total = truth.sum(1)
    both = smooth_transition(total, com, total.new_tensor([1.0, 0.0]))
    torch.testing.assert_close(both.sum(1), total, atol=1e-9, rtol=1e-12)
    torch.testing.assert_close(both[0, 0], total[0], atol=1e-9, rtol=1e-9)
    assert float(both[-1, 0, :3].abs().max()) < 1e-2 * 700.0


@pytest.mark.slow
def test_merged_plates_of_a_simulated_session_give_the_feet_their_truth() -> None:
    """Steps on one plate made of four: sums are exact, feet are near the truth, legs have torques throughout."""
    outcome = small_session.outcome()
    name = "sway_steps"
    one, trial = outcome.followed[name], outcome.session.trials[name]
    assert trial.forces is not None
    both = replace(trial, forces=merged(trial.forces))
    fit: GeometryFit = outcome.fit
    followed = follow(fit, both, one.tracked, Following.of(outcome.config, outcome.cutoff_hz))
    under = wrenches_under(followed, fit, outcome.phi, both, ContactOptions())
    assert under is not None and both.forces is not None
    smoother, total = one.motion.smoother, torch.nan_to_num(both.forces.total)
    open_ = (under.source == WrenchSource.SHARED).all(dim=1)
    assert int(open_.sum()) > 50
    torch.testing.assert_close(under.wrench.sum(1)[open_], smoother(total)[open_], atol=1e-3, rtol=1e-6)
    truth = smoother(small_session.session().trial(name).truth.feet.wrench[: len(total)])
    weight = float(total[:, 2].median())
    assert float((under.wrench - truth)[open_][..., 2].square().mean().sqrt()) < 0.08 * weight
    told = replace(
        outcome,
        followed={name: followed},
        under={name: under},
        session=replace(outcome.session, trials={name: both}),
    )
    figure = contacts_figure(told)
    assert figure is not None and "shares a plate" in figure.svg and f"{int(open_.sum())} frames" in figure.caption
    known = torques(followed, fit.model.tree, fit.geometry, outcome.phi, both, under)
    hidden = torques(followed, fit.model.tree, fit.geometry, outcome.phi, both)
    rows = [row for own in legs(fit.model.tree).values() for row in own]
    assert int(torch.isnan(known[:, rows]).sum()) < int(torch.isnan(hidden[:, rows]).sum())
