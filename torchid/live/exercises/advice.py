"""What a subject is asked to do next, and what came of it."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.dynamics.whitening import BlockSpectrum, Whitening, accumulate
from torchid.inertia.identify import Identified
from torchid.live.estimation.estimator import Estimator
from torchid.live.exercises.guidance import GOAL, Guide, Knowledge, Outlook

LEAVE = 0.25
"""Choice. An exercise is done for its whole duration unless another promises four times as much by now: who is told
something else every second does nothing well."""
MAINLY = 0.5
"""Choice. An exercise is for the segments that it brings at least this part of what it brings the first of them."""
NONE = 1e-9
"""Resolution. Progress that is none: of a segment of which no row tells."""
NOTHING = "none"
"""Name in the ledger of the time before any advice."""


@dataclass(frozen=True)
class Promise:
    """What an exercise is expected to bring if it is done for its duration."""

    name: str
    nats: float
    """Information on all parameters [nat]."""
    worth: float
    """Fall of what the segments lack, per second [1/s]."""
    rise: Float[Tensor, " bodies"]
    """Of the share known of each body's determined parameters."""


@dataclass(frozen=True)
class Advice:
    """An exercise that the subject is asked for."""

    name: str
    text: str
    """What the subject is told."""
    seconds: float
    """For how long it is asked for [s]."""
    gain_nats: float
    """Information that it is expected to bring in this time [nat]."""
    segments: tuple[str, ...]
    """Segments that it is for, the first one first."""


@dataclass(frozen=True)
class AdviceEntry:
    """What one interval of a session has brought."""

    exercise: str
    """What was advised."""
    blocks: int
    """Of rows that came in it."""
    nats: float
    """Information that these added to what was known before [nat]."""
    progress: Float[Tensor, " bodies"]
    """Its part in each segment's progress."""


@dataclass(frozen=True)
class Account:
    """What all exercises of a session have brought."""

    names: tuple[str, ...]
    """Of the bodies."""
    entries: tuple[AdviceEntry, ...]
    """One for each interval, in order."""
    share: Float[Tensor, " bodies"]
    """How much of each body's determined parameters is known."""
    notes: tuple[str, ...] = ()
    """Exercises that were not asked for, or without a part, and why."""

    @property
    def table(self) -> dict[str, Any]:
        """Return the account by the keys of the line that ``torchid live`` prints."""
        return {
            "determined": self._by_name(self.share),
            "exercises": [
                {"exercise": one.exercise, "blocks": one.blocks, "nats": round(one.nats, 3),
                 "progress": self._by_name(one.progress)}
                for one in self.entries
            ],
            "notes": list(self.notes),
        }  # fmt: skip

    def _by_name(self, values: Float[Tensor, " bodies"]) -> dict[str, float]:
        return {name: round(float(x), 4) for name, x in zip(self.names, values, strict=True)}


def promises(guide: Guide, outlook: Outlook, known: Knowledge) -> tuple[Promise, ...]:
    """Return what each exercise promises, given what is known.

    What counts is the fall of sum_b max(0, GOAL - share_b) per second, b the bodies: a segment that is known does not
    call for more, and nothing that cannot be determined calls for anything. Where all are known, information counts.

    Args:
        outlook: what it tells under the present noise.
        known: what is known now.
    """
    share, found = outlook.share(known), []
    done = bool((share >= GOAL).all())
    for rehearsal, information in zip(guide.rehearsals, outlook.information, strict=True):
        seconds = rehearsal.exercise.seconds
        then = known.after(seconds * information)
        nats, next_share = then.nats - known.nats, outlook.share(then)
        fall = _lacking(share) - _lacking(next_share)
        found.append(Promise(rehearsal.exercise.name, nats, (nats if done else fall) / seconds, next_share - share))
    return tuple(found)


def _lacking(share: Float[Tensor, " bodies"]) -> float:
    return float((GOAL - share).clamp(min=0.0).sum())


