"""Numbers of a device's sheet: known with a standard deviation, or unknown (None)."""

from dataclasses import dataclass


@dataclass(frozen=True)
class SheetValue:
    """A number of a sheet and how well it is known."""

    value: float
    sd: float = 0.0
    """Standard deviation in the same unit; zero where the sheet states none."""

    def __format__(self, spec: str) -> str:
        """Write the number, and its standard deviation where there is one."""
        return f"{self.value:{spec}}" + (f" +- {self.sd:{spec}}" if self.sd else "")


Number = SheetValue | None
"""A number, or None for one that is to be identified."""
Triple = tuple[float, float, float]
"""Coordinates of a point or a direction in the axes that its field names."""
