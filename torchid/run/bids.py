"""A run as a data set of Motion-BIDS: what was measured of each trial, and what was found of it."""

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from torchid.config.sections import Subject
from torchid.io.bids_write import (
    NONE,
    VERSION,
    BidsChannel,
    entity_labels,
    motion_files,
    write_bids_motion,
    write_tsv,
)
from torchid.io.files import BIDS_DESCRIPTION
from torchid.model.tree import BASE_DOFS
from torchid.session import Outcome
from torchid.storage.files import write_json, write_text
from torchid.storage.provenance import versions

FOLDER = "bids"
"""Wording. Name of the data set, below that of the results."""
ABOUT = (BIDS_DESCRIPTION, "README.md", "participants.tsv", "participants.json")
"""Files of a whole data set."""
TRACKED = "markers"
"""Wording. What the tracking system is called: which one it was, recordings do not tell."""
OLDEST = 89
"""Cited. Age above which nobody's is told: BIDS and HIPAA, section 164.514 [years]."""
MEANINGS = {
    "age": {"Description": f"Age; {OLDEST} stands for {OLDEST} and more", "Units": "year"},
    "sex": {"Description": "Sex, by which tables of proportions and inertia were chosen"},
    "height": {"Description": "Standing height", "Units": "m"},
    "weight": {"Description": "Mass on a scale", "Units": "kg"},
}
"""Wording. Columns of what is known of a person."""
FRAMES = {
    "W": {
        "Description": "Laboratory: Z up; X and Y are the horizontal axes of the recording, whichever way people face",
        "SpatialAxes": "FLU", "RotationRule": "right-hand", "RotationOrder": "n/a",
    },
    "joint": {
        "Description": "Axes of the joint that the body of tracked_point hangs on, one after the other, against the "
        "body that carries it",
        "RotationRule": "right-hand", "RotationOrder": "n/a",
    },
}  # fmt: skip
"""Wording. Frames in which channels are told."""
README = """\
# {subject}

One person in Motion-BIDS, written by torchid {version}.
Each trial has one table of channels over time. LATENCY counts seconds on the clock of the recording.

- POS: places of markers as read, before what the diagnosis puts right [m], not filtered; n/a where one was not seen
  or was taken out as wrong.
- JNTANG: joint angles of the identified body [rad], filtered; n/a where markers do not tell them.
- MISC, of joints: net moments of joints [N*m], and forces of those that slide [N], filtered.
- MISC, of plates: force [N] and moment about the origin of W [N*m] that each plate puts on the person, as measured.

Where the pelvis is, and how it is turned, is left out: markers tell it.
"""
"""Wording. What a data set says of itself."""


class _Block(NamedTuple):
    """Columns that are made of one series."""

    channels: list[BidsChannel]
    values: Callable[[slice], Float[Tensor, "frames channels"]]


def bids_stems(subject: str, trials: Sequence[str]) -> dict[str, str]:
    """Return what the names of the files of each trial begin with, below the folder of results.

    Args:
        subject: its name, with or without ``sub-``.
        trials: their names.
    """
    who = _participant(subject)
    return {
        trial: f"{FOLDER}/{who}/motion/{who}_task-{label}_tracksys-{TRACKED}"
        for trial, label in zip(trials, entity_labels(trials), strict=True)
    }


def _participant(subject: str) -> str:
    return f"sub-{entity_labels([subject.removeprefix('sub-')])[0]}"


def bids_names(subject: str, trials: Sequence[str]) -> list[str]:
    """Return every file of the data set, below the folder of results.

    Args:
        subject, trials: as of ``bids_stems``.
    """
    stems = bids_stems(subject, trials).values()
    return [*(f"{FOLDER}/{name}" for name in ABOUT), *(name for stem in stems for name in motion_files(stem))]


def write_bids_about(subject: Subject, place: Callable[[str], Path]) -> None:
    """Write what a data set says of itself, and of its person where anything is known.

    Args:
        subject: whom it shows.
        place: where a file of a name is to be written.

    Raises:
        InputError: ``results.unwritable``.
    """
    description, readme, table, meanings = (place(f"{FOLDER}/{name}") for name in ABOUT)
    version = versions()["torchid"]
    about = {
        "Name": f"Motion and joint moments of {subject.name}", "BIDSVersion": VERSION, "DatasetType": "derivative",
        "GeneratedBy": [{"Name": "torchid", "Version": version}],
    }  # fmt: skip
    write_json(description, about)
    write_text(readme, README.format(subject=subject.name, version=version))
    known = _known(subject)
    if known:
        write_tsv(table, ["participant_id", *known], [[_participant(subject.name), *known.values()]])
        write_json(meanings, {key: MEANINGS[key] for key in known})


