"""Everything that could be hidden: every effect at every place, as columns beside those of the inertia."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchid.diagnosis.cameras import Answer, Cameras, MarkerSums, marker_sums
from torchid.diagnosis.idle import IdleSums, idle_sums
from torchid.diagnosis.nuisances import GeometryError, SkinSlide
from torchid.diagnosis.proposals import suggested
from torchid.diagnosis.rates import calibrated
from torchid.diagnosis.shaken import covariation
from torchid.diagnosis.watched import Watched
from torchid.dynamics import wrench_about
from torchid.effects.effect import STEP, Effect, Place, columns
from torchid.effects.markers import MarkerShift
from torchid.effects.plates import PlateDrift, PlateOffset
from torchid.effects.sight import View
from torchid.geometry.fitted import GeometryFit

PLATES = ((PlateOffset(), 0.1), (PlateDrift(), 0.05))
"""Small errors that every plate has, part of their priors as effects: 0.5 N and 0.025 N/s are nobody's discovery."""

PERIODS = 2.0
"""Of what repeats itself that a trial must show: a walk of a second takes slow ground for an offset of its own. Walks
and squats that weigh 34 N differently agreed by that."""


@dataclass(frozen=True)
class Source:
    """Columns that a nuisance or candidates share."""

    effect: Effect
    place: Place
    columns: slice
    mean: tuple[float, ...]
    scale: tuple[float, ...]
    """Of the prior of its parameters."""
    trial: str | None = None
    """The only one that has its columns; None: every one does."""


@dataclass(frozen=True)
class Candidate:
    """An effect at a place."""

    effect: Effect
    place: Place
    source: Source
    trials: frozenset[int]
    """In which it could act, by their order."""

    odds: float = 1.0
    """Of the place among all places of the effect."""
    proposed: Place | None = None
    """Before the ends of its interval were moved."""

    @property
    def blocks(self) -> tuple[frozenset[int], ...]:
        """Trials that share parameters."""
        return tuple(frozenset({k}) for k in sorted(self.trials)) if self.effect.anew else (self.trials,)

    @property
    def size(self) -> int:
        """Number of parameters."""
        return len(self.columns) * len(self.blocks)

    @property
    def columns(self) -> Int[Tensor, " columns"]:
        """In the design."""
        return torch.arange(self.source.columns.start, self.source.columns.stop)

    @property
    def relative(self) -> Float[Tensor, " columns"]:
        """Prior standard deviations against those of the source."""
        own = torch.tensor(self.effect.scale(self.place), dtype=torch.float64)
        return own / torch.tensor(self.source.scale, dtype=torch.float64)


@dataclass(frozen=True)
class Kept:
    """Columns of a design that a narrower one has."""

    all: Int[Tensor, " kept"]
    kinematic: Int[Tensor, " some"]
    """Those among the kinematic ones, from the first of these on."""


@dataclass(frozen=True)
class Beside:
    """What one trial knows of its columns beside their rows of forces."""

    live: Int[Tensor, " live"]
    """Columns of the design that the trial has: those of the inertia, and of sources that could act in it."""
    markers: MarkerSums | None
    """Of the kinematic ones."""
    idle: IdleSums | None = None
    """Of zero errors."""
    covariation: Float[Tensor, "bands 6 6 live"] | None = None
    """Of the noise that markers leave in the columns with that of the total."""

    def only(self, some: "Kept") -> "Beside":
        """Of a narrower design, in which nuisances stand where they did."""
        at, live = kept(self.live, some.all)
        noise = None if self.covariation is None else self.covariation[..., at]
        return Beside(live, None if self.markers is None else self.markers.only(some.kinematic), self.idle, noise)


@dataclass(frozen=True)
class Columns:
    """Of those sources that could act in one trial."""

    extra: Float[Tensor, "6 more frames"]
    """Behind those of the inertia, about the root's origin."""
    beside: Beside
    beyond: Float[Tensor, "frames 6"] | None = None
    """What late effects do beyond their columns, about the origin of W, where those are linearised elsewhere."""


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
    def kinematic(self) -> slice:
        """Columns that have rows of markers."""
        return _kinematic(self.sources)

    @property
    def shared(self) -> int:
        """Number of columns that every trial has."""
        return next((s.columns.start for s in self.sources if s.trial is not None), self.width)

    @property
    def width(self) -> int:
        """Number of all columns."""
        return self.sources[-1].columns.stop if self.sources else self.inertia

    @property
    def late(self) -> list[bool]:
        """Which columns behind the inertia are rates of what plates read."""
        return [s.effect.late for s in self.sources for _ in s.scale]

    @property
    def mean(self) -> Float[Tensor, " more"]:
        """Of the prior of everything behind the inertia."""
        return torch.tensor([x for s in self.sources for x in s.mean], dtype=torch.float64)

    @property
    def scale(self) -> Float[Tensor, " more"]:
        """Its standard deviations."""
        return torch.tensor([x for s in self.sources for x in s.scale], dtype=torch.float64)


