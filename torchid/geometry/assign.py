"""This module turns the labels of a session into markers of a model, labels that no marker set lists included."""

from dataclasses import dataclass, replace
from typing import Literal

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchid.errors import DataError, Note
from torchid.geometry.rigidity import ELSEWHERE, Carrier, carrier_of
from torchid.model.marker_set import MarkerSet, MarkerSpec, marker_prior
from torchid.model.model import Model
from torchid.model.tree import Tree
from torchid.model.whole_body import lock_bodies
from torchid.recording import Trial
from torchid.wording import listing


@dataclass(frozen=True)
class Attachment:
    """The markers of a subject on the bodies of a tree, with the prior of their places."""

    labels: tuple[str, ...]
    body: Int[Tensor, " markers"]
    """Each marker's segment as its index in the tree."""
    mean: Float[Tensor, "markers 3"]
    """Prior mean of p_BM_B [m]."""
    sd: Float[Tensor, "markers 3"]
    """Prior scatter [m]; large for markers that are free on their segment."""
    landmark: tuple[str | None, ...]
    """Each marker's landmark on the template; None for markers that are free on their segment."""

    @property
    def known(self) -> Tensor:
        """Return the mask of the markers on a landmark, whose places on the template are known (markers,)."""
        return torch.tensor([name is not None for name in self.landmark], device=self.body.device)


FIRM = 0.1
"""A body without markers between marked ones has joint angles that scatter this much about rest [rad]; chosen."""
HINGES = 2
"""Coordinates between marked bodies that need no holding; chosen: markers on both sides tell an ankle and a subtalar
joint apart, but three turns only with three good markers on either side."""
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

    A label that no marker set lists joins the segment that it moves with, if none else comes near (``rigidity``), or is
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
    if sum(spec.segment == root for spec in specs.values()) < 3:
        raise DataError(
            "markers.root", f"fewer than three markers on the {root}", found=", ".join(specs) or "no known labels",
            remedy="name a marker set that fits these labels (markers: in the config), or list them in a YAML file",
        )  # fmt: skip
    model, said = _settle_bare(model, {spec.segment for spec in specs.values()})
    return Assignment(model, _attach(model, specs), (*notes, *said))


def _unlisted(
    labels: tuple[str, ...], trials: tuple[Trial, ...], choice: Literal["assign", "leave_out"]
) -> tuple[tuple[str, ...], list[Note]]:
    """Return which of the labels that no set lists are to be assigned, and what is said of the others."""
    if choice == "leave_out":
        text = f"{len(labels)} labels that the marker set does not list are left out: {listing(labels)}"
        return (), [
            Note("markers.unlisted", f"{text}. unlisted: assign places them by how they move")
        ] if labels else []
    computed = {label for trial in trials for label in trial.computed}.intersection(labels)
    text = f"left out, for they move in another trial as if computed from others: {listing(sorted(computed))}"
    notes = [Note("markers.computed", text)] if computed else []
    return tuple(label for label in labels if label not in computed), notes


def _carried(
    labels: tuple[str, ...], known: dict[str, MarkerSpec], model: Model, trials: tuple[Trial, ...]
) -> tuple[dict[str, MarkerSpec], list[Note]]:
    """Return the segments of the labels that surely move with one, the surest first, and what is said of all.

    Each that is told helps to tell the next ones.
    """
    found, left, notes = {}, list(labels), []
    while left:
        each = {label: carrier_of(label, known | found, model, trials) for label in left}
        sure = {label: one for label, one in each.items() if one is not None and one.sure}
        if not sure:
            return found, [*notes, *(Note("markers.unknown", _unsure(label, one)) for label, one in each.items())]
        label = max(sure, key=lambda label: sure[label].probability)
        one = sure[label]
        found[label] = MarkerSpec(one.segment)
        left.remove(label)
        how = f"distances scatter {1e3 * one.scatter:.1f} mm, probability {one.probability:.2f}"
        notes.append(Note("markers.assigned", f"{label} is in no marker set; it moves with {one.segment} ({how})"))
    return found, notes


def _unsure(label: str, one: Carrier | None) -> str:
    """Return why a label is left out."""
    if one is None or one.scatter > ELSEWHERE:
        return f"{label} is in no marker set and moves with no segment; left out"
    return f"{label} is in no marker set; it may move with {one.segment} or {one.other}; left out"


def _settle_bare(model: Model, marked: set[str]) -> tuple[Model, tuple[Note, ...]]:
    """Lock bodies without markers at the ends to their parents, and hold those between marked ones by a firm prior."""
    tree = model.tree
    bare = [k for k, name in enumerate(tree.names) if k and name not in marked]
    between = [k for k in bare if any(tree.names[below] in marked for below in tree.subtree(k))]
    model, said = lock_bodies(model, tuple(tree.names[k] for k in bare if k not in between))
    names = [tree.names[k] for k in between if _undetermined(tree, k, marked)]
    if not names:
        return model, said
    rows = {row for k, name in enumerate(model.tree.names) if name in names for row in model.tree.driving(k)}
    dofs = tuple(replace(dof, sd=FIRM) if row in rows else dof for row, dof in enumerate(model.tree.dofs))
    message = f"{', '.join(names)} without markers of its own: its joint is held within about {FIRM} rad of rest"
    return replace(model, tree=replace(model.tree, dofs=dofs)), (*said, Note("model.between", message))


def _undetermined(tree: Tree, body: int, marked: set[str]) -> bool:
    """Return whether more than ``HINGES`` coordinates lie between the marked bodies above and below an unmarked one."""

    def bare_above(k: int) -> list[int]:
        parent = tree.bodies[k].parent
        return [k, *(bare_above(parent) if parent > 0 and tree.names[parent] not in marked else [])]

    ends = [k for k in tree.subtree(body) if tree.names[k] in marked and body in bare_above(k)]
    return any(len({row for k in bare_above(end) for row in tree.driving(k)}) > HINGES for end in ends)


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


def _attach(model: Model, specs: dict[str, MarkerSpec]) -> Attachment:
    """Return the markers of ``specs`` with their places on the model's bodies as the prior has them."""
    mean, sd = marker_prior(model, specs.values())
    body = torch.tensor([model.tree.index(spec.segment) for spec in specs.values()])
    return Attachment(tuple(specs), body, mean, sd, tuple(spec.landmark for spec in specs.values()))
