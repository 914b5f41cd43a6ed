"""Columns of everything that could be hidden, beside those of the inertia, and designs that hold fewer of them."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchid.diagnosis.candidates.candidate import Candidate, ColumnSource
from torchid.observation.marker_bands import MarkerStatistics
from torchid.observation.statements import Statements, positions
from torchid.storage.snapshot import unload


@dataclass(frozen=True)
class ColumnSelection:
    """Columns of a design that a narrower one has."""

    all: Int[Tensor, " kept"]
    """Indices of the columns in the wider design."""
    marker_columns: Int[Tensor, " some"]
    """Indices of those that markers show, counted from the first that they show."""


@dataclass(frozen=True)
class Terms:
    """Terms of one trial's normal equations that do not come from its rows of forces."""

    live: Int[Tensor, " live"]
    """Columns of the design that the trial has: those of the inertia, and of sources that could act in it."""
    markers: MarkerStatistics | None
    """Statistics of the columns that markers show; None where no camera is at hand."""
    stated: Statements | None = None
    """Statements of unloaded plates, model-free checks and earlier sessions; None where there are none."""
    noise_scores: Float[Tensor, "bands 6 6 live"] | None = None
    """Products that noise of markers in the columns is expected to have with the noise of the total, by band, channel
    of the total and channel of the column; None where no camera shows the noise."""

    def only(self, some: "ColumnSelection") -> "Terms":
        """Return the terms of a narrower design, in which nuisances stand where they did.

        Args:
            some: columns that it has.
        """
        at, live = positions(self.live, some.all)
        noise = None if self.noise_scores is None else self.noise_scores[..., at]
        markers = None if self.markers is None else self.markers.only(some.marker_columns)
        return Terms(live, markers, None if self.stated is None else self.stated.only(some.all), noise)


@dataclass(frozen=True)
class Columns:
    """Columns of the sources that could act in one trial."""

    wide: Float[Tensor, "6 wide frames"]
    """Columns behind those of the inertia, about the root's origin [N, N m per unit parameter]; see ``kept``. They may
    lie in a file."""
    terms: Terms
    """Terms of the trial that do not come from its rows of forces."""
    beyond: Float[Tensor, "frames 6"] | None = None
    """Wrench about the origin of W [N, N m] of effects that shift time beyond their columns, where those are linearised
    away from zero; None where none are."""
    kept: Int[Tensor, " more"] | None = None
    """Indices of those of ``wide`` and, behind them, ``fresh`` that these are, which saves copying them; None: all of
    ``wide``."""
    fresh: Float[Tensor, "6 fresh frames"] | None = None
    """Columns that stand for some of ``wide``, or behind them; None: none do."""

    @property
    def extra(self) -> Float[Tensor, "6 more frames"]:
        """Columns behind those of the inertia, about the root's origin; a copy where some of many are kept."""
        return self.during(slice(None))

    def during(self, part: slice) -> Float[Tensor, "6 more own"]:
        """Return ``extra`` in some frames, without a copy of the others.

        Args:
            part: the frames.
        """
        return self.wide[:, :, part] if self.kept is None else self._taken(self.kept, part)

    def replaced(self, at: Int[Tensor, " some"], by: Float[Tensor, "6 some frames"]) -> "Columns":
        """Return the columns with others in the place of some, or behind all; the rest is not copied.

        Args:
            at: their indices; that behind the last, and so on, append.
            by: the others.
        """
        first = self.wide.shape[1] + (0 if self.fresh is None else self.fresh.shape[1])
        own = torch.arange(self.wide.shape[1]) if self.kept is None else self.kept
        kept = own.new_empty(max(len(own), int(at.max()) + 1 if len(at) else 0))
        kept[: len(own)] = own
        kept[at] = torch.arange(first, first + len(at))
        return replace(self, kept=kept, fresh=by if self.fresh is None else torch.cat([self.fresh, by], 1))

    def _taken(self, which: Int[Tensor, " some"], part: slice = slice(None)) -> Float[Tensor, "6 some own"]:
        """Return a copy of some of ``wide`` and ``fresh`` in some frames."""
        wide = self.wide[:, :, part]
        if self.fresh is None:
            return wide[:, which]
        found, first = wide.new_empty(6, len(which), wide.shape[2]), which >= wide.shape[1]
        found[:, ~first] = wide[:, which[~first]]
        found[:, first] = self.fresh[:, which[first] - wide.shape[1], part]
        return found

    def only(self, some: "ColumnSelection", inertia: int) -> "Columns":
        """Return the columns of a narrower design, in which nuisances stand where they did.

        Args:
            some: columns that it has.
            inertia: number of inertial parameters.
        """
        at, _ = positions(self.terms.live, some.all)
        at = at[inertia:] - inertia
        return replace(self, kept=at if self.kept is None else self.kept[at], terms=self.terms.only(some))

    def added(self, theta: Float[Tensor, " more"]) -> Float[Tensor, "frames 6"]:
        """Return the wrench about the root's origin that parameters add [N, N m].

        Args:
            theta: parameters of the columns behind the inertia's.
        """
        some = theta.nonzero()[:, 0]
        added = (theta[some] @ self._taken(some if self.kept is None else self.kept[some])).T
        unload()
        return added


