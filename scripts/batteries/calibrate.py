"""What hangs on the calibrated thresholds of the diagnosis, on seeds that no quoted figure uses.

    scripts/battery --calibrate --sessions 108 --out out/calibration
    scripts/battery --calibrate --factors off --sessions 54 --out out/rules

A session is simulated and run once with the diagnosis disabled. Then it is diagnosed with the present thresholds, and
with each calibrated one at half and at double, all others as they are; the truth is opened only after that. ``off``
puts a threshold where its rule does nothing, which shows what the rule is worth: where the rule took no step, the
verdict is the present one without a run. A row per session goes to a file, so that a calibration that was stopped goes
on; rows of other present values do not count, and after any other change of the diagnosis another ``--out`` is needed.
A table of what each change wins and loses, and what that says of the threshold, is printed and written to
``calibration.json``.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from operator import attrgetter, itemgetter
from typing import Any, NamedTuple, get_args, get_type_hints

from annotated_types import Ge, Gt, Le

from batteries.judge import matches
from torchid.config import Config
from torchid.diagnosis.options import DiagnosisOptions, ThresholdKind, threshold_kinds
from torchid.diagnosis.verdict.records import Diagnosis
from torchid.diagnosis.verdict.table import verdict_table
from torchid.effects.catalogue import CATALOGUE
from torchid.extension.diagnosing import diagnose_outcome
from torchid.run import run_experiment

RESERVED = range(700_000, 800_000)
"""Seeds of the sessions that calibrate thresholds: no quoted figure uses them, and no other battery may."""
FACTORS = {"half": 0.5, "double": 2.0}
"""What a threshold is multiplied by."""
NEVER = 1e9
"""Nats and standard deviations that nothing has."""
OFF: dict[str, tuple[float, tuple[str, ...]]] = {
    "NamingOptions.look_closer_part": (1.0, ()),
    "EliminationOptions.residual_part": (0.0, ("residual_structure",)),
    "EliminationOptions.negative_sd": (NEVER, ("negative",)),
    "AdequacyOptions.position_part": (1.0, ("position_dependence",)),
    "ConfidenceOptions.doubt": (1.0, ("residual_structure", "position_dependence")),
    "MissingWeightOptions.missing_part": (1.0, ("missing_weight",)),
}  # fmt: skip
"""Values at which a threshold's rule does nothing, or as little as its bounds allow, and the rules one of which has
taken a step if that matters; none where steps do not tell."""
SURE = 0.5
"""Confidence above which a false cause counts."""


class Session(NamedTuple):
    """A session hides an effect of medium size or nothing; MuJoCo writes it, or torchid's own simulator."""

    seed: int
    effect: str | None
    own: bool


class Variant(NamedTuple):
    """One threshold, by its name in ``threshold_kinds``, has another value; ``factor`` is a key of ``FACTORS`` or
    ``off``."""

    threshold: str
    factor: str
    value: float
    options: DiagnosisOptions
    rules: tuple[str, ...] = ()
    """Rules of which one has taken a step wherever the verdict is another; empty if that is not known."""


@dataclass(frozen=True)
class Line:
    """What a change of one threshold does in all sessions; what is won was not there with the present value."""

    threshold: str
    factor: str
    value: float
    sessions: int
    changed: int
    """Sessions in which anything below, or the list of causes with their places, is another."""
    right: tuple[int, int]
    """Sessions won and lost whose first cause is right."""
    false: tuple[int, int]
    """Causes won and lost that the session does not hide, with a confidence above ``SURE``."""
    flagged: tuple[int, int]
    """Sessions won and lost in which more than noise is said to be left."""

    @property
    def net(self) -> int:
        """Right causes minus false ones, beyond those of the present value."""
        return self.right[0] - self.right[1] - self.false[0] + self.false[1]


