"""Torques as they would be with other bodies, other errors of the markers and other plates.

All trials share the drawn bodies and plates: what is the same in two conditions leaves their difference.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.geometry.result import GeometryFit
from torchid.torque.bodies import BodyDraws, geometry_of
from torchid.torque.inverse import Load, joint_torques
from torchid.torque.seen import SeenTrial, by_body, by_markers, shifted


@dataclass(frozen=True)
class PlateErrors:
    """How wrong a plate in good order is, as standard deviations."""

    gain: float = 0.004
    """Of all its channels together. Measured: weight on one plate against the other differs by 0.4 % between the
    shared recordings (``session/standing.py``)."""
    place_m: float = 0.0023
    """Of its centre of pressure along either edge [m]. Cited: 2.3 mm on the better of four commercial plates before
    they were calibrated anew (Cappello, Bagala, Cedraro & Chiari, Gait & Posture 33(4), 2011)."""


@dataclass(frozen=True)
class TorqueDraws:
    """Torques of some trials, and how they scatter."""

    value: dict[str, Float[Tensor, "_ dofs"]]
    """As published, by trial [N m, N]."""
    draws: dict[str, Float[Tensor, "draws _ dofs"]]
    bodies: BodyDraws
    """Of each draw."""

    def sd(self, trial: str) -> Float[Tensor, "frames dofs"]:
        """Return the standard deviation of a trial's torques about the published ones [N m, N]."""
        return (self.draws[trial] - self.value[trial]).square().mean(0).sqrt()


def torque_draws(
    fit: GeometryFit,
    phi: Float[Tensor, "bodies 10"],
    trials: Sequence[SeenTrial],
    bodies: BodyDraws,
    generator: torch.Generator,
    plates: PlateErrors = PlateErrors(),
) -> TorqueDraws:
    """Compute the torques of all trials with each drawn body, under drawn errors of markers and plates.

    Args:
        fit: geometry that the motions were found with.
        phi: inertia that is published.
        bodies: drawn with the same fit.
        plates: how wrong plates are.
    """
    names = sorted({load.plate for trial in trials for load in trial.loads if load.plate is not None})
    maps = {name: _plate_maps(plates, len(bodies.xi), fit.xi, generator) for name in names}
    value, drawn = {}, {}
    for trial in trials:
        value[trial.name] = joint_torques(fit.model.tree, fit.geometry, phi, trial.motion, trial.loads)
        drawn[trial.name] = _drawn(fit, trial, bodies, maps, generator)
    return TorqueDraws(value, drawn, bodies)


def _plate_maps(errors: PlateErrors, count: int, like: Tensor, generator: torch.Generator) -> Float[Tensor, "_ 6 6"]:
    """What a plate adds to the wrench that it reads about the origin of W, as a matrix for each draw."""
    gain, x, y = torch.randn(3, count, generator=generator, dtype=torch.float64).to(like)
    found = errors.gain * gain[:, None, None] * torch.eye(6, dtype=like.dtype, device=like.device)
    found[:, 3, 2] += errors.place_m * y
    found[:, 4, 2] -= errors.place_m * x
    found[:, 5, 0] -= errors.place_m * y
    found[:, 5, 1] += errors.place_m * x
    return found


def _drawn(
    fit: GeometryFit,
    trial: SeenTrial,
    bodies: BodyDraws,
    maps: Mapping[str, Float[Tensor, "draws 6 6"]],
    generator: torch.Generator,
) -> Float[Tensor, "draws frames dofs"]:
    """Torques of one trial, draw by draw."""
    count = len(bodies.xi)
    out = trial.motion.q.new_empty(count, *trial.motion.q.shape)
    both = zip(
        by_body(trial, fit, list(bodies.xi), bodies.skin.shift(trial)), by_markers(trial, count, generator), strict=True
    )
    for k, (body, markers) in enumerate(both):
        motion = shifted(trial.motion, body + markers)
        loads = _misread(trial.loads, {name: found[k] for name, found in maps.items()}, generator)
        out[k] = joint_torques(fit.model.tree, geometry_of(fit, bodies.xi[k]), bodies.phi[k], motion, loads)
    return out


def _misread(loads: Sequence[Load], maps: Mapping[str, Tensor], generator: torch.Generator) -> list[Load]:
    """Loads as other plates would have read them, with a part of what the filter took, and computed ones in error."""
    # Of what plates show beyond the filter, joints bear anything between nothing and all; the rest, inertia does.
    borne = float(torch.rand((), generator=generator))
    most = max((load.doubt.shape[2] for load in loads if load.doubt is not None), default=0)
    causes = torch.randn(most, generator=generator, dtype=torch.float64)
    found = []
    for load in loads:
        wrench = load.wrench if load.fast is None else load.wrench + borne * load.fast
        if load.plate is not None:
            wrench = wrench + wrench @ maps[load.plate].mT
        if load.doubt is not None:
            wrench = wrench + load.doubt @ causes[: load.doubt.shape[2]].to(wrench)
        found.append(replace(load, wrench=wrench))
    return found
