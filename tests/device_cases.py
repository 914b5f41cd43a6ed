"""Devices, motions and rows for tests of ``torchid.devices``."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from torchid.conventions import INERTIA_PAIRS
from torchid.devices import Device, SheetValue, device_forces
from torchid.devices.reading import device_of
from torchid.dynamics.equations_of_motion import wrench_about
from torchid.dynamics.rows import WrenchTrial, predict
from torchid.filters import Smoother
from torchid.model.model import Geometry, Model
from torchid.model.tree import Tree
from torchid.model.whole_body import whole_body
from torchid.motion import Motion

RATE = 100.0
CUTOFF = 6.0
SHEET = Path("sheet.yaml")


def made(**sheet: Any) -> Device:
    """A device of keys as a YAML file has them."""
    return device_of({"name": "tried", **sheet}, SHEET)


def person() -> tuple[Model, Tree, Geometry]:
    """The mean of the template, its tree and its geometry."""
    model = whole_body(1.75, 70.0, "male")
    return model, model.tree, model.geometry.geometry(model.geometry.mean)


def random_motion(rng: np.random.Generator, tree: Tree, frames: int = 40, size: float = 0.3) -> Motion:
    """Independent postures, rates and accelerations, through no filter."""
    q, v, a = (torch.tensor(size * rng.normal(size=(frames, len(tree.dofs)))) for _ in range(3))
    return Motion(torch.arange(frames, dtype=torch.float64) / RATE, q, v, a, Smoother(RATE, RATE))


def moving(rng: np.random.Generator, tree: Tree, seconds: float = 12.0) -> Motion:
    """Every coordinate a sum of slow sines, with exact derivatives, called filtered."""
    time = torch.arange(round(seconds * RATE), dtype=torch.float64) / RATE
    q, v, a = (torch.zeros(len(time), len(tree.dofs), dtype=torch.float64) for _ in range(3))
    for _ in range(3):
        w = torch.tensor(2.0 * np.pi * rng.uniform(0.15, 1.2, size=len(tree.dofs)))
        phase = torch.tensor(rng.uniform(0.0, 2.0 * np.pi, size=len(tree.dofs)))
        size = torch.tensor(rng.uniform(0.05, 0.2, size=len(tree.dofs)))
        turn = time[:, None] * w + phase
        q, v, a = q + size * turn.sin(), v + size * w * turn.cos(), a - size * w * w * turn.sin()
    return Motion(time, q, v, a, Smoother(CUTOFF, RATE))


def with_parts(phi: Tensor, tree: Tree, device: Device) -> Tensor:
    """Inertia of a body with the parts of a device whose numbers are all known."""
    phi = phi.clone()
    for part in device.parts:
        assert part.mass_kg and part.com_m and part.inertia_kgm2
        m, c = part.mass_kg.value, phi.new_tensor([x.value for x in part.com_m])
        own = phi.new_tensor([x.value for x in part.inertia_kgm2])
        steiner = torch.stack([m * (float(i == j) * (c @ c) - c[i] * c[j]) for i, j in INERTIA_PAIRS])
        phi[tree.index(part.segment)] += torch.cat([phi.new_tensor([m]), m * c, own + steiner])
    return phi


def worn_trial(
    name: str, rng: np.random.Generator, tree: Tree, geometry: Geometry, phi: Tensor, device: Device | None = None
) -> WrenchTrial:
    """A trial whose plates read what a body, with a device's supports, needs; noise of 2 N and 0.5 N m."""
    motion = moving(rng, tree)
    used = torch.ones(len(motion.q), dtype=torch.bool)
    trial = WrenchTrial(name, tree, geometry, motion, motion.q.new_zeros(len(motion.q), 6), used)
    wrench = wrench_about(predict(trial, phi), -motion.q[:, :3])
    if device is not None:
        for held in device_forces(device, tree, geometry, motion).external.values():
            wrench = wrench - held
    noise = torch.tensor(rng.normal(size=tuple(wrench.shape))) * wrench.new_tensor([2.0] * 3 + [0.5] * 3)
    return replace(trial, wrench=wrench + motion.smoother(noise))


def filled(device: Device, **numbers: dict[str, float]) -> Device:
    """A device with some numbers of its elements replaced, by element and parameter."""
    own = {name: {k: SheetValue(v) for k, v in some.items()} for name, some in numbers.items()}
    return replace(device, elements=tuple(e.with_numbers(own.get(e.name, {})) for e in device.elements))
