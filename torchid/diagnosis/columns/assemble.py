"""Columns of every effect at every place, beside those of the inertia."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import groupby

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchid.diagnosis.candidates.candidate import ColumnSource
from torchid.diagnosis.candidates.enumeration import enumerate_candidates
from torchid.diagnosis.columns.corrected_scores import noise_scores
from torchid.diagnosis.columns.design import Columns, Design, Terms, marker_columns
from torchid.diagnosis.columns.force_columns import about_root, plate_columns
from torchid.diagnosis.columns.marker_columns import response_of
from torchid.diagnosis.columns.rate_calibration import calibrated
from torchid.diagnosis.options import NamingOptions
from torchid.effects.effect import Effect
from torchid.geometry.result import GeometryFit
from torchid.observation.marker_bands import MarkerStatistics, marker_statistics, retaken_statistics
from torchid.observation.marker_response import MarkerResponse
from torchid.observation.response_cache import ResponseCache
from torchid.observation.statements import positions
from torchid.observation.trial import TrialObservation
from torchid.observation.unloaded_plates import zero_statistics
from torchid.storage.snapshot import unload

TOGETHER = 64
"""Resolution. Number of columns whose momenta are turned into wrenches at once: all columns of a catalogue would fill
gigabytes at each step."""


def make_design(
    observed: Sequence[TrialObservation],
    effects: Sequence[Effect],
    fit: GeometryFit | None = None,
    options: NamingOptions = NamingOptions(),
) -> Design:
    """Return the design of every effect at every place, with the columns of each trial.

    Args:
        observed: trials.
        effects: effects to try.
        fit: geometry that the trials were tracked with, whose errors are nuisances; None: none are.
        options: thresholds; ``periods`` decides which trials can show what repeats itself.
    """
    found = enumerate_candidates(observed, effects, fit, options)
    trials = tuple(trial_columns(one, found.sources) for one in observed)
    return Design(observed[0].phi.numel(), found.base, found.sources, found.candidates, trials)


def trial_columns(observed: TrialObservation, sources: Sequence[ColumnSource]) -> Columns:
    """Return the columns of the sources that could act in one trial.

    Args:
        observed: the trial.
        sources: sources of the design.
    """
    sources = [s for s in sources if s.trial in (None, observed.rows.name)]
    own, first = marker_columns(sources), observed.phi.numel()
    live = torch.cat([torch.arange(first), *(torch.arange(s.columns.start, s.columns.stop) for s in sources)])
    extra, at, statistics = observed.room((6, len(live) - first, len(observed.rows.used))), 0, None
    for effect, some in groupby(sources, key=lambda s: s.effect):
        alike = list(some)
        part = slice(at, at + sum(len(s.scale) for s in alike))
        if not effect.moves_markers:
            extra[:, part] = about_root(observed, plate_columns(observed.view, alike))
            unload()
        at = part.stop
    if observed.response is not None and own.stop > own.start:
        statistics = _of_cameras(observed, observed.response, sources, extra[:, own.start - first : own.stop - first])
    late = torch.tensor([s.effect.shifts_time for s in sources for _ in s.scale])
    extra[:, late] = calibrated(extra[:, late], observed.rows, observed.scatter)
    unload()
    unloaded = zero_statistics(observed.unloaded, [(s.effect, s.place, s.columns) for s in sources])
    found = Columns(extra, Terms(live, statistics, unloaded, _covariation(observed, sources, live)))
    if observed.response is not None:
        observed.response.forget()
    return found


def retaken(
    observed: TrialObservation, own: Columns, sources: Sequence[ColumnSource], others: Sequence[ColumnSource]
) -> Columns:
    """Return the columns of a trial after some effects on markers were linearised at other parameters.

    Args:
        observed: the trial.
        own: its columns as they were.
        sources: sources of all columns, with those of ``others`` as they are now.
        others: sources whose parameters (``ColumnSource.at``) have changed; no trial lacks them.
    """
    response = observed.response
    assert response is not None, "effects on markers have been found"
    at, terms = torch.cat([torch.arange(s.columns.start, s.columns.stop) for s in others]), own.terms
    n, noise = observed.phi.numel(), terms.noise_scores
    fresh = [response_of(response, s) for s in others]
    own = own.replaced(at - n, about_root(observed, response.wrench(fresh)))
    assert terms.markers is not None, "they show among the markers"
    every, first = _together([s for s in sources if s.effect.moves_markers]), marker_columns(sources).start
    fixed = ResponseCache(response)
    shifts = (torch.cat([response_of(response, s, fixed=fixed).shift for s in some]) for some in every)
    left = response.bands.left(torch.cat([answer.shift for answer in fresh]))
    statistics = retaken_statistics(response.bands, terms.markers, shifts, at - first, left, observed.room)
    if noise is not None and observed.noise_budget is not None:
        noise = noise.clone()
        noise[..., at] = noise_scores(observed, observed.noise_budget, others, inertia=False)
    response.forget()
    return replace(own, terms=replace(terms, markers=statistics, noise_scores=noise))


def _of_cameras(
    observed: TrialObservation,
    response: MarkerResponse,
    sources: Sequence[ColumnSource],
    out: Float[Tensor, "6 own frames"],
) -> MarkerStatistics:
    """Return statistics of what markers show of the columns; ``out`` takes the wrench about the root's origin that the
    motion needs by them [N, N m]."""
    bands, own = response.bands, [s for s in sources if s.effect.moves_markers]
    spectra = observed.room((len(bands.band), out.shape[1] + 1, bands.rows.shape[1]))
    _respond(observed, response, own, spectra, out)
    spectra[:, -1] = bands.spectrum(bands.left(bands.error[None]))[0]
    return marker_statistics(bands, spectra, response.least, observed.room)


def _respond(
    observed: TrialObservation,
    response: MarkerResponse,
    sources: Sequence[ColumnSource],
    spectra: Float[Tensor, "kept all rows"],
    out: Float[Tensor, "6 own frames"],
) -> None:
    """Fill in what postures leave of the columns among the markers, and the wrench that the motion needs by them.

    What columns share is freed with the end of this.
    """
    fixed, at = ResponseCache(response), 0
    for some in _together(sources):
        answers, first = [response_of(response, s, fixed=fixed) for s in some], at
        for source, answer in zip(some, answers, strict=True):
            spectra[:, at : at + len(source.scale)] = answer.spectrum(response.bands).transpose(0, 1)
            at += len(source.scale)
        out[:, first:at] = about_root(observed, response.wrench(answers))
        unload()


def _together(sources: Sequence[ColumnSource]) -> Iterator[list[ColumnSource]]:
    """Yield neighbours that have as many columns as are best worked on at once."""
    some, columns = [], 0
    for source in sources:
        some.append(source)
        columns += len(source.scale)
        if columns >= TOGETHER:
            yield some
            some, columns = [], 0
    if some:
        yield some


def _covariation(
    observed: TrialObservation, sources: Sequence[ColumnSource], live: Int[Tensor, " live"]
) -> Float[Tensor, "bands 6 6 live"] | None:
    """Return the scores of the noise (``Terms.noise_scores``), zero for columns that no acceleration enters."""
    if observed.noise_budget is None:
        return None
    some, n = [s for s in sources if s.effect.follows_acceleration], observed.phi.numel()
    at, _ = positions(
        live, torch.cat([torch.arange(n), *(torch.arange(s.columns.start, s.columns.stop) for s in some)])
    )
    found = noise_scores(observed, observed.noise_budget, some, inertia=True)
    whole = found.new_zeros(*found.shape[:3], len(live))
    whole[..., at] = found
    return whole
