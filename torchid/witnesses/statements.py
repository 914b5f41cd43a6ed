"""Numbers that witnesses state, with what they are about and how well they are known."""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor


@dataclass(frozen=True)
class Subject:
    """What a number is about."""

    kind: str
    """Name of the witness."""
    trial: str
    """Trial that it was taken from."""
    plate: str = ""
    """Plate that it is about; empty: all of them."""


@dataclass(frozen=True)
class Statements:
    """Numbers of witnesses, zero where nothing is wrong."""

    about: tuple[Subject, ...]
    value: Float[Tensor, " some"]
    covariance: Float[Tensor, "some some"]
    """Of the scatter within the trial that they were taken from."""


def joined(some: list[Statements]) -> Statements:
    """Return all statements, those of different trials being independent."""
    return Statements(
        tuple(one for own in some for one in own.about),
        torch.cat([own.value for own in some]),
        torch.block_diag(*(own.covariance for own in some)),
    )