def make_design(watched: Sequence[Watched], effects: Sequence[Effect], fit: GeometryFit | None = None) -> Design:
    """Columns of every effect at every place, trial by trial.

    Args:
        watched: trials.
        effects: to try.
        fit: whose geometry the trials were followed with; its errors are nuisances.
    """
    names = [w.rows.name for w in watched]
    inertia = watched[0].view.scene.phi.numel()
    known, at = {}, inertia
    for effect, place, mean, scale in nuisances(watched, fit):
        known[_key(effect, place)] = Source(effect, place, slice(at, at + len(scale)), mean, scale)
        at += len(scale)
    base, candidates = at, []
    offered = {effect: suggested(effect, watched) for effect in effects}
    wanted = [(effect, effect.source(place)[0]) for effect, places in offered.items() for place in places]
    # Those that markers show stand together, behind the nuisances that markers show; those of one trial stand last.
    for effect, own in sorted(wanted, key=lambda both: (not both[0].kinematic, confined(*both) is not None)):
        if _key(effect, own) not in known:
            scale = effect.scale(own)
            part = slice(at, at + len(scale))
            known[_key(effect, own)] = Source(effect, own, part, (0.0,) * len(scale), scale, confined(effect, own))
            at = part.stop
    for effect, places in offered.items():
        for place in places:
            own, trials = effect.source(place)
            which = range(len(names)) if trials is None else [names.index(t) for t in trials]
            told = frozenset(k for k in which if _longest_s(watched[k]) >= PERIODS * effect.period_s(place))
            odds = place.odds / mass(effect, places)
            if told:
                candidates.append(Candidate(effect, place, known[_key(effect, own)], told, odds))
    sources = tuple(known.values())
    return Design(inertia, base, sources, tuple(candidates), tuple(trial_columns(w, sources) for w in watched))


def confined(effect: Effect, place: Place) -> str | None:
    """The only trial in which something can be seen there; markers' rows are kept of all effects."""
    trials = {own.trial for own in place.when or ()}
    return None if effect.kinematic or len(trials) != 1 else next(iter(trials))


def _longest_s(watched: Watched) -> float:
    """Of the blocks of used frames."""
    return max((part.stop - part.start for part in watched.rows.blocks()), default=0) / watched.rows.rate


def _kinematic(sources: Sequence[Source]) -> slice:
    own = [s.columns for s in sources if s.effect.kinematic]
    return slice(own[0].start, own[-1].stop) if own else slice(0, 0)


def narrower(design: Design, some: Sequence[Candidate]) -> tuple[Design, tuple[Candidate, ...], Kept]:
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
    k = design.kinematic
    small = replace(design, sources=tuple(sources.values()), candidates=own, trials=())
    return small, own, Kept(which, which[(which >= k.start) & (which < k.stop)] - k.start)


def only(design: Design, some: Sequence[Candidate]) -> tuple[Design, tuple[Candidate, ...], Int[Tensor, " kept"]]:
    """A design of the base and some candidates, these in it, and which columns of all it keeps."""
    small, own, which = narrower(design, some)
    trials = []
    for one in design.trials:
        at, _ = kept(one.beside.live, which.all)
        extra = one.extra[:, at[design.inertia :] - design.inertia]
        trials.append(replace(one, extra=extra, beside=one.beside.only(which)))
    return replace(small, trials=tuple(trials)), own, which.all


def kept(live: Int[Tensor, " live"], some: Int[Tensor, " some"]) -> tuple[Int[Tensor, " kept"], Int[Tensor, " kept"]]:
    """Where those of some columns that live stand among all that do, and which of the some they are."""
    at = torch.searchsorted(live, some).clamp(max=len(live) - 1)
    there = (live[at] == some).nonzero()[:, 0]
    return at[there], there


def mass(effect: Effect, places: Sequence[Place]) -> float:
    """Odds of all places together; those of proposals are shares of what could have been proposed."""
    return 1.0 if effect.timed or effect.anew else sum(place.odds for place in places)


