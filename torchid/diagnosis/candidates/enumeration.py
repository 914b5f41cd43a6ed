"""Every effect at every place, as sources of columns and as candidates with prior odds.

Sources stand in the order that the rest relies on: nuisances, which every trial has; effects that markers show, behind
the nuisances that markers show; other effects; and last those whose columns one trial alone has.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from torchid.diagnosis.candidates.candidate import Candidate, ColumnSource
from torchid.diagnosis.candidates.nuisances import nuisances
from torchid.diagnosis.candidates.proposals import propose
from torchid.diagnosis.options import NamingOptions
from torchid.effects.effect import Effect
from torchid.effects.place import Place
from torchid.geometry.result import GeometryFit
from torchid.observation.trial import TrialObservation


@dataclass(frozen=True)
class Enumeration:
    """All effects and places that a session could hide, with the columns that they need."""

    base: int
    """Number of columns of inertia and nuisances."""
    sources: tuple[ColumnSource, ...]
    """Sources of columns, in the order of the columns."""
    candidates: tuple[Candidate, ...]
    """Effects at places."""


def enumerate_candidates(
    observed: Sequence[TrialObservation], effects: Sequence[Effect], fit: GeometryFit | None, options: NamingOptions
) -> Enumeration:
    """Return every effect at every place that the trials propose.

    Args:
        observed: trials.
        effects: effects to try.
        fit: geometry that the trials were tracked with, whose errors are nuisances; None: none are.
        options: thresholds; ``periods`` decides which trials can show what repeats itself.
    """
    known, at = {}, observed[0].phi.numel()
    for effect, place, mean, scale in nuisances(observed, fit):
        known[source_key(effect, place)] = ColumnSource(effect, place, slice(at, at + len(scale)), mean, scale)
        at += len(scale)
    offered = {effect: propose(effect, observed) for effect in effects}
    base, known = at, known | _sources(offered, known, at)
    return Enumeration(base, tuple(known.values()), tuple(_candidates(observed, offered, known, options.periods)))


def _sources(
    offered: Mapping[Effect, Sequence[Place]], known: Mapping[tuple, ColumnSource], at: int
) -> dict[tuple, ColumnSource]:
    """Return sources of offered places that are not known yet, from a column on."""
    found: dict[tuple, ColumnSource] = {}
    wanted = [(effect, effect.source(place)[0]) for effect, places in offered.items() for place in places]
    for effect, own in sorted(wanted, key=lambda both: (not both[0].moves_markers, confined(*both) is not None)):
        key = source_key(effect, own)
        if key not in known and key not in found:
            scale = effect.scale(own)
            part = slice(at, at + len(scale))
            found[key] = ColumnSource(effect, own, part, (0.0,) * len(scale), scale, confined(effect, own))
            at = part.stop
    return found


def _candidates(
    observed: Sequence[TrialObservation],
    offered: Mapping[Effect, Sequence[Place]],
    known: Mapping[tuple, ColumnSource],
    periods: float,
) -> Iterator[Candidate]:
    """Yield offered places that some trial can show."""
    names = [one.rows.name for one in observed]
    for effect, places in offered.items():
        for place in places:
            own, trials = effect.source(place)
            which = range(len(names)) if trials is None else [names.index(t) for t in trials]
            shown = frozenset(k for k in which if _longest_s(observed[k]) >= periods * effect.period_s(place))
            if shown:
                odds = place.odds / _odds_of_all(effect, places)
                yield Candidate(effect, place, known[source_key(effect, own)], shown, odds)


def confined(effect: Effect, place: Place) -> str | None:
    """Return the only trial in which an effect at a place can be seen; None if there are several, or markers show it.

    Args:
        effect: the effect.
        place: its place.
    """
    trials = {own.trial for own in place.when or ()}
    return None if effect.moves_markers or len(trials) != 1 else next(iter(trials))


def source_key(effect: Effect, place: Place) -> tuple:
    """Return a key that is equal for places with the same columns.

    Args:
        effect: the effect.
        place: its place.
    """
    return effect.name, place.where, place.when, place.point, tuple(place.grid.items()), place.follows


def _longest_s(observed: TrialObservation) -> float:
    """Return the length of the longest block of used frames [s]."""
    return max((part.stop - part.start for part in observed.rows.blocks()), default=0) / observed.rows.rate


def _odds_of_all(effect: Effect, places: Sequence[Place]) -> float:
    """Return the odds of all places together; those of proposals are shares of what could have been proposed."""
    return 1.0 if effect.intermittent or effect.per_trial else sum(place.odds for place in places)
