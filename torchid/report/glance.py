"""What one look tells of a run: each side of it beside its norm, what is wrong with the recordings, what to do next."""

from collections.abc import Iterator

from torchid.checks.finding import Severity
from torchid.diagnosis.verdict.instruments import instrument_findings
from torchid.diagnosis.verdict.records import Cause, Diagnosis
from torchid.effects.catalogue import CATALOGUE
from torchid.effects.recommendations import tell_apart
from torchid.report.blocks import Light
from torchid.report.cause_sentences import called, likely, told
from torchid.session import Outcome
from torchid.session.judging import REMEDIES, Mass, Masses, masses
from torchid.session.outcome import ORDER, Quality, QualityLevel
from torchid.wording import change, clean, listing, number, plural, spread

SIDES = {
    "Mass": ("mass_standing", "mass_recorded"),
    "Markers": ("markers", "marker_max"),
    "Forces": ("force", "moment", "force_template", "moment_template"),
    "Segments": ("unseen", "symmetry", "segment_mass"),
}
"""Figures by what they tell of; all others tell of the fit itself."""
FIT = "Fit"
NOTHING = "Nothing has to be done: masses are in `inertia.json`, the model in `model.osim` and `model.urdf`"
"""What comes next where all is within its norm."""
LOOK = "Read “What the model gets wrong” and “Data handling” before the results are used"
"""What comes next where something is wrong that has no remedy of its own."""
WHOLE = 400
"""Choice. Letters of a sentence that are shown."""


def glance(outcome: Outcome, quality: Quality) -> tuple[Light, ...]:
    """Return what one look tells of a run, line by line.

    Args:
        outcome: the run.
        quality: what it is worth.
    """
    lights = [light for about in SIDES if (light := _side(about, outcome, quality))]
    lights += [*_fit(quality), *_recordings(outcome, quality)]
    good = all(one.level in (None, QualityLevel.GOOD) for one in lights)
    step = next_step(outcome.diagnosis, quality) or (NOTHING if good else LOOK)
    return (*lights, Light("Next", None, f"{step}."))


def _side(about: str, outcome: Outcome, quality: Quality) -> Light | None:
    """The first two figures of a side, and others beyond their norm; of the mass, all that is said of it."""
    own = [one for one in quality.criteria if one.name in SIDES[about]]
    level = max((one.level for one in own), key=ORDER.index, default=None)
    if about == "Mass":
        refused = outcome.identified is not None and not quality.usable
        words = mass_words(masses(outcome), quality.usable)
        return Light(about, QualityLevel.UNUSABLE if refused else level, f"{words}.")
    shown = [one for k, one in enumerate(own) if k < 2 or one.level is not QualityLevel.GOOD]
    return Light(about, level, _sentence("; ".join(one.words for one in shown))) if shown else None


def _fit(quality: Quality) -> Iterator[Light]:
    """What kept the rest from being found, and what keeps a run from being good."""
    known = {name for names in SIDES.values() for name in names}
    own = [one for one in quality.criteria if one.name not in known]
    if own:
        words = _sentence("; ".join(one.words for one in own))
        yield Light(FIT, max((one.level for one in own), key=ORDER.index), words)


def _sentence(text: str) -> str:
    return f"{text[0].upper()}{text[1:]}."


def _recordings(outcome: Outcome, quality: Quality) -> Iterator[Light]:
    """What the diagnosis and distances between markers say of the recordings."""
    found, moved = outcome.diagnosis, outcome.session.tracking
    said = [] if found is None else [verdict_words(found, quality.usable)]
    said += [_sentence(f"{clean(one.sentence, WHOLE)} ({clean(one.trial)})") for one in moved[:1]]
    said += [f"{plural(len(moved) - 1, 'more finding')} of markers: see “Data handling”."] if len(moved) > 1 else []
    if said:
        named = found is not None and (found.likely or found.unexplained.significant)
        wrong = named or moved or not quality.usable
        yield Light("Recordings", QualityLevel.CARE if wrong else QualityLevel.GOOD, " ".join(said))


