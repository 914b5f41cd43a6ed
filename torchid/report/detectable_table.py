"""What a session would have shown, as a table and as a sentence: what a verdict without a cause is worth."""

import math
from collections.abc import Iterator, Sequence

from torchid.diagnosis.evidence.detectable import Detectable
from torchid.diagnosis.evidence.planted_rules import CHANCE
from torchid.effects.catalogue import effect
from torchid.effects.instrument_faults import FAULTS
from torchid.effects.quantities import units_of
from torchid.report.blocks import Block, Details, Paragraph, Table
from torchid.report.cause_sentences import noun
from torchid.wording import decimals, listing, number

UNTESTABLE = "not testable here"
SAID = 5
"""Wording. Faults that the sentence lists."""
HEAD = (
    f"From these sizes on, {number(10.0 * CHANCE, 0)} of 10 such effects would have been named, by the noise here, "
    "what sound sessions seem to have of each effect, and what other effects would explain of it. Real recordings hold "
    "more, and fewer of the faults of these sizes planted into some were named, of plates' places none "
    "(docs/diagnosis.md). Smaller ones may go unseen. Of several parameters of an effect, one is there at a time."
)


def detectable_table(found: Sequence[Detectable]) -> list[Block]:
    """Return the fold-out of all sizes; nothing where none were computed.

    Args:
        found: sizes of a diagnosis.
    """
    rows = tuple((what, _range(some)) for what, some in _grouped(found))
    if not rows:
        return []
    table = Table("Smallest sizes that would have been named", ("Effect", "Named from"), rows, text=2, wrap=True)
    return [Details("What this session would have shown", (Paragraph(HEAD), table))]


def would_show(found: Sequence[Detectable]) -> list[str]:
    """Return one sentence on faults of instruments: from which size each would have been named at every place.

    Args:
        found: sizes of a diagnosis.
    """
    least: dict[str, str] = {}
    for _, some in _grouped([one for one in found if one.effect in FAULTS]):
        sizes = [one.size for one in some if one.size is not None]
        if len(sizes) == len(some):
            name, key = some[0].effect, some[0].key
            least.setdefault(name, f"{effect(name).noun} from {sized(key, max(sizes))}")
    times = number(10.0 * CHANCE, 0)
    said = f"It would have shown, {times} times in 10 by its noise: "
    return [f"{said}{listing(list(least.values()), SAID)}."] if least else []


def sized(key: str, size: float) -> str:
    """Return a size in the unit that people read, with two digits.

    Args:
        key: key of the parameter, which ends in its unit.
        size: size in that unit.
    """
    _, unit, factor = units_of(key)
    said = number(size, decimals(factor * size, 2), factor)
    return f"{said}{unit}" if unit == "°" else f"{said} {unit}"


def _grouped(found: Sequence[Detectable]) -> Iterator[tuple[str, list[Detectable]]]:
    """Yield the sizes of each effect and key, with its name; the key is said where an effect has several."""
    groups: dict[tuple[str, str], list[Detectable]] = {}
    for one in found:
        groups.setdefault((one.effect, one.key), []).append(one)
    names = [name for name, _ in groups]
    for (name, key), some in groups.items():
        yield noun(name) + (f", {key.partition('_')[0]}" if names.count(name) > 1 else ""), some


def _range(some: Sequence[Detectable]) -> str:
    """Return the least and the largest size, each with its place."""
    order = sorted(some, key=lambda one: math.inf if one.size is None else one.size)
    least, most = order[0], order[-1]
    if least.size is None:
        return UNTESTABLE
    if len(order) == 1 or _said(least) != _said(most):
        ends = [f"{_said(one)} ({effect(one.effect).located(one.where)})" for one in (order[0], *order[1:][-1:])]
        return (" to " if most.size is not None else "; ").join(ends)
    return f"{_said(least)} (everywhere)"


def _said(one: Detectable) -> str:
    """Return a size in words."""
    return UNTESTABLE if one.size is None else sized(one.key, one.size)
