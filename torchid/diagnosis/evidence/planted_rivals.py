"""This module gives what an effect that is there says for others: the moments that it leaves where they look.

Where the data hold information A of the parameters of all candidates, parameters z_j of one of them give another one a
moment A_kj z_j, and what adds to b_j, their own, adds A_kj A_jj^-1 as much to b_k. The rest of b_k is what the session
has there anyway.
"""

import math
from collections.abc import Iterator

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.diagnosis.candidates.candidate import Candidate
from torchid.diagnosis.evidence.joint_information import JointInformation
from torchid.diagnosis.evidence.planted_moments import Moments, moments_along

RIVALS = 8
"""Resolution. Other effects and places that are asked: those that an effect of the largest size says most for."""


def rival_moments(
    joint: JointInformation,
    one: Candidate,
    direction: Float[Tensor, "draws n"],
    own: Moments,
    place: int,
) -> Iterator[tuple[Candidate, Moments]]:
    """Yield the rivals of a candidate, each with the moments that the candidate's effect gives it.

    Args:
        joint: information of all candidates.
        one: the candidate.
        direction: its parameters by lot, in units of their priors.
        own: moments of the candidate's own parameters.
        place: index of the candidate among the places of these.
    """
    value, vector = own.value[place], own.vector[place]
    inverse = torch.where(value > len(value) * torch.finfo(value.dtype).eps * value.max(), 1.0 / value, 0.0)
    at = next(k for k, c in enumerate(joint.candidates) if c is one)
    here = joint.moment[joint.at[at]] @ vector
    for k in _nearest(joint, at, direction):
        passed, information = (joint.between(k, at) @ vector) * inverse, joint.between(k, k)
        noise = joint.moment[joint.at[k]] + (own.noise[place] - here) @ passed.mT
        pushed = own.pushed[place] @ passed.mT
        yield joint.candidates[k], moments_along(information[None], noise[None], pushed[None])


def _nearest(joint: JointInformation, one: int, direction: Float[Tensor, "draws n"]) -> list[int]:
    """Return the other effects or places that could take most of what a candidate's effect does to the data, each at
    the frequency that takes most."""
    own, odds = joint.candidates[one], [math.log(other.odds) for other in joint.candidates]
    best: dict[tuple[str, tuple[str, ...]], tuple[float, int]] = {}
    for k, taken in enumerate(joint.taken_by_each(one, direction.mT @ direction / len(direction)).tolist()):
        other = joint.candidates[k]
        if not _same(other, own):
            found, key = (0.5 * taken + odds[k], k), (other.effect.name, other.place.where)
            best[key] = max(best.get(key, found), found)
    return [k for _, k in sorted(best.values(), reverse=True)[:RIVALS]]


def _same(one: Candidate, other: Candidate) -> bool:
    """Return whether two candidates are one effect at one place."""
    return one.effect.name == other.effect.name and one.place.where == other.place.where
