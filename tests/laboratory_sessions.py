"""Sessions of laboratories by lot, as the evidence that each keeps, with a fault hidden in all of them."""

import math

import numpy as np
import torch

from torchid.cohort.laboratories import Laboratory, laboratories
from torchid.diagnosis.evidence.laboratory import LaboratoryEvidence
from torchid.effects.scene import PlateFrame
from torchid.session.laboratory import LaboratoryPlate, SessionEvidence

FAULTS = (
    ("time_offset", ("session",)), ("plate_gain", ("plate_1",)), ("plate_gain", ("plate_2",)),
    ("plate_pose", ("plate_1",)), ("plate_pose", ("plate_2",)), ("gravity_tilt", ("session",)),
)  # fmt: skip
SIZES = (1, 1, 1, 6, 6, 2)
PARAMETERS = sum(SIZES)
SD = 0.3
"""To which one session knows a parameter, in prior standard deviations."""
SCATTER = 0.05
"""By which sessions differ in each of them."""
SESSIONS = 12
SQUARE = torch.tensor([[0.3, 0.2, 0.0], [-0.3, 0.2, 0.0], [-0.3, -0.2, 0.0], [0.3, -0.2, 0.0]], dtype=torch.float64)


def columns(fault: int) -> slice:
    """Parameters of a fault."""
    first = sum(SIZES[:fault])
    return slice(first, first + SIZES[fault])


def session(draw: np.random.Generator, theta: np.ndarray) -> LaboratoryEvidence:
    """What a session says of true parameters of its laboratory, half of it by statements."""
    own, parts = theta + SCATTER * draw.standard_normal(PARAMETERS), []
    for _ in range(2):
        rows = draw.standard_normal((3 * PARAMETERS, PARAMETERS)) / math.sqrt(6 * PARAMETERS) / SD
        A = rows.T @ rows
        parts.append((A, A @ own + rows.T @ draw.standard_normal(len(rows))))
    (A, a), (S, s) = (tuple(map(torch.from_numpy, part)) for part in parts)
    return LaboratoryEvidence(FAULTS, SIZES, A + S, a + s, S, s)


def here(evidence: LaboratoryEvidence, away: float = 0.0, swapped: bool = False) -> SessionEvidence:
    """The session on two plates; ``away``: of another laboratory; ``swapped``: its file numbers them otherwise."""
    corners = torch.stack([SQUARE + torch.tensor([away, y, 0.0], dtype=torch.float64) for y in (0.0, 0.6)])
    names = ("plate_2", "plate_1") if swapped else ("plate_1", "plate_2")
    eye = torch.eye(3, dtype=torch.float64)
    frames = (PlateFrame(n, c.mean(0), eye) for n, c in zip(names, corners, strict=True))
    return SessionEvidence(evidence, tuple(map(LaboratoryPlate, frames, corners)))


def laboratory(draw: np.random.Generator, theta: np.ndarray, begin: int = 0, dated: bool = False) -> Laboratory:
    """A laboratory whose sessions have these parameters from one on."""
    each = {f"s{k:02d}": here(session(draw, theta if k >= begin else 0.0 * theta)) for k in range(SESSIONS)}
    days = {name: f"2024-03-{k + 1:02d}" if dated else "" for k, name in enumerate(each)}
    (found,) = laboratories(each, {name: {"session": day} for name, day in days.items()})
    return found


def hidden(draw: np.random.Generator) -> tuple[int, np.ndarray]:
    """A fault by lot, of one prior standard deviation in a direction by lot; a clock of more than bodies' lag hides."""
    fault, theta = int(draw.integers(len(FAULTS))), np.zeros(PARAMETERS)
    direction = draw.standard_normal(SIZES[fault])
    size = 2.5 if FAULTS[fault][0] == "time_offset" else 1.0
    theta[columns(fault)] = size * direction / np.linalg.norm(direction)
    return fault, theta
