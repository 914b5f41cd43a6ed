"""Faults of a laboratory's instruments, told by all of its sessions together.

Sessions are to a laboratory what trials are to a session (``pool.py``), and the same scan names its faults, with the
consent of each session. A fault may also begin or end between two sessions.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from torchid.cohort.laboratories import Laboratory
from torchid.cohort.pool import Pool
from torchid.diagnosis.candidates.candidate import Candidate
from torchid.diagnosis.evidence.laboratory import LaboratoryEvidence
from torchid.diagnosis.evidence.posterior import fit
from torchid.diagnosis.options import NamingOptions
from torchid.diagnosis.search.rivals import Round, shares, twins
from torchid.diagnosis.search.scan import scan_all
from torchid.diagnosis.verdict.causes import parameter_table
from torchid.effects.parameter import propagated
from torchid.effects.place import Place

MOST = 6
"""Faults of a laboratory that are named at most; chosen: more are no laboratory's."""
COMMON = 0.5 / (7 + 1)
"""Share of laboratories all of whose sound sessions seem to have as much of an effect as one that has it: none of the
seven whose sessions gave ``SIZES``, by Jeffreys' prior (Proc R Soc A 186:453 (1946)); derived."""


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
    expected: LaboratoryEvidence
    """What they say of one more session, on plates by the laboratory's names."""


def pooled(laboratory: Laboratory, options: NamingOptions = NamingOptions()) -> LaboratoryVerdict:
    """Return what the sessions of a laboratory say of its instruments together.

    Args:
        laboratory: its sessions.
        options: thresholds of naming, those of a single session.
    """
    pool = Pool.of(laboratory)
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
    # Of the others nothing tells that they are more than bodies do; they would share the size of what is named.
    named = [one for one in chosen if not one.ordinary]
    beside = pool.likeliest(named, scatter)
    found = (
        _fault(pool, named, one, scan, beside) for one, scan in zip(chosen, rounds, strict=True) if not one.ordinary
    )
    return LaboratoryVerdict(laboratory, tuple(found), scatter, pool.for_next(beside, _as_the_last(pool, named)))


def _as_the_last(pool: Pool, named: Sequence[Candidate]) -> list[int]:
    """Return indices of the sessions that have the faults of the last one, and no others."""
    last = len(pool.visits) - 1
    return [k for k in range(last + 1) if all((k in one.trials) == (last in one.trials) for one in named)]


def _fault(
    pool: Pool, named: Sequence[Candidate], one: Candidate, scan: Round, scatter: Mapping[str, float]
) -> SharedFault:
    """Return one of the named candidates as a fault, against the rivals of the round that named it."""
    own, others = shares(scan, one)
    alike = twins(others, most=2)
    posterior = fit(pool.statistics(scatter), named)
    before = next(j for j, other in enumerate(named) if other is one)
    first = pool.base + sum(c.size for c in named[:before])
    part = slice(first, first + one.size)
    scale = one.relative * torch.tensor(one.source.scale, dtype=torch.float64)
    theta, covariance = scale * posterior.mean[part], scale[:, None] * posterior.covariance[part, part] * scale
    told = propagated(lambda x: one.effect.named(one.place, x), theta, covariance)
    names = tuple(pool.visits[j].name for j in sorted(one.trials))
    return SharedFault(
        one.effect.name, one.place.where, one.place, parameter_table(told),
        min(1.0, own.weight + sum(twin.weight for twin in alike)),
        tuple((s.rival.candidate.effect.name, s.rival.candidate.place.where) for s in alike),
        names[0], names[-1], names, scan.family(scan.rivals[0]),
    )  # fmt: skip
