"""What model-free checks state of a session, as rows of the linear model beside those of the same trial's forces.

A statement is a number that plates and the way of the centre of mass give without a body model: an apparent mass, a
clock, a zero. Each effect changes it by its *signature*; what it scatters by where nothing is wrong was measured on
public sessions (``torchid.model_free.scatter``). Statements of one trial are whitened together. What all of a kind share
in a session counts in each of its T trials with T times its variance, so that all trials together know no more than one
of them could: exact where trials are alike.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchid.diagnosis.candidates.candidate import ColumnSource
from torchid.diagnosis.columns.design import ColumnSelection, Design, positions
from torchid.model_free.panel import Panel


@dataclass(frozen=True)
class StatementRows:
    """Gram matrix and moment of one trial's whitened statements."""

    columns: Int[Tensor, " some"]
    """Columns of the design that change them."""
    gram: Float[Tensor, "some some"]
    moment: Float[Tensor, " some"]

    def only(self, some: ColumnSelection) -> "StatementRows":
        """Return the rows of a narrower design.

        Args:
            some: columns that it has.
        """
        at, which = positions(self.columns, some.all)
        return StatementRows(which, self.gram[at][:, at], self.moment[at])


def with_statements(design: Design, panel: Panel | None, names: Sequence[str]) -> Design:
    """Return the design with rows of statements in the terms of its trials.

    Statements of trials that have no rows of forces, standing above all, go with the first that has.

    Args:
        design: columns of all trials.
        panel: the statements; None: there are none.
        names: of the trials, in their order.
    """
    if panel is None:
        return design
    sources = [s for s in design.sources if not s.effect.moves_markers and s.place.when is None]
    if not sources:
        return design
    columns = torch.cat([torch.arange(s.columns.start, s.columns.stop) for s in sources])
    J = torch.cat([_signature(panel, source) for source in sources], 1)
    # What plates read in the air is in the rows already (``Terms.unloaded``).
    where = [-1 if one.kind.startswith("zero") else names.index(one.trial) if one.trial in names else 0
             for one in panel.about]
    own = panel.likeliest(spread=True)
    trials = []
    for k, trial in enumerate(design.trials):
        some = torch.tensor([j for j, at in enumerate(where) if at == k], dtype=torch.long)
        L = torch.linalg.cholesky(own[some][:, some])
        both = torch.cat([J[some], panel.value[some, None]], 1)
        white = torch.linalg.solve_triangular(L, both, upper=False)
        heard = white[:, :-1].abs().sum(0) > 0.0
        X, at = white[:, :-1][:, heard], columns[heard]
        rows = StatementRows(at, X.T @ X, X.T @ white[:, -1])
        trials.append(replace(trial, terms=replace(trial.terms, statements=rows if len(some) else None)))
    return replace(design, trials=tuple(trials))


def _signature(panel: Panel, source: ColumnSource) -> Float[Tensor, "statements params"]:
    """Return what a unit of each parameter changes in the statements."""
    if source.effect.all_or_nothing:
        whole = panel.value.new_ones(1)
        return -panel.change([one.without(source.effect, source.place, whole) for one in panel.trials])[:, None]
    found = panel.signature(source.effect, source.place)
    if source.trial is not None:
        here = torch.tensor([one.trial == source.trial for one in panel.about])
        found = found * here[:, None]
    return found
