"""What every effect of the catalogue, and every one that is added, must keep."""

import inspect
import math
import re
from dataclasses import dataclass

import torch
from torch.testing import assert_close

from torchid.effects import kinds
from torchid.effects.effect import Effect
from torchid.effects.place import Place
from torchid.effects.traits import Traits

KINDS = (kinds.LoadEffect, kinds.ReadingEffect, kinds.SlidingMarkers, kinds.DisplacedBodies)
DERIVED = {name for base in (Traits, Effect) for name, value in vars(base).items() if isinstance(value, property)}
"""Properties that follow from classes and enumerations."""


@dataclass(frozen=True)
class Found:
    """An effect as it was found."""

    where: tuple[str, ...]
    place: Place
    parameters: dict[str, dict[str, torch.Tensor]]


def check_class(kind: type[Effect]) -> None:
    """Final and of one kind; nothing final is replaced, and nothing is replaced twice."""
    assert getattr(kind, "__final__", False) and not inspect.isabstract(kind)
    assert sum(issubclass(kind, one) for one in KINDS) == 1
    assert not [(base, DERIVED & set(vars(base))) for base in kind.__mro__ if base not in (Traits, Effect)
                and DERIVED & set(vars(base))]  # fmt: skip
    for name in {name for base in kind.__mro__ for name, value in vars(base).items() if inspect.isfunction(value)}:
        made = [vars(base)[name] for base in kind.__mro__ if name in vars(base)]
        said = [one for one in made if not getattr(one, "__isabstractmethod__", False)]
        assert len(said) <= 2, f"{kind.__name__}.{name} is replaced twice"
        assert not any(getattr(one, "__final__", False) for one in made[1:]), f"{kind.__name__}.{name} is final"


def check_words(own: Effect, place: Place) -> None:
    """Its prior has a source; its parameters come back from what is reported; its sentence is plain."""
    for parameter in own.parameters:
        assert parameter.source and not parameter.source.endswith("."), (own.name, parameter.key)
    assert own.noun and own.advice and own.link and all(own.apart.values())
    theta = torch.tensor(own.scale(place), dtype=torch.float64)
    assert own.size(place) == len(theta) and own.positives(place) <= len(theta)
    values = own.named(place, theta)
    sd = {key: 0.1 * value.abs() for key, value in values.items()}
    said = own.sentence(Found(place.where, place, {k: {"value": v, "sd": sd[k]} for k, v in values.items()}))
    assert said and not said.endswith(".") and "_" not in said and "nan" not in said and "tensor" not in said
    assert re.search(r"\d", said) or not values
    assert all(math.isfinite(float(value.norm())) for value in values.values())
    assert_close(own.named(place, own.internal(place, values)), values, rtol=1e-7, atol=1e-7)
