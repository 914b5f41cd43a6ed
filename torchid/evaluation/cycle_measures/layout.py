"""Which columns an evaluation has: measures of coordinates, of the low back and of the whole cycle; and its courses."""

from collections.abc import Sequence
from dataclasses import dataclass

from torchid.config import Config
from torchid.config.sections import BUILTIN_MODELS
from torchid.cycles.conventions import chosen, side_of, spellings
from torchid.cycles.cycles import Cycle
from torchid.cycles.measures import STANCE, STRIDE, WHOLE
from torchid.evaluation.statistics.comparing import MeasureColumn
from torchid.evaluation.torque_shares.back import trunk_of
from torchid.model.model import Model

BACK = "L5/S1"
"""Where of the low back's columns."""
BACK_MEASURES = ("peak_moment_Nm", "cumulative_moment_Nms", "peak_compression_N")
"""Of the extension moment between pelvis and trunk, and of compression."""
BACK_COURSES = ("extension_moment_Nm", "compression_N")
CYCLE = "cycle"
"""Where of the columns that a whole cycle has."""


@dataclass(frozen=True)
class MeasureLayout:
    """What is computed of every cycle."""

    dofs: tuple[str, ...]
    """Coordinates of the model, in its own names."""
    names: tuple[str, ...]
    """The same as the convention spells them."""
    rows: tuple[int, ...]
    """Their rows in q."""
    signs: tuple[float, ...]
    sides: tuple[str, ...]
    measures: tuple[str, ...]
    back: bool
    """Whether the model has the joint between pelvis and trunk."""
    whole: tuple[str, ...]
    """Values of a stride, or of another cycle."""
    missing: tuple[str, ...] = ()
    """Coordinates that were asked for and that the model does not have."""

    @property
    def columns(self) -> tuple[MeasureColumn, ...]:
        """All columns of measures, in order."""
        each = [
            MeasureColumn(name, measure, side)
            for name, side in zip(self.names, self.sides, strict=True)
            for measure in self.measures
        ]
        back = [MeasureColumn(BACK, measure) for measure in BACK_MEASURES] if self.back else []
        return (*each, *back, *(MeasureColumn(CYCLE, value) for value in self.whole))

    @property
    def courses(self) -> tuple[MeasureColumn, ...]:
        """All courses over a cycle: torques, then the low back's."""
        each = [MeasureColumn(name, "torque_Nm", side) for name, side in zip(self.names, self.sides, strict=True)]
        return (*each, *(MeasureColumn(BACK, course) for course in (BACK_COURSES if self.back else ())))


def from_file(config: Config) -> bool:
    """Whether the model is a file's: coordinates keep their names, and its inertia is what would have been taken."""
    return config.model not in BUILTIN_MODELS


def usual_body(config: Config) -> str:
    """What would have been taken instead of the identified body, in words."""
    return "model as shipped" if from_file(config) else "scaled template"


def make_layout(config: Config, model: Model, cycles: Sequence[Cycle]) -> MeasureLayout:
    """The columns of an evaluation.

    Args:
        config: coordinates, measures, convention, and whether the model is from a file.
        model: as it was read.
        cycles: of all trials; strides have other values than squats.
    """
    options, tree = config.evaluate, model.tree
    spelling = spellings(model, options.convention, from_file(config))
    dofs, missing = chosen(options.joints, tree.dof_names[6:])
    names, signs = zip(*(spelling[dof] for dof in dofs), strict=True) if dofs else ((), ())
    sided = bool(cycles) and all(cycle.side for cycle in cycles)
    return MeasureLayout(
        dofs, tuple(names), tuple(tree.dof_names.index(dof) for dof in dofs), tuple(signs),
        tuple(side_of(dof) for dof in dofs), options.measures, trunk_of(tree) is not None,
        (STANCE if options.cycles == "stance" else STRIDE) if sided else WHOLE, missing,
    )  # fmt: skip
