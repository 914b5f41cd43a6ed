"""This module holds the options of the geometric fit."""

from dataclasses import dataclass, field
from typing import Annotated, Literal

from annotated_types import Le

from torchid.conventions import Count, Name, Positive


@dataclass(frozen=True)
class GeometryOptions:
    """The options with which geometry and posture are fitted."""

    solver: Literal["arrow", "adam", "lbfgs"] = "arrow"
    """Levenberg-Marquardt on all frames jointly (`arrow`), or a gradient method on the same cost."""
    symmetry: Literal["none", "tied"] = "none"
    """``tied`` lets left and right share every parameter."""
    groups: dict[Name, tuple[Name, ...]] = field(default_factory=dict)
    """Parameters that become one (grouped bones), by the name of the new one."""
    sigma_mm: Positive | dict[Name, Positive] = 5.0
    """Expected marker residual (noise and skin), for all markers or by label [mm]."""
    reestimate_sigma: bool = True
    """True takes noise and skin from the residuals, and only the proportions of a ``sigma_mm`` by label."""
    robust: Positive | None = 4.0
    """Residuals beyond this many standard deviations lose their influence; None: plain least squares."""
    static_posture_sd: Positive = 0.2
    """Scatter of the joint angles of a standing subject about the neutral pose [rad]."""
    limit_sd: Positive = 0.05
    """Softness of joint limits [rad]."""
    temporal: bool = True
    """True bridges gaps by the smooth course of each coordinate."""
    max_frames: Count = 1000
    """Frames of all fit trials together that enter the joint fit, evenly spaced."""
    static_frames: Count = 30
    """Frames of the static trial that enter the fits, evenly spaced."""
    iterations: Annotated[Count, Le(100_000)] = 60
    """Most steps of the arrow solver."""
    gradient_iterations: Annotated[Count, Le(1_000_000)] = 2000
    """Steps of Adam, or most function evaluations of LBFGS."""
    tolerance: Positive = 1e-6
    """Relative fall of the cost at which the arrow solver stops."""
