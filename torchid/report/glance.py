"""What one look tells of a run: each side of it beside its norm, what is wrong with the recordings, what to do next."""

from collections.abc import Iterator, Sequence

from torchid.diagnosis.verdict.records import Diagnosis
from torchid.effects.catalogue import CATALOGUE
from torchid.report.blocks import Light
from torchid.report.read_as import read_as
from torchid.report.recording_faults import WRONG, Fault, recording_faults
from torchid.session import Outcome
from torchid.session.judging import FAR_SD, Mass, Masses, masses
from torchid.session.outcome import ORDER, Quality, QualityLevel
from torchid.session.person import LEFT, UNLIKE, USED
from torchid.wording import change, clean, listing, number, plural, spread

SIDES = {
    "Mass": ("mass_standing", "mass_recorded", "mass_tables"),
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
SETTLED = "Faults that are corrected or left out here ask for nothing in this run."
"""What is said beside where no listed fault asks for anything."""
REMAINS = "More remains in the forces than noise makes, and no named cause explains it."
LINES, BODILY = 4, 2
"""Choice. Lines on the recordings, beside the one that counts the rest; those that faults of the body may fill."""


def glance(outcome: Outcome, quality: Quality) -> tuple[Light, ...]:
    """Return what one look tells of a run, line by line.

    Args:
        outcome: the run.
        quality: what it is worth.
    """
    lights = [light for about in SIDES if (light := _side(about, outcome, quality))]
    faults = recording_faults(outcome)
    beside = _beside(outcome, quality, faults)
    shown = faults[: _room(faults, beside)]
    lights += [*_tables(outcome), *_fit(quality), *_recordings(outcome, quality, shown, faults[len(shown) :], beside)]
    good = all(one.level in (None, QualityLevel.GOOD) for one in lights)
    step = next_step(faults, shown, quality) or (NOTHING if good else LOOK)
    settled = f" {SETTLED}" if any(f.settled for f in shown) and not any(f.step or f.apart for f in shown) else ""
    return (*lights, Light("Next", None, f"{step}.{settled}"))


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


def _tables(outcome: Outcome) -> Iterator[Light]:
    """For whom the tables of adults were changed, and by which people, where they were."""
    if outcome.fit.model.build:
        yield Light("Tables", None, f"Of adults, {listing(outcome.fit.model.build)}.")
    for note in outcome.notes:
        if note.code in (USED, LEFT, UNLIKE):
            level = None if note.code == USED else QualityLevel.CARE
            yield Light("Tables", level, _sentence(clean(note.message, 300)))


def _fit(quality: Quality) -> Iterator[Light]:
    """What kept the rest from being found, and what keeps a run from being good."""
    known = {name for names in SIDES.values() for name in names}
    own = [one for one in quality.criteria if one.name not in known]
    if own:
        words = _sentence("; ".join(one.words for one in own))
        yield Light(FIT, max((one.level for one in own), key=ORDER.index), words)


def _sentence(text: str) -> str:
    return f"{text[0].upper()}{text[1:]}."


def _beside(outcome: Outcome, quality: Quality, faults: Sequence[Fault]) -> tuple[list[str], list[str]]:
    """Lines before and after those of faults: that none is likely, what remains, and as what forces were read."""
    found = outcome.diagnosis
    first = "" if found is None else unnamed(found, quality.usable, bool(faults))
    remains = REMAINS if found is not None and found.unexplained.significant else ""
    return [*filter(None, (first,))], [*filter(None, (remains, read_as(outcome)))]


def _room(faults: Sequence[Fault], beside: tuple[list[str], list[str]]) -> int:
    """How many faults are told: of the body's, which come last, only what fills the first lines."""
    own = sum(not one.bodily for one in faults)
    return min(LINES - len(beside[0]) - len(beside[1]), max(own, BODILY))


def _recordings(
    outcome: Outcome, quality: Quality, shown: Sequence[Fault], hidden: Sequence[Fault],
    beside: tuple[list[str], list[str]],
) -> Iterator[Light]:  # fmt: skip
    """What is wrong with the recordings, a line each, and as what they were read."""
    found = outcome.diagnosis
    more = _more(hidden, 0 if found is None else len(found.possible))
    lines = [*beside[0], *(one.line for one in shown), *([more] if more else []), *beside[1]]
    if not lines:
        return
    wrong = not all(one.settled for one in (*shown, *hidden)) or REMAINS in lines or not quality.usable
    level = QualityLevel.CARE if wrong else None if found is None else QualityLevel.GOOD
    yield Light("Recordings", level, lines[0]) if len(lines) == 1 else Light("Recordings", level, "", tuple(lines))


def _more(hidden: Sequence[Fault], possible: int) -> str:
    """How many faults are not told here, and where they are."""
    counts = [f"{len(hidden)} more"] if hidden else []
    counts += [plural(possible, "possible cause")] if possible else []
    places = dict.fromkeys([one.section for one in hidden] + ([WRONG] if possible else []))
    return f"And {listing(counts)}: see {listing([f'“{name}”' for name in places])}." if counts else ""


def unnamed(found: Diagnosis, usable: bool, others: bool) -> str:
    """Return what a diagnosis says that names nothing likely; empty where it does.

    Args:
        found: the diagnosis.
        usable: False where the run is not to be used: that nothing was found is no good news then.
        others: whether tracks of markers tell of faults.
    """
    kinds = len(CATALOGUE)
    if found.likely:
        return ""
    if usable:
        sure = "confirmed" if found.causes or found.refuted else "found"
        return f"No {'other ' if others else ''}fault {sure} ({kinds} kinds tested)."
    return "" if found.possible else f"None of the {kinds} kinds of fault that were tested explains it."


def next_step(faults: Sequence[Fault], shown: Sequence[Fault], quality: Quality) -> str:
    """Return what to do next, as a sentence without its end: the remedy of what kept a run from its end, what mends the
    surest fault, the recording that tells it from its twin, the remedy of the worst figure; empty where there is none.

    Args:
        faults: of the recordings, those that ask for something first.
        shown: those of them that are told; no other is told from its twin.
        quality: what the run is worth.
    """
    worst = quality.deciding
    beyond = worst.remedy if worst is not None and worst.level is not QualityLevel.GOOD else ""
    failed = beyond if worst is not None and worst.failed else ""
    mending, apart = (one.step for one in faults), (one.apart for one in shown)
    text = next(filter(None, (failed, *mending, *apart, beyond)), "").rstrip(".")
    return text and f"{text[0].upper()}{text[1:]}"


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
    if said.tables is not None and found is not None and abs(found.apart(said.tables)) > FAR_SD:
        words.append(f"tables have {spread(said.tables.value, said.tables.sd, 0)} kg ({_sds(found, said.tables)})")
    if said.identified is None:
        words.append("nothing was identified: masses are those of tables")
    elif found is None:
        words.append("the identified mass is not to be used")
    return "; ".join(words)


def _sds(one: Mass, other: Mass) -> str:
    return f"{number(abs(one.apart(other)))} sd"
