"""Named causes in plain words: what, where, how much, when and how sure."""

from dataclasses import replace

from torchid.diagnosis.evidence.earlier_sessions import Unlike
from torchid.diagnosis.verdict.records import Alternative, Cause, NearestEffect, Refuted
from torchid.effects.catalogue import effect
from torchid.effects.place_words import motion_words
from torchid.effects.recommendations import tell_apart
from torchid.effects.traits import Site
from torchid.wording import clean, listing, number, percent


def called(one: Cause | Alternative | NearestEffect | Refuted | Unlike) -> str:
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


FEW = 6
"""Intervals that are listed."""
WORTH = 0.01
"""Probability below which a rival is not worth a word."""
WORDS = ((0.99, "practically certain"), (0.9, "very likely"), (0.66, "likely"), (0.0, "more likely than not"))
POSSIBLE = "possible, not confirmed independently"


def told(cause: Cause) -> str:
    """The cause as one sentence."""
    sentence = effect(cause.effect).sentence(cause)
    return f"{sentence[0].upper()}{sentence[1:]}{_when(cause)}."


def likely(cause: Cause) -> str:
    """How sure that is, in words and as a chance."""
    words = [word for least, word in WORDS if cause.confidence >= least]
    sure = POSSIBLE if cause.level == "possible" else words[0]
    return f"{sure} ({chance(cause.confidence)})"


def surely(cause: Cause) -> str:
    """How sure that is, and what else it could be."""
    said = [likely(cause)]
    for twin in cause.indistinguishable:
        part = f"Of that, {chance(twin.confidence)} is {called(twin)}, which cannot be told apart here"
        said.append(f"{part}; to tell them apart, record {tell_apart(cause.effect, twin.effect)}")
        if twin.parameters is not None and twin.place is not None:
            acts = {"place": twin.place, "when": twin.place.when, "parameters": twin.parameters}
            own = replace(cause, effect=twin.effect, where=twin.where, **acts)
            said.append(f"If it is that: {told(own).rstrip('.')}")
    twins = {(t.effect, t.where) for t in cause.indistinguishable}
    others = [a for a in rivals(cause) if (a.effect, a.where) not in twins and a.confidence >= WORTH]
    if others:
        record = tell_apart(cause.effect, others[0].effect)
        said.append(
            f"Next comes {called(others[0])} ({chance(others[0].confidence)}); to tell them apart, record {record}"
        )
    elif not twins and not cause.doubted:
        said.append(f"No other effect reaches {percent(WORTH)}")
    if cause.doubted:
        said.append("The confidence is lowered by an unexplained residual or a missing test, see below")
    return ". ".join(said) + "."


def rivals(cause: Cause) -> list[Alternative]:
    """Everything that a cause competes with, the likeliest first."""
    found = {(a.effect, a.where): a for a in (*cause.indistinguishable, *cause.alternatives)}
    return sorted(found.values(), key=lambda a: -a.confidence)


def name(one: Cause | Alternative) -> str:
    """The cause as a label, with the coordinate that it follows: skin of one segment may slide with several."""
    text = called(one)
    if isinstance(one, Cause) and one.place.follows is not None:
        text = f"{text} ({motion_words(one.place.follows)})"
    return text[0].upper() + text[1:]


def chance(confidence: float) -> str:
    """A probability that is never called certain."""
    return "over 99 %" if confidence > 0.99 else "under 1 %" if confidence < 0.01 else percent(confidence)


def _when(cause: Cause) -> str:
    """Intervals of a cause; of a state of whole recordings, the names of these."""
    when = cause.when or ()
    if not when:
        return ""
    if effect(cause.effect).per_recording:
        trials = [clean(one.trial) for one in when]
        return f" in trial{'s' if len(trials) > 1 else ''} {listing(trials)}"
    spans = [f"from {number(w.t0, 2)} to {number(w.t1, 2)} s of {clean(w.trial)}" for w in when]
    return f", {listing(spans, FEW)}"
