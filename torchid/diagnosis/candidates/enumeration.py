"""Every effect at every place, each with its prior odds and the trials in which it could act."""

from collections.abc import Sequence

from torchid.effects.effect import Effect
from torchid.effects.place import Place
from torchid.observation.trial import TrialObservation

PERIODS = 2.0
"""Of what repeats itself that a trial must show: a walk of a second takes slow ground for an offset of its own. Walks
and squats that weigh 34 N differently agreed by that."""


def confined(effect: Effect, place: Place) -> str | None:
    """The only trial in which something can be seen there; markers' rows are kept of all effects."""
    trials = {own.trial for own in place.when or ()}
    return None if effect.moves_markers or len(trials) != 1 else next(iter(trials))


def longest_s(observed: TrialObservation) -> float:
    """Of the blocks of used frames."""
    return max((part.stop - part.start for part in observed.rows.blocks()), default=0) / observed.rows.rate


def mass(effect: Effect, places: Sequence[Place]) -> float:
    """Odds of all places together; those of proposals are shares of what could have been proposed."""
    return 1.0 if effect.intermittent or effect.per_trial else sum(place.odds for place in places)


def source_key(effect: Effect, place: Place) -> tuple:
    return effect.name, place.where, place.when, place.point, tuple(place.grid.items()), place.follows