def verdict_words(found: Diagnosis, usable: bool) -> str:
    """What the diagnosis says, in a sentence or two; its section has the rest.

    Args:
        found: the diagnosis.
        usable: False where the run is not to be used: that nothing was found is no good news then.
    """
    sure = found.likely
    more, possible = max(len(sure) - 1, 0), len(found.possible)
    said = []
    if sure:
        twins = " or ".join(map(called, sure[0].indistinguishable))
        apart = f"; it may as well be {twins}, which the recordings do not tell apart" if twins else ""
        done = "" if sure[0].applied else "; it is not corrected, as the model would predict worse"
        said = [told(sure[0]), f"That is {likely(sure[0])}{apart}{done}."]
    elif usable:
        kinds = f"({len(CATALOGUE)} kinds tested)"
        said = [f"No fault confirmed {kinds}." if found.causes or found.refuted else f"No fault found {kinds}."]
    elif not possible:
        said = [f"None of the {len(CATALOGUE)} kinds of fault that were tested explains it."]
    others = [plural(count, f"{kind} cause") for count, kind in ((more, "more"), (possible, "possible")) if count]
    if others:
        said.append(f"{listing(others)} and all rivals: see “What the model gets wrong”.")
    if found.unexplained.significant:
        said.append("More remains in the forces than noise makes, and no named cause explains it.")
    return " ".join(said)


def next_step(found: Diagnosis | None, quality: Quality) -> str:
    """Return what to do next, as a sentence without its end: the remedy of what kept a run from its end, the line that
    mends a recording, the recording that tells causes apart, the remedy of the worst figure; empty where there is none.

    Args:
        found: the diagnosis; None where there was none.
        quality: what the run is worth.
    """
    instruments = [] if found is None else instrument_findings(found)
    problems = [one for one in instruments if one.severity is Severity.PROBLEM]
    worst = quality.deciding
    beyond = worst.remedy if worst is not None and worst.level is not QualityLevel.GOOD else ""
    failed = beyond if worst is not None and worst.name not in REMEDIES else ""
    lines = (one.cures[0].config for one in problems if one.cures)
    cures = (f"Add `{line}` to the trials of the config, so that they are read without it" for line in lines)
    apart = () if found is None else map(_to_tell_apart, found.likely[:1])
    text = next(filter(None, (failed, *cures, *apart, beyond, *(one.advice for one in problems))), "").rstrip(".")
    return text and f"{text[0].upper()}{text[1:]}"


def _to_tell_apart(cause: Cause) -> str:
    """What to record where a cause has a twin; empty where it has none."""
    if not cause.indistinguishable:
        return ""
    twin = cause.indistinguishable[0]
    return f"To tell {called(cause)} from {called(twin)}, record {tell_apart(cause.effect, twin.effect)}"


def mass_words(said: Masses, usable: bool) -> str:
    """Identified, recorded and standing mass in one sentence, with what lies between them.

    Args:
        said: all statements of the mass.
        usable: False where the identified mass is not to be used: it is not stated then.
    """
    found = said.identified if usable else None
    words = [] if found is None else [f"{spread(found.value, found.sd, 2)} kg identified"]
    where = f"standing in {listing(said.trials)}"
    for other, how in ((said.recorded, "recorded"), (said.standing, where)):
        if other is not None:
            away = "" if found is None else f" (identified {change(other.value, found.value)}, {_sds(found, other)})"
            words.append(f"{spread(other.value, other.sd)} kg {how}{away}")
    if said.recorded is None:
        words.append("not recorded")
    if said.identified is None:
        words.append("nothing was identified: masses are those of tables")
    elif found is None:
        words.append("the identified mass is not to be used")
    return "; ".join(words)


def _sds(one: Mass, other: Mass) -> str:
    return f"{number(abs(one.apart(other)))} sd"
