"""Faults of a laboratory's instruments, told by all of its sessions together.

What a session says of lasting faults is information and a moment (``LaboratoryEvidence``). With parameters theta of
the laboratory, a session has theta + delta of its own, delta ~ N(0, D): what its body does that looks like such a
fault, and what the fault varies by. With delta integrated out,

    log p(session | theta) = b*' theta - theta' A* theta / 2 + constant,
    A* = A - A R M^-1 R A,  b* = b - A R M^-1 R b,  R = D^(1/2),  M = 1 + R A R,

so that sessions are to a laboratory what trials are to a session, and the same scan names its faults, with the consent
of each session. D has one variance for each effect, of the sizes that sound sessions seem to have (``SIZES``), the
likeliest of them. A fault may also begin or end between two sessions. Forces of all bodies come late by themselves
(``USUAL_LAG_S``), which a clock has to exceed: that lag, with its mean, is one more parameter of the laboratory.

Reference: Laird & Ware, Biometrics 38:963 (1982), on such random effects.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.checks.clocks import USUAL_LAG_S
from torchid.cohort.laboratories import Laboratory, Visit, parameters_of
from torchid.diagnosis.candidates.candidate import Candidate, ColumnSource
from torchid.diagnosis.evidence.apparent import SIZES, shares_of
from torchid.diagnosis.evidence.gains import gains
from torchid.diagnosis.evidence.posterior import fit
from torchid.diagnosis.evidence.statistics import Statistics, TrialStatistics
from torchid.diagnosis.options import NamingOptions
from torchid.diagnosis.search.rivals import Round, shares, twins
from torchid.diagnosis.search.scan import scan_all
from torchid.diagnosis.verdict.causes import parameter_table
from torchid.effects.catalogue import CATALOGUE
from torchid.effects.parameter import propagated
from torchid.effects.place import SESSION, Place
from torchid.effects.timing import TimeOffset
from torchid.observation.statements import Statements

MOST = 6
"""Faults of a laboratory that are named at most; chosen: more are no laboratory's."""
SPANS = 0.2
"""Odds of all spans of sessions together, against all sessions; chosen, as for single trials of a clock."""
COMMON = 0.5 / (7 + 1)
"""Share of laboratories all of whose sound sessions seem to have as much of an effect as one that has it: none of the
seven whose sessions gave ``SIZES``, by Jeffreys' prior (Proc R Soc A 186:453 (1946)); derived."""
BODIES_LAG_S = sum(USUAL_LAG_S.values()) / len(USUAL_LAG_S)
"""Mean over laboratories, and as large its standard deviation, of the lag of bodies [s]; derived."""
SWEEPS = 2
"""Times that the variances of all effects are chosen in turn; resolution."""


@dataclass(frozen=True)
class SharedFault:
    """A fault that sessions of a laboratory share."""

    effect: str
    """Name of the effect."""
    where: tuple[str, ...]
    """Names of its place, plates by the laboratory's names."""
    place: Place
    """Its place."""
    parameters: dict[str, dict[str, Tensor]]
    """``value`` and ``sd`` by key."""
    confidence: float
    """Probability that it, or one that cannot be told from it, is there."""
    indistinguishable: tuple[tuple[str, tuple[str, ...]], ...]
    """Effects and places that cannot be told from it."""
    first: str
    """Name of the first session that has it."""
    last: str
    """Name of the last session that has it."""
    visits: tuple[str, ...]
    """Names of all sessions that have it."""
    nats: float
    """Log odds that it is there, before rivals [nat]."""


@dataclass(frozen=True)
class LaboratoryVerdict:
    """What all sessions of a laboratory say together."""

    laboratory: Laboratory
    """Its sessions."""
    faults: tuple[SharedFault, ...]
    """What is wrong with its instruments, in the order in which it was named."""
    scatter: dict[str, float]
    """Standard deviation of each effect between sessions, in units of its prior."""


def pooled(laboratory: Laboratory, options: NamingOptions = NamingOptions()) -> LaboratoryVerdict:
    """Return what the sessions of a laboratory say of its instruments together.

    Args:
        laboratory: its sessions.
        options: thresholds of naming, those of a single session.
    """
    pool = _Pool.of(laboratory)
    chosen: list[Candidate] = []
    rounds: list[Round] = []
    scatter = pool.likeliest(chosen, dict.fromkeys(pool.effects, 0.0))
    while len(chosen) < MOST:
        left = [one for one in pool.candidates if one not in chosen]
        if not left:
            break
        closer, varies = pool.closer(chosen, left, scatter)
        scan = scan_all(pool.statistics(closer), left, chosen, options, largest=COMMON).round
        if scan.named is None:
            break
        rounds.append(replace(scan, appearance=max(scan.appearance, varies)))
        chosen.append(replace(scan.named.candidate, ordinary=rounds[-1].ordinary))
        scatter = pool.likeliest(chosen, closer)
    found = (
        pool.fault(k, chosen, rounds, scatter) for k, one in enumerate(chosen) if not one.ordinary
    )  # of the others nothing tells that they are more than bodies do
    return LaboratoryVerdict(laboratory, tuple(found), scatter)


