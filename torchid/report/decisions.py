"""Why a cause was named, left out or doubted, step by step in plain words."""

import math
from collections.abc import Callable, Mapping

from torchid.diagnosis.trace import TraceStep
from torchid.effects.catalogue import effect
from torchid.report.blocks import Block, Details, Items, Paragraph
from torchid.wording import number, percent

Numbers = Mapping[str, float]
HEAD = (
    "Each line is one decision, in the order in which they were made. Effects enter one after the other while the fit "
    "trials support one. Rules then remove what other causes explain, and held-out trials test the rest. "
    "Contradictions lower the confidence. Odds a : b compare how well the recordings are predicted with the effect and "
    "without it. They are corrected for the number of candidates."
)


def why(trace: tuple[TraceStep, ...]) -> list[Block]:
    """The fold-out of all decisions; nothing where none was made.

    Args:
        trace: of the diagnosis.
    """
    if not trace:
        return []
    lines = tuple(sentence(one) for one in trace)
    return [Details("Why this, and what else was considered", (Paragraph(HEAD), Items(lines)))]


def sentence(one: TraceStep) -> str:
    """A decision as a sentence."""
    called = effect(one.effect).called(one.where)
    said = RULES[one.rule](one.numbers)
    return f"{called[0].upper()}{called[1:]} {said}."


def odds(nats: float) -> str:
    """A log likelihood ratio as odds that a person can read."""
    if nats < 0.0:
        first, _, second = odds(-nats).partition(" : ")
        return f"{second} : {first}"
    if nats >= math.log(1e6):
        return "over a million : 1"
    return f"{number(math.exp(nats), 0 if nats > 1.0 else 1)} : 1"


def _entered(noise: str) -> Callable[[Numbers], str]:
    def said(n: Numbers) -> str:
        entered = f"is named{noise}: odds {odds(n['effect_nats'])} (required {odds(n['least_nats'])})"
        if n["crossed_nats"] == n["evidence_nats"]:
            return f"{entered}; no other trial can confirm it"
        return f"{entered}; with each trial predicted from the others {odds(n['crossed_nats'])}"

    return said


def _field(n: Numbers) -> str:
    return (
        f"keeps {percent(n['factor'])} of its confidence: a force that varies with position explains "
        f"{percent(n['field_part'])} of the residual there, which this cause cannot"
    )


def _worse(n: Numbers) -> str:
    kinds = {"forces": n["force_growth_part"], "moments": n["moment_growth_part"], "markers": n["markers_growth_part"]}
    if not all(math.isfinite(part) for part in kinds.values()):
        return "stays named and is not corrected: no body fits with it corrected"
    grown = ", ".join(f"{kind} {percent(part)}" for kind, part in kinds.items())
    return (
        f"stays named and is not corrected: after refitting, errors would grow by {grown} (at most "
        f"{percent(n['most_part'])} beyond chance is allowed)"
    )


def _ordinary(n: Numbers) -> str:
    if "apparent_nats" in n:
        return (
            f"is not named: odds {odds(n['effect_nats'])}, but only {odds(n['effect_nats'] - n['apparent_nats'])} "
            f"against what sound sessions seem to have of it (required {odds(n['least_nats'])})"
        )
    return (
        f"is not named: odds {odds(n['evidence_nats'])}, with similar evidence at all locations "
        f"({odds(n['background_nats'])}): not specific"
    )


RULES: dict[str, Callable[[Numbers], str]] = {
    "evidence": _entered(""),
    "evidence_under_its_own_noise": _entered(", under the noise that it would leave"),
    "nothing_left": lambda n: (
        f"is named whatever sound sessions seem to have of it: its odds beside the others are "
        f"{odds(n['evidence_nats'])} (required {odds(n['least_nats'])}), and hardly more than noise is left with it"
    ),
    "missing_weight": lambda n: (
        f"is named before the search: up to {percent(n['missing_part'])} of the weight is borne where no plate is"
    ),
    "exchanged_distances": lambda n: (
        f"is named before the search: distances to neighbouring markers are off by {number(n['misfit_mm'])} mm as "
        f"labelled, by {number(n['undone_mm'])} mm with the labels exchanged"
    ),
    "moved_distances": lambda n: (
        f"is named beside the search, by distances to neighbouring markers: {number(n['shift_mm'])} mm from where it "
        f"sat when the subject stood (odds {odds(n['evidence_nats'])}, against one such marker in fifty)"
    ),
    "unsupported": lambda n: (
        f"is removed: given the other causes its odds are {odds(n['evidence_nats'])} (required {odds(n['least_nats'])})"
    ),
    "negative": lambda n: (
        f"is removed: its load or spring would be negative by {number(-n['lowest_sd'])} standard deviations"
    ),
    "heldout_density": lambda n: (
        f"is refuted: odds {odds(n['evidence_nats'])} in the fit trials, but {odds(n['heldout_nats'])} in held-out ones"
    ),
    "never_worse": _worse,
    "trials_disagree": lambda n: (
        f"is not named: odds {odds(n['evidence_nats'])} over all trials, but {odds(n['crossed_nats'])} with each trial "
        "predicted from the others; trials disagree"
    ),
    "ordinary": _ordinary,
    "search_price": lambda n: (
        f"is not named: odds {odds(n['evidence_nats'])} at this place, {odds(n['effect_nats'])} corrected for the "
        f"number of places tried (required {odds(n['least_nats'])})"
    ),
    "residual_structure": lambda n: (
        f"keeps {percent(n['factor'])} of its confidence: the residual exceeds the noise of plates and markers"
    ),
    "position_dependence": _field,
}
"""What each rule of the diagnosis says, by its name in the trace."""