def plan(first: int, sessions: int) -> list[Session]:
    """The sessions of so many seeds: every other hides nothing, of both simulators; the others one effect in turn.

    Raises:
        ValueError: a seed is not among the reserved ones.
    """
    if sessions < 1 or first not in RESERVED or first + sessions - 1 not in RESERVED:
        raise ValueError(
            f"--first {first} --sessions {sessions}: a calibration takes at least one seed, and only from "
            f"{RESERVED.start} to {RESERVED.stop - 1}, which no quoted figure uses"
        )
    return [_session(seed) for seed in range(first, first + sessions)]


def _session(seed: int) -> Session:
    names, (turn, hides) = tuple(CATALOGUE), divmod(seed - RESERVED.start, 2)
    return Session(seed, names[turn % len(names)], False) if hides else Session(seed, None, bool(turn % 2))


def calibrated_names() -> list[str]:
    """The thresholds that call themselves calibrated."""
    return [name for name, (kind, _) in threshold_kinds().items() if kind is ThresholdKind.CALIBRATED]


def present_values(options: DiagnosisOptions, names: Sequence[str]) -> dict[str, float]:
    """The values of thresholds, by name."""
    return {name: attrgetter(".".join(_place(options, name)))(options) for name in names}


def variants(options: DiagnosisOptions, names: Sequence[str], factors: Sequence[str] = tuple(FACTORS)) -> list[Variant]:
    """Each threshold by each factor, within its bounds; what these leave as it is, is left out."""
    found = []
    for name, present in present_values(options, names).items():
        section, key = _place(options, name)
        own = getattr(options, section)
        kind = get_type_hints(type(own), include_extras=True)[key]
        tried = {f: (bounded(kind, FACTORS[f] * present), ()) for f in factors if f in FACTORS}
        tried |= {f: OFF[name] for f in factors if f not in FACTORS and name in OFF}
        for factor, (value, rules) in tried.items():
            if value != present:
                changed = replace(options, **{section: replace(own, **{key: value})})
                found.append(Variant(name, factor, value, changed, rules))
    return found


def _place(options: DiagnosisOptions, name: str) -> tuple[str, str]:
    """The section's field, and the threshold's in it."""
    owner, _, key = name.partition(".")
    return next(f.name for f in fields(options) if type(getattr(options, f.name)).__name__ == owner), key


def bounded(kind: object, value: float) -> float:
    """The nearest value of a type of ``conventions``; whole for a count. Open bounds of real ones are at zero."""
    base, *bounds = get_args(kind)
    value = round(value) if base is int else value
    for bound in bounds:
        if isinstance(bound, Le):
            value = min(value, bound.le)
        elif isinstance(bound, Ge):
            value = max(value, bound.ge)
        elif isinstance(bound, Gt) and base is int:
            value = max(value, bound.gt + 1)
    return base(value)


def diagnosed(config: Config, some: Sequence[Variant]) -> list[Diagnosis | None]:
    """What is said of recordings with the present thresholds, and then with each variant.

    Names of swapped markers are not put right: verdicts are those before anything is fitted anew.
    """
    disabled = config.diagnosis.model_copy(update={"enabled": False})
    outcome = run_experiment(config.model_copy(update={"diagnosis": disabled}))

    def said(options: DiagnosisOptions) -> Diagnosis | None:
        section = config.diagnosis.model_copy(update={"thresholds": options})
        return diagnose_outcome(replace(outcome, config=config.model_copy(update={"diagnosis": section})))

    present = said(config.diagnosis.thresholds)
    return [present, *(present if _idle(one, present) else said(one.options) for one in some)]


def _idle(one: Variant, present: Diagnosis | None) -> bool:
    """Whether no rule that the variant concerns has taken a step."""
    return bool(one.rules) and not (present and any(step.rule in one.rules for step in present.trace))


def row(truth: Sequence[dict], said: Sequence[Diagnosis | None], some: Sequence[Variant]) -> dict:
    """The verdicts of one session against what it hides: the present one, and that of each variant."""
    present, *others = (
        judged(truth, verdict_table(one)["causes"] if one else [], bool(one and one.unexplained.significant))
        for one in said
    )
    pairs = zip(some, others, strict=True)
    changed = [{"threshold": v.threshold, "factor": v.factor, "value": v.value} | one for v, one in pairs]
    return {"verdict": present, "variants": changed}


