"""Trees of OpenSim files, held against the files' own joints."""

from pathlib import Path

import numpy as np
import torch
from osim_files import draw
from torch import Tensor
from torch.testing import assert_close

from torchid.errors import Note
from torchid.kinematics.chain import chain_poses
from torchid.model.model import Model
from torchid.model.opensim.as_model import read_osim_model
from torchid.model.opensim.model import OsimModel
from torchid.model.opensim.posing import body_poses, coupled
from torchid.model.opensim.rotations import R_OW


def drawn_state(model: OsimModel, rng: np.random.Generator, frames: int = 4) -> tuple[Tensor, Tensor, Tensor]:
    """Coordinates, rates and accelerations, locked ones at rest, couplers obeyed."""
    q = draw(model, rng, frames)
    v, a = (torch.tensor(rng.normal(size=q.shape)) for _ in range(2))
    still = [row for row, one in enumerate(model.coordinates) if one.locked]
    q[:, still], v[:, still], a[:, still] = model.defaults[still], 0.0, 0.0

    def rate(q: Tensor, v: Tensor) -> Tensor:
        return torch.func.jvp(lambda x: coupled(model, x), (q,), (v,))[1]

    v, a = torch.func.jvp(rate, (q, v), (v, a))
    return coupled(model, q), v, a


def checked(folder: Path, text: str, rng: np.random.Generator) -> tuple[Model, tuple[Note, ...]]:
    """The model of a file, its poses and its coordinates compared with the file's."""
    (folder / "a.osim").write_text(text)
    made, notes = read_osim_model(folder / "a.osim")
    binding, names = made.osim, made.tree.dof_names
    assert binding is not None
    q, v, a = drawn_state(binding.model, rng)
    states, _, _ = binding.to_tree(names, q, v, a)
    X_WT = chain_poses(made.tree, states, made.geometry.geometry(made.geometry.mean))
    X_GB = body_poses(binding.model, q)
    for body in binding.bodies:
        X_WB = X_WT[:, binding.group_of(body)] @ binding.X_TB[body]
        assert_close(R_OW @ X_WB[:, :3, :3], X_GB[:, body, :3, :3], rtol=0, atol=1e-9)
        assert_close(X_WB[:, :3, 3] @ R_OW.T, X_GB[:, body, :3, 3], rtol=0, atol=1e-9)
    back = body_poses(binding.model, binding.from_tree(names, states))
    if len(binding.bodies) == len(binding.model.bodies):
        assert_close(back, X_GB, rtol=0, atol=1e-8)
    return made, notes
