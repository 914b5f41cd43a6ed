"""From the labels of a session to the markers of a model: marker set, priors, and labels nobody listed."""

from dataclasses import dataclass, replace

import torch

from torchid.errors import DataError, Note
from torchid.geometry.attachment import Attachment, rigid_segment
from torchid.model.marker_set import MarkerSet, MarkerSpec, marker_prior
from torchid.model.model import Model
from torchid.model.whole_body import lock_bodies
from torchid.recording import Markers, Trial

RIGID = 0.02
"""An unlisted label joins a segment when its distances to the segment's markers scatter less than this [m]."""
SEEN = 0.2
"""A marker takes part when it is visible in at least this share of the frames of some trial."""


@dataclass(frozen=True)
class Assignment:
    """A model whose bodies all carry markers, those markers, and what was decided on the way."""

    model: Model
    attachment: Attachment
    notes: tuple[Note, ...]


def assign_markers(model: Model, marker_set: MarkerSet, trials: tuple[Trial, ...]) -> Assignment:
    """Assign every label of the trials to a segment and lock the bodies that no marker sees.

    Raises:
        DataError: no marker of the pelvis, or fewer than three labels known.
    """
    match = marker_set.match(_labels(trials))
    specs, notes = dict(match.assigned), []
    if match.computed:
        notes.append(Note("markers.computed", f"left out as computed points: {', '.join(match.computed)}"))
    known = dict(specs)
    for label in match.unknown:
        segment, scatter = _rigid(label, known, model, trials)
        if segment is None or scatter > RIGID:
            notes.append(Note("markers.unknown", f"{label} is in no marker set and moves with no segment; left out"))
            continue
        specs[label] = MarkerSpec(segment)
        said = f"{label} is in no marker set; it moves with {segment} (distances scatter {1e3 * scatter:.1f} mm)"
        notes.append(Note("markers.assigned", said))
    root = model.tree.bodies[0].name
    if sum(spec.segment == root for spec in specs.values()) < 3:
        raise DataError(
            "markers.root", f"fewer than three markers on the {root}", found=", ".join(specs) or "no known labels",
            remedy="name a marker set that fits these labels (markers: in the config), or list them in a YAML file",
        )  # fmt: skip
    bare = tuple(body for body in model.tree.names[1:] if all(spec.segment != body for spec in specs.values()))
    model, said = lock_bodies(model, bare) if bare else (model, ())
    return Assignment(model, _attach(model, specs), (*notes, *said))


def _labels(trials: tuple[Trial, ...]) -> tuple[str, ...]:
    found: dict[str, None] = {}
    for trial in trials:
        share = torch.isfinite(trial.markers.position[..., 0]).double().mean(0)
        found.update({label: None for label, s in zip(trial.markers.labels, share.tolist(), strict=True) if s >= SEEN})
    return tuple(found)


def _rigid(
    label: str, known: dict[str, MarkerSpec], model: Model, trials: tuple[Trial, ...]
) -> tuple[str | None, float]:
    best: tuple[str | None, float] = (None, float("inf"))
    moving = [t for t in trials if t.role != "static"] or list(trials)
    longest = max((t.markers for t in moving if label in t.markers.labels), key=lambda m: len(m.time), default=None)
    if longest is None:
        return best
    body, scatter = rigid_segment(longest.select((label,)).position[:, 0], _clusters(longest, known, model))
    return (model.tree.names[body], scatter) if body >= 0 else best


def _clusters(markers: Markers, known: dict[str, MarkerSpec], model: Model) -> dict[int, torch.Tensor]:
    found = {}
    for k, name in enumerate(model.tree.names):
        labels = tuple(label for label in markers.labels if label in known and known[label].segment == name)
        if labels:
            found[k] = markers.select(labels).position
    return found


def _attach(model: Model, specs: dict[str, MarkerSpec]) -> Attachment:
    mean, sd = marker_prior(model, specs.values())
    body = torch.tensor([model.tree.index(spec.segment) for spec in specs.values()])
    return Attachment(tuple(specs), body, mean, sd, tuple(spec.landmark for spec in specs.values()))


def only(attachment: Attachment, keep: torch.Tensor) -> Attachment:
    """The markers of a mask."""
    index = keep.nonzero()[:, 0].tolist()
    return replace(
        attachment,
        labels=tuple(attachment.labels[k] for k in index),
        body=attachment.body[index],
        mean=attachment.mean[index],
        sd=attachment.sd[index],
        landmark=tuple(attachment.landmark[k] for k in index),
    )
