"""What was planted into a session, in the words of torchid's catalogue, and whether a cause is it."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

ANYWHERE = "*"


class Inapplicable(Exception):  # noqa: N818 - no error: a battery goes on without the case
    """A session has no place for a fault."""


@dataclass(frozen=True)
class Answer:
    """An effect at a place."""

    effect: str
    where: tuple[str, ...] = ()
    """Segments, markers, ``session``; ``*`` for any place."""
    parameters: dict[str, list[float]] = field(default_factory=dict)
    """True values of reported parameters, flat."""
    plates: tuple[dict[str, str], ...] = ()
    """For places that are plates, the name of each in every trial's file: a verdict numbers plates anew."""

    def is_at(self, where: list[str], plates: Mapping[str, Any]) -> bool:
        """Whether a cause's place is this one, plates by the session's names as of ``diagnosis.json``."""
        if self.where == (ANYWHERE,):
            return True
        if not self.plates:
            return set(where) == set(self.where)
        each = [_same(own, plates) for own in self.plates]
        return all(names & set(where) for names in each) and (len(where) == 1) is (len(each) == 1)


@dataclass(frozen=True)
class Truth:
    """What was planted."""

    right: tuple[Answer, ...]
    """Any of these is the right answer; none where nothing was planted."""
    told: str = ""
    """Place and size, for people."""
    alike: tuple[Answer, ...] = ()
    """What does the same to the recordings: no right answer, unless the verdict says that it cannot tell, and not a
    wrong one."""

    def table(self) -> dict[str, Any]:
        """As JSON has it."""
        return asdict(self)


def _same(own: Mapping[str, str], plates: Mapping[str, Any]) -> set[str]:
    """Names of the session's plates that share most of these channels."""
    shared = {name: len(plate["channels"].items() & own.items()) for name, plate in plates.items()}
    return {name for name, number in shared.items() if number and number == max(shared.values())}


def plates_answer(
    effect: str, plates: Sequence[Mapping[str, str]], parameters: dict[str, list[float]] | None = None
) -> Answer:
    """An effect on one plate, or on several together, each given by its name in every trial's file."""
    return Answer(effect, (), parameters or {}, tuple(map(dict, plates)))


def truth_from(table: Mapping[str, Any]) -> Truth:
    """The inverse of ``Truth.table``, also of what JSON made of it."""
    return Truth(_answers(table["right"]), table["told"], _answers(table["alike"]))


def _answers(entries: list[dict[str, Any]]) -> tuple[Answer, ...]:
    return tuple(Answer(e["effect"], tuple(e["where"]), e["parameters"], tuple(e["plates"])) for e in entries)