def _known(subject: Subject) -> dict[str, str]:
    """Return what is known of a person, by the names that BIDS has for it."""
    age = None if subject.age_years is None else min(subject.age_years, OLDEST)
    sex = None if subject.sex == "unknown" else subject.sex
    each = {"age": age, "sex": sex, "height": subject.height_m, "weight": subject.mass_kg}
    return {key: value if isinstance(value, str) else f"{value:g}" for key, value in each.items() if value is not None}


def write_bids_trial(outcome: Outcome, name: str, pieces: Sequence[slice], place: Callable[[str], Path]) -> None:
    """Write what was measured of a trial, and what was found of it.

    Args:
        outcome: the run.
        name: of the trial.
        pieces: of its frames, one after the other.
        place: where a file of a name is to be written.

    Raises:
        InputError: ``results.unwritable``.
    """
    blocks = list(_blocks(outcome, name))
    markers = outcome.session.trials[name].markers
    rate = float(f"{markers.rate:.9g}") if len(markers.time) > 1 else 0.0
    stated = {
        "Description": "Markers and plates as measured, joint angles and moments as identified",
        "TaskName": name, "TaskDescription": f"Role in the identification: {outcome.session.trials[name].role}",
        "TrackingSystemName": TRACKED, "SamplingFrequency": rate, "SamplingFrequencyEffective": rate,
    }  # fmt: skip
    values = (torch.cat([block.values(part) for block in blocks], dim=1).numpy() for part in pieces)
    channels = [channel for block in blocks for channel in block.channels]
    stem = bids_stems(outcome.config.subject.name, list(outcome.session.trials))[name]
    write_bids_motion(stem, channels, values, stated, FRAMES, place)


def _blocks(outcome: Outcome, name: str) -> Iterator[_Block]:
    time, forces = outcome.followed[name].motion.time, outcome.session.trials[name].forces
    latency = BidsChannel("latency", NONE, "LATENCY", NONE, "s", description="Seconds on the clock of the recording")
    yield _Block([latency], lambda part: time[part, None])
    yield _markers(outcome, name)
    yield _angles(outcome, name)
    if forces is not None:
        yield _moments(outcome, name)
        channels = [
            BidsChannel(f"{plate.name} {kind} {axis}", axis, "MISC", plate.name, unit, "n/a", "W", "Measured")
            for plate in forces.plates
            for kind, unit in (("force", "N"), ("moment", "N*m"))
            for axis in "xyz"
        ]
        yield _Block(channels, lambda part: forces.wrench[part].flatten(1))


def _markers(outcome: Outcome, name: str) -> _Block:
    """Markers that are seen at some time, as they were read: what the diagnosis puts right is in the angles alone."""
    markers, attachment = outcome.session.trials[name].markers, outcome.fit.attachment
    bodies = [outcome.fit.model.tree.names[k] for k in attachment.body.tolist()]
    placement = dict(zip(attachment.labels, bodies, strict=True))
    seen = markers.position.isfinite().all(dim=2).any(dim=0)
    labels = np.array(markers.labels)[seen.numpy()].tolist()
    channels = [
        BidsChannel(f"{label} {axis}", axis, "POS", label, "m", placement.get(label, NONE), "W", "Measured")
        for label in labels
        for axis in "xyz"
    ]
    return _Block(channels, lambda part: markers.position[part][:, seen].flatten(1))


def _angles(outcome: Outcome, name: str) -> _Block:
    """Coordinates of joints, where markers tell them."""
    item = outcome.followed[name]
    channels = [
        BidsChannel(dof, NONE, "JNTANG" if unit == "rad" else "MISC", body, unit, NONE, "joint", _said(outcome))
        for dof, unit, body in _joints(outcome)
    ]
    told = item.tracked.observable[:, None]
    return _Block(channels, lambda part: torch.where(told[part], item.motion.q[part, BASE_DOFS:], torch.nan))


def _moments(outcome: Outcome, name: str) -> _Block:
    """Net moments of joints, and forces of those that slide."""
    named = {"rad": ("moment", "N*m"), "m": ("force", "N")}
    channels = [
        BidsChannel(f"{dof} {named[unit][0]}", NONE, "MISC", body, named[unit][1], NONE, "joint", _said(outcome))
        for dof, unit, body in _joints(outcome)
    ]
    return _Block(channels, lambda part: outcome.torque[name][part, BASE_DOFS:])


def _joints(outcome: Outcome) -> list[tuple[str, str, str]]:
    """Name, unit and body of every coordinate of a joint; a coordinate of several has the first."""
    tree = outcome.fit.model.tree
    body = {row: name for k, name in reversed(list(enumerate(tree.names))) for row in tree.driving(k)}
    return [(dof.name, dof.unit, body.get(row, NONE)) for row, dof in enumerate(tree.dofs) if row >= BASE_DOFS]


def _said(outcome: Outcome) -> str:
    return f"Identified, filtered at {outcome.cutoff_hz:.3g} Hz"