def judged(truth: Sequence[dict], causes: Sequence[dict], flagged: bool) -> dict:
    """Whether the first of the causes of a ``diagnosis.json`` is hidden, and which are not and above ``SURE``."""
    right = [any(matches(planted, cause) for planted in truth) for cause in causes]
    named = [[c["effect"], list(c["where"]), round(c["confidence"], 3)] for c in causes]
    false = [n[:2] for n, c, good in zip(named, causes, right, strict=True) if not good and c["confidence"] > SURE]
    return {"named": named, "first": right[:1] == [True], "false": false, "flagged": flagged}


def counted(rows: Sequence[dict], some: Sequence[Variant]) -> list[Line]:
    """A line for each variant, over the sessions that did not fail."""
    every = [(r["verdict"], v) for r in rows if "failed" not in r for v in r["variants"]]
    key = itemgetter("threshold", "factor")
    return [_line(one, [pair for pair in every if key(pair[1]) == one[:2]]) for one in some]


def _line(one: Variant, pairs: Sequence[tuple[dict, dict]]) -> Line:
    both = pairs, [(after, before) for before, after in pairs]
    right, flagged = (tuple(sum(b[key] and not a[key] for a, b in some) for some in both)
                      for key in ("first", "flagged"))  # fmt: skip
    false = tuple(sum((_causes(b) - _causes(a)).total() for a, b in some) for some in both)
    changed = sum(_essence(a) != _essence(b) for a, b in pairs)
    return Line(one.threshold, one.factor, one.value, len(pairs), changed, right, false, flagged)


def _causes(verdict: dict) -> Counter:
    return Counter((effect, *where) for effect, where in verdict["false"])


def _essence(verdict: dict) -> tuple:
    return [one[:2] for one in verdict["named"]], verdict["first"], verdict["false"], verdict["flagged"]


def decided(lines: Sequence[Line]) -> str:
    """What the lines of one threshold say of it; where none is alone the best, the present value is kept."""
    if not any(line.changed for line in lines):
        sessions = max((line.sessions for line in lines), default=0)
        return f"nothing hangs on it in {sessions} sessions: remove it or record sessions that need it"
    best = max(line.net for line in lines)
    ahead = [line.factor for line in lines if line.net == best]
    return f"{ahead[0]} is better" if best > 0 and len(ahead) == 1 else "keep"


def document(
    rows: Sequence[dict], options: DiagnosisOptions, names: Sequence[str], factors: Sequence[str], date: str
) -> dict:
    """Content of ``calibration.json``; ``text`` is what is printed."""
    lines, present = counted(rows, variants(options, names, factors)), present_values(options, names)
    said = {name: decided([line for line in lines if line.threshold == name]) for name in names}
    failed = sum("failed" in r for r in rows)
    text = [f"{'threshold':38s} {'factor':>7s} {'value':>7s} sessions changed   right   false flagged (won/lost)"]
    text += [_told(line) for line in lines]
    text += [f"{name} = {present[name]:g}: {one}" for name, one in said.items()]
    text.append(f"{len(rows)} sessions, of which {failed} failed")
    return {"date": date, "seeds": sorted(r["seed"] for r in rows), "failed": failed, "present": present,
            "verdicts": said, "lines": [asdict(line) for line in lines], "text": text}  # fmt: skip


def _told(line: Line) -> str:
    counts = " ".join(f"{f'+{won}/-{lost}':>7s}" for won, lost in (line.right, line.false, line.flagged))
    return f"{line.threshold:38s} {line.factor:>7s} {line.value:7.3g} {line.sessions:8d} {line.changed:7d} {counts}"


def judged_with(present: dict[str, float], row: Mapping[str, Any]) -> bool:
    """Whether a session was judged with these present values; with more thresholds than these, too."""
    return present.items() <= row.get("present", {}).items()
