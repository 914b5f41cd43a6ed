"""Sessions of a laboratory as the trials of one model, in which what varies between them is integrated out.

What a session says of lasting faults is information and a moment (``LaboratoryEvidence``). With parameters theta of
the laboratory, a session has theta + delta of its own, delta ~ N(0, D): what its body does that looks like such a
fault, and what the fault varies by. With delta integrated out,

    log p(session | theta) = b*' theta - theta' A* theta / 2 + constant,
    A* = A - A R M^-1 R A,  b* = b - A R M^-1 R b,  R = D^(1/2),  M = 1 + R A R.

D has one variance for each effect, of the sizes that sound sessions seem to have (``SIZES``), the likeliest of them.
Forces of all bodies come late by themselves (``BODIES_LAG_S``), which a clock has to exceed: that lag, with its mean,
is one more parameter of the laboratory. One more session has theta and a delta of its own: what it may expect is the
sum of all A* and b*, with that delta integrated out once more.

Reference: Laird & Ware, Biometrics 38:963 (1982), on such random effects.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.cohort.laboratories import Laboratory, Visit, parameters_of
from torchid.diagnosis.candidates.candidate import Candidate, ColumnSource
from torchid.diagnosis.evidence.apparent import SIZES, shares_of
from torchid.diagnosis.evidence.earlier_sessions import CLOCK, beside_bodies, integrated_out
from torchid.diagnosis.evidence.gains import gains
from torchid.diagnosis.evidence.laboratory import Fault, LaboratoryEvidence
from torchid.diagnosis.evidence.posterior import fit
from torchid.diagnosis.evidence.statistics import Statistics, TrialStatistics
from torchid.effects.catalogue import CATALOGUE
from torchid.effects.place import Place
from torchid.observation.statements import Statements

SPANS = 0.2
"""Odds of all spans of sessions together, against all sessions; chosen, as for single trials of a clock."""
SWEEPS = 2
"""Times that the variances of all effects are chosen in turn; resolution."""


@dataclass(frozen=True)
class Pool:
    """Sessions as trials of a design that has a column for each parameter of each fault, behind that of bodies' lag."""

    visits: tuple[Visit, ...]
    """The sessions."""
    at: dict[Fault, Tensor]
    """Columns of each fault."""
    candidates: tuple[Candidate, ...]
    """Every fault throughout, and in spans of sessions where these have an order."""
    base: int
    """Number of columns of what bodies are like."""
    effects: dict[str, Tensor]
    """Columns of each effect."""
    whole: tuple[Float[Tensor, "visits all all"], Float[Tensor, "visits all"]]
    """Information and moment of each session, of all parameters."""
    bare: tuple[Float[Tensor, "visits all all"], Float[Tensor, "visits all"]]
    """The same without statements that need no body model."""

    @classmethod
    def of(cls, laboratory: Laboratory) -> "Pool":
        """Return the sessions of a laboratory.

        Args:
            laboratory: its sessions.
        """
        at, length = parameters_of(laboratory.visits)
        clock = at.get(CLOCK)
        base = 0 if clock is None else 1
        effects: dict[str, list[Tensor]] = {}
        for (name, _), columns in at.items():
            effects.setdefault(name, []).append(columns)
        each = [visit.evidence for visit in laboratory.visits]
        where = [torch.cat([at[fault] for fault in one.faults] or [torch.arange(0)]) for one in each]
        whole = beside_bodies(*_spread([(one.information, one.moment) for one in each], where, length), clock)
        stated = _spread([(one.stated_information, one.stated_moment) for one in each], where, length)
        stated = beside_bodies(*stated, clock)
        bare = whole[0] - stated[0], whole[1] - stated[1]
        every = {name: base + torch.cat(some) for name, some in effects.items()}
        columns = {fault: base + own for fault, own in at.items()}
        return cls(laboratory.visits, columns, tuple(_candidates(laboratory, columns)), base, every, whole, bare)

    def likeliest(self, chosen: Sequence[Candidate], scatter: Mapping[str, float]) -> dict[str, float]:
        """Return the standard deviation of each effect between sessions that is likeliest beside the chosen faults.

        Args:
            chosen: faults in the model.
            scatter: standard deviations from which the search begins.
        """
        found = dict(scatter)
        for _ in range(SWEEPS):
            for name in self.effects:
                odds = shares_of(CATALOGUE[name]).log().tolist()
                tried = [self._evidence(chosen, found | {name: size}) + o for size, o in zip(SIZES, odds, strict=True)]
                found[name] = SIZES[max(range(len(SIZES)), key=tried.__getitem__)]
        return found

    def closer(
        self, chosen: Sequence[Candidate], left: Sequence[Candidate], scatter: Mapping[str, float]
    ) -> tuple[dict[str, float], float]:
        """Return the scatter that the likeliest fault would leave, and the log evidence of what varies in place of it.

        What nobody has named yet is in the scatter that was found without it, and hides itself.

        Args:
            chosen: faults in the model.
            left: others.
            scatter: found without these.
        """
        found: list[tuple[float, float, str, float]] = []
        none = self._evidence(chosen, scatter)
        for name in self.effects:
            own = [one for one in left if one.effect.name == name]
            if not own:
                continue
            odds = dict(zip(SIZES, shares_of(CATALOGUE[name]).log().tolist(), strict=True))
            statistics = self.statistics({**scatter, name: SIZES[1]})
            gained = gains(statistics, fit(statistics, chosen), own)[0]
            best = own[int((gained + gained.new_tensor([one.odds for one in own]).log()).argmax())]
            tried = {size: self._evidence([*chosen, best], {**scatter, name: size}) + odds[size] for size in SIZES[:-1]}
            size = max(tried, key=tried.__getitem__)
            without = self._evidence(chosen, {**scatter, name: size}) + odds[size]
            before = none + odds[scatter[name]]
            found.append((tried[size] - before + math.log(best.odds), before - without, name, size))
        _, varies, name, size = max(found)
        return {**scatter, name: size}, max(varies, 0.0)

    def _evidence(self, chosen: Sequence[Candidate], scatter: Mapping[str, float]) -> float:
        """Log evidence of all sessions with the chosen faults and a scatter between sessions [nat]."""
        information, moment, nats = without(*self.whole, self._root(scatter))
        return fit(_statistics(self.base, information, moment), chosen).log_evidence + float(nats.sum())

    def statistics(self, scatter: Mapping[str, float]) -> Statistics:
        """Return statistics of all sessions in which what varies between them is integrated out.

        Args:
            scatter: standard deviation of each effect between sessions.
        """
        root = self._root(scatter)
        information, moment, _ = without(*self.whole, root)
        less, weaker, _ = without(*self.bare, root)
        return _statistics(self.base, information, moment, (information - less, moment - weaker))

    def for_next(self, scatter: Mapping[str, float], since: Sequence[int]) -> LaboratoryEvidence:
        """Return what sessions say of one more.

        Args:
            scatter: standard deviation of each effect between sessions.
            since: indices of the sessions whose instruments are those of the one more.
        """
        root, kept = self._root(scatter), torch.arange(self.base, self.whole[1].shape[1])
        found = []
        for information, moment in (self.whole, self.bare):
            each = without(information[since], moment[since], root)
            all_of_them = integrated_out(each[0].sum(0), each[1].sum(0), kept)
            one_more = without(all_of_them[0][None], all_of_them[1][None], root[kept])
            found.append((one_more[0][0], one_more[1][0]))
        (A, a), (B, b) = found
        return LaboratoryEvidence(tuple(self.at), tuple(map(len, self.at.values())), A, a, A - B, a - b)

    def _root(self, scatter: Mapping[str, float]) -> Float[Tensor, " all"]:
        """Standard deviations of all parameters between sessions."""
        root = torch.zeros_like(self.whole[1][0])
        for name, columns in self.effects.items():
            root[columns] = scatter[name]
        return root


