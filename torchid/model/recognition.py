"""Which segments a recording's labels are on: by the built-in set that lists most of them, by their own words, and by
places and motion where these were asked (``geometry/placing``)."""

from collections.abc import Iterable
from dataclasses import dataclass, field, replace

from torchid.conventions import ROOT_MARKERS
from torchid.errors import ConfigError
from torchid.model.label_words import told_by_words
from torchid.model.marker_set import MarkerSet, MarkerSpec, load_marker_set, marker_sets
from torchid.wording import listing

ENOUGH = 0.6
"""Choice. Share of a recording's labels that a set must list to be taken for the laboratory's own; and that a set and
words must tell together, so that a person can be followed."""
WORDS = "words"
"""Wording. Name of a set that is told by words alone."""


@dataclass(frozen=True)
class Recognised:
    """A built-in set, and words, beside the labels of a recording."""

    set: MarkerSet
    """The built-in one; without labels where none is the laboratory's own."""
    listed: dict[str, MarkerSpec]
    """Labels that the set lists."""
    worded: dict[str, MarkerSpec]
    """Labels that it does not list, and that say by themselves where they are."""
    unknown: tuple[str, ...]
    """Labels that say nothing."""
    absent: int
    """Places of the set that no label is at."""
    placed: dict[str, MarkerSpec] = field(default_factory=dict)
    """Labels that say nothing, and whose markers stand and move as on a segment."""

    @property
    def every(self) -> int:
        """Number of labels, without those that the set knows as computed."""
        return len(self.told) + len(self.unknown)

    @property
    def told(self) -> dict[str, MarkerSpec]:
        """Labels whose segments are known."""
        return self.listed | self.worded | self.placed

    @property
    def markers(self) -> MarkerSet:
        """The set with what it does not list."""
        if not self.beside:
            return self.set
        return replace(self.set, specs={**self.set.specs, **self.beside})

    @property
    def beside(self) -> dict[str, MarkerSpec]:
        """Labels that the set does not list and that are told nevertheless."""
        return self.worded | self.placed

    @property
    def name(self) -> str:
        """Of the set, by which a config may name it where nothing is told beside it."""
        return self.set.name

    @property
    def root(self) -> int:
        """Labels on the pelvis."""
        return sum(spec.segment == "pelvis" for spec in self.told.values())

    @property
    def enough(self) -> bool:
        """Whether a person can be followed by what is told."""
        return len(self.told) >= ENOUGH * max(1, self.every) and self.root >= ROOT_MARKERS

    @property
    def said(self) -> str:
        """What was recognised, as a phrase."""
        parts = [f"{self.name} lists {len(self.listed)} of {self.every} labels"] if self.listed else []
        if self.worded:
            parts.append(f"words tell {len(self.worded)}" + ("" if parts else f" of {self.every} labels"))
        if self.placed:
            parts.append(f"places and motion tell {len(self.placed)}" + ("" if parts else f" of {self.every} labels"))
        return ", ".join(parts) or f"nothing tells where {self.every} labels are"


def recognised(labels: Iterable[str]) -> Recognised:
    """Return where labels are: by the built-in set that lists most of them, and the others by words.

    Of two sets that list as many, the one with fewer absent places is taken.

    A set that lists too few is not the laboratory's, and its labels may mean other places there: then words tell alone.

    Args:
        labels: of recordings.
    """
    labels = tuple(dict.fromkeys(labels))
    best = min((_beside(load_marker_set(name), labels) for name in marker_sets()), key=_order)
    own = best if len(best.listed) >= ENOUGH * max(1, best.every) else _beside(MarkerSet(WORDS, {}), labels)
    told = {label: spec for label in own.unknown if (spec := told_by_words(label)) is not None}
    return replace(own, worded=told, unknown=tuple(label for label in own.unknown if label not in told))


def unrecognised(found: Recognised, source: str = "") -> ConfigError:
    """Return the refusal of labels of which too few are told, or too few on the pelvis: ``markers.unrecognised``.

    Args:
        found: what is told.
        source: where the labels come from.
    """
    untold = f"; not {listing(found.unknown, 12)}" if found.unknown else ""
    return ConfigError(
        "markers.unrecognised", "labels do not tell where the markers are", source=source, place="markers",
        found=f"{found.said}, {found.root} on the pelvis{untold}",
        remedy="Give markers: FILE.yaml with a line LABEL: SEGMENT for every marker (docs/config.md)",
    )  # fmt: skip


def _order(one: Recognised) -> tuple[int, int]:
    return -len(one.listed), one.absent


def _beside(given: MarkerSet, labels: tuple[str, ...]) -> Recognised:
    match = given.match(labels)
    absent = {*given.specs.values()} - {*match.assigned.values()}
    return Recognised(given, match.assigned, {}, match.unknown, len(absent))
