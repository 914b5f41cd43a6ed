"""Units of length that recordings use."""

METRES = {"mm": 1e-3, "cm": 1e-2, "dm": 1e-1, "m": 1.0, "in": 0.0254}
"""Length of each unit [m]."""
