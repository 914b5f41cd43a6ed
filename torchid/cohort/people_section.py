"""A cohort's people: the file that ``subject.people`` of a config takes, and the chapter of the page."""

from collections.abc import Iterator, Sequence
from contextlib import suppress

import torch

from torchid.cohort.members import person_of
from torchid.cohort.one_run import Row
from torchid.cohort.people import people_like
from torchid.errors import InputError
from torchid.model.anthropometry import tables_of
from torchid.model.model import Geometry
from torchid.model.people import PARTS, People, own_covariance
from torchid.model.pseudo import com, mass
from torchid.model.whole_body import whole_body
from torchid.report.blocks import Paragraph, Section, Table
from torchid.session.outcome import QualityLevel
from torchid.session.people import people_dataset, read_people
from torchid.session.person import NAME as PERSON
from torchid.session.person import PersonEvidence, read_person, together
from torchid.storage.files import file_sha256, safe_name
from torchid.storage.netcdf import write_netcdf
from torchid.storage.provenance import stage_key
from torchid.storage.results import OutputFolder
from torchid.wording import number, percent, segment, spread

NAME = "people.nc"
"""Of the file in a cohort's folder."""
CLEAR = 2.0
"""Choice. Standard deviations of the mean by which a share of mass is said to differ from the tables."""


def cohort_people(rows: Sequence[Row], folder: OutputFolder) -> People | None:
    """Return what the people of a cohort say of one more, and write it; None where too few say anything.

    Nobody counts whose results are not to be used. Nothing is computed again where no session has changed.

    Args:
        rows: of all members.
        folder: of the cohort, with each member's results, and what an earlier call wrote.

    Raises:
        InputError: the file cannot be written.
    """
    used = [r["subject"] for r in rows if r["status"] == "done" and r["verdict"] != QualityLevel.UNUSABLE.value]
    each = {name: file for name in used if (file := folder.out / safe_name(name) / PERSON).is_file()}
    key = stage_key(people=[[name, file_sha256(file)] for name, file in each.items()])
    with suppress(InputError):
        kept, said = read_people(folder.out / NAME)
        if said == key:
            return kept
    found: dict[str, list[PersonEvidence]] = {}
    for name, file in each.items():
        with suppress(InputError):
            found.setdefault(person_of(name), []).append(read_person(file))
    people = people_like([together(sessions) for sessions in found.values()])
    if people is None:
        (folder.out / NAME).unlink(missing_ok=True)  # of an earlier call with more
    else:
        write_netcdf(folder.path(NAME), [people_dataset(people, key)])
    return people


def people_section(people: People | None) -> Section | None:
    """Return the chapter of the page; None without a prior of people.

    Args:
        people: what a cohort's people say of one more.
    """
    if people is None:
        return None
    lines = list(_shares(people))
    apart = [f"{name} {change}" for name, change, clear, *_ in lines if clear]
    who = f"{people.count} people"
    finding = f"{who}: as in the tables." if not apart else f"{who}; against the tables: {', '.join(apart)} of mass."
    table = Table(
        "Of an adult of medium height and mass. Mean of the group with its standard deviation, and what one person has "
        "about it.",
        (
            "Segment",
            "tables [% of mass]",
            "these people",
            "one person ±",
            "centre of mass moved: forward, left, up [mm]",
        ),
        tuple((name, *cells) for name, _, _, *cells in lines),
    )
    how = Paragraph(
        f"Of what tables leave open, {percent(people.own)} is each person's own. `subject: {{people: {NAME}}}` in a "
        "config begins from these people instead of from the tables alone; leave its own session out of the cohort."
    )
    return Section("people", "People", finding, (table, how))


def _medium() -> Geometry:
    prior = whole_body(None, None).geometry
    return prior.geometry(prior.mean)


def _shares(people: People) -> Iterator[tuple[str, str, bool, str, str, str, str]]:
    """Name of each segment, its change in words, whether it is clear, and the cells of its row; left and right once."""
    tables = tables_of(_medium(), None, None, None, "unknown")
    (before, _), (after, way) = (tables.at(score) for score in (torch.zeros_like(people.score), people.score))
    before, after = before.reshape(-1, 10), after.reshape(-1, 10)
    own = own_covariance(people.own)
    mean_sd, own_sd = (_share_sd(after, way, covariance) for covariance in (people.covariance - own, own))
    share = [mass(one) / mass(one).sum() for one in (before, after)]
    for k, part in enumerate(PARTS):
        if k != PARTS.index(part):
            continue
        change = float(share[1][k] / share[0][k] - 1.0)
        moved = com(after)[k] - com(before)[k]
        clear = abs(float(share[1][k] - share[0][k])) > CLEAR * float(mean_sd[k])
        yield (
            segment(part), f"{'+' if change > 0 else ''}{percent(change)}", clear, number(share[0][k], 1, 100.0),
            spread(share[1][k], mean_sd[k], 1, 100.0), number(own_sd[k], 1, 100.0),
            ", ".join(number(x, 0, 1e3) for x in moved),
        )  # fmt: skip


def _share_sd(phi: torch.Tensor, way: torch.Tensor, covariance: torch.Tensor) -> torch.Tensor:
    """Standard deviations of the segments' shares of the mass."""
    total = mass(phi).sum()
    share = mass(phi) / total
    lever = (way[::10] - share[:, None] * way[::10].sum(0)) / total
    return ((lever @ covariance) * lever).sum(1).clamp(min=0.0).sqrt()
