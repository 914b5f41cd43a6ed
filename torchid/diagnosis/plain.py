"""Contacts that were plain before anything was searched, as causes."""

import math
from collections.abc import Sequence
from dataclasses import replace

import torch

from torchid.diagnosis.gross import EFFECT, Gross
from torchid.diagnosis.rivals import ALIKE, TWINS
from torchid.diagnosis.verdict import RIVALS, Alternative, Cause, Diagnosis, Twin


def with_gross(found: Diagnosis, some: Sequence[Gross]) -> Diagnosis:
    """The verdict with contacts that were plain before anything was searched, first."""
    causes = tuple(_plain(one) for one in some)
    return replace(found, causes=(*causes, *found.causes), aside=tuple(i for one in some for i in one.aside))


def _plain(one: Gross) -> Cause:
    assert one.place.when is not None
    order = sorted(one.odds.items(), key=lambda both: -both[1])
    listed = tuple(Alternative(EFFECT.name, (name,), odds) for name, odds in order if name not in one.place.where)
    alike = [a for a in listed if a.confidence > math.exp(-ALIKE) * order[0][1]][:TWINS]
    twins = tuple(Twin(a.effect, a.where, a.confidence) for a in alike)
    told = EFFECT.estimated(one.place, one.theta, torch.diag(one.sd.square()))
    parameters = {key: {"value": value, "sd": sd} for key, (value, sd) in told.items()}
    confidence = min(1.0, order[0][1] + sum(t.confidence for t in twins))
    alternatives = tuple(a for a in listed if a.confidence > 1e-3)[:RIVALS]
    return Cause(
        EFFECT.name, one.place.where, one.place.when, parameters, confidence, alternatives, twins, one.gain,
        one.place, one.theta[None], (one.place.when[0].trial,), False,
    )  # fmt: skip
