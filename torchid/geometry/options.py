"""Options of the geometric fit."""

from dataclasses import dataclass, field
from typing import Literal


@dataclass(frozen=True)
class GeometryOptions:
    """How geometry and posture are fitted."""

    solver: Literal["arrow", "adam", "lbfgs"] = "arrow"
    symmetry: Literal["none", "tied"] = "none"
    """``tied``: left and right share every parameter."""
    groups: dict[str, tuple[str, ...]] = field(default_factory=dict)
    """New name: parameters that become one (grouped bones)."""
    sigma_mm: float | dict[str, float] = 5.0
    """Expected marker residual (noise and skin), for all markers or by label."""
    reestimate_sigma: bool = True
    """Take noise and skin from the residuals; of ``sigma_mm`` by label only the proportions of skin remain."""
    robust: float | None = 4.0
    """Residuals beyond this many standard deviations lose their influence; None: plain least squares."""
    static_posture_sd: float = 0.2
    """Scatter of the joint angles of a standing subject about the neutral pose [rad]."""
    limit_sd: float = 0.05
    """Softness of joint limits [rad]."""
    temporal: bool = True
    """Bridge gaps by the smooth course of each coordinate."""
    max_frames: int = 1000
    """Frames of all fit trials together that enter the joint fit, evenly spaced."""
    static_frames: int = 30
    iterations: int = 60
    """Of the arrow solver."""
    gradient_iterations: int = 2000
    """Of Adam, or function evaluations of LBFGS."""
    tolerance: float = 1e-6
