"""What an evaluation compares: the conditions under which trials were recorded, and what is asked about them."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

from annotated_types import Ge, Gt, Lt
from pydantic import PlainValidator

from torchid.config.paths import resolve_path
from torchid.conventions import Count, Name, Positive
from torchid.errors import OptionError

DEVICE_SUFFIXES = (".yaml", ".yml", ".json", ".urdf", ".xml")
MEASURES = (
    "peak_torque_Nm", "max_torque_Nm", "min_torque_Nm", "mean_torque_Nm", "positive_work_J", "negative_work_J",
    "peak_power_W", "cumulative_load_Nms", "range_deg",
)  # fmt: skip
"""Of a coordinate in one cycle; ``torchid/cycles/measures.py`` defines them."""

FEWEST_DRAWS = 20
"""Choice. They tell a standard deviation to 16 %."""


def _device(value: object, info: Any) -> Path | str | None:
    """The path of a device's file, or the name of one in the library."""
    if isinstance(value, str) and value.strip() and Path(value).suffix.lower() not in DEVICE_SUFFIXES:
        return value
    return None if value is None else resolve_path(value, info)


@dataclass(frozen=True)
class Condition:
    """A way in which the subject was recorded."""

    reference: bool = False
    """Others are compared with this one."""
    device: Annotated[Path | str | None, PlainValidator(_device)] = None
    """What was worn: a YAML or URDF file, or the name of a device of the library; absent: nothing."""
    channels: dict[Name, Name] = field(default_factory=dict)
    """Column of a trial's ``channels`` file for each name by which the device asks for one; absent: the same name."""


@dataclass(frozen=True)
class GivenCycle:
    """One cycle that somebody else has found."""

    trial: Name
    """Name of the trial."""
    t0: float
    """The first moment in the trial's time [s]."""
    t1: float
    """The last moment [s]."""
    side: Literal["l", "r"] | None = None
    """Foot whose cycle it is; absent: of the whole body."""

    def __post_init__(self) -> None:
        if not self.t1 > self.t0:
            raise OptionError(
                "evaluate.cycle", "a cycle ends after it begins", place="t1", found=f"{self.t0} to {self.t1} s",
                remedy="Give t0 < t1 in the trial's time",
            )  # fmt: skip


@dataclass(frozen=True)
class EventCycles:
    """Cycles between equally named events of the recordings."""

    event: Name = "Foot Strike"
    """Name of the event in the files."""


@dataclass(frozen=True)
class CoordinateCycles:
    """Cycles from one rest of a coordinate to the next, past an extreme: squats, lifts, bends."""

    coordinate: Name = "pelvis_z"
    """Coordinate whose rests bound the cycles."""
    turn: Literal["low", "high"] = "low"
    """Whether the movement leads to low values (the pelvis in a squat) or to high ones (flexion in a lift)."""


@dataclass(frozen=True)
class EvaluateOptions:
    """What is asked of an evaluation."""

    joints: tuple[Name, ...] = ("hip_flexion", "knee_flexion", "ankle_flexion")
    """Coordinates; one without side stands for both sides."""
    cycles: Literal["gait", "stance"] | EventCycles | CoordinateCycles | tuple[GivenCycle, ...] = "gait"
    """How cycles are found: strides or stances by the feet's contacts, events of the files, rests of a coordinate, or a
    list of intervals."""
    measures: tuple[Literal[MEASURES], ...] = (  # type: ignore[valid-type]
        "peak_torque_Nm", "max_torque_Nm", "min_torque_Nm", "positive_work_J", "negative_work_J", "cumulative_load_Nms",
        "range_deg",
    )  # fmt: skip
    """What is tested of every coordinate; each one more is another chance to find something that is not there."""
    units: Literal["trials", "blocks"] = "trials"
    """What is exchanged between conditions: trials, or blocks of successive cycles, which takes for granted that whole
    trials of one condition do not differ."""
    level: Annotated[float, Gt(0), Lt(0.5)] = 0.05
    """Family-wise rate of false findings."""
    permutations: Annotated[int, Ge(99)] = 9999
    """At most; where there are fewer arrangements, all of them."""
    draws: Annotated[int, Ge(0)] = 64
    """Choice. Of body, markers and plates, for bands: their standard deviation is then known to 9 %. 0 draws none: no
    test needs them, and they are two thirds of what an evaluation computes after its body's run."""
    per_mass: bool = False
    """Torques, powers and works divided by the subject's mass."""
    convention: Literal["torchid", "isb", "opensim"] = "torchid"
    """Names and signs of coordinates in the files and in the report (docs/evaluate.md)."""
    lever_arm_m: tuple[Positive, Positive] = (0.05, 0.075)
    """Cited. Lever arms of the equivalent back muscle between which compression is given: 5 cm (Chaffin & Andersson,
    Occupational Biomechanics) and 7.5 cm (McGill & Norman 1987, J Biomech 20:591)."""
    shortest_s: Positive = 0.15
    """Choice. A cycle that is shorter is none: the stance of a run takes as long."""
    longest_s: Positive = 10.0
    """Choice. A cycle that is longer holds a pause."""
    points: Annotated[Count, Ge(11)] = 101
    """Points of a normalised cycle, both ends included."""

    def __post_init__(self) -> None:
        low, high = self.lever_arm_m
        if not low < high:
            raise OptionError(
                "evaluate.lever_arm", "the smaller lever arm comes first", place="lever_arm_m",
                found=f"{low}, {high}", remedy="Give [smaller, larger] in metres",
            )  # fmt: skip
        if 0 < self.draws < FEWEST_DRAWS:
            raise OptionError(
                "evaluate.draws", "so few draws tell no scatter", place="draws", found=str(self.draws),
                remedy=f"Give {FEWEST_DRAWS} or more, or 0 for no bands",
            )  # fmt: skip
        if not self.shortest_s < self.longest_s:
            raise OptionError(
                "evaluate.duration", "no cycle is that long", place="shortest_s",
                found=f"{self.shortest_s} to {self.longest_s} s", remedy="Give shortest_s < longest_s",
            )  # fmt: skip


class ConditionFault(NamedTuple):
    """What is wrong with the conditions of a config."""

    kind: str
    said: str


def faults(conditions: Mapping[str, Condition], trials: Mapping[str, str | None]) -> ConditionFault | None:
    """What is wrong with the conditions of a config, None where nothing is.

    Args:
        conditions: by name; none at all is no fault.
        trials: condition of every trial, None where it has none.
    """
    unknown = sorted({own for own in trials.values() if own is not None and own not in conditions})
    if unknown:
        return ConditionFault("unknown_condition", f"no condition is named {', '.join(unknown)}")
    if not conditions:
        return None
    references = [name for name, condition in conditions.items() if condition.reference]
    if len(references) != 1:
        return ConditionFault("no_reference", f"one condition must be the reference, {len(references)} are")
    empty = [name for name in conditions if name not in trials.values()]
    if empty and trials:
        return ConditionFault("empty_condition", f"no trial was recorded under {', '.join(empty)}")
    return None
