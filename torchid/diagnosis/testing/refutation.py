"""Held-out motion is one more judge: what it says of a cause is added to what the fit trials say.

Its log density with the cause over that without is on the scale of evidence. It consents by the rule of a fit trial as
the others predict it, with a leeway of its own (``naming.heldout_nats``). What a correction does to predictions decides
whether it is applied, and takes no name (``torchid/extension/publishing.py``).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from torchid.diagnosis.candidates.candidate import Candidate
from torchid.diagnosis.options import NamingOptions
from torchid.diagnosis.search.result import support, without
from torchid.diagnosis.search.rivals import consented
from torchid.diagnosis.testing.heldout import HeldOut
from torchid.diagnosis.trace import StepKind, Trace, step

RULE = "heldout_density"
"""Name of the rule in ``docs/diagnosis.md``."""


@dataclass(frozen=True)
class HeldOutScore:
    """Evidence of fit trials and of held-out motion on a cause beside all the others."""

    evidence: float
    """Log evidence in the fit trials [nat]."""
    heldout: float
    """Log density that it gains on held-out motion [nat]: of forces given what cameras saw, where it acts on forces
    alone."""

    def total(self, options: NamingOptions) -> float:
        """Return what both say together; the lesser, where held-out motion does not consent [nat].

        Args:
            options: what consent is.
        """
        agreed = consented(self.evidence, self.heldout, replace(options, consent_nats=options.heldout_nats))
        return self.evidence + self.heldout if agreed else min(self.evidence, self.heldout)


@dataclass(frozen=True)
class Upheld:
    """Causes that held-out motion leaves, and those that it refutes."""

    chosen: tuple[Candidate, ...]
    """Causes that are left."""
    refuted: tuple[tuple[Candidate, dict[str, float]], ...]
    """Refuted causes with the numbers that the rule compared, by names that end in their unit."""
    trace: Trace
    """Decisions, in order."""


def uphold(unseen: HeldOut, chosen: Sequence[Candidate], options: NamingOptions) -> Upheld:
    """Return the causes that fit trials and held-out motion together support; the least supported leaves first.

    Args:
        unseen: the held-out trials.
        chosen: the causes.
        options: thresholds of naming.
    """
    kept, refuted, trace = list(chosen), [], []
    while kept and unseen.trials:
        scores = score(unseen, kept)
        against = [k for k, said in enumerate(scores) if said.heldout < 0.0]  # else fit trials alone decide
        worst = min(against, key=lambda k: scores[k].total(options), default=None)
        if worst is None or scores[worst].total(options) >= options.named_nats:
            break
        gone, said = kept.pop(worst), scores[worst]
        if not gone.ordinary:
            numbers = {"evidence_nats": said.evidence, "heldout_nats": said.heldout, "least_nats": options.named_nats}
            refuted.append((gone, numbers))
            trace.append(step(StepKind.REFUSE, gone, RULE, **numbers))
    return Upheld(tuple(kept), tuple(refuted), tuple(trace))


def score(unseen: HeldOut, chosen: Sequence[Candidate]) -> list[HeldOutScore]:
    """Return what is said of each cause.

    Args:
        unseen: the held-out trials.
        chosen: the causes.
    """
    whole = {density: density(chosen) for density in (unseen.density, unseen.density_of_forces)}
    found = []
    for one in chosen:
        own, rest = unseen.density if one.effect.moves_markers else unseen.density_of_forces, without(chosen, one)
        evidence = support(unseen.found.model.statistics, chosen, one)
        found.append(HeldOutScore(evidence, whole[own] - own(rest)))
    return found