class Adviser:
    """Advises after every block, and keeps which rows came under which advice."""

    def __init__(self, guide: Guide, rate_hz: float) -> None:
        """Begin before any row."""
        self._guide, self._rate_hz = guide, rate_hz
        self._whitening: Whitening | None = None
        self._information = torch.zeros(0)
        self._given: list[tuple[float, str]] = []
        self.advice: Advice | None = None
        self.share = torch.zeros(0)
        """How much of each body's determined parameters is known, once there was advice."""

    def after(self, estimator: Estimator, now_s: float) -> Advice:
        """Return what to do next.

        Args:
            estimator: with all rows so far.
        """
        found = self._promises(estimator)
        best = max(found, key=lambda one: one.worth)
        if self.advice is not None:
            (now,) = (one for one in found if one.name == self.advice.name)
            if now_s < self._given[-1][0] + self.advice.seconds and now.worth >= LEAVE * best.worth:
                return self.advice
        self._given.append((now_s, best.name))
        self.advice = self._advice(best)
        return self.advice

    def account(self, estimator: Estimator, identified: Identified) -> Account:
        """Return what each interval has brought, under the noise of the end.

        Nats and what is known are of motion and geometry taken for exact, as advice is. Of each segment's progress in
        the end, which is not, every interval has the part that it has of that of exact rows.

        Args:
            estimator: with all rows.
            identified: what it ended with.
        """
        guide, omega_2 = self._guide, identified.fit.omega_2
        labels = [self._advised(time_s) for time_s in estimator.times]
        begin = Knowledge.begin(estimator.prior, guide.mass, omega_2)  # of the geometry that was refined
        entries, known = make_ledger(labels, estimator.blocks, identified.whitening, begin)
        told = torch.stack([one.progress for one in entries]).sum(0)
        part = torch.where(told > NONE, identified.fit.progress.segment / told.clamp(min=NONE), 0.0)
        entries = tuple(replace(one, progress=part * one.progress) for one in entries)
        outlook = guide.outlook(guide.information(identified.whitening, self._rate_hz), omega_2)
        return Account(guide.names, entries, outlook.share(known), guide.notes)

    def _promises(self, estimator: Estimator) -> tuple[Promise, ...]:
        if estimator.whitening is not self._whitening:
            self._whitening = estimator.whitening
            self._information = self._guide.information(estimator.whitening, self._rate_hz)
        omega_2 = 1.0 if estimator.fit is None else estimator.fit.omega_2
        known = Knowledge.begin(estimator.prior, self._guide.mass, omega_2)
        if estimator.sums is not None:
            known = known.after(estimator.sums.gram)
        outlook = self._guide.outlook(self._information, omega_2)
        self.share = outlook.share(known)
        return promises(self._guide, outlook, known)

    def _advised(self, time_s: float) -> str:
        """Exercise of the newest advice that was given by then."""
        return next((name for given, name in reversed(self._given) if given <= time_s), NOTHING)

    def _advice(self, promise: Promise) -> Advice:
        exercise = next(one.exercise for one in self._guide.rehearsals if one.exercise.name == promise.name)
        order = promise.rise.argsort(descending=True).tolist()
        least = MAINLY * float(promise.rise.max())
        segments = tuple(self._guide.names[k] for k in order if float(promise.rise[k]) >= least)
        return Advice(exercise.name, exercise.text, exercise.seconds, promise.nats, segments)


def make_ledger(
    labels: Sequence[str], blocks: Sequence[BlockSpectrum], whitening: Whitening, begin: Knowledge
) -> tuple[tuple[AdviceEntry, ...], Knowledge]:
    """Return what each interval has added to those before it, and what is known at the end.

    Args:
        labels: of every block, the exercise that was advised; an interval is a run of the same.
        blocks: all rows, in order.
        whitening: their noise.
        begin: what was known before.
    """
    known, entries, start = begin, [], 0
    for name, run in groupby(labels):
        count = len(list(run))
        then = known.after(accumulate(blocks[start : start + count], whitening).gram)
        entries.append(AdviceEntry(name, count, then.nats - known.nats, then.progress - known.progress))
        known, start = then, start + count
    return tuple(entries), known
