"""What effects are called in a sentence."""

from torchid.diagnosis.verdict.records import Alternative, Cause, NearestEffect, Refuted
from torchid.effects.catalogue import effect
from torchid.effects.traits import Site


def called(one: Cause | Alternative | NearestEffect | Refuted) -> str:
    """An effect and where it sits, as part of a sentence."""
    return effect(one.effect).called(one.where)


def place(one: Cause | Alternative | NearestEffect | Refuted) -> str:
    """Where an effect sits: segments and joints with their article, plates, trials and markers by name."""
    return effect(one.effect).located(one.where)


def noun(name: str) -> str:
    """What the effect called ``name`` is called in words, as the beginning of a line."""
    words = effect(name).noun
    return words[0].upper() + words[1:]


def of_markers(cause: Cause) -> bool:
    """Whether the places of a cause are markers."""
    return effect(cause.effect).site is Site.MARKER
