"""The same tree as a pytorch-kinematics ``Chain``, geometry as virtual joints.

Every offset of a joint centre is three virtual prismatic joints and every hinge angle a virtual revolute one, so that
poses and derivatives with respect to motion *and* geometry come from one batched call. The pose of the floating base
and the markers' local places are applied on top. Built from objects rather than URDF text, whose origins the library
parses in float32 (1e-8 m off).
"""

from dataclasses import dataclass
from functools import lru_cache

import pytorch_kinematics as pk
import torch
from jaxtyping import Float
from pytorch_kinematics.frame import Frame, Joint, Link
from torch import Tensor

from torchid.kinematics.recursion import CHUNK
from torchid.model.model import Geometry
from torchid.model.rotation import rotation_matrix
from torchid.model.tree import BASE_DOFS, Body, Rotation, Tree


@dataclass(frozen=True)
class ChainMap:
    """A chain and how its joint vector is filled."""

    chain: pk.Chain
    q_rows: Tensor
    """For each joint of the chain: row of (axis values, offset flattened, hinge) stacked."""
    signs: Tensor
    frames: Tensor
    """Frame index of each body."""
    joint_frames: Tensor
    """Frame index of each chain joint."""
    names: tuple[str, ...]
    tree: Tree


@lru_cache(maxsize=16)
def chain_of(tree: Tree, dtype: torch.dtype = torch.float64, device: str = "cpu") -> ChainMap:
    """Chain of ``tree`` on ``device``."""
    builder = _Builder(tree, dtype, device)
    chain = pk.Chain(builder.root, dtype=dtype, device=device)
    names = chain.get_joint_parameter_names()
    source = [builder.source[name] for name in names]
    frame = {chain.find_frame(f).joint.name: i for f, i in chain.frame_to_idx.items()}  # type: ignore[union-attr]
    return ChainMap(
        chain,
        q_rows=torch.tensor([row for row, _ in source], device=device, dtype=torch.long),
        signs=torch.tensor([sign for _, sign in source], device=device, dtype=dtype),
        frames=torch.tensor([chain.frame_to_idx[body.name] for body in tree.bodies], device=device),
        joint_frames=torch.tensor([frame[name] for name in names], device=device),
        names=tuple(names),
        tree=tree,
    )


class _Builder:
    """Collects the frames of the chain and where each joint's value comes from."""

    def __init__(self, tree: Tree, dtype: torch.dtype, device: str) -> None:
        self.tree, self.dtype, self.device = tree, dtype, device
        self.source: dict[str, tuple[int, float]] = {}
        n, self.root = tree.n_axes, Frame(tree.bodies[0].name, Link(tree.bodies[0].name))
        self.offset_row, self.hinge_row = n, n + 3 * len(tree.bodies)
        ends = {0: self.root}
        for k, body in enumerate(tree.bodies[1:], start=1):
            ends[k] = self._attach(ends[body.parent], k, body)

    def _attach(self, at: Frame, index: int, body: Body) -> Frame:
        for axis in range(3):
            row = self.offset_row + 3 * index + axis
            at = self._joint(at, f"{body.name}_offset_{'xyz'[axis]}", "prismatic", axis, row, 1.0)
        at = self._constant(at, f"{body.name}_before", body.R_PJ)
        for k, slide in enumerate(body.slides):
            at = self._joint(at, f"{body.name}_slide_{k}", "prismatic", slide.axis, slide.row, 1.0)
        for k, turn in enumerate(body.turns):
            row = turn.row if turn.moving else self.hinge_row + turn.row
            at = self._joint(at, f"{body.name}_turn_{k}", "revolute", turn.axis, row, turn.sign)
        return self._constant(at, body.name, body.R_JB)

    def _joint(self, at: Frame, name: str, kind: str, axis: int, row: int, sign: float) -> Frame:
        unit = [float(k == axis) for k in range(3)]
        joint = Joint(name, joint_type=kind, axis=unit, dtype=self.dtype, device=self.device)  # type: ignore[arg-type]
        self.source[name] = (row, sign)
        return self._hang(at, Frame(f"{name}_frame", Link(f"{name}_frame"), joint))

    def _constant(self, at: Frame, name: str, R: Rotation | None) -> Frame:
        offset = None
        if R is not None:
            rot = torch.tensor(R, dtype=self.dtype, device=self.device)
            offset = pk.Transform3d(rot=rot, dtype=self.dtype, device=self.device)
        joint = Joint(f"{name}_fixed", offset=offset, dtype=self.dtype, device=self.device)
        return self._hang(at, Frame(name, Link(name), joint))

    @staticmethod
    def _hang(at: Frame, frame: Frame) -> Frame:
        at.add_child(frame)
        return frame


def joint_values(
    chain: ChainMap, q: Float[Tensor, "frames dofs"], geometry: Geometry
) -> Float[Tensor, "frames joints"]:
    """Values of all chain joints: motion and geometry side by side; differentiable in all of them."""
    raw = torch.cat([geometry.offset.reshape(-1), geometry.hinge])
    both = torch.cat([chain.tree.axes(q.T).T, raw.expand(len(q), -1)], dim=1)
    return both.index_select(1, chain.q_rows) * chain.signs


def chain_transforms(
    chain: ChainMap, q: Float[Tensor, "frames dofs"], geometry: Geometry
) -> Float[Tensor, "links frames 4 4"]:
    """Poses of all chain frames in the root body's axes."""
    return chain.chain.forward_kinematics_tensor(joint_values(chain, q, geometry))


def chain_poses(
    tree: Tree, q: Float[Tensor, "frames dofs"], geometry: Geometry, chunk: int = CHUNK
) -> Float[Tensor, "frames bodies 4 4"]:
    """X_WB of all bodies through pytorch-kinematics, in chunks of frames (its intermediates outgrow the cache).

    Differentiable with respect to q, offsets and hinge angles.
    """
    chain = chain_of(tree, q.dtype, str(q.device))
    return torch.cat([_world(chain, part, geometry) for part in q.split(chunk)])


def _world(chain: ChainMap, q: Tensor, geometry: Geometry) -> Tensor:
    X_RB = chain_transforms(chain, q, geometry)[chain.frames].transpose(0, 1)
    return base_transform(q)[:, None] @ X_RB


def base_transform(q: Float[Tensor, "frames dofs"]) -> Float[Tensor, "frames 4 4"]:
    """X_WR of the root body from the first six coordinates."""
    R = rotation_matrix(q[:, 3:BASE_DOFS])
    top = torch.cat([R, q[:, :3, None]], dim=2)
    bottom = q.new_tensor([0.0, 0.0, 0.0, 1.0]).expand(len(q), 1, 4)
    return torch.cat([top, bottom], dim=1)


def chain_points(
    tree: Tree,
    q: Float[Tensor, "frames dofs"],
    geometry: Geometry,
    body: Tensor,
    p_BM_B: Float[Tensor, "markers 3"],
    chunk: int = CHUNK,
) -> Float[Tensor, "frames markers 3"]:
    """p_WM_W of points fixed to bodies (tree indices) through pytorch-kinematics."""
    X = chain_poses(tree, q, geometry, chunk)[:, body]
    return (X[..., :3, :3] @ p_BM_B[..., None])[..., 0] + X[..., :3, 3]
