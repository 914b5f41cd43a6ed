"""Advice while a subject moves: how soon all segments are known with it, in random order, and in the best fixed order.

PYTHONPATH=.:scripts python -m benchmarks.guidance --subjects 10 --seed 7

Bodies, motions and plates are torchid's own simulator's. Coordinates get the error that inverse kinematics makes of
1 mm on every marker, to first order, and the geometry 3 mm on every length; there is no stream of frames. Rows go to
the estimator of a stream, and the guide knows nothing but what it finds. The best fixed order is looked for on the
very subjects it is tried on, with all that their rows will tell: no one could know it beforehand.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from harness.command import Command, said_seed
from harness.pool import alone
from torch import Tensor

from torchid.dynamics.whitening import BlockSpectrum, accumulate
from torchid.filters import Smoother
from torchid.inertia.identify import identify_spectra
from torchid.inertia.options import InertiaOptions
from torchid.kinematics.plan import plan_tree
from torchid.kinematics.recursion import points, poses
from torchid.live.estimation.estimator import Estimator
from torchid.live.exercises.advice import Adviser, promises
from torchid.live.exercises.exercises import RATE_HZ, Possibilities, perform
from torchid.live.exercises.guidance import GOAL, Guide, Knowledge, Outlook, rehearse, rows_of
from torchid.model.anthropometry import inertial_prior
from torchid.simulate.balance import needed_wrench
from torchid.simulate.subject import SimulatedSubject, simulate_subject

RATE, CUTOFF_HZ, STEP, LIMIT_S = 100.0, 6.0, 5, 600
"""Frames a second; filter; seconds after which there is a new estimate; end of a session that does not succeed."""
MARKER_M, LENGTH_M, FORCE_N, MOMENT_ARM = 1e-3, 3e-3, 2.0, 0.2
REPETITIONS, ORDERS, SLOTS, TRIES = 6, 2, 40, 400
MASS_SD, OPTIONS = 0.3, InertiaOptions(refuse=False, base_parameters=False)
Choose = Callable[[Estimator, int], str]
"""Exercise to do from now on, by what is known and the second of the session."""


@dataclass
class Person:
    """A subject, what it knows of itself, and all that it may do."""

    true: SimulatedSubject
    guide: Guide
    done: dict[tuple[str, int], Sequence[BlockSpectrum]]
    """Ten seconds of rows of each exercise, some times over."""
    gram: dict[tuple[str, int], Tensor]
    """Information of these, by the noise of all."""
    judge: Outlook
    """By the noise of all that it may do."""
    seconds: float
    """To rehearse."""
    advising: list[float]
    """What a piece of advice took [s]."""

    @property
    def begin(self) -> Knowledge:
        """Return what is known before any row."""
        return Knowledge.begin(self.guide.prior, self.guide.mass)


@dataclass
class Result:
    """Of a session."""

    seconds: int
    """Until all segments are known."""
    minute: Tensor
    """Shares after one minute."""
    three: Tensor
    """After three."""


def make_person(seed: int) -> Person:
    """Draw a subject and let it do everything, some times over."""
    true, rng = simulate_subject(None, seed), np.random.default_rng((seed, 9))
    xi = true.xi.clone()
    for k, unit in enumerate(true.model.geometry.units):
        xi[k] += LENGTH_M * rng.normal() * (unit == "m")
    geometry = true.model.geometry.geometry(xi)
    prior = inertial_prior(geometry, true.recorded_height, true.recorded_mass, MASS_SD, true.sex)
    seen = replace(true, geometry=geometry, xi=xi, phi=prior.mean, mass=float(prior.mean[:, 0].sum()))
    begun = time.thread_time()
    guide = rehearse(seen, prior, (true.recorded_mass, MASS_SD), Smoother(CUTOFF_HZ, RATE_HZ), Possibilities())
    seconds = time.thread_time() - begun
    names = [one.exercise.name for one in guide.rehearsals]
    done = {(name, k): _performed(guide, name, k, true, seen, rng) for name in names for k in range(REPETITIONS)}
    whitening = identify_spectra(list(done.values()), guide.names, prior, OPTIONS, guide.mass).whitening
    judge = guide.outlook(guide.information(whitening, RATE))
    gram = {key: accumulate(own, whitening).gram for key, own in done.items()}
    person = Person(true, guide, done, gram, judge, seconds, [])
    noise = whitening.covariance[4].diagonal().sqrt().tolist()
    print(f"  {seed}: {true.mass:.0f} kg, noise at 2 to 3 Hz {np.mean(noise[:3]):.1f} N {np.mean(noise[3:]):.1f} N m, "
          f"determined {torch.bincount(judge.body, minlength=len(guide.names)).tolist()}, "
          f"rehearsed in {seconds:.1f} s", flush=True)  # fmt: skip
    return person


def _performed(
    guide: Guide, name: str, k: int, true: SimulatedSubject, seen: SimulatedSubject, rng: np.random.Generator
) -> Sequence[BlockSpectrum]:
    """Rows of one time that a subject does an exercise."""
    exercise = next(one.exercise for one in guide.rehearsals if one.exercise.name == name)
    motion = next(m for j in range(9) if (m := perform(exercise, true, Possibilities(), 1000 + 10 * k + j, RATE)))
    noise = FORCE_N * 2.0**0.5 * torch.from_numpy(rng.normal(size=(len(motion.q), 6)))
    wrench = needed_wrench(true, motion) + noise * noise.new_tensor([1.0] * 3 + [MOMENT_ARM] * 3)
    measured = replace(motion, q=motion.q + _posture_error(true, motion.q, rng))
    return rows_of(true.model.tree, seen.geometry, measured, Smoother(CUTOFF_HZ, RATE), wrench)


def _posture_error(who: SimulatedSubject, q: Tensor, rng: np.random.Generator, every: int = 10) -> Tensor:
    """What noise of the markers makes of the coordinates: (J' J)^-1 J' n, J anew every tenth frame."""
    plan = plan_tree(who.model.tree)
    body = torch.tensor([plan.position[who.model.tree.index(name)] for name in who.segments])

    def markers(q: Tensor) -> Tensor:
        return points(poses(plan, q.T.contiguous(), who.geometry), body, who.p_BM_B).permute(2, 0, 1).flatten(1)

    few, size = q[::every], 1e-5
    shifts = size * torch.eye(q.shape[1], dtype=q.dtype)
    J = torch.stack([(markers(few + shift) - markers(few - shift)) / (2.0 * size) for shift in shifts], 2)
    H = J.mT @ J + 1e-5 * torch.eye(q.shape[1], dtype=q.dtype)
    noise = MARKER_M * torch.from_numpy(rng.normal(size=(len(q), J.shape[1])))
    at = torch.arange(len(q)) // every
    return (torch.linalg.solve(H, J.mT)[at] @ noise[:, :, None])[:, :, 0]


def session(person: Person, choose: Choose) -> Result:
    """What comes of the exercises that are chosen."""
    guide, judge = person.guide, person.judge
    estimator = Estimator(guide.names, guide.prior, OPTIONS, guide.mass)
    spent, at, reached = {one.exercise.name: 0 for one in guide.rehearsals}, {}, LIMIT_S
    for now in range(0, LIMIT_S, STEP):
        name = choose(estimator, now)
        blocks = person.done[name, (spent[name] // 10) % REPETITIONS]
        estimator.add([(now + 0.5, block) for block in blocks[spent[name] % 10 : spent[name] % 10 + STEP]])
        spent[name] += STEP
        assert estimator.sums is not None
        at[now + STEP] = judge.share(person.begin.after(estimator.sums.gram))
        if bool((at[now + STEP] >= GOAL).all()):
            reached = min(reached, now + STEP)
        if reached < LIMIT_S and now + STEP >= 180:
            break
    return Result(reached, at[60], at[180])


def advised(person: Person) -> Choose:
    """What the guide says."""
    adviser = Adviser(person.guide, RATE)

    def choose(estimator: Estimator, now: int) -> str:
        begun = time.thread_time()
        advice = adviser.after(estimator, float(now))
        person.advising.append(time.thread_time() - begun)
        return advice.name

    return choose


def informative(person: Person) -> Choose:
    """Whatever brings most information, wherever it is needed or not."""
    said: list[str] = []

    def choose(estimator: Estimator, now: int) -> str:
        if now % 10 == 0:
            information = person.guide.information(estimator.whitening, RATE)
            known = person.begin if estimator.sums is None else person.begin.after(estimator.sums.gram)
            found = promises(person.guide, person.guide.outlook(information), known)
            said.append(max(found, key=lambda one: one.nats).name)
        return said[-1]

    return choose


def in_order(order: Sequence[str]) -> Choose:
    """One after the other, ten seconds each, then from the start."""
    return lambda estimator, now: order[now // 10 % len(order)]


def best_order(people: list[Person], rng: np.random.Generator) -> list[str]:
    """Shortest mean time over all, from a greedy start by single changes; the noise is that of all rows."""
    names = [one.exercise.name for one in people[0].guide.rehearsals]
    order: list[str] = []
    while len(order) < SLOTS:
        order.append(min(names, key=lambda name: sum(_lacking(person, [*order, name]) for person in people)))
    best = sum(_slots(person, order) for person in people)
    for _ in range(TRIES):
        tried, last = list(order), int(best / len(people)) + 4
        i, j = rng.integers(last, size=2) % SLOTS
        if rng.random() < 0.5:
            tried[i] = str(rng.choice(names))
        else:
            tried[i], tried[j] = tried[j], tried[i]
        cost = sum(_slots(person, tried) for person in people)
        if cost <= best:
            order, best = tried, cost
    return order


def _known(person: Person, order: Sequence[str]) -> Knowledge:
    """What is known after an order."""
    count: dict[str, int] = {}
    total = torch.zeros_like(person.begin.before)
    for name in order:
        total += person.gram[name, count.setdefault(name, 0) % REPETITIONS]
        count[name] += 1
    return person.begin.after(total)


def _lacking(person: Person, order: Sequence[str]) -> float:
    return float((GOAL - person.judge.share(_known(person, order))).clamp(min=0.0).sum())


def _slots(person: Person, order: Sequence[str]) -> float:
    """How many exercises it takes; what is lacking before the last one breaks ties."""
    low, high = 0, SLOTS + 1
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (low, middle) if _lacking(person, order[:middle]) < 1e-9 else (middle, high)
    return high + 0.01 * _lacking(person, order[: high - 1])


def bench_guidance(subjects: int, seed: int) -> dict[str, list[Result]]:
    """Sessions of all subjects in every kind of order."""
    rng = np.random.default_rng(seed)
    people = [make_person(seed + k) for k in range(subjects)]
    order = best_order(people, rng)
    print(f"best fixed order: {' '.join(order[:24])}", flush=True)
    names = [one.exercise.name for one in people[0].guide.rehearsals]
    found: dict[str, list[Result]] = {"guided": [], "information": [], "fixed": [], "random": []}
    for person in people:
        found["guided"].append(session(person, advised(person)))
        found["information"].append(session(person, informative(person)))
        found["fixed"].append(session(person, in_order(order)))
        for _ in range(ORDERS):
            mixed = [str(name) for _ in range(8) for name in rng.permutation(names)]
            found["random"].append(session(person, in_order(mixed)))
        print(f"  {person.true.seed}: " + ", ".join(
            f"{what} {' '.join(str(one.seconds) for one in own[-(ORDERS if what == 'random' else 1):])} s"
            for what, own in found.items()), flush=True)  # fmt: skip
    advising = [s for person in people for s in person.advising]
    print(
        f"an advice takes {1e3 * np.median(advising):.0f} ms, rehearsals {max(p.seconds for p in people):.1f} s at most"
    )
    _table(found, people[0].guide.names)
    return found


def _table(found: dict[str, list[Result]], names: tuple[str, ...]) -> None:
    print(f"{'':14s}" + "".join(f"{what:>13s}" for what in found))
    times = {what: [one.seconds for one in own] for what, own in found.items()}
    for label, of in (("mean [s]", np.mean), ("median [s]", np.median), ("longest [s]", np.max)):
        print(f"{label:14s}" + "".join(f"{float(of(own)):13.0f}" for own in times.values()))
    print(f"{'in 180 s':14s}" + "".join(f"{float(np.mean(np.array(own) <= 180)):13.2f}" for own in times.values()))
    for when, label in (("minute", "after 60 s"), ("three", "after 180 s")):
        print(label)
        shares = {what: torch.stack([getattr(one, when) for one in own]).mean(0) for what, own in found.items()}
        for k, name in enumerate(names):
            print(f"  {name:12s}" + "".join(f"{float(own[k]):13.2f}" for own in shares.values()))


if __name__ == "__main__":
    alone()
    given = Command(__doc__, subjects=10, seed=int).asked()
    bench_guidance(given.subjects, said_seed(given.seed, 10**6))
