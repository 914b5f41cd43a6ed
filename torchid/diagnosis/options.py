"""Every threshold that decides a verdict, with its kind and its source.

The docstring of each field begins with its kind: *Derived* follows from the model of the noise or from what a number
means, *Cited* stands in the source that is named, *Calibrated* was set on sessions or recordings that were seen before:
``scripts/battery --calibrate`` shows on seeds that no quoted figure uses what hangs on it. ``threshold_kinds`` reads
them. Constants that decide nothing by themselves stay beside the code that uses them, each with a kind:
*Resolution* says how finely something is computed, *Estimator* is a constant of the statistical model, *Proposal* says
what is asked about at all, so that evidence decides, and *Wording* how a result is told.
"""

import ast
import inspect
from dataclasses import dataclass, field
from enum import StrEnum

from torchid.conventions import Count, NonNegative, Positive, Share
from torchid.model_free.options import WitnessOptions
from torchid.observation.options import ObservationOptions


@dataclass(frozen=True)
class NamingOptions:
    """Thresholds by which one scan of the catalogue names an effect, and tells it from others."""

    named_nats: Positive = 2.5
    """Calibrated. Log odds from which an effect is named, 12 to one: above the best score of any effect in sessions
    that hide nothing (``scripts/battery --calibrate``)."""
    effect_odds: Share = 0.1
    """Derived. Odds before any data that a session has an effect of one kind: one session in ten."""
    very_strong_nats: Positive = 5.0
    """Cited. Log odds from which an effect is named that sound sessions seem to have as well, if nothing but noise is
    left with it: above 150 to one, evidence is very strong (Kass & Raftery, JASA 90:773 (1995))."""
    alike_nats: Positive = 3.0
    """Cited. Log odds within which a rival cannot be told from the best: below 20 to one, evidence is not strong
    (Kass & Raftery, JASA 90:773 (1995))."""
    out_of_sight_nats: Positive = 10.0
    """Derived. Log odds behind the best at which nothing that is reported changes: odds of 22 000 to one move no
    stated percentage."""
    consent_nats: NonNegative = 1.0
    """Calibrated. Log likelihood by which trials may be predicted worse for a cause that they say nothing of. Set on a
    hidden load of 4.8 kg."""
    consent_part: Share = 0.1
    """Calibrated. Part of the evidence by which trials may be predicted worse, if that is more: for causes that only
    the prior contradicts, such as a wrong record."""
    heldout_nats: Positive = 3.0
    """Derived. Log likelihood by which held-out motion may be predicted worse, in place of ``consent_nats``: a ratio
    that should be m has a standard deviation of (2 m)^0.5, so that a true cause falls below -3 once in 140 at most."""
    look_closer_part: Share = 0.2
    """Calibrated. Part of what the likeliest explains that another effect must explain to be tried under the noise
    that it would leave."""
    look_closer_most: Count = 4
    """Calibrated. Number of effects that are tried so in one round, at most; each costs one estimate of the noise."""
    look_again_growth: Positive = 1.5
    """Calibrated. Times what an effect explained when it found no support under its own noise that it must explain to
    be tried again; it saves time."""
    periods: Positive = 2.0
    """Derived. Periods of what repeats itself that a trial must show: over fewer, sine and cosine are nearly
    combinations of an offset and a drift, which every plate has."""


@dataclass(frozen=True)
class EliminationOptions:
    """Thresholds by which a cause leaves that evidence alone would keep."""

    residual_part: Share = 0.05
    """Calibrated. Part of the residual force or moment that a cause takes away by itself from which on it is not
    doubted for a residual that is barely more than noise."""
    negative_sd: Positive = 3.0
    """Calibrated. Standard deviations below zero that refute one of several parameters that are never negative. Set on
    three recordings; of true ones one in 700 is so low by chance."""


@dataclass(frozen=True)
class AdequacyOptions:
    """Thresholds from which on what is left is more than noise."""

    p_value: Share = 0.01
    """Cited. Chance of such a residual below which it is not noise (the contract of ``unexplained.significant``)."""
    band_part: Share = 0.4
    """Calibrated. Part of a band's residual that noise does not explain from which on it matters: two thirds as much as
    the noise itself. Set before any battery was seen."""
    coefficients: Count = 30
    """Derived. Cosine coefficients below which a band is not judged: the variance of fewer is known to no better than
    a quarter, (2 / 30)^0.5."""
    position_part: Share = 0.15**2
    """Calibrated. Part of what a named force and a field beside it explain from which on the field matters: the energy
    of a force that is 15 % off. Set after two magnets had shown 0.13 and 0.21, and true forces at most 0.005."""
    vibration_ratio: Positive = 3.0
    """Calibrated. Times the power beside it that a line above the cut-off must have in every trial."""
    vibration_line_part: Share = 0.5
    """Calibrated. Part of that height from which on a line counts as one of several."""
    vibration_trials: Count = 3
    """Calibrated. Number of trials that must show the line. Set on walks, two of which shared a line by chance."""
    vibration_lines: Count = 2
    """Calibrated. Number of lines up to which they are a machine's and its first harmonic; gaits have more."""