def _candidates(laboratory: Laboratory, at: Mapping[tuple[str, tuple[str, ...]], Tensor]) -> Iterator[Candidate]:
    """Yield every fault, throughout and, where sessions have an order, from or up to each of them."""
    whole = frozenset(range(len(laboratory.visits)))
    spans, later = [whole], sorted(set(laboratory.ranks))[1:]  # sessions of one day have no order among them
    for rank in later:
        since = frozenset(k for k, own in enumerate(laboratory.ranks) if own >= rank)
        spans += [since, whole - since]
    places = {name: sum(other == name for other, _ in at) for name, _ in at}
    for (name, where), columns in at.items():
        effect = CATALOGUE[name]
        for k, span in enumerate(spans):
            # Each span is a place of its own, by which rivals are told apart.
            place = Place(where)
            scale, part = effect.scale(place), slice(int(columns[0]), int(columns[-1]) + 1)
            source = ColumnSource(effect, place, part, (0.0,) * len(scale), scale)
            odds = 1.0 if k == 0 else SPANS / (len(spans) - 1)
            yield Candidate(effect, place, source, span, odds / (places[name] * (1.0 + SPANS * bool(later))))


def _spread(
    each: Sequence[tuple[Tensor, Tensor]], where: Sequence[Tensor], length: int
) -> tuple[Float[Tensor, "visits all all"], Float[Tensor, "visits all"]]:
    """What sessions say, of the parameters of all of them: nothing of what one does not have."""
    square = torch.zeros(len(each), length, length, dtype=torch.float64)
    line = torch.zeros(len(each), length, dtype=torch.float64)
    for k, ((information, moment), own) in enumerate(zip(each, where, strict=True)):
        square[k, own[:, None], own], line[k, own] = information, moment
    return square, line


def _statistics(
    base: int,
    information: Float[Tensor, "visits all all"],
    moment: Float[Tensor, "visits all"],
    stated: tuple[Float[Tensor, "visits all all"], Float[Tensor, "visits all"]] | None = None,
) -> Statistics:
    """Sessions as trials, with the part of each that is stated."""
    every = torch.arange(moment.shape[1])
    grams, moments = torch.nn.functional.pad(information, (0, 1, 0, 1)), torch.nn.functional.pad(moment, (0, 1))
    said = [None] * len(moment) if stated is None else [Statements(every, *one) for one in zip(*stated, strict=True)]
    trials = (TrialStatistics(every, *one) for one in zip(grams, moments, said, strict=True))
    return Statistics(base, len(every), tuple(trials))


def without(
    A: Float[Tensor, "visits all all"], b: Float[Tensor, "visits all"], root: Float[Tensor, " all"]
) -> tuple[Float[Tensor, "visits all all"], Float[Tensor, "visits all"], Float[Tensor, " visits"]]:
    """Return information and moments with deviations integrated out, see above, and the log evidence of these [nat].

    Args:
        A: information of each session.
        b: moment of each.
        root: standard deviations of what is a session's own; 0 where it has none.
    """
    some = root.nonzero()[:, 0]
    rows = root[some, None] * torch.cat([A[:, some], b[:, some, None]], 2)
    factor = torch.linalg.cholesky(torch.eye(len(some)).to(A) + rows[:, :, some] * root[some])
    left = torch.linalg.solve_triangular(factor, rows, upper=False)
    less, u = left[..., :-1], left[..., -1]
    nats = 0.5 * u.square().sum(1) - factor.diagonal(dim1=1, dim2=2).log().sum(1)
    return A - less.mT @ less, b - (less.mT @ u[..., None])[..., 0], nats
