"""A device's YAML as pydantic sections: strict, no unknown keys; numbers are x, {value, sd} or ``unknown``."""

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

from torchid.conventions import Name, NonNegative


class SheetSection(BaseModel):
    """Base of all sections: frozen, strict types, no unknown keys."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)


class WithSd(SheetSection):
    """A number with its standard deviation."""

    value: float
    sd: NonNegative


Unknown = Literal["unknown"]
NumberText = float | WithSd | Unknown
Vector = tuple[float, float, float]


class VectorWithSd(SheetSection):
    """A vector with one standard deviation, or one for each of its entries."""

    value: Vector
    sd: NonNegative | tuple[NonNegative, NonNegative, NonNegative]


class MatrixWithSd(SheetSection):
    """Moments of inertia with one standard deviation for all."""

    value: Vector | tuple[Vector, Vector, Vector]
    sd: NonNegative


VectorText = Vector | VectorWithSd | Unknown
MatrixText = Vector | tuple[Vector, Vector, Vector] | MatrixWithSd | Unknown
"""Principal moments along the segment's axes, or a whole matrix."""
Table = tuple[tuple[float, float], ...]


class PartSheet(SheetSection):
    """A rigid part on a segment."""

    segment: Name
    name: Name | None = None
    mass_kg: NumberText = "unknown"
    com_m: VectorText = "unknown"
    inertia_kgm2: MatrixText = "unknown"


class ViaSheet(SheetSection):
    """A pulley on a segment."""

    segment: Name
    point_m: Vector | None = None
    marker: Name | None = None


class ProfileSheet(SheetSection):
    """A force or torque over time, phase or angle: two columns of a CSV file, or pairs of numbers."""

    over: Literal["time", "phase", "angle"]
    file: Name | None = None
    column: Name | None = None
    """Column of the file; its second one if absent."""
    table: Table | None = None


class SensorSheet(SheetSection):
    """Channels that the device records about an element."""

    force: Name | None = None
    torque: Name | None = None
    length: Name | None = None
    angle: Name | None = None
    sd: Annotated[float, Field(gt=0)] | None = None
    """Standard deviation of a sample of force or torque."""


class ElementSheet(SheetSection):
    """An element; which keys belong together is checked by ``reading``."""

    type: Literal["spring", "damper", "cable", "torque", "force", "ground"]
    between: tuple[Name, Name]
    name: Name | None = None
    coordinate: Name | None = None
    axis: Vector | None = None
    from_m: Vector | None = None
    to_m: Vector | None = None
    from_marker: Name | None = None
    """Label of a marker on the first end, instead of ``from_m``."""
    to_marker: Name | None = None
    via: tuple[ViaSheet, ...] = ()
    rail: Vector | None = None
    stiffness_N_m: NumberText | None = None
    stiffness_Nm_rad: NumberText | None = None
    rest_m: NumberText | None = None
    rest_rad: NumberText | None = None
    preload_N: NumberText | None = None
    preload_Nm: NumberText | None = None
    force_N: NumberText | None = None
    free_play_m: NumberText | None = None
    free_play_rad: NumberText | None = None
    damping_Ns_m: NumberText | None = None
    damping_Nms_rad: NumberText | None = None
    tension_only: bool | None = None
    table: Table | None = None
    profile: ProfileSheet | None = None
    channel: Name | None = None
    channels: tuple[Name, Name, Name] | None = None
    gain: NumberText | None = None
    lag_s: NumberText | None = None
    sensor: SensorSheet | None = None


class AttachedLink(SheetSection):
    """Where a link of a URDF file lies on a segment."""

    segment: Name
    xyz: Vector = (0.0, 0.0, 0.0)
    rpy: Vector = (0.0, 0.0, 0.0)


class DeviceSheet(SheetSection):
    """A whole device."""

    name: Name
    sources: tuple[Annotated[str, Field(min_length=1, max_length=2000)], ...] = ()
    mass_kg: NumberText | None = None
    parts: tuple[PartSheet, ...] = ()
    urdf: Name | None = None
    attach: dict[Name, Name | AttachedLink] = Field(default_factory=dict)
    """Link of the URDF file: segment, or its pose on one."""
    elements: tuple[ElementSheet, ...] = ()
