"""Which built-in marker set a recording's labels are of."""

from collections.abc import Collection, Iterable
from dataclasses import dataclass

from torchid.errors import ConfigError
from torchid.model.marker_set import load_marker_set, marker_sets
from torchid.wording import listing

ENOUGH = 0.6
"""Choice. Share of a recording's labels that a set must list to be taken for the laboratory's own: three in five, so
that what it does not list can be told by how it keeps its distance from what it lists."""
ROOT_MARKERS = 3
"""Markers on the pelvis without which no posture is told."""


@dataclass(frozen=True)
class Recognised:
    """A built-in set beside the labels of a recording."""

    name: str
    listed: tuple[str, ...]
    """Labels that the set places on a segment."""
    unknown: tuple[str, ...]
    """Labels that it does not list."""
    absent: int
    """Markers that the set lists and the recording lacks."""
    root: int
    """Of the listed ones, those on the pelvis."""

    @property
    def every(self) -> int:
        """Number of the recording's labels, without those that the set knows as computed."""
        return len(self.listed) + len(self.unknown)

    @property
    def share(self) -> float:
        """Part of them that the set lists."""
        return len(self.listed) / max(1, self.every)

    @property
    def enough(self) -> bool:
        """Whether the labels may be called the set's."""
        return self.share >= ENOUGH and self.root >= ROOT_MARKERS


def recognised(labels: Iterable[str]) -> tuple[Recognised, ...]:
    """Return every built-in set beside some labels, the one that lists most of them first.

    Of two that list as many the one with fewer absent markers comes first.
    """
    labels = tuple(dict.fromkeys(labels))
    return tuple(sorted((_beside(name, labels) for name in marker_sets()), key=lambda r: (-len(r.listed), r.absent)))


def recognise(labels: Collection[str], source: str = "") -> Recognised:
    """Return the built-in set that labels are of.

    Args:
        labels: of the recordings, computed points left out or not.
        source: where they come from, for the error.

    Raises:
        ConfigError: ``markers.unrecognised``; the nearest set and what it lacks are named.
    """
    best = recognised(labels)[0]
    if best.enough:
        return best
    raise ConfigError(
        "markers.unrecognised", "no built-in marker set lists enough of these labels", source=source, place="markers",
        found=f"{best.name} lists {len(best.listed)} of {best.every} labels, {best.root} on the pelvis"
        + (f"; not {listing(best.unknown, 12)}" if best.unknown else ""),
        remedy="Give markers: FILE.yaml with a line LABEL: SEGMENT for every marker (docs/config.md)",
    )  # fmt: skip


def _beside(name: str, labels: tuple[str, ...]) -> Recognised:
    given = load_marker_set(name)
    match = given.match(labels)
    places = {(spec.segment, spec.landmark) for spec in match.assigned.values()}
    absent = sum((spec.segment, spec.landmark) not in places for spec in given.specs.values())
    root = sum(spec.segment == "pelvis" for spec in match.assigned.values())
    return Recognised(name, tuple(match.assigned), match.unknown, absent, root)
