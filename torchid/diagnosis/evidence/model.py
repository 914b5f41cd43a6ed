"""The linear Gaussian model of a session: rows, prior, columns and noise, and everything that is computed from them.

In every trial k the whitened rows are F_k = Y_k theta + e_k with theta = mean + factor z, z ~ N(0, 1), and e_k of the
covariance that ``Noise`` has for each band. All evidence, estimates and residuals follow from the Gram matrices and
moments of z (``statistics``), which are made once and cut where fewer columns will do.

Reference: MacKay, Neural Computation 4:415 (1992), on the evidence of such models.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.diagnosis.candidates.candidate import Candidate, ColumnSource
from torchid.diagnosis.candidates.enumeration import confined
from torchid.diagnosis.columns.design import Columns, ColumnSelection, Design, Terms, narrower
from torchid.diagnosis.columns.force_columns import force_columns
from torchid.diagnosis.evidence.noise import Noise, initial_noise
from torchid.diagnosis.evidence.posterior import Posterior, fit
from torchid.diagnosis.evidence.prior import Prior, make_prior
from torchid.diagnosis.evidence.spectra import TrialSpectra, trial_spectra, with_columns
from torchid.diagnosis.evidence.statistics import Statistics, TrialStatistics
from torchid.dynamics.row_equations import NormalEquations
from torchid.dynamics.whitening import BlockSpectrum, Whitening, accumulate
from torchid.effects.place import Place
from torchid.geometry.result import GeometryFit
from torchid.model.model import InertialPrior
from torchid.observation.statements import positions
from torchid.observation.trial import TrialObservation
from torchid.storage.snapshot import unload


@dataclass(frozen=True)
class Identification:
    """Prior and result of the inertial fit before the diagnosis."""

    inertia: InertialPrior
    """Prior of the inertial parameters."""
    omega: float
    """Weight of that prior."""
    whitening: Whitening
    """Noise of the forces, with which a search begins."""
    geometry: GeometryFit | None = None
    """Geometry that the trials were tracked with; None: its errors are not asked for."""


@dataclass(frozen=True)
class LinearModel:
    """Rows, prior, columns and noise of all trials."""

    rows: tuple[TrialSpectra, ...]
    """Rows and columns of each trial in the frequency domain."""
    prior: Prior
    """Prior of the parameters of all columns."""
    design: Design
    """Columns, their sources and candidates."""
    noise: Noise
    """Noise of forces and markers."""

    @cached_property
    def statistics(self) -> Statistics:
        """Gram matrices and moments of z of forces, markers and statements, trial by trial."""
        return self._statistics(self._forces)

    @property
    def statistics_without_forces(self) -> Statistics:
        """Gram matrices and moments of markers and statements alone."""
        return self._statistics(self._no_forces)

    @property
    def marker_statistics(self) -> Statistics:
        """Gram matrices and moments of markers alone."""
        rows = tuple(replace(one, terms=replace(one.terms, stated=None)) for one in self.rows)
        return replace(self, rows=rows).statistics_without_forces

    def _statistics(self, forces: Callable[[int], tuple[NormalEquations, float]]) -> Statistics:
        """Return statistics with the forces that a function gives for each trial, beside markers and
        statements."""
        found = [self._standardised(k, *forces(k)) for k in range(len(self.rows))]
        constant = sum((density for _, density in found), start=0.0)
        return Statistics(self.design.base, self.design.shared, tuple(raw for raw, _ in found), constant)

    def _forces(self, trial: int) -> tuple[NormalEquations, float]:
        """Return whitened normal equations of one trial's forces, and the logarithm of the noise's volume."""
        whitening, rows = self.noise.of(trial), self.rows[trial]
        found = accumulate(rows.forces, whitening)
        if rows.terms.noise_scores is not None:
            more = torch.einsum("bij,bijc->c", torch.linalg.inv(whitening.covariance), rows.terms.noise_scores)
            found = replace(found, moment=found.moment + more)
        return found, sum(whitening.log_determinant(block.band) for block in rows.forces)

    def _no_forces(self, trial: int) -> tuple[NormalEquations, float]:
        """Return normal equations of no rows."""
        n, mean = len(self.rows[trial].terms.live), self.prior.mean
        return NormalEquations(mean.new_zeros(n, n), mean.new_zeros(n), 0.0, 0), 0.0

    def _standardised(self, trial: int, forces: NormalEquations, volume: float) -> tuple[TrialStatistics, float]:
        """Return one trial's statistics in terms of z, and the log density of its rows up to what models of one noise
        differ in.

        Markers and statements are added to the Gram matrix and moment of the forces, which are used up.
        """
        terms = self.rows[trial].terms
        gram, moment, k, square = forces.gram, forces.moment, self.design.marker_columns, forces.square
        if terms.markers is not None:
            weight, markers = self.noise.markers.reciprocal(), terms.markers
            gram[k, k] += (weight @ markers.gram.flatten(1)).view_as(gram[k, k])
            moment[k] += weight @ markers.moment
            square += float(weight @ markers.energy)
            volume += float(markers.count @ self.noise.markers.log())
        if terms.stated is not None:
            at, _ = positions(terms.live, terms.stated.columns)
            gram[at[:, None], at] += terms.stated.gram
            moment[at] += terms.stated.moment
        unload()
        mean = self.prior.mean[terms.live]
        away = square - 2.0 * float(moment @ mean) + float(mean @ gram @ mean)
        found = self.prior.standard(gram, moment, terms.live)
        if terms.stated is not None:
            found = replace(found, stated=self.prior.standard_statements(terms.stated))
        return found, -0.5 * (away + volume)

    def forget(self) -> None:
        """Drop the statistics; they are made again if they are asked for."""
        self.__dict__.pop("statistics", None)

    def fit(self, chosen: Sequence[Candidate] = ()) -> Posterior:
        """Return the posterior of the model that has these effects and no others.

        Args:
            chosen: the effects.
        """
        return fit(self.statistics, chosen)

    def with_noise(self, noise: Noise) -> "LinearModel":
        """Return the model of the same rows under another noise, with statistics of its own.

        Args:
            noise: the other noise.
        """
        return replace(self, noise=noise)

    def with_statistics(self, statistics: Statistics) -> "LinearModel":
        """Return the same model with its statistics at hand, as if it had made them.

        Args:
            statistics: statistics of its rows under its noise.
        """
        found = replace(self)
        found.__dict__["statistics"] = statistics
        return found

    def restrict(self, some: Sequence[Candidate]) -> tuple["LinearModel", tuple[Candidate, ...]]:
        """Return the model without the columns of all other candidates, and the candidates as it has them.

        Statistics that are at hand are cut instead of being made again.

        Args:
            some: candidates to keep.
        """
        small, own, which = narrower(self.design, some)
        columns = tuple(one.only(which, self.design.inertia) for one in self.design.trials)
        terms = [one.terms for one in columns] or [one.terms.only(which) for one in self.rows]
        rows = tuple(_cut(one, which, more) for one, more in zip(self.rows, terms, strict=True))
        unload()
        design = replace(small, trials=columns)
        found = LinearModel(rows, self.prior.for_design(design), design, self.noise)
        if "statistics" in self.__dict__:
            found = found.with_statistics(self.statistics.only(which.all, small.shared))
        return found, own

    def append(
        self, observed: Sequence[TrialObservation], one: Candidate, places: Sequence[Place]
    ) -> tuple["LinearModel", tuple[Candidate, ...]]:
        """Return the model with columns of an effect at further places behind all others, and the candidates there.

        Args:
            observed: its trials; a trial that the effect is not confined to has no columns of it.
            one: a candidate of the effect.
            places: further places.
        """
        design, fresh = _with_places(self.design, one, places)
        trials, rows = list(self.design.trials), list(self.rows)
        for k, own in enumerate(observed):
            here = [c for c in fresh if c.source.trial in (None, own.rows.name)]
            if here:
                extra = torch.cat([force_columns(own, c.source) for c in here], 1)
                terms = _more_terms(rows[k].terms, here)
                rows[k] = with_columns(rows[k], terms, own, extra, one.effect.noisy)
                trials[k] = _more_columns(trials[k], extra, terms)
        design = replace(design, trials=tuple(trials))
        return LinearModel(tuple(rows), self.prior.for_design(design), design, self.noise), fresh


def make_model(observed: Sequence[TrialObservation], design: Design, known: Identification) -> LinearModel:
    """Return the model of a design under the noise of the inertial fit.

    Args:
        observed: trials of the design.
        design: columns of all trials.
        known: what the inertial fit knew and found.
    """
    prior = make_prior(known.inertia, known.omega, design)
    return LinearModel(
        spectra_of(observed, design), prior, design, initial_noise(known.whitening, len(observed))
    )  # fmt: skip


def spectra_of(observed: Sequence[TrialObservation], design: Design) -> tuple[TrialSpectra, ...]:
    """Return rows of all trials in the frequency domain, with the columns of a design.

    Args:
        observed: trials of the design.
        design: columns of all trials.
    """
    both = zip(observed, design.trials, strict=True)
    return tuple(trial_spectra(own, columns, design.noisy) for own, columns in both)


def _cut(rows: TrialSpectra, which: ColumnSelection, terms: Terms) -> TrialSpectra:
    """Return rows with those columns that a narrower design has."""
    at, _ = positions(rows.terms.live, which.all)
    blocks = tuple(BlockSpectrum(block.Y[:, at], block.F, block.frequency) for block in rows.forces)
    return TrialSpectra(blocks, terms, rows.noise_budget)


def _with_places(design: Design, one: Candidate, places: Sequence[Place]) -> tuple[Design, tuple[Candidate, ...]]:
    """Return the design with an effect at further places as its last sources, and the candidates there."""
    at, sources = design.width, []
    for place in places:
        scale = one.effect.scale(place)
        sources.append(
            ColumnSource(
                one.effect, place, slice(at, at + len(scale)), (0.0,) * len(scale), scale, confined(one.effect, place)
            )
        )
        at += len(scale)
    fresh = tuple(replace(one, place=s.place, source=s, proposed=one.proposed or one.place) for s in sources)
    return replace(design, sources=(*design.sources, *sources), candidates=(*design.candidates, *fresh)), fresh


def _more_terms(terms: Terms, fresh: Sequence[Candidate]) -> Terms:
    """Return terms with further columns, which enter no rows of markers and no scores."""
    live = torch.cat([terms.live, *(c.columns for c in fresh)])
    n = len(live) - len(terms.live)
    noise = None if terms.noise_scores is None else torch.nn.functional.pad(terms.noise_scores, (0, n))
    return replace(terms, live=live, noise_scores=noise)


def _more_columns(columns: Columns, extra: Float[Tensor, "6 more frames"], terms: Terms) -> Columns:
    """Return columns with further ones behind."""
    n = columns.wide.shape[1] if columns.kept is None else len(columns.kept)
    return replace(columns.replaced(torch.arange(n, n + extra.shape[1]), extra), terms=terms)