def nuisances(
    watched: Sequence[Watched], fit: GeometryFit | None
) -> Iterator[tuple[Effect, Place, tuple[float, ...], tuple[float, ...]]]:
    """Effect, place, and mean and standard deviation of its parameters."""
    views = [w.view for w in watched]
    for effect, share in PLATES:
        for place in effect.places(views):
            yield effect, place, (0.0,) * effect.size(place), tuple(share * s for s in effect.scale(place))
    if fit is None or watched[0].cameras is None:
        return
    n = len(fit.prior.mean)
    away = fit.prior.mean - fit.xi[:n]
    yield GeometryError(fit.prior), Place(("session",)), tuple(away.tolist()), tuple(fit.prior.sd.tolist())
    away = fit.attachment.mean - fit.place
    for k, label in enumerate(fit.attachment.labels):
        yield MarkerShift(), Place((label,)), tuple(away[k].tolist()), tuple(fit.attachment.sd[k].tolist())
    skin = SkinSlide()
    for place in skin.places(views):
        yield skin, place, (0.0,) * skin.size(place), skin.scale(place)


def _key(effect: Effect, place: Place) -> tuple:
    return effect.name, place.where, place.when, place.point, tuple(place.grid.items()), place.follows


def trial_columns(watched: Watched, sources: Sequence[Source]) -> Columns:
    """Of the sources that could act in one trial."""
    sources = [s for s in sources if s.trial in (None, watched.rows.name)]
    cameras, own, first = watched.cameras, _kinematic(sources), watched.phi.numel()
    live = torch.cat([torch.arange(first), *(torch.arange(s.columns.start, s.columns.stop) for s in sources)])
    wrench, at = watched.rows.wrench.new_zeros(6, len(live) - first, len(watched.rows.used)), 0
    for source in sources:
        part = slice(at, at + len(source.scale))
        if not source.effect.kinematic:
            wrench[:, part] = _seen_by_plates(watched.view, source)
        at = part.stop
    answers, sums = [] if cameras is None else [answer_of(cameras, s) for s in sources if s.effect.kinematic], None
    if cameras is not None and answers:
        wrench[:, own.start - first : own.stop - first] = cameras.wrench(answers)
        sums = marker_sums(cameras.coarse, cameras.left(answers), cameras.least)
    extra = _about_root(watched, wrench)
    late = torch.tensor([s.effect.late for s in sources for _ in s.scale])
    extra[:, late] = calibrated(extra[:, late], watched.rows, watched.scatter)
    idle = idle_sums(watched.idle, [(s.effect, s.place, s.columns) for s in sources])
    return Columns(extra, Beside(live, sums, idle, _covariation(watched, sources, live)))


def _seen_by_plates(view: View, source: Source) -> Float[Tensor, "6 columns frames"]:
    return columns(source.effect, view.scene, view.read(source.effect.inverted), source.place)


def _about_root(watched: Watched, wrench: Float[Tensor, "6 more frames"]) -> Float[Tensor, "6 more frames"]:
    root = watched.rows.motion.q[:, :3].expand(wrench.shape[1], -1, -1)
    return wrench_about(wrench.permute(1, 2, 0), root).permute(2, 0, 1)


def _covariation(
    watched: Watched, sources: Sequence[Source], live: Int[Tensor, " live"]
) -> Float[Tensor, "bands 6 6 live"] | None:
    """See ``Columns``; zero for what no acceleration enters."""
    if watched.expected is None:
        return None
    some = [s for s in sources if s.effect.accelerated]

    def of(view: View) -> Float[Tensor, "6 some frames"]:
        empty = view.reading.wrench.new_zeros(6, 0, len(view.scene.time))
        return _about_root(watched, torch.cat([empty, *(_seen_by_plates(view, s) for s in some)], 1))

    plain, n = of(watched.view), watched.phi.numel()
    noise = ((torch.cat([one.inertia, of(one.view) - plain], 1), one.total) for one in watched.shaken)
    found = covariation(watched.rows, watched.expected, noise)
    whole = found.new_zeros(*found.shape[:3], len(live))
    which = [torch.arange(n), *(torch.arange(s.columns.start, s.columns.stop) for s in some)]
    whole[..., kept(live, torch.cat(which))[0]] = found
    return whole


def answer_of(cameras: Cameras, source: Source) -> Answer:
    """To unit parameters of an effect."""
    effect, place = source.effect, source.place
    sight, slid, moved = cameras.sight, [], []
    if (swaying := effect.courses(sight.scene, place)) is not None:
        return cameras.swayed(*swaying)
    for k, scale in enumerate(effect.scale(place)):
        theta = sight.p_BM_B.new_zeros(effect.size(place))
        theta[k] = STEP * scale
        slid.append((effect.slide(sight, place, theta), theta[k]))
        moved.append((effect.move(sight.scene, place, theta), theta[k]))
    answers = []
    if slid[0][0] is not None:
        answers.append(
            cameras.respond(slid[0][0].which, torch.stack([s.by / step for s, step in slid if s is not None]))
        )
    if moved[0][0] is not None:
        answers.append(cameras.moved(torch.stack([m / step for m, step in moved if m is not None])))
    return answers[0] if len(answers) == 1 else answers[0] + answers[1]
