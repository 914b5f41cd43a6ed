"""Somebody who walks over two plates, in a few lines: feet that stand and step, forces that aim at the body."""

import numpy as np
import torch

from torchid.conventions import GRAVITY
from torchid.recording import Forces, Markers, Plate, Trial

RATE, SPEED, STRIDE_S, MASS = 100.0, 1.2, 1.1, 70.0
STANCE = 0.62
FOOT = np.array([[0.0, 0.0, 0.03], [0.2, 0.0, 0.02], [0.15, 0.04, 0.02], [0.06, 0.03, 0.08]])
"""Heel, toe, side and ankle."""
BODY = np.array([[0.0, y, z] for y in (-0.15, 0.15) for z in (0.5, 0.95, 1.4, 1.6)])


def walking_trial(seed: int, corners: bool = True) -> Trial:
    """A walk of 2.2 s whose third and fourth steps meet a plate each, with marker noise of 1 mm and plate noise of 1 N.

    Args:
        seed: of the noise and of where on their plates the feet stand.
        corners: False gives plates without corners, as a MOT has them, in a file of their own.
    """
    random = np.random.default_rng(seed)
    time = np.arange(round(2.2 * RATE)) / RATE
    centre = np.stack([SPEED * (time - 0.6), 0 * time, 0.95 + 0 * time], axis=1)
    feet, wrenches, plates = [], [], []
    for side, y in enumerate((0.1, -0.1)):
        heel, contacts = _steps(time, 0.5 * STRIDE_S * side, y)
        feet.append(heel[:, None] + FOOT * [1, 1 if y > 0 else -1, 1])
        start, stop, x = next(c for c in contacts if c[0] > 0.4)
        plates.append(_plate(f"plate {side + 1}", x + 0.1 + random.uniform(-0.08, 0.08), y, corners))
        wrenches.append(
            _pressed(time, start, stop, x, y, centre) + random.normal(size=(len(time), 6)) * [1, 1, 1, 0, 0, 0.1]
        )
    position = np.concatenate([*feet, centre[:, None] * [1, 1, 0] + BODY], axis=1)
    position += 1e-3 * random.normal(size=position.shape)
    labels = tuple(f"M{k}" for k in range(position.shape[1]))
    clock = torch.from_numpy(time)
    forces = Forces(clock, torch.from_numpy(np.stack(wrenches, axis=1)), tuple(plates))
    facts = {"file": "walk"} if corners else {"file": "walk", "forces": "walk.mot"}
    return Trial("walk", Markers(labels, clock, torch.from_numpy(position)), forces, parameters=facts)


def _steps(time: np.ndarray, phase: float, y: float) -> tuple[np.ndarray, list[tuple[float, float, float]]]:
    """Heel (frames, 3) and every contact: its start, its end and where the heel stands."""
    heel, contacts = np.zeros((len(time), 3)), []
    stride = SPEED * STRIDE_S
    for n in range(-1, 4):
        start = n * STRIDE_S + phase
        stop, x = start + STANCE * STRIDE_S, SPEED * (start - 0.6) + 0.15
        contacts.append((start, stop, x))
        standing = (time >= start) & (time < stop)
        heel[standing] = [x, y, 0.0]
        swing = (time >= stop) & (time < start + STRIDE_S)
        share = (time[swing] - stop) / ((1 - STANCE) * STRIDE_S)
        smooth = share**2 * (3 - 2 * share)
        heel[swing] = np.stack([x + stride * smooth, y + 0 * share, 0.12 * np.sin(np.pi * share)], axis=1)
    return heel, contacts


def _pressed(time: np.ndarray, start: float, stop: float, x: float, y: float, centre: np.ndarray) -> np.ndarray:
    """Wrench about the world's origin of one contact: pressure from heel to toe, force towards the centre."""
    share = ((time - start) / (stop - start)).clip(0.0, 1.0)
    fz = MASS * GRAVITY * np.minimum(1.0, 6.0 * np.minimum(share, 1.0 - share)) * ((share > 0) & (share < 1))
    point = np.stack([x + 0.02 + 0.18 * share, y + 0 * share, 0 * share], axis=1)
    force = fz[:, None] * (centre - point) / centre[:, 2:]
    free = np.stack([0 * fz, 0 * fz, 0.005 * fz * np.sin(2 * np.pi * share)], axis=1)
    return np.concatenate([force, np.cross(point, force) + free], axis=1)


def _plate(name: str, x: float, y: float, corners: bool) -> Plate:
    """0.6 m by 0.5 m about (x, y), Z down as in C3D files; its transducer lies 40 mm below."""
    if not corners:
        return Plate(name)
    square = torch.tensor([[x + 0.3 * a, y + 0.25 * b, 0.0] for a, b in ((1, -1), (-1, -1), (-1, 1), (1, 1))])
    return Plate(name, square.double(), torch.tensor([0.0, 0.0, -0.04]).double(), 1e-3)
