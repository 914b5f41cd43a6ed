"""Which trials a finished run is judged on."""

from dataclasses import dataclass

from torchid.session.outcome import Outcome


@dataclass(frozen=True)
class Judges:
    """Trials on which the model is judged."""

    names: tuple[str, ...]
    words: str
    """``held-out trials``, or what stands in for them."""
    heldout: bool


def judges(outcome: Outcome, stage: str = "geometry") -> Judges:
    """Held-out trials that ``stage`` is judged on; where there are none, the fit trials, and without these all."""
    for role, words in (("heldout", "held-out trials"), ("fit", "fit trials")):
        names = tuple(outcome.session.part(role, stage))
        if names:
            return Judges(names, words, role == "heldout")
    return Judges(tuple(outcome.session.trials), "trials", False)
