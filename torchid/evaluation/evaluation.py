"""Everything that an evaluation knows: what its files hold and its report says."""

from dataclasses import dataclass

from jaxtyping import Float
from torch import Tensor

from torchid.config import Config
from torchid.evaluation.cycle_measures.cycles import Cycle
from torchid.evaluation.cycle_measures.layout import MeasureLayout, from_file, usual_body
from torchid.evaluation.cycle_measures.rows import CycleRows
from torchid.evaluation.statistics.comparing import Comparison, Sample
from torchid.evaluation.torque_shares.wearing import Worn
from torchid.evaluation.trials import ConditionTrial
from torchid.session import Outcome


@dataclass(frozen=True)
class Gap:
    """Something that cannot be determined, and why."""

    what: str
    why: str


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
class BodyAnswer:
    """What one body says: the identified one, or the scaled template with tabulated inertia."""

    rows: CycleRows
    sample: Sample
    comparisons: tuple[Comparison, ...]
    """Of every condition with the reference."""
    course_p: tuple[Float[Tensor, "points courses"], ...]
    """Adjusted p-values of every comparison's courses."""


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

    @property
    def reference(self) -> str:
        """Condition that the others are compared with."""
        return next(name for name, condition in self.config.conditions.items() if condition.reference)

    @property
    def others(self) -> tuple[str, ...]:
        """Conditions that are compared with the reference."""
        return tuple(name for name in self.config.conditions if name != self.reference)

    @property
    def usual(self) -> str:
        """What ``template`` is: the scaled template, or the user's own model as it was shipped."""
        return usual_body(self.config)

    @property
    def signs(self) -> str:
        """Whose names and signs coordinates have: those of the convention, or of the user's own model (``file``)."""
        chosen = self.config.evaluate.convention
        return f"file_{chosen}" if from_file(self.config) else chosen

    def unit(self, ending: str) -> str:
        """Unit of a torque measure, per mass where that is wanted.

        Args:
            ending: unit as it is without division, such as ``N m``.
        """
        return ending if self.per_mass_kg is None else f"{ending}/kg"
