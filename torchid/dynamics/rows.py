"""Rows of the base: regressor and measured wrench of a trial, about the pelvis' origin, in blocks of used frames."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchid.dynamics.equations_of_motion import base_rows, body_rows, dynamic_state, wrench_about
from torchid.model.model import Geometry
from torchid.model.tree import Tree
from torchid.motion import Motion
from torchid.runs import runs

BLOCK = 512
"""Frames per block at most; memory does not grow with the trial."""
SHORTEST = 12
"""A run of fewer used frames is passed over: its ends would be all there is of it."""


@dataclass(frozen=True)
class WrenchTrial:
    """Motion and measured wrench of one trial, through the same filter."""

    name: str
    tree: Tree
    geometry: Geometry
    motion: Motion
    wrench: Float[Tensor, "frames 6"]
    """Total on the subject about the world's origin, in W."""
    used: Bool[Tensor, " frames"]

    def frames(self, part: slice) -> "WrenchTrial":
        """Some of the frames."""
        return replace(self, motion=self.motion.frames(part), wrench=self.wrench[part], used=self.used[part])

    @property
    def rate(self) -> float:
        """Frames per second."""
        return self.motion.smoother.rate_hz

    def rows(self, part: slice) -> tuple[Float[Tensor, "6 params frames"], Float[Tensor, "6 frames"]]:
        """Y and F of some frames about the root's origin."""
        motion = self.motion
        q, v, a = (x[part].T.contiguous() for x in (motion.q, motion.v, motion.a))
        state = dynamic_state(self.tree, self.geometry, q, v, a)
        Y = base_rows(state.plan, body_rows(state))
        return Y, wrench_about(self.wrench[part], motion.q[part, :3]).T

    def blocks(self) -> Iterator[slice]:
        """Runs of used frames, cut evenly into blocks of at most ``BLOCK``."""
        for start, stop in runs(self.used):
            if stop - start < SHORTEST:
                continue
            pieces = -(-(stop - start) // BLOCK)
            edges = [start + round(k * (stop - start) / pieces) for k in range(pieces + 1)]
            yield from (slice(a, b) for a, b in zip(edges, edges[1:], strict=False))


def predict(trial: WrenchTrial, phi: Float[Tensor, "bodies 10"]) -> Float[Tensor, "frames 6"]:
    """Wrench about the root's origin that the model with ``phi`` needs, every frame."""
    out = torch.empty_like(trial.wrench)
    for start in range(0, len(out), BLOCK):
        part = slice(start, min(start + BLOCK, len(out)))
        Y, _ = trial.rows(part)
        out[part] = (phi.reshape(-1) @ Y).T
    return out


def measured(trial: WrenchTrial) -> Float[Tensor, "frames 6"]:
    """Measured wrench about the root's origin."""
    return wrench_about(trial.wrench, trial.motion.q[:, :3])


def residual_rms(trials: list[WrenchTrial], phi: Float[Tensor, "bodies 10"]) -> tuple[float, float]:
    """RMS over used frames of the 3-vectors of residual force [N] and of moment about the pelvis origin [N m]."""
    parts = [(measured(t) - predict(t, phi))[t.used] for t in trials]
    both = torch.cat(parts) if parts else phi.new_zeros(0, 6)
    if not len(both):
        return float("nan"), float("nan")
    return float(both[:, :3].square().sum(1).mean().sqrt()), float(both[:, 3:].square().sum(1).mean().sqrt())
