"""What each recording of a session serves for: standing, the fit, held-out motion, or nothing; and why."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from torchid.checks.finding import Finding
from torchid.folder.survey import Surveyed

STILL_M = 0.03
"""Choice. A body of which nine in ten markers stay this near to their mean places stands still: quiet standing sways by
less, and whatever moves a limb moves markers by more."""
FEWEST_MARKERS = 8
"""Choice. A recording with fewer known markers shows a wand, a plate's corners or nobody."""
SHORTEST = 12
"""Choice. Frames below which a recording that moves tells no accelerations."""
HELD_OUT = 3
"""Choice. One recording in so many of a kind is held out: predictions are tested on motion like that of the fit."""
TRAVELS_M = 0.7
"""Choice. Who comes further than this along the floor in a recording walks or runs; on a treadmill nobody does."""
FORCES = "forces.feet"
"""Code of forces that do not agree with the feet, with which a run does not begin."""
STATIC_WORDS = re.compile(r"stat|stand|calib|neutral|t_?pose|n_?pose|anat", re.IGNORECASE)
ENDING = re.compile(r"[\s_\-.]*\d+$")
"""Number of a repetition at the end of a name."""


@dataclass(frozen=True)
class Use:
    """What a recording serves for, and why."""

    of: Surveyed
    role: str
    """``static``, ``fit``, ``heldout``, or empty where it cannot serve."""
    why: str
    inertia: bool = True
    """Whether its forces take part."""
    mend: str = ""
    """Line of a config without which its forces do not agree with its feet."""

    @property
    def serves_inertia(self) -> bool:
        """Whether it has forces that take part, as read or as mended."""
        return self.inertia and _serves_inertia(self.of)


def uses_of(found: Sequence[Surveyed], known: Mapping[str, int]) -> tuple[Use, ...]:
    """Return what each recording serves for, in their order.

    Args:
        found: the recordings of one subject.
        known: number of markers of each that the marker set lists, by name.
    """
    unfit = {one.name: why for one in found if (why := _unfit(one, known.get(one.name, 0)))}
    able = [one for one in found if one.name not in unfit]
    static = _static([one for one in able if _still(one)], known)
    moving = [one for one in able if one is not static]
    weighed = [one for one in moving if _serves_inertia(one)] or moving
    held = {one.name for kind in _kinds(weighed).values() for one in _held(kind)}
    return tuple(_use(one, unfit.get(one.name, ""), static, one.name in held) for one in found)


def _use(one: Surveyed, unfit: str, static: Surveyed | None, held: bool) -> Use:
    if unfit:
        return Use(one, "", unfit)
    mend, why = _mend(one), [_motion(one)]
    if not _serves_inertia(one):
        why.append("nobody is on a plate" if one.check and one.check.force_rate else "no forces")
    if mend:
        why.append(f"read as it agrees with the feet, for {_wrong(one)[0].evidence}")
    if one is static:
        return Use(one, "static", "; ".join(why), mend=mend)
    if not _serves_inertia(one):
        why.append("geometry alone")
    if held:
        why.append("others of its kind are fitted")
    return Use(one, "heldout" if held else "fit", "; ".join(why), inertia=_serves_inertia(one), mend=mend)


def _unfit(one: Surveyed, known: int) -> str:
    """Return why a recording cannot serve, empty where it can."""
    if one.refusal is not None:
        said = f"{one.refusal.message}{f' (found: {one.refusal.found})' if one.refusal.found else ''}"
        return f"{said}. {one.refusal.remedy} [{one.refusal.code}]"
    assert one.check is not None
    if known < FEWEST_MARKERS:
        return f"{known} of its {len(one.labels)} markers are the set's: it shows no body"
    if _wrong(one) and not _mend(one):
        return "; ".join(note.message for note in _wrong(one))
    if one.check.frames < SHORTEST and not _still(one):
        return f"{one.check.frames} frames are too few to tell accelerations"
    return ""


def _wrong(one: Surveyed) -> list[Finding]:
    """Return where its forces do not agree with its feet."""
    return [note for note in one.check.problems if note.code == FORCES] if one.check else []


def _mend(one: Surveyed) -> str:
    """Return the line of a config that makes its forces agree with its feet, where there is just one."""
    return _wrong(one)[0].config if len(_wrong(one)) == 1 else ""


def _serves_inertia(one: Surveyed) -> bool:
    """Return whether plates carry somebody, as read or as mended."""
    return one.has_forces or bool(_mend(one))


def _still(one: Surveyed) -> bool:
    return one.wander_m < STILL_M


def _static(still: Sequence[Surveyed], known: Mapping[str, int]) -> Surveyed | None:
    """Return the recording that tells the standing posture best: by name, by plates, by markers, by length."""
    return max(
        still,
        key=lambda one: (
            bool(STATIC_WORDS.search(one.name)),
            _serves_inertia(one),
            known.get(one.name, 0),
            one.seconds,
        ),
        default=None,
    )


def standing_of(found: Sequence[Surveyed]) -> Surveyed | None:
    """Return the recording that tells the standing posture best; None where nobody stands still.

    Args:
        found: the recordings of one subject.
    """
    return _static([one for one in found if one.labels and _still(one)], {one.name: len(one.labels) for one in found})


def _kinds(some: Sequence[Surveyed]) -> dict[tuple[str, str], list[Surveyed]]:
    """Return recordings by kind: by their names but for numbers, and by what they show."""
    kinds: dict[tuple[str, str], list[Surveyed]] = {}
    for one in some:
        kinds.setdefault((ENDING.sub("", one.name), _motion(one)), []).append(one)
    return kinds


def _held(kind: Sequence[Surveyed]) -> Sequence[Surveyed]:
    """Return the recordings of a kind that are held out: the last third, never the only one."""
    number = 0 if len(kind) < 2 else max(1, round(len(kind) / HELD_OUT))
    return kind[len(kind) - number :]


def _motion(one: Surveyed) -> str:
    """Return what a recording shows, in a word or two."""
    if _still(one):
        return "stands still"
    return "travels" if one.travel_m > TRAVELS_M else "moves in place"