@dataclass(frozen=True)
class Design:
    """Columns of nuisances and candidates, behind the inertia's; those of one trial stand last."""

    inertia: int
    """Number of inertial parameters."""
    base: int
    """Number of columns of inertia and nuisances."""
    sources: tuple[ColumnSource, ...]
    """Sources of the columns behind the inertia's, in their order."""
    candidates: tuple[Candidate, ...]
    """Effects at places, each with its source."""
    trials: tuple[Columns, ...]
    """Columns of each trial."""

    @property
    def marker_columns(self) -> slice:
        """Columns that have rows of markers."""
        return marker_columns(self.sources)

    @property
    def shared(self) -> int:
        """Number of columns that every trial has."""
        return next((s.columns.start for s in self.sources if s.trial is not None), self.width)

    @property
    def width(self) -> int:
        """Number of all columns."""
        return self.sources[-1].columns.stop if self.sources else self.inertia

    @property
    def noisy(self) -> list[bool]:
        """True for every column behind the inertia that holds noise of the found accelerations (``Effect.noisy``)."""
        return [s.effect.noisy for s in self.sources for _ in s.scale]

    @property
    def mean(self) -> Float[Tensor, " more"]:
        """Mean of the prior of everything behind the inertia."""
        return torch.tensor([x for s in self.sources for x in s.mean], dtype=torch.float64)

    @property
    def scale(self) -> Float[Tensor, " more"]:
        """Standard deviations of the prior of everything behind the inertia."""
        return torch.tensor([x for s in self.sources for x in s.scale], dtype=torch.float64)


def marker_columns(sources: Sequence[ColumnSource]) -> slice:
    """Return the columns of sources that markers show, which stand together.

    Args:
        sources: sources of a design, in the order of their columns.
    """
    own = [s.columns for s in sources if s.effect.moves_markers]
    return slice(own[0].start, own[-1].stop) if own else slice(0, 0)


def narrower(design: Design, some: Sequence[Candidate]) -> tuple[Design, tuple[Candidate, ...], ColumnSelection]:
    """Return a design of the base and some candidates without columns of trials, these in it, and the columns that it
    keeps.

    Args:
        design: the wider design.
        some: candidates to keep.
    """
    wanted = {c.source.columns.start for c in some}
    kept = [s for s in design.sources if s.columns.start < design.base or s.columns.start in wanted]
    sources, at, index = {}, design.inertia, [torch.arange(design.inertia)]
    for source in kept:
        index.append(torch.arange(source.columns.start, source.columns.stop))
        sources[source.columns.start] = replace(source, columns=slice(at, at + len(source.scale)))
        at += len(source.scale)
    which = torch.cat(index)
    own = tuple(replace(c, source=sources[c.source.columns.start]) for c in some)
    k = design.marker_columns
    small = replace(design, sources=tuple(sources.values()), candidates=own, trials=())
    return small, own, ColumnSelection(which, which[(which >= k.start) & (which < k.stop)] - k.start)


def only(design: Design, some: Sequence[Candidate]) -> tuple[Design, tuple[Candidate, ...], Int[Tensor, " kept"]]:
    """Return a design of the base and some candidates, these in it, and the indices of the columns that it keeps.

    Args:
        design: the wider design.
        some: candidates to keep.
    """
    small, own, which = narrower(design, some)
    return replace(small, trials=tuple(one.only(which, design.inertia) for one in design.trials)), own, which.all