@dataclass(frozen=True)
class _Pool:
    """Sessions as trials of a design that has a column for each parameter of each fault, behind that of bodies' lag."""

    visits: tuple[Visit, ...]
    candidates: tuple[Candidate, ...]
    base: int
    """Number of columns of what bodies are like."""
    effects: dict[str, Tensor]
    """Columns of each effect."""
    whole: tuple[Float[Tensor, "visits all all"], Float[Tensor, "visits all"]]
    """Information and moment of each session, of all parameters."""
    bare: tuple[Float[Tensor, "visits all all"], Float[Tensor, "visits all"]]
    """The same without statements that need no body model."""

    @classmethod
    def of(cls, laboratory: Laboratory) -> "_Pool":
        at, length = parameters_of(laboratory.visits)
        clock = at.get((TimeOffset.name, SESSION.where))
        base = 0 if clock is None else 1
        effects: dict[str, list[Tensor]] = {}
        for (name, _), columns in at.items():
            effects.setdefault(name, []).append(columns)
        each = [visit.evidence for visit in laboratory.visits]
        where = [torch.cat([at[fault] for fault in one.faults] or [torch.arange(0)]) for one in each]
        whole = _beside_bodies(*_spread([(one.information, one.moment) for one in each], where, length), clock)
        stated = _spread([(one.stated_information, one.stated_moment) for one in each], where, length)
        stated = _beside_bodies(*stated, clock)
        bare = whole[0] - stated[0], whole[1] - stated[1]
        every = {name: base + torch.cat(some) for name, some in effects.items()}
        columns = {fault: base + own for fault, own in at.items()}
        return cls(laboratory.visits, tuple(_candidates(laboratory, columns)), base, every, whole, bare)

    def likeliest(self, chosen: Sequence[Candidate], scatter: Mapping[str, float]) -> dict[str, float]:
        """Return the standard deviation of each effect between sessions that is likeliest beside the chosen faults."""
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
        information, moment, nats = _without(*self.whole, self._root(scatter))
        return fit(_statistics(self.base, information, moment), chosen).log_evidence + float(nats.sum())

    def statistics(self, scatter: Mapping[str, float]) -> Statistics:
        """Return statistics of all sessions in which what varies between them is integrated out."""
        root = self._root(scatter)
        information, moment, _ = _without(*self.whole, root)
        less, weaker, _ = _without(*self.bare, root)
        return _statistics(self.base, information, moment, (information - less, moment - weaker))

    def _root(self, scatter: Mapping[str, float]) -> Float[Tensor, " all"]:
        """Standard deviations of all parameters between sessions."""
        root = torch.zeros_like(self.whole[1][0])
        for name, columns in self.effects.items():
            root[columns] = scatter[name]
        return root

    def fault(
        self, k: int, chosen: Sequence[Candidate], rounds: Sequence[Round], scatter: Mapping[str, float]
    ) -> SharedFault:
        """Return the k-th chosen candidate as a fault, against the rivals of the round that named it."""
        one, scan = chosen[k], rounds[k]
        own, others = shares(scan, one)
        alike = twins(others, most=2)
        # What is only ordinary would share the size of what is named.
        named = [other for other in chosen if not other.ordinary]
        posterior = fit(self.statistics(self.likeliest(named, scatter)), named)
        first = self.base + sum(c.size for c in named[: next(j for j, other in enumerate(named) if other is one)])
        part = slice(first, first + one.size)
        scale = one.relative * torch.tensor(one.source.scale, dtype=torch.float64)
        theta, covariance = scale * posterior.mean[part], scale[:, None] * posterior.covariance[part, part] * scale
        told = propagated(lambda x: one.effect.named(one.place, x), theta, covariance)
        names = tuple(self.visits[j].name for j in sorted(one.trials))
        return SharedFault(
            one.effect.name, one.place.where, one.place, parameter_table(told),
            min(1.0, own.weight + sum(twin.weight for twin in alike)),
            tuple((s.rival.candidate.effect.name, s.rival.candidate.place.where) for s in alike),
            names[0], names[-1], names, scan.family(scan.rivals[0]),
        )  # fmt: skip


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


def _beside_bodies(
    information: Float[Tensor, "visits n n"], moment: Float[Tensor, "visits n"], clock: Tensor | None
) -> tuple[Float[Tensor, "visits all all"], Float[Tensor, "visits all"]]:
    """What sessions say of faults, beside the lag of bodies, as the first column, with its mean taken off."""
    if clock is None:
        return information, moment
    usual = torch.zeros(1, moment.shape[1], dtype=torch.float64)
    usual[0, clock] = BODIES_LAG_S / TimeOffset().scale(SESSION)[0]
    both = torch.cat([usual, torch.eye(moment.shape[1], dtype=torch.float64)])
    return both @ information @ both.mT, (moment - information @ usual[0]) @ both.mT


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


def _without(
    A: Float[Tensor, "visits all all"], b: Float[Tensor, "visits all"], root: Float[Tensor, " all"]
) -> tuple[Float[Tensor, "visits all all"], Float[Tensor, "visits all"], Float[Tensor, " visits"]]:
    """Information and moments with deviations integrated out, see above, and the log evidence of these [nat]."""
    some = root.nonzero()[:, 0]
    rows = root[some, None] * torch.cat([A[:, some], b[:, some, None]], 2)
    factor = torch.linalg.cholesky(torch.eye(len(some)).to(A) + rows[:, :, some] * root[some])
    left = torch.linalg.solve_triangular(factor, rows, upper=False)
    less, u = left[..., :-1], left[..., -1]
    nats = 0.5 * u.square().sum(1) - factor.diagonal(dim1=1, dim2=2).log().sum(1)
    return A - less.mT @ less, b - (less.mT @ u[..., None])[..., 0], nats
