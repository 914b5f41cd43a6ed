"""What a run keeps of its person's body for others like this one: ``person.nc``.

Rows of forces are information on inertial parameters, in the information form of a normal distribution. It is kept as
information on scores (``model.people``), in which people of different build are alike. What geometry and motion leave
open (``extension.open_geometry``) is noise of the rows to it.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import torch
import xarray
from jaxtyping import Float
from torch import Tensor

from torchid.config import Config
from torchid.config.sections import Subject
from torchid.errors import Note
from torchid.inertia.identify import Identified
from torchid.inertia.spectrum import cholesky
from torchid.model.anthropometry import tables_of
from torchid.model.people import SCORES
from torchid.session.outcome import Outcome
from torchid.session.people import FORM, numbers_of, people_of
from torchid.session.unseen import UNSEEN, unseen_mass
from torchid.wording import number

NAME = "person.nc"
"""Of the file in a run's folder."""
NOTHING = 1e-9
"""Resolution. Information, over the prior's, below which the rows say nothing of a direction."""
USED, LEFT, UNLIKE = "people.used", "people.left", "people.unlike"
"""Codes of the notes on people: the inertia begins from them; it does not; it does, and forces speak against it."""
UNLIKE_ODDS = 10.0
"""Cited. Times as likely under the tables alone from which on a person is unlike the people: strong evidence (Kass &
Raftery, J Am Stat Assoc 90:773 (1995), from 10 or 20)."""
MOST_SAID = 1e6
"""Wording. Odds beyond which a number of digits says nothing."""
Wide = Float[Tensor, "params params"]


@dataclass(frozen=True)
class PersonEvidence:
    """What rows of forces say of a person's scores."""

    information: Float[Tensor, "scores scores"]
    """Information on the scores."""
    moment: Float[Tensor, " scores"]
    """Moment of the data: scores would be estimated as the information's inverse times it."""

    def nats(self, score: Float[Tensor, " scores"], covariance: Float[Tensor, "scores scores"]) -> float:
        """Return the log evidence of normal scores, up to a constant of the rows [nat].

        Args:
            score: their mean.
            covariance: of them.
        """
        factor = torch.linalg.cholesky(covariance)
        pull = factor.mT @ (self.moment - self.information @ score)
        own = torch.linalg.cholesky(torch.eye(len(pull)).to(pull) + factor.mT @ self.information @ factor)
        left = torch.linalg.solve_triangular(own, pull[:, None], upper=False)
        at_mean = self.moment @ score - 0.5 * score @ self.information @ score
        return float(at_mean + 0.5 * left.square().sum() - own.diagonal().log().sum())


def person_evidence(outcome: Outcome, who: Subject) -> PersonEvidence | None:
    """Return what a session says of its person's body.

    Args:
        outcome: up to the deviations of its inertia.
        who: the subject, on whose tables scores are: of a record that was corrected, the corrected one.

    Returns:
        None without an identified body, of a model from a file, under a prior that is not normal, and of a body most of
        which nobody saw moving.
    """
    config, found = outcome.config, outcome.identified
    if found is None or config.model != "whole_body" or config.inertia.prior != "quadratic":
        return None
    if unseen_mass(outcome.fit, outcome.prior)[0] > UNSEEN:
        return None
    mean, way = tables_of(outcome.fit.geometry, *who.known).at(torch.zeros(SCORES, dtype=torch.float64))
    factor = cholesky(found.fit.prior.covariance)
    information, moment = _told(found, factor)
    away = _white(factor, (mean - found.fit.prior.mean.reshape(-1))[:, None])[:, 0]
    into = _white(factor, way)
    return PersonEvidence(into.mT @ information @ into, into.mT @ (moment - information @ away))


def together(sessions: Sequence[PersonEvidence]) -> PersonEvidence:
    """Return what sessions of one person say: his scores are the same in all.

    Args:
        sessions: one or more.
    """
    information = torch.stack([one.information for one in sessions]).sum(0)
    return PersonEvidence(information, torch.stack([one.moment for one in sessions]).sum(0))


