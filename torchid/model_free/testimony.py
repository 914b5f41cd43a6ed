"""What each model-free check says of the causes of a verdict."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from torchid.effects.effect import Effect
from torchid.effects.place import Place
from torchid.model_free.panel import Panel
from torchid.model_free.scatter import SCATTER
from torchid.model_free.statements import CheckSubject

CONTRADICTS_SD = 3.0
"""Choice. Standard deviations from what a claim would have a witness say at which that witness contradicts it."""
HEARD_SD = 2.0
"""Choice. Standard deviations that a claim must move what a witness says for its answer to tell anything."""


@dataclass(frozen=True)
class Claim:
    """A cause with its size, as it acts on each trial."""

    effect: Effect
    place: Place
    theta: Callable[[str], Float[Tensor, " params"] | None]
    """Internal parameters in a trial; None where it does not act."""


@dataclass(frozen=True)
class CheckAnswer:
    """What one witness says of one claim, beside all others."""

    name: str
    """Kind of the witness: of ``scatter.SCATTER``, ``marker_distances`` or ``marker_quickness``."""
    trial: str
    """Trial that it was asked about."""
    where: str
    """Plate or marker that it is about; empty: all of them."""
    value: float
    """What it says, without what the other claims account for."""
    sd: float
    """Standard deviation of that between sessions where nothing is wrong."""
    expected: float
    """What it would say, were the claim right."""
    usual: float
    """What it says where nothing is wrong."""
    unit: str
    """Of all these."""

    @property
    def agrees(self) -> bool:
        """True if it does not contradict the claim, and speaks for it more than for nothing."""
        return self._off <= CONTRADICTS_SD * self.sd and self._off < abs(self.value - self.usual)

    @property
    def contradicts(self) -> bool:
        """True if the claim cannot be so, in size or at all."""
        return self._off > CONTRADICTS_SD * self.sd

    @property
    def _off(self) -> float:
        return abs(self.value - self.expected)


def answers(panel: Panel, claims: Sequence[Claim]) -> list[tuple[CheckAnswer, ...]]:
    """Return what each witness that hears a claim says of it, those that hear most of it first.

    Args:
        panel: the statements.
        claims: all that are made at once.
    """
    said = [_said(panel, one) for one in claims]
    together = sum(said, start=torch.zeros_like(panel.value))
    sd = panel.sd
    usual = panel.value.new_tensor([SCATTER[one.kind].usual for one in panel.about])
    found = []
    for own in said:
        loud, value = own.abs() / sd, panel.value + usual - (together - own)
        order = [k for k in loud.argsort(descending=True).tolist() if loud[k] > HEARD_SD]
        found.append(tuple(_answer(panel.about[k], value[k], sd[k], usual[k] + own[k]) for k in order))
    return found


def _answer(about: CheckSubject, value: Tensor, sd: Tensor, expected: Tensor) -> CheckAnswer:
    """Return what a witness says of one subject."""
    of = SCATTER[about.kind]
    return CheckAnswer(
        about.kind, about.trial, about.plate, float(value), float(sd), float(expected), of.usual, of.unit
    )  # fmt: skip


def _said(panel: Panel, one: Claim) -> Float[Tensor, " some"]:
    """Return the change that a claim made to the statements: what they are, less what they would be without it."""
    acting = [(trial, one.theta(trial.name)) for trial in panel.trials]
    return -panel.change([t if x is None else t.without(one.effect, one.place, x) for t, x in acting])
