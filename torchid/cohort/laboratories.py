"""Laboratories of a cohort: sessions on the same plates, and each plate under one name."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from datetime import date
from itertools import count

import torch
from torch import Tensor

from torchid.diagnosis.evidence.laboratory import Fault, LaboratoryEvidence
from torchid.session.laboratory import LaboratoryPlate, SessionEvidence, names_in, renamed


@dataclass(frozen=True)
class Visit:
    """One session of a laboratory."""

    name: str
    """Of the member whose session it is."""
    when: str
    """The table's word for the session, which orders them; empty where it has none."""
    evidence: LaboratoryEvidence
    """What it says, with the laboratory's names of the plates."""


@dataclass(frozen=True)
class Laboratory:
    """Sessions whose instruments are the same."""

    name: str
    """As the table has it, with a number where others without a common plate have it, too; or ``laboratory_1`` and so
    on."""
    plates: tuple[LaboratoryPlate, ...]
    """Plates of all sessions."""
    visits: tuple[Visit, ...]
    """Sessions: in the order of time where all tell theirs, else in that of the table."""
    ranks: tuple[int, ...] = ()
    """Rank of each session in time, alike where these are; none where not all tell theirs."""


def laboratories(
    found: Mapping[str, SessionEvidence], labels: Mapping[str, Mapping[str, str]]
) -> tuple[Laboratory, ...]:
    """Return the laboratories in which sessions were recorded.

    Sessions belong together whose plates are in the same places, unless the table calls their laboratories by different
    names; without corners of plates, only where it calls them by one. Those without any plate that another one has are
    a laboratory each.

    Args:
        found: what each session says, by its name.
        labels: what a table says of each: ``laboratory``, ``session``.
    """
    every: list[Laboratory] = []
    # Those with a name come first, so that who has none joins them and cannot hold two names together.
    for name in sorted(found, key=lambda one: not labels.get(one, {}).get("laboratory")):
        said = labels.get(name, {})
        known = next((k for k, one in enumerate(every) if _shares(one, found[name], said)), None)
        home = Laboratory(said.get("laboratory") or "", (), ()) if known is None else every[known]
        grown = _with(home, name, said.get("session", ""), found[name])
        if known is None:
            every.append(grown)
        else:
            every[known] = grown
    order = {name: k for k, name in enumerate(found)}
    names = _distinct([one.name for one in every])
    return tuple(_in_time(replace(one, name=name), order) for one, name in zip(every, names, strict=True))


def _distinct(names: Sequence[str]) -> Iterator[str]:
    """Names of which no two are alike, even to disks that know no case: a laboratory's file goes by its name."""
    taken, wanted = set[str](), {name.casefold() for name in names}
    for name in names:
        numbered = (f"{name or 'laboratory'}_{k}" for k in count(2 if name else 1))
        free = (one for one in numbered if one.casefold() not in taken | wanted)
        own = name if name and name.casefold() not in taken else next(free)
        taken.add(own.casefold())
        yield own


def _in_time(home: Laboratory, order: Mapping[str, int]) -> Laboratory:
    """The laboratory with its sessions in order, by dates or by numbers where all have such."""
    visits = sorted(home.visits, key=lambda one: order[one.name])
    for read in (date.fromisoformat, float):
        with suppress(ValueError):
            when = {one.name: read(one.when) for one in visits}
            ranks = {moment: k for k, moment in enumerate(sorted(set(when.values())))}
            visits = sorted(visits, key=lambda one: ranks[when[one.name]])
            return replace(home, visits=tuple(visits), ranks=tuple(ranks[when[one.name]] for one in visits))
    return replace(home, visits=tuple(visits))


def _shares(home: Laboratory, session: SessionEvidence, said: Mapping[str, str]) -> bool:
    """Whether a session was recorded in a laboratory: on one of its plates, and under no other name.

    In many laboratories feet bear in the same places: without corners, plates are the same where the table says so.
    """
    if said.get("laboratory") and said["laboratory"] != home.name:
        return False
    surveyed = [one for one in session.plates if said.get("laboratory") or bool(one.corners.isfinite().all())]
    return bool(names_in(home.plates, surveyed))


def _with(home: Laboratory, name: str, when: str, session: SessionEvidence) -> Laboratory:
    """The laboratory with one more session, and the plates that are new with it."""
    called, plates = names_in(home.plates, session.plates), list(home.plates)
    for one in session.plates:
        if one.frame.name not in called:
            called[one.frame.name] = f"plate_{len(plates) + 1}"
            plates.append(replace(one, frame=replace(one.frame, name=called[one.frame.name])))
    visit = Visit(name, when, renamed(session.evidence, called))
    return replace(home, plates=tuple(plates), visits=(*home.visits, visit))


def parameters_of(visits: Sequence[Visit]) -> tuple[dict[Fault, Tensor], int]:
    """Return where the parameters of each fault stand in a vector of those of all sessions, and its length.

    Args:
        visits: sessions of a laboratory.
    """
    at: dict[Fault, Tensor] = {}
    length = 0
    for visit in visits:
        for fault, size in zip(visit.evidence.faults, visit.evidence.sizes, strict=True):
            if fault not in at:
                at[fault] = torch.arange(length, length + size)
                length += size
    return at, length
