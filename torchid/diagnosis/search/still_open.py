"""Candidates that may still be named beside those that are chosen."""

from collections.abc import Sequence

from torchid.diagnosis.candidates.candidate import Candidate
from torchid.diagnosis.columns.design import Design
from torchid.effects.effect import Effect


def open_candidates(design: Design, chosen: Sequence[Candidate], limit: int) -> list[Candidate]:
    """Return the candidates of kinds of which fewer than ``limit`` are chosen.

    Each kind is counted apart, so that no plate's error is left out because bodies are as bodies are, or because of
    markers or a wrong record.

    Args:
        design: design of all candidates.
        chosen: effects in the model.
        limit: number of effects at most of each kind.
    """
    kinds = [kind_of(c.effect) for c in chosen if not c.ordinary]
    late = {c.place.where for c in chosen if c.effect.shifts_time}
    left = [c for c in design.candidates if c not in chosen and kinds.count(kind_of(c.effect)) < limit]
    # Of two lags of one thing only the sum shows; taken at two lags, their difference would sharpen what plates read.
    return [c for c in left if not (c.effect.shifts_time and c.place.where in late)]


def closed_by(design: Design, chosen: Sequence[Candidate], one: Candidate) -> list[Candidate]:
    """Return the candidates that one of the chosen effects keeps from being named: itself if it is ordinary, and other
    lags of the same.

    Args:
        design: design of all candidates.
        chosen: effects in the model.
        one: one of them.
    """
    here = [c for c in design.candidates if c.effect.shifts_time and c.place.where == one.place.where]
    lags = [c for c in here if c not in chosen] if one.effect.shifts_time else []
    return [one, *lags] if one.ordinary else lags


def kind_of(effect: Effect) -> tuple[bool, ...]:
    """Return the kind as which an effect is counted: whether it is of bodies, of markers, of records, all over the
    body.

    Args:
        effect: the effect.
    """
    return effect.bodily, effect.moves_markers, effect.on_record, effect.whole_body
