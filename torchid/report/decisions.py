"""Why a cause was named, left out or doubted, step by step in plain words."""

import math
from collections.abc import Callable, Mapping

from torchid.diagnosis.trace import TraceStep
from torchid.effects.catalogue import effect
from torchid.report.blocks import Block, Details, Items, Paragraph
from torchid.wording import number, percent

Numbers = Mapping[str, float]
HEAD = (
    "Each line is one decision, in the order in which they were made. One effect after the other enters as long as the "
    "fit trials support one; rules then take out what the others made superfluous, held-out motion is asked, and what "
    "contradicts the model lowers the confidence. Support is given as odds: so many times likelier with the effect "
    "than without it, the search for it paid for."
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
    if abs(nats) < 0.05:
        return "even odds"
    if nats < 0.0:
        return f"{odds(-nats)} against"
    return (
        f"{number(math.exp(nats), 0 if nats > 1.0 else 1)} to one" if nats < math.log(1e6) else "over a million to one"
    )


def _entered(noise: str) -> Callable[[Numbers], str]:
    def said(n: Numbers) -> str:
        entered = f"enters{noise}: {odds(n['effect_nats'])} ({odds(n['least_nats'])} are asked)"
        if n["crossed_nats"] == n["evidence_nats"]:
            return f"{entered}; no other trial could be asked"
        return f"{entered}, and each trial is predicted from the others with {odds(n['crossed_nats'])}"

    return said


def _field(n: Numbers) -> str:
    return (
        f"is doubted ({percent(n['factor'])} of its confidence stay): a force that changes freely with place explains "
        f"{percent(n['field_part'])} of what is there, which this cause could not"
    )


def _worse(n: Numbers) -> str:
    kinds = {"forces": n["force_growth_part"], "moments": n["moment_growth_part"], "markers": n["markers_growth_part"]}
    if not all(math.isfinite(part) for part in kinds.values()):
        return f"is refuted: with it no body fits, where errors may grow by {percent(n['most_part'])}"
    grown = ", ".join(f"{kind} {percent(part)}" for kind, part in kinds.items())
    return (
        "is refuted: all fitted again, the errors of the model grow by it where they grow most (in held-out trials, or "
        f"in parts of fit trials that are left out in turn): {grown}; with all causes, by "
        f"{percent(n['base_growth_part'])} of the base model's beyond chance"
    )


def _unproven(n: Numbers) -> str:
    kinds = {"forces": n["force_growth_part"], "moments": n["moment_growth_part"], "markers": n["markers_growth_part"]}
    changed = ", ".join(f"{kind} {percent(part)}" for kind, part in kinds.items())
    return (
        "leaves the model, and is listed as possible: all fitted again without it, no error grows by more than "
        f"{percent(n['most_part'])} beyond chance ({changed})"
    )


RULES: dict[str, Callable[[Numbers], str]] = {
    "evidence": _entered(""),
    "evidence_under_its_own_noise": _entered(", judged beside the noise that it would leave itself"),
    "restored_record": lambda n: f"enters since forces that stood for it have left: {odds(n['score_nats'])}",
    "missing_weight": lambda n: (
        f"enters before any search: up to {percent(n['missing_part'])} of the weight are borne where no plate is"
    ),
    "exchanged_distances": lambda n: (
        f"enters before any search: distances to the markers beside them are off by {number(n['misfit_mm'])} mm as "
        f"labelled, by {number(n['undone_mm'])} mm the other way round"
    ),
    "unsupported": lambda n: (
        f"leaves: beside the others it has {odds(n['evidence_nats'])} ({odds(n['least_nats'])} are asked)"
    ),
    "negative": lambda n: (
        f"leaves: it would be a negative load or spring, by {number(-n['lowest_sd'])} standard deviations"
    ),
    "opposed": lambda n: (
        f"leaves together with another cause: the two undo each other but for {percent(n['remaining_part'])} of the "
        "larger one's energy"
    ),
    "no_residual_gain": lambda n: (
        f"leaves: it takes {percent(n['residual_part'], 1)} of the residual away, where {percent(n['least_part'])} "
        "are asked because noise does not explain what remains"
    ),
    "heldout_density": lambda n: (
        f"is refuted: held-out motion has {odds(n['heldout_nats'])} of it, beyond its leeway of "
        f"{number(n['leeway_nats'])} nats"
    ),
    "heldout_errors": lambda n: (
        f"is refuted: held-out forces and moments both err by {percent(n['error_growth_part'])} more because of it"
    ),
    "never_worse": _worse,
    "no_gain": _unproven,
    "taken_back": lambda n: (
        "leaves: what was named without a body model is taken back by what the body model finds, but for "
        f"{number(n['size_sd'])} standard deviations ({number(n['least_size_sd'])} are asked): it stood for something"
        " else"
    ),
    "one_fault": lambda n: (
        "is one fault with what was named without a body model: both sizes are added up "
        f"({number(n['size_sd'])} standard deviations)"
    ),
    "only_refined": lambda n: (
        "leaves: it would only change the size of what was named without a body model, which stays as it is "
        f"(confidence {percent(n['confidence'])})"
    ),
    "trials_disagree": lambda n: (
        f"is not named: all trials together have {odds(n['evidence_nats'])}, but predicted from each other "
        f"{odds(n['crossed_nats'])}"
    ),
    "ordinary_everywhere": lambda n: (
        f"is not named: it has {odds(n['evidence_nats'])}, of which what all places have some of explains "
        f"{odds(n['background_nats'])}"
    ),
    "search_price": lambda n: (
        f"is not named: at this place it has {odds(n['evidence_nats'])}, with all the places that were tried "
        f"{odds(n['effect_nats'])} ({odds(n['least_nats'])} are asked)"
    ),
    "nothing_can_check": lambda n: (
        f"is doubted ({percent(n['factor'])} of its confidence stay): there is too little in one trial to check it by"
    ),
    "residual_structure": lambda n: (
        f"is doubted ({percent(n['factor'])} of its confidence stay): more remains than the noise of plates and markers"
    ),
    "position_dependence": _field,
    "witnesses_name": lambda n: (
        f"enters before any body model is asked: by what needs none it is there, or what looks like it, with a "
        f"probability of {percent(n['probability'])} (over {percent(n['least_probability'])} are asked); alone it has "
        f"{odds(n['witness_nats'])}"
    ),
    "witnesses_disagree": lambda n: (
        f"is not named: what needs no body model says so with {odds(n['witness_nats'])}, but disagrees in itself by "
        f"more than chance (probability {number(n['p_value'])}, {number(n['least_p_value'])} is asked)"
    ),
    "witnesses_outdone": lambda n: (
        f"is not named: what needs no body model says so with {odds(n['witness_nats'])}, but something without a size,"
        f" as exchanged cables, describes it better, with {odds(n['rival_nats'])}: the body model is asked"
    ),
    "witnesses_contradict": lambda n: (
        f"is not named: of what needs no body model, it would change something by {number(n['heard_sd'], 1)} standard "
        f"deviations, which is {odds(n['witness_nats'])}"
    ),
    "no_witness": lambda n: (
        f"is only possible ({percent(n['factor'])} of its confidence stay): nothing that needs no body model bears it "
        f"out ({odds(n['witness_nats'])})"
    ),
}
"""What each rule of the diagnosis says, by its name in the trace."""
