"""Everything a finished (or stopped) experiment knows: what is written to files and what the report draws."""

import math
from dataclasses import dataclass, field
from enum import StrEnum

from jaxtyping import Float
from torch import Tensor

from torchid.config import Config
from torchid.contact.contact import Contact
from torchid.contact.sharing.records import ContactWrenches
from torchid.diagnosis.verdict.records import Diagnosis
from torchid.dynamics.rows import WrenchTrial
from torchid.errors import Note
from torchid.geometry.result import GeometryFit
from torchid.geometry.tracking import Tracked
from torchid.inertia.identify import Identified
from torchid.model.model import InertialPrior
from torchid.motion import Motion
from torchid.recording import Trial
from torchid.session.session import Session
from torchid.storage.provenance import StageTime
from torchid.torque.consistent import ConsistentTrial


class QualityLevel(StrEnum):
    """What a reader may do with a result."""

    GOOD = "good"
    CARE = "usable with care"
    UNUSABLE = "do not use"


ORDER = (QualityLevel.GOOD, QualityLevel.CARE, QualityLevel.UNUSABLE)
"""From the best to the worst."""

FOREMOST = ("unseen",)
"""Figures that all others are read by: what no marker saw is no result, however well the rest agrees."""


@dataclass(frozen=True)
class Criterion:
    """One figure of a run beside its norm."""

    name: str
    """Key of files, such as ``force``; of a failure its code."""
    level: QualityLevel
    value: float
    norm: float
    """Up to which the figure is good; NaN where there is no figure."""
    shown: str
    """The figure in words, such as ``held-out force residual 11 % of peak``."""
    bound: str
    """The norm in words, such as ``norm 5 %``; empty where there is none."""
    source: str
    """Where the norm comes from."""
    remedy: str = ""
    """What to do where it is not good."""

    @property
    def words(self) -> str:
        """The figure and its norm."""
        return f"{self.shown} ({self.bound})" if self.bound else self.shown

    @property
    def failed(self) -> bool:
        """Whether it is what kept the rest from being found: its name is the dotted code of a failure."""
        return "." in self.name

    @property
    def ratio(self) -> float:
        """How many times its norm it is: infinite of what all others are read by, zero where there is no figure."""
        if self.failed or self.name in FOREMOST:
            return math.inf
        share = self.value / self.norm if self.norm else math.nan
        return share if math.isfinite(share) else 0.0


@dataclass(frozen=True)
class Quality:
    """All figures of a run beside their norms, those that weigh most first."""

    criteria: tuple[Criterion, ...]

    @property
    def level(self) -> QualityLevel:
        """The worst of all."""
        return max((one.level for one in self.criteria), key=ORDER.index, default=QualityLevel.CARE)

    @property
    def deciding(self) -> Criterion | None:
        """Of those of the worst level what kept the rest from being found, else what nobody saw, else what is the most
        times its norm; None of a run without any."""
        worst = [one for one in self.criteria if one.level is self.level]
        return max(worst, key=lambda one: one.ratio, default=None)

    @property
    def usable(self) -> bool:
        """False where the result is not to be used."""
        return self.level is not QualityLevel.UNUSABLE

    @property
    def line(self) -> str:
        """The verdict and the number that decides, as one line."""
        return self.level.value if self.deciding is None else f"{self.level.value}: {self.deciding.words}"


def graded(value: float, norm: float, limit: float = float("inf")) -> QualityLevel:
    """The level of a figure that should be small; a figure that is not known cannot be good.

    Args:
        norm: good up to here.
        limit: not to be used beyond.
    """
    if value <= norm:
        return QualityLevel.GOOD
    return QualityLevel.UNUSABLE if value > limit else QualityLevel.CARE


@dataclass(frozen=True)
class Followed:
    """One trial followed by one model: motion, contact and wrench through the same filter."""

    name: str
    tracked: Tracked
    motion: Motion
    contact: Contact | None = None
    wrench: WrenchTrial | None = None
    """None where the trial has no forces."""


@dataclass(frozen=True)
class Residual:
    """Force and moment residual of one group of trials under one choice of filter, geometry and inertia."""

    label: str
    role: str
    """fit or heldout."""
    cutoff_hz: float
    geometry: str
    """scaled or identified."""
    inertia: str
    """prior or identified."""
    force_rmse_N: float
    moment_rmse_Nm: float


@dataclass(frozen=True)
class Outcome:
    """Results of one subject."""

    config: Config
    session: Session
    fit: GeometryFit
    scaled: GeometryFit
    cutoff_hz: float
    followed: dict[str, Followed]
    """By trial, with the identified geometry."""
    followed_scaled: dict[str, Followed]
    prior: InertialPrior
    """At the identified segment lengths."""
    prior_scaled: InertialPrior
    identified: Identified | None = None
    diagnosis: Diagnosis | None = None
    """None where it was not asked for, or nothing was identified."""
    corrected: dict[str, Trial] = field(default_factory=dict)
    """Trials whose readings or markers are put right by what the diagnosis names; the others are as they were read."""
    base: "Outcome | None" = None
    """Before the model was extended by what the diagnosis names; None where it was not."""
    added: dict[str, Float[Tensor, "_ 6"]] = field(default_factory=dict)
    """What named effects add to the plates' total about the origin of W, by trial."""
    torque: dict[str, Float[Tensor, "_ dofs"]] = field(default_factory=dict)
    torque_scaled: dict[str, Float[Tensor, "_ dofs"]] = field(default_factory=dict)
    torque_sd: dict[str, Float[Tensor, "_ dofs"]] = field(default_factory=dict)
    """Standard deviations of ``torque`` (``torques.draws``); none where nothing was drawn."""
    consistent: dict[str, ConsistentTrial] = field(default_factory=dict)
    """Motion that obeys the forces (``motion.consistent``), by trial; static ones, and those without usable forces, are
    left out."""
    under: dict[str, ContactWrenches] = field(default_factory=dict)
    """Wrenches under the feet with the identified body, by trial; trials whose feet nobody tells are left out."""
    residuals: tuple[Residual, ...] = ()
    notes: tuple[Note, ...] = ()
    quality: Quality | None = None
    """What it is worth; None until it was judged."""
    times: dict[str, StageTime] = field(default_factory=dict)
    """Cost of each stage up to here; the only part that two equal runs do not share."""

    @property
    def phi(self) -> Float[Tensor, "bodies 10"]:
        """Identified inertia, or the prior where no forces were measured."""
        return self.prior.mean if self.identified is None else self.identified.fit.phi

    def right(self, name: str) -> Trial:
        """Return a trial as it was read, with what the diagnosis corrects put right."""
        return self.corrected.get(name, self.session.trials[name])

    def tracked(self, name: str) -> Tracked:
        """Trial followed by the identified geometry."""
        return self.followed[name].tracked
