"""Everything that an evaluation knows: what its files hold and its report says."""

from dataclasses import dataclass

from jaxtyping import Float
from torch import Tensor

from torchid.config import Config
from torchid.cycles.cycles import Cycle
from torchid.evaluation.compared import Gap
from torchid.evaluation.cycle_measures.layout import MeasureLayout, from_file, usual_body
from torchid.evaluation.statistics.answers import BodyAnswer, sided_courses
from torchid.evaluation.statistics.comparing import Comparison
from torchid.evaluation.statistics.effects import Estimate
from torchid.evaluation.torque_shares.wearing import Worn
from torchid.evaluation.trials import ConditionTrial
from torchid.report.cause_sentences import name, told
from torchid.session import Outcome


@dataclass(frozen=True)
class AppliedCorrection:
    """A cause that the body's run has corrected for."""

    label: str
    what: str
    """Fault, place, size and time in a sentence."""
    effect: str
    where: tuple[str, ...]
    confidence: float
    """Probability that it, or one that cannot be told from it, is there."""
    trials: tuple[str, ...]
    """Trials in which it acts."""


def corrections_of(outcome: Outcome) -> tuple[AppliedCorrection, ...]:
    """Causes of a run's diagnosis that were applied."""
    if outcome.diagnosis is None or outcome.base is None:
        return ()
    return tuple(
        AppliedCorrection(name(cause), told(cause), cause.effect, cause.where, cause.confidence, cause.trials)
        for cause in outcome.diagnosis.causes
        if cause.applied
    )


@dataclass(frozen=True)
class ContactCount:
    """Of a condition's frames in which a contact bears, the shares by where its force comes from."""

    condition: str
    foot: str
    """Foot, or name of another contact."""
    frames: int
    measured: float
    """On a plate of its own."""
    shared: float
    """On a plate with another contact, and shared out."""
    beside: float
    """On no plate, or on one that does not tell: predicted where that was asked for, else left out."""


@dataclass(frozen=True)
class Evaluation:
    """Conditions of one subject compared."""

    config: Config
    outcome: Outcome
    trials: tuple[ConditionTrial, ...]
    cycles: tuple[Cycle, ...]
    conditions: tuple[str, ...]
    """Condition of every cycle."""
    layout: MeasureLayout
    identified: BodyAnswer
    template: BodyAnswer
    apart: Float[Tensor, " cycles"]
    """How far each cycle stands apart from its condition's others (``cycles.outliers``)."""
    worn: dict[str, Worn]
    contacts: tuple[ContactCount, ...]
    gaps: tuple[Gap, ...]
    per_mass_kg: float | None
    """Mass by which torques are divided, None where they are not."""
    corrections: tuple[AppliedCorrection, ...] = ()
    """What the diagnosis corrected before anything was compared."""

    @property
    def name(self) -> str:
        """The subject's."""
        return self.config.subject.name

    @property
    def names(self) -> tuple[str, ...]:
        """All conditions."""
        return tuple(self.config.conditions)

    @property
    def comparisons(self) -> tuple[Comparison, ...]:
        """With the identified body."""
        return self.identified.comparisons

    @property
    def level(self) -> float:
        """Family-wise rate of false findings."""
        return self.config.evaluate.level

    @property
    def per_mass(self) -> bool:
        """Whether torques are divided by mass."""
        return self.per_mass_kg is not None

    @property
    def reference(self) -> str:
        """Condition that the others are compared with."""
        return next(name for name, condition in self.config.conditions.items() if condition.reference)

    @property
    def usual(self) -> str:
        """What ``template`` is: the scaled template, or the user's own model as it was shipped."""
        return usual_body(self.config)

    @property
    def signs(self) -> str:
        """Whose names and signs coordinates have: those of the convention, or of the user's own model (``file``)."""
        chosen = self.config.evaluate.convention
        return f"file_{chosen}" if from_file(self.config) else chosen

    def devices(self, condition: str) -> tuple[str, ...]:
        """Name of what was worn; none where nothing was."""
        device = self.worn[condition].device
        return () if device is None else (device.name,)

    def course(self, one: Comparison, condition: str, share: str) -> Estimate:
        """Mean courses of a condition with their band, flattened to points times courses.

        Args:
            one: a comparison; all have the same courses.
            share: human, demand, device, or template.
        """
        answer = self.template if share == "template" else self.identified
        rows = answer.rows
        courses = rows.human if share == "template" else getattr(rows, share)
        draws = rows.human_draws if share == "human" else None
        values = sided_courses(courses, self.layout, self.cycles)
        return answer.mean(condition, values.flatten(1), None if draws is None else draws.flatten(2))
