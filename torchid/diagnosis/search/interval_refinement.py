"""Refinement of the interval of something that comes and goes, and of its course, once it is known what it is."""

from collections.abc import Iterator, Sequence
from dataclasses import replace

from torchid.diagnosis.candidates.candidate import Candidate
from torchid.diagnosis.evidence.gains import gains
from torchid.diagnosis.evidence.model import LinearModel
from torchid.effects.place import Interval, Place
from torchid.observation.trial import TrialObservation

STEP_S = 0.1
"""Resolution. Step by which both ends of an interval are moved [s]."""
REACH = 3
"""Resolution. Number of steps to either side."""
EDGES_S = (0.1, 0.25, 0.5)
"""Resolution. Times that it may take to come and to go [s]."""


def refine_interval(
    observed: Sequence[TrialObservation], model: LinearModel, chosen: Sequence[Candidate]
) -> tuple[LinearModel, Candidate]:
    """Return the model with the last chosen effect's ends and course where the evidence is best, and that candidate.

    Args:
        observed: trials of the model.
        model: model under the noise that the chosen effects leave.
        chosen: effects, the last one confined to an interval of one trial.
    """
    best = chosen[-1]
    small, own = model.restrict(chosen)
    base = small.fit(own[:-1])
    for places in (moved_ends, best.effect.finer):
        if not (some := tuple(places(best.place))):
            break
        tried, fresh = small.append(observed, best, (best.place, *some))
        best = fresh[int(gains(tried.statistics, base, fresh)[0].argmax())]
    whole, (best,) = model.append(observed, best, (best.place,))
    return whole, best


def moved_ends(place: Place) -> Iterator[Place]:
    """Yield places with the interval's ends moved, and quicker or slower to come and go.

    Args:
        place: place with one interval.
    """
    assert place.when is not None
    (own,) = place.when
    steps = [k * STEP_S for k in range(-REACH, REACH + 1)]
    for t0, t1 in ((own.t0 + a, own.t1 + b) for a in steps for b in steps):
        for edge in (e for e in EDGES_S if 2.0 * e < t1 - t0):
            yield replace(place, when=(Interval(own.trial, t0, t1),), grid={"edge_s": edge})
