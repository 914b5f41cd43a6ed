"""This module lets earlier sessions of a laboratory speak of the instruments in one more.

They say it as ``LaboratoryEvidence``, by names of plates that are the session's own. It enters the model as statements,
an equal share of it in each trial. A session may also be unlike the others: with parameters theta of the laboratory and
delta of one fault that this session alone has, both of unit priors, theta integrated out, the information on delta is

    B = A - A (A + E + 1)^-1 A,  its moment  c = a - A (A + E + 1)^-1 (a + e),

where A, a are the session's own information and moment and E, e those of the others. The evidence for delta over none
is that of any effect (MacKay, Neural Computation 4:415 (1992)).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchid.checks.clocks import USUAL_LAG_S
from torchid.diagnosis.columns.design import Design
from torchid.diagnosis.evidence.laboratory import Fault, LaboratoryEvidence
from torchid.effects.place import SESSION
from torchid.effects.timing import TimeOffset
from torchid.observation.statements import Statements

BODIES_LAG_S = sum(USUAL_LAG_S.values()) / len(USUAL_LAG_S)
"""Mean over laboratories, and as large its standard deviation, of the lag of bodies [s]; derived."""
CLOCK: Fault = (TimeOffset.name, SESSION.where)
"""Resolution. The fault that looks like bodies' lag."""


@dataclass(frozen=True)
class Unlike:
    """A fault by which a session is unlike earlier ones of its laboratory."""

    effect: str
    """Name of the effect."""
    where: tuple[str, ...]
    """Names of its place."""
    nats: float
    """Log evidence that the session has another amount of it than they, less what the search costs [nat]."""


def beside_bodies(
    information: Float[Tensor, "*many n n"], moment: Float[Tensor, "*many n"], clock: Int[Tensor, " one"] | None
) -> tuple[Float[Tensor, "*many all all"], Float[Tensor, "*many all"]]:
    """Return information and moment beside the lag of bodies, as the first parameter, with its mean taken off; as they
    are where no clock is asked about.

    Args:
        information: of parameters of faults.
        moment: of the same.
        clock: index of the clock's among them.
    """
    if clock is None:
        return information, moment
    usual = torch.zeros(1, moment.shape[-1], dtype=torch.float64)
    usual[0, clock] = BODIES_LAG_S / TimeOffset().scale(SESSION)[0]
    both = torch.cat([usual, torch.eye(moment.shape[-1], dtype=torch.float64)])
    return both @ information @ both.mT, (moment - information @ usual[0]) @ both.mT


def integrated_out(
    information: Float[Tensor, "all all"], moment: Float[Tensor, " all"], kept: Int[Tensor, " kept"]
) -> tuple[Float[Tensor, "kept kept"], Float[Tensor, " kept"]]:
    """Return information and moment of some parameters, all others, of unit priors, integrated out.

    Args:
        information: of all parameters.
        moment: of all parameters.
        kept: indices of those to keep.
    """
    gone = torch.ones(len(moment), dtype=torch.bool)
    gone[kept] = False
    rows = torch.cat([information[gone][:, kept], moment[gone, None]], 1)
    factor = torch.linalg.cholesky(information[gone][:, gone] + torch.eye(int(gone.sum())).to(information))
    left = torch.linalg.solve_triangular(factor, rows, upper=False)
    less, u = left[:, :-1], left[:, -1]
    return information[kept][:, kept] - less.mT @ less, moment[kept] - less.mT @ u


def among(evidence: LaboratoryEvidence, faults: Sequence[Fault]) -> LaboratoryEvidence:
    """Return the evidence of those faults that are among some, in their order, the others integrated out.

    Args:
        evidence: of faults.
        faults: effect and place of some.
    """
    at = evidence.at
    some = tuple(one for one in faults if one in at)
    kept = torch.cat([at[one] for one in some] or [torch.arange(0)])
    whole = integrated_out(evidence.information, evidence.moment, kept)
    bare = integrated_out(
        evidence.information - evidence.stated_information, evidence.moment - evidence.stated_moment, kept
    )
    sizes = tuple(len(at[one]) for one in some)
    return LaboratoryEvidence(some, sizes, *whole, whole[0] - bare[0], whole[1] - bare[1])


def statements_of(design: Design, earlier: LaboratoryEvidence) -> Statements:
    """Return what earlier sessions say, in terms of the parameters of a design's columns.

    Args:
        design: columns of all trials.
        earlier: what they say.
    """
    at = {(one.effect.name, one.place.where): one for one in design.candidates}
    told = among(earlier, [fault for fault in at if fault in earlier.at])
    places = [at[fault] for fault in told.faults]
    columns = torch.cat([one.columns for one in places] or [torch.arange(0)])
    scale = torch.tensor([sd for one in places for sd in one.effect.scale(one.place)], dtype=torch.float64)
    order = columns.argsort()
    gram = told.information / scale[:, None] / scale
    return Statements(columns[order], gram[order][:, order], (told.moment / scale)[order])


def with_earlier(design: Design, earlier: LaboratoryEvidence | None) -> Design:
    """Return the design with what earlier sessions say, an equal share of it in each trial: none of them said it.

    Args:
        design: columns of all trials.
        earlier: what they say; None: nothing.
    """
    if earlier is None:
        return design
    share = statements_of(design, earlier).times(1.0 / len(design.trials))
    trials = []
    for one in design.trials:
        before = one.terms.stated
        trials.append(replace(one, terms=replace(one.terms, stated=share if before is None else before + share)))
    return replace(design, trials=tuple(trials))


def unlike(own: LaboratoryEvidence, earlier: LaboratoryEvidence) -> Unlike | None:
    """Return the fault by which a session differs most from earlier ones; None where they speak of no common fault.

    Args:
        own: what the session says by itself, its bodies' lag among it.
        earlier: what the others say.
    """
    common = tuple(fault for fault in own.faults if fault in earlier.at)
    if not common:
        return None
    others, (information, moment) = among(earlier, common), _without_lag(own)
    # What the others say nothing of is not there, as long as nobody names it: with all of it open, nothing is unlike.
    kept = torch.cat([own.at[fault] for fault in common])
    A, a = information[kept][:, kept], moment[kept]
    factor = torch.linalg.cholesky(A + others.information + torch.eye(len(a)).to(A))
    B = A - A @ torch.cholesky_solve(A, factor)
    c = a - A @ torch.cholesky_solve((a + others.moment)[:, None], factor)[:, 0]
    nats = {fault: _gain(B[at][:, at], c[at]) for fault, at in others.at.items()}
    worst = max(nats, key=nats.__getitem__)
    return Unlike(*worst, nats[worst] - math.log(len(nats)))


def _without_lag(own: LaboratoryEvidence) -> tuple[Float[Tensor, "all all"], Float[Tensor, " all"]]:
    """Information and moment with the lag of bodies integrated out."""
    if (clock := own.at.get(CLOCK)) is None:
        return own.information, own.moment
    faults = torch.arange(1, len(own.moment) + 1)
    return integrated_out(*beside_bodies(own.information, own.moment, clock), faults)


def _gain(information: Float[Tensor, "n n"], moment: Float[Tensor, " n"]) -> float:
    """Log evidence for parameters of unit priors over none [nat]."""
    factor = torch.linalg.cholesky(information + torch.eye(len(moment)).to(information))
    half = torch.linalg.solve_triangular(factor, moment[:, None], upper=False)
    return float(0.5 * half.square().sum() - factor.diagonal().log().sum())
