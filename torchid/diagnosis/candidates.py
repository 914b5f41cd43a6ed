"""Everything that could be hidden: every effect at every place, as columns beside those of the inertia."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import groupby

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchid.diagnosis.answers import answer_of
from torchid.diagnosis.cameras import Cameras
from torchid.diagnosis.coarse import MarkerSums, marker_sums, retaken_sums
from torchid.diagnosis.covariation import covariation
from torchid.diagnosis.design import Candidate, Columns, Design, Source, Terms, kinematic, positions
from torchid.diagnosis.fixed import Fixed
from torchid.diagnosis.idle import idle_sums
from torchid.diagnosis.nuisances import GeometryError, SkinSlide
from torchid.diagnosis.proposals import suggested
from torchid.diagnosis.rates import calibrated
from torchid.diagnosis.watched import Watched
from torchid.dynamics import wrenches_about
from torchid.effects.columns import columns
from torchid.effects.effect import Effect
from torchid.effects.markers import MarkerShift
from torchid.effects.place import Place
from torchid.effects.plates import PlateDrift, PlateOffset
from torchid.effects.sight import View
from torchid.geometry.fitted import GeometryFit

PLATES = ((PlateOffset(), 0.1), (PlateDrift(), 0.02))
"""Small errors that every plate has, part of their priors as effects: 0.5 N and the 0.01 N/s that charge amplifiers are
sold with are nobody's discovery. With 0.025 N/s usual on three other plates, 0.25 N/s had an sd of a third."""

TOGETHER = 64
"""Columns whose momenta are turned into wrenches at once: of a whole catalogue, each step would fill a gigabyte."""

PERIODS = 2.0
"""Of what repeats itself that a trial must show: a walk of a second takes slow ground for an offset of its own. Walks
and squats that weigh 34 N differently agreed by that."""


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
    skin = SkinSlide(fit.attachment.labels, fit.place)
    for place in skin.places(views):
        yield skin, place, (0.0,) * skin.size(place), skin.scale(place)


def _key(effect: Effect, place: Place) -> tuple:
    return effect.name, place.where, place.when, place.point, tuple(place.grid.items()), place.follows


def trial_columns(watched: Watched, sources: Sequence[Source]) -> Columns:
    """Of the sources that could act in one trial."""
    sources = [s for s in sources if s.trial in (None, watched.rows.name)]
    own, first = kinematic(sources), watched.phi.numel()
    live = torch.cat([torch.arange(first), *(torch.arange(s.columns.start, s.columns.stop) for s in sources)])
    extra, at, sums = watched.rows.wrench.new_zeros(6, len(live) - first, len(watched.rows.used)), 0, None
    for effect, some in groupby(sources, key=lambda s: s.effect):
        alike = list(some)
        part = slice(at, at + sum(len(s.scale) for s in alike))
        if not effect.kinematic:
            extra[:, part] = _about_root(watched, _seen_by_plates(watched.view, alike))
        at = part.stop
    if watched.cameras is not None and own.stop > own.start:
        sums, wrench = _of_cameras(watched.cameras, sources)
        extra[:, own.start - first : own.stop - first] = _about_root(watched, wrench)
    late = torch.tensor([s.effect.late for s in sources for _ in s.scale])
    extra[:, late] = calibrated(extra[:, late], watched.rows, watched.scatter)
    idle = idle_sums(watched.idle, [(s.effect, s.place, s.columns) for s in sources])
    found = Columns(extra, Terms(live, sums, idle, _covariation(watched, sources, live)))
    if watched.cameras is not None:
        watched.cameras.forget()
    return found