def _white(factor: Wide, x: Float[Tensor, "params _"]) -> Float[Tensor, "params _"]:
    return torch.linalg.solve_triangular(factor, x, upper=False)


def _told(found: Identified, factor: Wide) -> tuple[Wide, Float[Tensor, " params"]]:
    """Information and moment of the rows about the mean of the fit's prior, in its standard deviations.

    With geometry and motion for known these are A = Q diag(a) Q' and b = A x + noise of covariance A. An error of the
    estimate with covariance M, S b where S is the fit's covariance, is one of b with S^-1 M S^-1. So what a^(-1/2) Q' b
    says of x has a^(1/2) Q' for its design, and 1 + N for its noise, N = a^(-1/2) Q' S^-1 M S^-1 Q a^(-1/2).
    """
    fit, sums = found.fit, found.equations
    information = fit.omega_1 * factor.mT @ sums.gram @ factor
    pull = fit.omega_1 * factor.mT @ (sums.moment - sums.gram @ fit.prior.mean.reshape(-1))
    precise = torch.linalg.inv(_white(factor, _white(factor, found.of_rows).mT))
    more = _white(factor, _white(factor, fit.covariance - found.of_rows).mT)
    a, Q = torch.linalg.eigh(0.5 * (information + information.mT))
    some = a > NOTHING
    root, Q = a[some].sqrt(), Q[:, some]
    whitened = (Q / root).mT
    noise = torch.eye(len(root)).to(root) + whitened @ precise @ more @ precise @ whitened.mT
    seen = _white(torch.linalg.cholesky(noise), torch.cat([(Q * root).mT, (whitened @ pull)[:, None]], 1))
    design, told = seen[:, :-1], seen[:, -1]
    return design.mT @ design, design.mT @ told


def people_note(config: Config) -> Iterator[Note]:
    """Yield what the inertia begins from where that is not the tables alone.

    Args:
        config: that may name people.
    """
    people = people_of(config.model, config.subject)
    if people is not None:
        said = f"inertia begins from tables as {people.count} people of a cohort changed them"
        yield Note(USED, said, str(config.subject.people))


def unlike_note(outcome: Outcome, evidence: PersonEvidence | None) -> Iterator[Note]:
    """Yield that forces speak for the tables alone, against the people whom a subject was said to be like.

    Args:
        outcome: up to the deviations of its inertia.
        evidence: what it says of its person's body; None: nothing.
    """
    people = people_of(outcome.config.model, outcome.config.subject)
    if people is None or evidence is None:
        return
    tables = evidence.nats(torch.zeros(SCORES).to(people.score), torch.eye(SCORES).to(people.score))
    odds = torch.tensor(tables - evidence.nats(people.score, people.covariance)).exp()
    if odds > UNLIKE_ODDS:
        times = number(odds.clamp(max=MOST_SAID), 0)
        said = f"forces are {times} times as likely under the tables alone: leave subject.people out"
        yield Note(UNLIKE, said, str(outcome.config.subject.people))


def person_dataset(evidence: PersonEvidence) -> xarray.Dataset:
    """Return the content of ``person.nc``.

    Args:
        evidence: of a session.
    """
    return xarray.Dataset(
        {
            "information": (("score", "other"), evidence.information.numpy()),
            "moment": (("score",), evidence.moment.numpy()),
        },
        attrs={"form": FORM, "meaning": "what forces say of the body, in standard deviations of the tables"},
    )


def read_person(path: Path) -> PersonEvidence:
    """Return what a finished run says of its person's body.

    Args:
        path: of its ``person.nc``.

    Raises:
        InputError: ``people.unreadable``, ``people.form``.
    """
    _, (information, moment) = numbers_of(path, {"information": (SCORES, SCORES), "moment": (SCORES,)})
    return PersonEvidence(information, moment)