@dataclass(frozen=True)
class ConfidenceOptions:
    """Limits of what a verdict may claim."""

    doubt: Share = 0.5
    """Derived. Times the confidence of a cause that a test contradicts without an answer of its own: even odds."""
    rivals: Count = 4
    """Derived. Number of rivals that are listed at most; what the others have stays in the confidence, so that no
    verdict hangs on it."""
    twins: Count = 2
    """Cited. Rivals that cannot be told from a cause that are named with it at most (the contract of
    ``indistinguishable``)."""


@dataclass(frozen=True)
class MissingWeightOptions:
    """Thresholds by which weight is plainly borne where no plate is."""

    missing_part: Share = 0.2
    """Calibrated. Part of the weight that must be missing for a while."""
    gone_part: Share = 0.05
    """Calibrated. Part of the weight that is missing at the ends of such an interval: more than plates and inertia
    leave open on a good recording."""
    shortest_s: Positive = 0.25
    """Calibrated. Time for which that part must be missing: a stance of running leaves as much for half of it."""
    longest_part: Share = 0.7
    """Calibrated. Part of a trial beyond which it is no interval, but a harness or a wrong mass."""
    raised_m: Positive = 0.08
    """Calibrated. Height above its lowest from which the centre of a foot that touches something is on no floor [m]:
    half of the lowest step that people stand on."""
    reach_m: Positive = 0.2
    """Calibrated. Distance from the centre of a foot within which a force goes through it [m]."""


@dataclass(frozen=True)
class NeverWorseOptions:
    """Thresholds by which a model that was fitted with a cause predicts worse than without it."""

    margin_part: Share = 0.02
    """Derived. Part by which errors may grow that nobody would call worse: below it, no figure of a report changes that
    a reader acts on. It is also the scatter of growth between blocks that is expected before any is seen."""
    prior_blocks: Positive = 2.0
    """Derived. Number of blocks that this expectation counts for: with one block, growth beyond 8 % is worse, with two
    that agree 5 %, with ten 3 %."""
    level: Share = 0.05
    """Derived. Chance that errors which grow by the margin are called worse, in one group of blocks."""


@dataclass(frozen=True)
class DiagnosisOptions:
    """Options of the diagnosis: one section for each question that a verdict answers."""

    observation: ObservationOptions = field(default_factory=ObservationOptions)
    """Frames of a trial that are evidence, and unloaded plates."""
    naming: NamingOptions = field(default_factory=NamingOptions)
    """Thresholds from which an effect is named and told from others."""
    elimination: EliminationOptions = field(default_factory=EliminationOptions)
    """Thresholds by which a cause is taken out again."""
    adequacy: AdequacyOptions = field(default_factory=AdequacyOptions)
    """Thresholds from which the residual is more than noise."""
    confidence: ConfidenceOptions = field(default_factory=ConfidenceOptions)
    """Limits of what a verdict may claim."""
    missing_weight: MissingWeightOptions = field(default_factory=MissingWeightOptions)
    """Thresholds from which weight is borne where no plate is."""
    witnesses: WitnessOptions = field(default_factory=WitnessOptions)
    """Thresholds by which model-free checks name a fault or contradict a cause."""
    never_worse: NeverWorseOptions = field(default_factory=NeverWorseOptions)
    """Thresholds by which a model that was fitted with a cause predicts worse."""


SECTIONS = (
    ObservationOptions, NamingOptions, EliminationOptions, AdequacyOptions, ConfidenceOptions,
    MissingWeightOptions, WitnessOptions, NeverWorseOptions,
)  # fmt: skip
"""Sections of the options, in the order of the table in ``docs/diagnosis.md``."""


class ThresholdKind(StrEnum):
    """Kinds of thresholds by where they come from."""

    DERIVED = "Derived"
    CITED = "Cited"
    CALIBRATED = "Calibrated"


def threshold_kinds() -> dict[str, tuple[ThresholdKind, str]]:
    """Return kind and reason of every threshold, by ``Section.field``, as its docstring has them.

    Raises:
        ValueError: a field has no docstring, or one that begins with no kind.
    """
    return {f"{one.__name__}.{name}": _kind(doc) for one in SECTIONS for name, doc in field_docs(one).items()}


def field_docs(section: type) -> dict[str, str]:
    """Return the docstring of every field of a section, empty where there is none."""
    body = ast.parse(inspect.getsource(section)).body[0]
    assert isinstance(body, ast.ClassDef)
    fields = [s.target.id for s in body.body if isinstance(s, ast.AnnAssign) and isinstance(s.target, ast.Name)]
    pairs = zip(body.body, body.body[1:], strict=False)
    docs = {
        a.target.id: inspect.cleandoc(str(b.value.value))
        for a, b in pairs
        if isinstance(a, ast.AnnAssign) and isinstance(a.target, ast.Name)
        and isinstance(b, ast.Expr) and isinstance(b.value, ast.Constant)
    }  # fmt: skip
    return {name: docs.get(name, "") for name in fields}


def _kind(doc: str) -> tuple[ThresholdKind, str]:
    """Return the kind with which a docstring begins, and the rest of it."""
    kind, _, reason = doc.partition(". ")
    return ThresholdKind(kind), reason
