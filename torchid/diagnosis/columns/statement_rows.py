"""Statements of model-free checks as rows of the linear model, beside those of the same trial's forces.

A statement is a number that plates and the way of the centre of mass give without a body model: an apparent mass, a
clock, a leaning force. Each effect changes it by its *signature*. What a trial's plates read in the air is no statement
here, as it is a row already (``torchid.observation.unloaded_plates``).
"""

from collections.abc import Sequence
from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.diagnosis.candidates.candidate import ColumnSource
from torchid.diagnosis.columns.design import Columns, Design
from torchid.model_free.panel import Panel
from torchid.observation.statements import Statements


def with_statements(design: Design, panel: Panel | None, names: Sequence[str]) -> Design:
    """Return the design with what the checks state in the terms of its trials.

    Statements about trials without rows of forces, standing above all, go with the first that has some.

    Args:
        design: columns of all trials.
        panel: the statements; None: there are none.
        names: of the trials, in their order.
    """
    # What comes and goes has proposals by the hundred, of which a second's balance says little.
    sources = [s for s in design.sources if not s.effect.moves_markers and s.place.when is None]
    if panel is None or not sources:
        return design
    columns = torch.cat([torch.arange(s.columns.start, s.columns.stop) for s in sources])
    signature = torch.cat([_signature(panel, source) for source in sources], 1)
    scale = torch.tensor([x for source in sources for x in source.effect.scale(source.place)], dtype=torch.float64)
    unknown = signature * scale.to(signature)
    covariance = panel.covariance_beside(unknown @ unknown.T)
    trial = torch.tensor([names.index(one.trial) if one.trial in names else 0 for one in panel.about])
    own = torch.tensor([not one.kind.startswith("zero") for one in panel.about])
    trials = []
    for k, one in enumerate(design.trials):
        here = (own & (trial == k)).nonzero()[:, 0]
        stated = _stated(covariance[here][:, here], signature[here], panel.value[here], columns)
        before = one.terms.stated
        trials.append(_having(one, stated if before is None else before + stated))
    return replace(design, trials=tuple(trials))


def _stated(
    covariance: Float[Tensor, "own own"],
    signature: Float[Tensor, "own params"],
    value: Float[Tensor, " own"],
    columns: Tensor,
) -> Statements:
    """Return the whitened statements of one trial, of the columns that change them."""
    heard = (signature != 0.0).any(0)
    L = torch.linalg.cholesky(covariance)
    white = torch.linalg.solve_triangular(L, torch.cat([signature[:, heard], value[:, None]], 1), upper=False)
    X, y = white[:, :-1], white[:, -1]
    return Statements(columns[heard], X.T @ X, X.T @ y)


def _signature(panel: Panel, source: ColumnSource) -> Float[Tensor, "statements params"]:
    """Return what a unit of each parameter changes in the statements, in the trial that has its columns or in all."""
    found = panel.signature(source.effect, source.place)
    if source.trial is None:
        return found
    return found * torch.tensor([one.trial == source.trial for one in panel.about])[:, None]


def _having(columns: Columns, stated: Statements) -> Columns:
    return replace(columns, terms=replace(columns.terms, stated=stated))
