"""Trials as cameras and plates have seen them, and their motion as other markers or another geometry would give it."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.dynamics.rows import WrenchTrial
from torchid.geometry.result import GeometryFit
from torchid.geometry.tracking import modelled
from torchid.motion import Motion
from torchid.observation.marker_response import MarkerResponse
from torchid.observation.noise_draws import displaced
from torchid.torque.inverse import Load

TOGETHER = 8
"""Draws whose postures are found at once; chosen for memory."""
KEPT = 0.1
"""Least share of a marker's error that postures are assumed to leave in its residual; chosen, so that a hand held by
two markers does not blow up what one of them shows."""


@dataclass(frozen=True)
class SeenTrial:
    """One trial whose torques are asked for."""

    name: str
    motion: Motion
    response: MarkerResponse
    """Markers, and how postures yield to them."""
    loads: tuple[Load, ...] = ()
    rows: WrenchTrial | None = None
    """Rows of the base, where the inertia was identified on this trial."""


def by_body(
    trial: SeenTrial,
    fit: GeometryFit,
    xi: Sequence[Float[Tensor, " xi"]],
    skin: Float[Tensor, "draws markers 3 frames"],
) -> Iterator[Float[Tensor, "frames dofs"]]:
    """Yield how far the coordinates move when the same markers are followed with another body, for each of several.

    One step of least squares at every frame: the model's markers go where the other geometry and the skin put them at
    the same coordinates, and postures take back what they can.

    Args:
        fit: geometry that the motion was found with.
        xi: the other geometries, marker places included.
        skin: how far markers have slid in W [m].
    """
    p = modelled(fit, trial.motion.q)
    for start in range(0, len(xi), TOGETHER):
        some = slice(start, start + TOGETHER)
        moved = torch.stack([modelled(replace(fit, xi=one), trial.motion.q) - p for one in xi[some]], 3)
        moved += skin[some].permute(3, 1, 2, 0)
        yield from trial.response.followed(-moved.flatten(1, 2)).unbind(2)


def by_markers(trial: SeenTrial, count: int, generator: torch.Generator) -> Iterator[Float[Tensor, "frames dofs"]]:
    """Yield how far the coordinates move under other errors of the markers with the spectrum that their residuals show.

    Each marker's residual gets phases of its own, common to its three coordinates (surrogate data: Theiler et al.,
    Physica D 58 (1992)), and is enlarged by what postures take of a marker's error. Errors of whole segments, which no
    residual shows, are not among them.

    Args:
        count: number of draws.
    """
    response, left = trial.response, count
    kept = response.bands.kept.view(-1, 3).mean(1).clamp(min=KEPT)
    spectrum = torch.fft.rfft(response.error / kept.sqrt()[:, None, None], dim=2)
    markers, _, frequencies = spectrum.shape
    while left > 0:
        some = min(TOGETHER, left)
        phase = 2.0 * torch.pi * torch.rand(some, markers, 1, frequencies, generator=generator, dtype=torch.float64)
        turned = spectrum * torch.polar(torch.ones_like(phase), phase).to(spectrum.device)
        errors = torch.fft.irfft(turned, n=response.error.shape[2], dim=3)
        yield from response.followed(errors.permute(3, 1, 2, 0).flatten(1, 2)).unbind(2)
        left -= some


def shifted(motion: Motion, by: Float[Tensor, "frames dofs"]) -> Motion:
    """Return a motion whose coordinates were found elsewhere, through its own filter.

    Args:
        by: displacement of the coordinates before the filter [m, rad]; columns 3 to 5 turn the base in W.
    """
    return displaced(motion, motion.smoother(by))
