"""Columns of everything that could be hidden, beside those of the inertia, and designs that hold fewer of them."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchid.diagnosis.candidates.candidate import Candidate, Source
from torchid.observation.marker_bands import MarkerStatistics
from torchid.observation.unloaded_plates import ZeroStatistics


@dataclass(frozen=True)
class Selection:
    """Columns of a design that a narrower one has."""

    all: Int[Tensor, " kept"]
    marker_columns: Int[Tensor, " some"]
    """Those among the kinematic ones, from the first of these on."""


@dataclass(frozen=True)
class Terms:
    """Terms of one trial's normal equations that do not come from its rows of forces."""

    live: Int[Tensor, " live"]
    """Columns of the design that the trial has: those of the inertia, and of sources that could act in it."""
    markers: MarkerStatistics | None
    """Of the kinematic ones."""
    unloaded: ZeroStatistics | None = None
    """Of zero errors."""
    noise_scores: Float[Tensor, "bands 6 6 live"] | None = None
    """Of the noise that markers leave in the columns with that of the total."""

    def only(self, some: "Selection") -> "Terms":
        """Of a narrower design, in which nuisances stand where they did."""
        at, live = positions(self.live, some.all)
        noise = None if self.noise_scores is None else self.noise_scores[..., at]
        return Terms(
            live, None if self.markers is None else self.markers.only(some.marker_columns), self.unloaded, noise
        )


@dataclass(frozen=True)
class Columns:
    """Of those sources that could act in one trial."""

    wide: Float[Tensor, "6 wide frames"]
    """Behind those of the inertia, about the root's origin; see ``kept``."""
    terms: Terms
    beyond: Float[Tensor, "frames 6"] | None = None
    """What late effects do beyond their columns, about the origin of W, where those are linearised elsewhere."""
    kept: Int[Tensor, " more"] | None = None
    """Those of a wider design's that these are: to copy them out took a second of five trials of 25 s."""

    @property
    def extra(self) -> Float[Tensor, "6 more frames"]:
        """Behind those of the inertia, about the root's origin; made anew where some of many were kept."""
        return self.wide if self.kept is None else self.wide[:, self.kept]

    @property
    def copied(self) -> Float[Tensor, "6 more frames"]:
        """The same, to be changed."""
        return self.wide.clone() if self.kept is None else self.extra

    @property
    def alone(self) -> "Columns":
        """Without the others of the wider design, which go when nothing else holds them."""
        return replace(self, wide=self.extra, kept=None)

    def only(self, some: "Selection", inertia: int) -> "Columns":
        """Of a narrower design, in which nuisances stand where they did."""
        at, _ = positions(self.terms.live, some.all)
        at = at[inertia:] - inertia
        return replace(self, kept=at if self.kept is None else self.kept[at], terms=self.terms.only(some))

    def added(self, theta: Float[Tensor, " more"]) -> Float[Tensor, "frames 6"]:
        """By these parameters."""
        if self.kept is not None:
            theta = theta.new_zeros(self.wide.shape[1]).index_copy(0, self.kept, theta)
        return (theta @ self.wide).T


@dataclass(frozen=True)
class Design:
    """Columns of nuisances and candidates, behind the inertia's; those of one trial stand last."""

    inertia: int
    """Number of inertial parameters."""
    base: int
    """Number of columns of inertia and nuisances."""
    sources: tuple[Source, ...]
    candidates: tuple[Candidate, ...]
    trials: tuple[Columns, ...]

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
        """Which columns behind the inertia come from accelerations that were found, see ``Effect.noisy``."""
        return [s.effect.noisy for s in self.sources for _ in s.scale]

    @property
    def mean(self) -> Float[Tensor, " more"]:
        """Of the prior of everything behind the inertia."""
        return torch.tensor([x for s in self.sources for x in s.mean], dtype=torch.float64)

    @property
    def scale(self) -> Float[Tensor, " more"]:
        """Its standard deviations."""
        return torch.tensor([x for s in self.sources for x in s.scale], dtype=torch.float64)


def marker_columns(sources: Sequence[Source]) -> slice:
    """Columns of those that markers show, which stand together."""
    own = [s.columns for s in sources if s.effect.moves_markers]
    return slice(own[0].start, own[-1].stop) if own else slice(0, 0)


def narrower(design: Design, some: Sequence[Candidate]) -> tuple[Design, tuple[Candidate, ...], Selection]:
    """As ``only``, without columns of its own."""
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
    return small, own, Selection(which, which[(which >= k.start) & (which < k.stop)] - k.start)


def only(design: Design, some: Sequence[Candidate]) -> tuple[Design, tuple[Candidate, ...], Int[Tensor, " kept"]]:
    """A design of the base and some candidates, these in it, and which columns of all it keeps."""
    small, own, which = narrower(design, some)
    return replace(small, trials=tuple(one.only(which, design.inertia) for one in design.trials)), own, which.all


def positions(
    live: Int[Tensor, " live"], some: Int[Tensor, " some"]
) -> tuple[Int[Tensor, " kept"], Int[Tensor, " kept"]]:
    """Where those of some columns that live stand among all that do, and which of the some they are."""
    at = torch.searchsorted(live, some).clamp(max=len(live) - 1)
    there = (live[at] == some).nonzero()[:, 0]
    return at[there], there
