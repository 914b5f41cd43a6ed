"""This module turns the labels of a session into markers of a model, labels that no marker set lists included."""

from dataclasses import dataclass
from typing import Literal

import torch

from torchid.conventions import ROOT_MARKERS
from torchid.errors import DataError, Note
from torchid.geometry.attachment import Attachment, attach, settle_bare
from torchid.geometry.carriers import ELSEWHERE, Carrier
from torchid.geometry.placing.place import place_markers
from torchid.model.marker_set import MarkerSet, MarkerSpec
from torchid.model.model import Model
from torchid.recording import Trial
from torchid.wording import listing

SEEN = 0.2
"""A marker takes part when it is visible in at least this share of the frames of some trial; chosen."""


@dataclass(frozen=True)
class Assignment:
    """A model with the markers that it is fitted to, and notes on what was decided for the user to read."""

    model: Model
    """The template in which bodies without markers are locked, or held by a firm prior."""
    attachment: Attachment
    notes: tuple[Note, ...]


def assign_markers(
    model: Model, marker_set: MarkerSet, trials: tuple[Trial, ...], unlisted: Literal["assign", "leave_out"] = "assign"
) -> Assignment:
    """Assign every label of the trials to a segment, and lock the bodies that no marker sees.

    A label that no marker set lists joins the segment that its marker surely stands and moves on (``placing``), or is
    left out with a note; so is one that moves in some trial as if it was computed from others (``Trial.computed``).

    Args:
        model: template of the subject.
        marker_set: segments and landmarks of the labels that are known.
        trials: all trials of the session, the static one included.
        unlisted: ``leave_out`` keeps to the labels that the set lists.

    Returns:
        The model, its markers, and notes on labels that were assigned or left out and on bodies without markers.

    Raises:
        DataError: ``markers.none`` without a labelled marker in any trial; ``markers.root``, when fewer than three
            markers sit on the root body.
    """
    labels = _visible_labels(trials)
    if not labels:
        raise _unseen(trials)
    match = marker_set.match(labels)
    specs, notes = dict(match.assigned), []
    if match.computed:
        notes.append(Note("markers.computed", f"left out as computed points: {', '.join(match.computed)}"))
    unknown, said = _unlisted(match.unknown, trials, unlisted)
    notes += said
    carried, said = _carried(unknown, specs, model, trials)
    specs |= carried
    notes += said
    root = model.tree.bodies[0].name
    if sum(spec.segment == root for spec in specs.values()) < ROOT_MARKERS:
        raise DataError(
            "markers.root", f"fewer than three markers on the {root}", found=", ".join(specs) or "no known labels",
            remedy="name a marker set that fits these labels (markers: in the config), or list them in a YAML file",
        )  # fmt: skip
    model, said = settle_bare(model, {spec.segment for spec in specs.values()})
    return Assignment(model, attach(model, specs), (*notes, *said))


def _unlisted(
    labels: tuple[str, ...], trials: tuple[Trial, ...], choice: Literal["assign", "leave_out"]
) -> tuple[tuple[str, ...], list[Note]]:
    """Return which of the labels that no set lists are to be assigned, and what is said of the others."""
    if choice == "leave_out":
        text = f"{len(labels)} labels that the marker set does not list are left out: {listing(labels)}"
        return (), [
            Note("markers.unlisted", f"{text}. unlisted: assign places them by where they stand and how they move")
        ] if labels else []
    computed = {label for trial in trials for label in trial.computed}.intersection(labels)
    text = f"left out, for they move in another trial as if computed from others: {listing(sorted(computed))}"
    notes = [Note("markers.computed", text)] if computed else []
    return tuple(label for label in labels if label not in computed), notes


def _carried(
    labels: tuple[str, ...], known: dict[str, MarkerSpec], model: Model, trials: tuple[Trial, ...]
) -> tuple[dict[str, MarkerSpec], list[Note]]:
    """Return the segments of the labels that surely are on one, and what is said of all."""
    placed = place_markers(labels, model, trials, known) if labels else None
    if placed is None:
        said = "is in no marker set, and no body fits what is told of the others; left out"
        return {}, [Note("markers.unknown", f"{label} {said}") for label in labels]
    notes = []
    for label in labels:
        one = placed.told.of(label)
        how = f"scatters {1e3 * one.scatter:.0f} mm in its axes, probability {one.probability:.2f}"
        told = Note("markers.assigned", f"{label} is in no marker set; it moves with {one.segment} ({how})")
        notes.append(told if label in placed.specs else Note("markers.unknown", _unsure(label, one)))
    return dict(placed.specs), notes


def _unsure(label: str, one: Carrier) -> str:
    """Return why a label is left out."""
    if not one.scatter <= ELSEWHERE:
        return f"{label} is in no marker set and moves with no segment; left out"
    return f"{label} is in no marker set; it may move with {one.segment} or {one.other}; left out"


def _visible_labels(trials: tuple[Trial, ...]) -> tuple[str, ...]:
    """Return the labels that are visible often enough in some trial, in the order of their first appearance."""
    found: dict[str, None] = {}
    for trial in trials:
        share = torch.isfinite(trial.markers.position[..., 0]).double().mean(0)
        found.update({label: None for label, s in zip(trial.markers.labels, share.tolist(), strict=True) if s >= SEEN})
    return tuple(found)


def _unseen(trials: tuple[Trial, ...]) -> DataError:
    """Return the refusal of trials without a single marker, labelled and seen."""
    some = any(trial.markers.labels for trial in trials)
    rarely = f"no labelled marker is seen in {100.0 * SEEN:.0f} % of the frames of any trial"
    said = [note.message for trial in trials for note in trial.notes if note.code == "markers.unlabelled"]
    return DataError(
        "markers.none", rarely if some else "no labelled markers",
        source=trials[0].parameters.get("file", "") if trials else "",
        found=listing(said, 3) if said else "",
        remedy="Label the points in the recording system and export the trials again",
    )  # fmt: skip
