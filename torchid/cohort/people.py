"""A cohort's people as the prior of one more: ``people.nc``, and what it says on the page.

People are exchangeable draws (``model.people``): with a person's own scores integrated out (``pool.without``), what is
left of each is information on the mean of the group, and these add up. The share r that is each person's own is the
likeliest of ``OWN``: people who differ from the tables in their own way each leave the tables as they are.

Reference: Carlin & Louis, Bayesian Methods for Data Analysis (2008), ch. 5, on empirical Bayes.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.cohort.pool import without
from torchid.model.people import People, axes, own_covariance, shared
from torchid.session.person import PersonEvidence

OWN = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.99)
"""Resolution. Shares of the tables' variance that may be each person's own."""
FEWEST = 3
"""Choice. People from which on they are a prior of another: two tell what varies between them from one number."""


@dataclass(frozen=True)
class _Group:
    """What people say of the mean of their group."""

    information: Float[Tensor, "means means"]
    moment: Float[Tensor, " means"]
    nats: float
    """Log evidence [nat]."""


def people_like(found: Sequence[PersonEvidence]) -> People | None:
    """Return what people say of one more; None where too few say anything.

    Args:
        found: of each person, all sessions together.
    """
    if len(found) < FEWEST:
        return None
    T, means = axes(), shared().shape[1]
    A = torch.stack([T.mT @ one.information @ T for one in found])
    b = torch.stack([T.mT @ one.moment for one in found])
    groups = {own: _group(A, b, own, means) for own in OWN}
    own = max(groups, key=lambda r: groups[r].nats)
    covariance = torch.linalg.inv(groups[own].information + torch.eye(means).to(T) / (1.0 - own))
    B = T[:, :means]
    score = B @ (covariance @ groups[own].moment)
    return People(score, B @ covariance @ B.mT + own_covariance(own), len(found), own)


def _group(A: Float[Tensor, "people all all"], b: Float[Tensor, "people all"], own: float, means: int) -> _Group:
    """People with each one's own integrated out, and the evidence with the mean integrated out as well."""
    root = torch.ones_like(b[0])
    root[:means] = own**0.5
    left, pull, nats = without(A, b, root)
    information, moment = left.sum(0)[:means, :means], pull.sum(0)[:means]
    _, _, more = without(information[None], moment[None], torch.full_like(moment, 1.0 - own).sqrt())
    return _Group(information, moment, float(nats.sum() + more[0]))
