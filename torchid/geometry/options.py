"""Options of the geometric fit."""

from dataclasses import dataclass, field
from typing import Annotated, Literal

from annotated_types import Le

from torchid.bounds import Count, Name, Positive


@dataclass(frozen=True)
class GeometryOptions:
    """How geometry and posture are fitted."""

    solver: Literal["arrow", "adam", "lbfgs"] = "arrow"
    symmetry: Literal["none", "tied"] = "none"
    """``tied``: left and right share every parameter."""
    groups: dict[Name, tuple[Name, ...]] = field(default_factory=dict)
    """New name: parameters that become one (grouped bones)."""
    sigma_mm: Positive | dict[Name, Positive] = 5.0
    """Expected marker residual (noise and skin), for all markers or by label."""
    reestimate_sigma: bool = True
    """Take noise and skin from the residuals; of ``sigma_mm`` by label only the proportions of skin remain."""
    robust: Positive | None = 4.0
    """Residuals beyond this many standard deviations lose their influence; None: plain least squares."""
    static_posture_sd: Positive = 0.2
    """Scatter of the joint angles of a standing subject about the neutral pose [rad]."""
    limit_sd: Positive = 0.05
    """Softness of joint limits [rad]."""
    temporal: bool = True
    """Bridge gaps by the smooth course of each coordinate."""
    max_frames: Count = 1000
    """Frames of all fit trials together that enter the joint fit, evenly spaced."""
    static_frames: Count = 30
    iterations: Annotated[Count, Le(100_000)] = 60
    """Of the arrow solver."""
    gradient_iterations: Annotated[Count, Le(1_000_000)] = 2000
    """Of Adam, or function evaluations of LBFGS."""
    tolerance: Positive = 1e-6
