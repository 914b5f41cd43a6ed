"""How far shares of contact are from what separate plates measured."""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import torch
from torch import Tensor

from torchid.contact.contact import Contact
from torchid.conventions import LOADED_N
from torchid.recording import Forces, Plate

PRESSING = 0.05
"""A centre of pressure is judged where both the foot's own plate and the estimate bear this part of the weight."""


@dataclass(frozen=True)
class Errors:
    """Root mean squares over feet and frames; forces in percent of body weight."""

    vertical: float
    fore_aft: float
    sideways: float
    centre_mm: float
    total_vertical: float
    sums_N: float
    """Largest violation of the sum's force [N]."""
    sums_Nm: float
    """Largest violation of the sum's moment about the world's origin [N m]."""
    frames: int


@dataclass(frozen=True)
class Split:
    """The truth about some frames."""

    truth: Tensor
    total: Tensor
    frames: Tensor
    forward: Tensor
    weight: float
    height: float


def truth_of(contact: Contact, forces: Forces) -> Tensor:
    """(frames, feet, 6): what the plates under each foot read."""
    raw = torch.nan_to_num(forces.wrench)
    return torch.stack([(raw * (contact.plate == k)[..., None]).sum(1) for k in range(len(contact.feet))], dim=1)


def handovers(raw: Tensor, contact: Contact) -> Tensor:
    """Frames in which two plates are loaded, each under a foot of its own."""
    return (raw[..., 2] > LOADED_N).all(dim=1) & ~(contact.plate == -2).any(dim=1)


def merged(forces: Forces) -> Forces:
    """One plate in the place of all, as large as the rectangle that holds them."""
    known = [plate.corners for plate in forces.plates if plate.corners is not None]
    corners = None
    if len(known) == len(forces.plates):
        every = torch.cat(known)
        low, high, z = every.amin(0), every.amax(0), every[:, 2].mean()
        places = ((high[0], high[1]), (high[0], low[1]), (low[0], low[1]), (low[0], high[1]))
        corners = torch.stack([torch.stack([x, y, z]) for x, y in places])
    return Forces(forces.time, forces.wrench.sum(dim=1, keepdim=True), (Plate("merged", corners, number=1),))


def forward_axis(soles: list[Tensor]) -> Tensor:
    """Horizontal unit vector that the feet point along."""
    way = torch.stack([(sole[:, -1] - sole[:, 0])[:, :2].mean(0) for sole in soles]).mean(0)
    return way / way.norm()


def errors(split: Split, wrench: Tensor) -> Errors:
    """Errors of estimated wrenches (frames, feet, 6) in the frames that count."""
    truth, found = split.truth[split.frames], wrench[split.frames]
    gap, side = (found - truth) / split.weight, torch.stack([-split.forward[1], split.forward[0]])
    pressing = (truth[..., 2] > PRESSING * split.weight) & (found[..., 2] > PRESSING * split.weight)
    apart = (_centre(found, split.height) - _centre(truth, split.height)).norm(dim=-1)[pressing]
    sums = (found.sum(1) - split.total[split.frames]).abs()
    worst = float(sums[:, :3].max()), float(sums[:, 3:].max())
    return Errors(
        100 * _rms(gap[..., 2]), 100 * _rms(gap[..., :2] @ split.forward), 100 * _rms(gap[..., :2] @ side),
        1e3 * _rms(apart), 100 * _rms(gap[..., 2].sum(1)), *worst, len(truth),
    )  # fmt: skip


def _centre(wrench: Tensor, height: float) -> Tensor:
    x = -wrench[..., 4] + height * wrench[..., 0]
    y = wrench[..., 3] + height * wrench[..., 1]
    return torch.stack([x, y], dim=-1) / wrench[..., 2:3]


def _rms(x: Tensor) -> float:
    return float(x.square().mean().sqrt()) if x.numel() else math.nan


def table(report: dict) -> Iterator[str]:
    """Lines of a Markdown table: each walk, then each recording over its frames."""
    if "merged" not in report:
        yield from (f"{key}: {value:.6g}" for key, value in report.items())
        return
    columns = ("vertical", "fore_aft", "sideways", "centre_mm", "total_vertical", "sums_N", "sums_Nm", "frames")
    for part in ("merged", "no plates"):
        if not report[part]:
            continue
        yield f"\n### {part}\n\n| walk | by | " + " | ".join(columns) + " |\n" + "| --- " * (2 + len(columns)) + "|"
        for walk, ways in {**report[part], **_pooled(report[part])}.items():
            for way, found in ways.items():
                yield f"| {walk} | {way} | " + " | ".join(f"{found[c]:.3g}" for c in columns) + " |"
    cost = report["cost"].values()
    if cost:
        sums = {key: sum(one[key] for one in cost) for key in next(iter(cost))}
        yield f"\n{sums['frames'] / sums['seconds']:.0f} frames per second of one core; "
        yield f"{sums['shared']} of {sums['double']} frames shared; "
        yield f"{100 * sums['inside_95'] / max(1, sums['judged']):.0f} % of vertical forces inside 95 % bands"


def _pooled(walks: dict) -> dict:
    """Each recording's errors over all frames of its walks, and those of all recordings."""
    out: dict = {}
    for name in (*dict.fromkeys(walk.split("/")[0] for walk in walks), "all"):
        own = [ways for walk, ways in walks.items() if name == "all" or walk.startswith(f"{name}/")]
        out[f"**{name}**"] = {way: _pool([ways[way] for ways in own]) for way in own[0]}
    return out


def _pool(parts: list[dict]) -> dict:
    frames = sum(one["frames"] for one in parts)
    squares = ("vertical", "fore_aft", "sideways", "centre_mm", "total_vertical")
    pooled = {
        key: math.sqrt(sum(one["frames"] * one[key] ** 2 for one in parts if one["frames"]) / max(frames, 1))
        for key in squares
    }
    worst = {key: max(one[key] for one in parts) for key in ("sums_N", "sums_Nm")}
    return {**pooled, **worst, "frames": frames}