def retaken(watched: Watched, own: Columns, sources: Sequence[Source], others: Sequence[Source]) -> Columns:
    """Columns of a trial with those of some effects on markers taken elsewhere.

    Args:
        watched: the trial.
        own: its columns.
        sources: of all of them, ``others`` where they are now.
        others: that are elsewhere than they were; no trial lacks them.
    """
    cameras = watched.cameras
    assert cameras is not None, "effects on markers have been found"
    at, terms = torch.cat([torch.arange(s.columns.start, s.columns.stop) for s in others]), own.terms
    n, noise = watched.phi.numel(), terms.covariation
    extra = own.copied
    fresh = [answer_of(cameras, s) for s in others]
    extra[:, at - n] = _about_root(watched, cameras.wrench(fresh))
    assert terms.markers is not None, "they show among the markers"
    every, first = _together([s for s in sources if s.effect.kinematic]), kinematic(sources).start
    fixed = Fixed(cameras)
    shifts = (torch.cat([answer_of(cameras, s, fixed=fixed).shift for s in some]) for some in every)
    left = cameras.coarse.left(torch.cat([answer.shift for answer in fresh]))
    sums = retaken_sums(cameras.coarse, terms.markers, shifts, at - first, left)
    if noise is not None and watched.expected is not None:
        noise = noise.clone()
        noise[..., at] = covariation(watched, watched.expected, others, inertia=False)
    return replace(own, wide=extra, kept=None, terms=replace(terms, markers=sums, covariation=noise))


def _of_cameras(cameras: Cameras, sources: Sequence[Source]) -> tuple[MarkerSums, Float[Tensor, "6 columns frames"]]:
    """Sums of what markers show of the columns, and the wrench about the origin of W that the motion needs by them."""
    coarse, fixed, wrenches, at = cameras.coarse, Fixed(cameras), [], 0
    own = [s for s in sources if s.effect.kinematic]
    n = sum(len(s.scale) for s in own)
    spectra = coarse.error.new_empty(n + 1, len(coarse.band), coarse.error.shape[1])
    for some in _together(own):
        answers = [answer_of(cameras, s, fixed=fixed) for s in some]
        for answer, source in zip(answers, some, strict=True):
            spectra[at : at + len(source.scale)] = answer.spectrum(coarse)
            at += len(source.scale)
        wrenches.append(cameras.wrench(answers))
    spectra[n:] = coarse.spectrum(coarse.left(coarse.error[None]))
    return marker_sums(coarse, spectra, cameras.least), torch.cat(wrenches, 1)


def _together(sources: Sequence[Source]) -> Iterator[list[Source]]:
    """Neighbours that have as many columns as are best worked on at once."""
    some, columns = [], 0
    for source in sources:
        some.append(source)
        columns += len(source.scale)
        if columns >= TOGETHER:
            yield some
            some, columns = [], 0
    if some:
        yield some


def _seen_by_plates(view: View, alike: Sequence[Source]) -> Float[Tensor, "6 columns frames"]:
    """Columns of one effect."""
    effect = alike[0].effect
    if (at_once := effect.loads(view.scene, [s.place for s in alike])) is not None:
        return at_once.transpose(0, 1)
    return torch.cat([columns(effect, view.scene, view.read(effect.inverted), s.place) for s in alike], 1)


def _about_root(watched: Watched, wrench: Float[Tensor, "6 more frames"]) -> Float[Tensor, "6 more frames"]:
    return wrenches_about(wrench, watched.rows.motion.q[:, :3].T)


def _covariation(
    watched: Watched, sources: Sequence[Source], live: Int[Tensor, " live"]
) -> Float[Tensor, "bands 6 6 live"] | None:
    """See ``Terms``; zero for what no acceleration enters."""
    if watched.expected is None:
        return None
    some, n = [s for s in sources if s.effect.accelerated], watched.phi.numel()
    at, _ = positions(
        live, torch.cat([torch.arange(n), *(torch.arange(s.columns.start, s.columns.stop) for s in some)])
    )
    found = covariation(watched, watched.expected, some, inertia=True)
    whole = found.new_zeros(*found.shape[:3], len(live))
    whole[..., at] = found
    return whole
