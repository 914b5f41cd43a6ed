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
        return f"is refuted: no body fits with it (errors may grow by at most {percent(n['most_part'])})"
    grown = ", ".join(f"{kind} {percent(part)}" for kind, part in kinds.items())
    return (
        f"is refuted: after refitting, errors grow by {grown} (worst of held-out trials and left-out blocks); with all "
        f"causes, by {percent(n['base_growth_part'])} of the base model's errors, more than chance"
    )


def _unproven(n: Numbers) -> str:
    kinds = {"forces": n["force_growth_part"], "moments": n["moment_growth_part"], "markers": n["markers_growth_part"]}
    changed = ", ".join(f"{kind} {percent(part)}" for kind, part in kinds.items())
    return (
        "is not corrected, only listed as possible: after refitting without it, no error grows by more than "
        f"{percent(n['most_part'])} beyond chance ({changed})"
    )


RULES: dict[str, Callable[[Numbers], str]] = {
    "evidence": _entered(""),
    "evidence_under_its_own_noise": _entered(", under the noise that it would leave"),
    "restored_record": lambda n: f"is named after forces that replaced it were removed: odds {odds(n['score_nats'])}",
    "missing_weight": lambda n: (
        f"is named before the search: up to {percent(n['missing_part'])} of the weight is borne where no plate is"
    ),
    "exchanged_distances": lambda n: (
        f"is named before the search: distances to neighbouring markers are off by {number(n['misfit_mm'])} mm as "
        f"labelled, by {number(n['undone_mm'])} mm with the labels exchanged"
    ),
    "unsupported": lambda n: (
        f"is removed: given the other causes its odds are {odds(n['evidence_nats'])} (required {odds(n['least_nats'])})"
    ),
    "negative": lambda n: (
        f"is removed: its load or spring would be negative by {number(-n['lowest_sd'])} standard deviations"
    ),
    "opposed": lambda n: (
        f"is removed with another cause: the two cancel each other but for {percent(n['remaining_part'])} of the "
        "larger one's energy"
    ),
    "no_residual_gain": lambda n: (
        f"is removed: it explains {percent(n['residual_part'], 1)} of the residual (required "
        f"{percent(n['least_part'])}, as noise does not explain the rest)"
    ),
    "heldout_density": lambda n: (
        f"is refuted: held-out trials speak against it (odds {odds(-n['heldout_nats'])}, tolerance "
        f"{number(n['leeway_nats'])} nats)"
    ),
    "heldout_errors": lambda n: (
        f"is refuted: held-out errors of forces and moments both grow by {percent(n['error_growth_part'])} with it"
    ),
    "never_worse": _worse,
    "no_gain": _unproven,
    "taken_back": lambda n: (
        f"is removed: what model-free checks and body model find adds up to {number(n['size_sd'])} standard deviations "
        f"(required {number(n['least_size_sd'])}), so the checks saw something else"
    ),
    "one_fault": lambda n: (
        "is one fault with what model-free checks named: both sizes are added up "
        f"({number(n['size_sd'])} standard deviations)"
    ),
    "only_refined": lambda n: (
        f"is removed: with confidence {percent(n['confidence'])} it would only change the size of what model-free "
        "checks named, which stays as it is"
    ),
    "trials_disagree": lambda n: (
        f"is not named: odds {odds(n['evidence_nats'])} over all trials, but {odds(n['crossed_nats'])} with each trial "
        "predicted from the others; trials disagree"
    ),
    "ordinary_everywhere": lambda n: (
        f"is not named: odds {odds(n['evidence_nats'])}, with similar evidence at all locations "
        f"({odds(n['background_nats'])}): not specific"
    ),
    "search_price": lambda n: (
        f"is not named: odds {odds(n['evidence_nats'])} at this place, {odds(n['effect_nats'])} corrected for the "
        f"number of places tried (required {odds(n['least_nats'])})"
    ),
    "nothing_can_check": lambda n: f"keeps {percent(n['factor'])} of its confidence: one trial alone cannot confirm it",
    "residual_structure": lambda n: (
        f"keeps {percent(n['factor'])} of its confidence: the residual exceeds the noise of plates and markers"
    ),
    "position_dependence": _field,
    "witnesses_name": lambda n: (
        f"is named from model-free checks: {percent(n['probability'])} for this fault or one they cannot tell from it "
        f"(required {percent(n['least_probability'])}); alone its odds are {odds(n['witness_nats'])}"
    ),
    "witnesses_disagree": lambda n: (
        f"is not named: its odds are {odds(n['witness_nats'])}, but the model-free checks contradict each other "
        f"(p {number(n['p_value'], 3)}, required {number(n['least_p_value'], 2)})"
    ),
    "witnesses_outdone": lambda n: (
        f"is not named from model-free checks (odds {odds(n['witness_nats'])}): a fault such as exchanged cables "
        f"explains them better ({odds(n['rival_nats'])}); the body model decides"
    ),
    "witnesses_contradict": lambda n: (
        f"is not named: it would change a model-free check by {number(n['heard_sd'], 1)} standard deviations; the "
        f"checks give it odds {odds(n['witness_nats'])}"
    ),
    "no_witness": lambda n: (
        f"is only possible (keeps {percent(n['factor'])} of its confidence): no model-free check confirms it "
        f"({odds(n['witness_nats'])})"
    ),
}
"""What each rule of the diagnosis says, by its name in the trace."""
