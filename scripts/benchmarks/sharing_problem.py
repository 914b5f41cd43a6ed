"""Problems of shared contact whose totals two soles can bear, for the solver's speed and its tests."""

import torch
from torch import Tensor

from torchid.contact.sharing.expected import Expected, expected_rows
from torchid.contact.sharing.problem import SharingProblem

WEIGHT = 700.0
SOLE = ((-0.02, -0.05), (-0.02, 0.05), (0.27, -0.05), (0.27, 0.05))
FRICTION = 0.8


def random_problem(frames: int, seed: int, bend: bool = True, device: str = "cpu") -> tuple[SharingProblem, Tensor]:
    """A walk's double supports with wrenches that are drawn, and what is expected of them drawn around the truth.

    Args:
        frames: number of frames, which drift slowly through ten double supports or fewer.
        seed: of the draw.
        bend: whether frames are coupled.
        device: of the tensors.

    Returns:
        The problem, and the true wrenches (frames, 2, 6) about the world's origin.
    """
    draw = torch.Generator().manual_seed(seed)

    def uniform(*shape: int) -> Tensor:
        return torch.rand(*shape, generator=draw, dtype=torch.float64)

    def normal(*shape: int) -> Tensor:
        return torch.randn(*shape, generator=draw, dtype=torch.float64)

    phase = torch.linspace(0.0, 1.0, frames, dtype=torch.float64) * min(10.0, max(1.0, frames / 25.0))
    place = torch.stack([torch.stack([phase + 0.6 * k + 3.0, 0.0 * phase + 0.15 * (1 - 2 * k)], 1) for k in (0, 1)], 1)
    flat = place[:, :, None] + torch.tensor(SOLE, dtype=torch.float64)
    points = torch.cat([flat, torch.zeros_like(flat[..., :1])], dim=3).flatten(1, 2)
    share = 0.5 - 0.45 * torch.cos(2 * torch.pi * phase)
    pressed = uniform(frames, 8) * torch.stack([1.0 - share, share], 1).repeat_interleave(4, 1) * 0.5 * WEIGHT
    angle, slip = 2 * torch.pi * uniform(frames, 8), 0.7 * FRICTION * uniform(frames, 8)
    force = torch.stack([slip * pressed * angle.cos(), slip * pressed * angle.sin(), pressed], 2)
    each = torch.cat([force, torch.linalg.cross(points, force)], 2)
    truth = torch.stack([each[:, :4].sum(1), each[:, 4:].sum(1)], 1)
    load = truth[..., 2]
    moment = truth[..., 3:]
    centre = torch.stack([-moment[..., 1], moment[..., 0], 0.0 * load], 2) / load[..., None]
    centre[..., :2] += 0.015 * normal(frames, 2, 2)
    lean = truth[..., :2] / load[..., None] + 0.06 * normal(frames, 2, 2)
    along = torch.tensor([1.0, 0.0], dtype=torch.float64).expand(frames, 2, 2)
    rows = expected_rows(Expected(centre, along, torch.full((frames, 2, 2), 0.015, dtype=torch.float64), lean, load))
    problem = SharingProblem(
        truth.sum(1, keepdim=True), torch.zeros(2, dtype=torch.long), torch.ones(frames, 2, dtype=torch.bool),
        points, torch.arange(2).repeat_interleave(4), torch.full((8,), FRICTION, dtype=torch.float64),
        torch.eye(3, dtype=torch.float64).expand(8, 3, 3), rows, rows.new_zeros(rows.shape[:2]),
        torch.full((3,), 0.2 * WEIGHT, dtype=torch.float64) if bend else None,
    )  # fmt: skip
    return moved(problem, device), truth


def moved(problem: SharingProblem, device: str) -> SharingProblem:
    """The problem on another device."""
    parts = {name: value.to(device) for name, value in vars(problem).items() if isinstance(value, Tensor)}
    return SharingProblem(**{**vars(problem), **parts})
