"""One file read by the public reader of its kind, as plain values that can be compared."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from torchid.config import load_config
from torchid.errors import Note
from torchid.io import read_trial
from torchid.model.files import load_model
from torchid.model.marker_set import load_marker_set
from torchid.model.model import Model
from torchid.recording import Trial

Values = dict[str, Any]
"""Arrays, texts and tuples by what they are."""


@dataclass(frozen=True)
class Reading:
    """What a reader returned."""

    values: Values
    notes: frozenset[str]


def read(kind: str, path: Path) -> Reading:
    """The file read; errors as of the reader."""
    if kind in ("mot", "sto"):
        return _of_trial(read_trial("a", path.with_name("beside.trc"), path))
    if kind in ("c3d", "trc"):
        return _of_trial(read_trial("a", path))
    if kind == "config":
        return Reading(dict(_flat(load_config(path).model_dump(mode="json"))), frozenset())
    if kind == "marker_set":
        own = load_marker_set(path)
        return Reading(dict(_flat({"specs": own.specs, "aliases": own.aliases, "computed": own.computed})), frozenset())
    model, notes = load_model(path)
    return Reading(_of_model(model), _said(notes))


def _said(notes: tuple[Note, ...]) -> frozenset[str]:
    return frozenset(f"{note.code}: {note.message}" for note in notes)


def _of_trial(trial: Trial) -> Reading:
    values: Values = {
        "labels": trial.markers.labels, "time": trial.markers.time.numpy(),
        "position": trial.markers.position.numpy(), "events": trial.events,
        "facts": tuple(sorted(trial.parameters.items())),
    }  # fmt: skip
    if trial.forces is not None:
        plates = trial.forces.plates
        values |= {
            "plates": tuple(plate.name for plate in plates), "force time": trial.forces.time.numpy(),
            "wrench": trial.forces.wrench.numpy(),
            "corners": tuple(None if p.corners is None else tuple(p.corners.flatten().tolist()) for p in plates),
        }  # fmt: skip
    return Reading(values, _said(trial.notes))


def _of_model(model: Model) -> Values:
    tree = model.tree
    values: Values = {"bodies": tree.names, "parents": tree.parents, "tree": tree, "marks": tuple(model.landmarks)}
    values |= {"offset": model.geometry.mean.numpy(), "constant": model.geometry.constant.numpy()}
    values |= {"inertia": model.inertia.mean.numpy(), "scatter": model.inertia.covariance.numpy()}
    return values | {"height": model.height, "places": np.array([m.p_BM_B for m in model.landmarks.values()])}


def _flat(tree: Any, name: str = "") -> list[tuple[str, Any]]:
    """Leaves by their dotted names."""
    if isinstance(tree, Mapping):
        return [leaf for key, value in tree.items() for leaf in _flat(value, f"{name}.{key}".lstrip("."))]
    if isinstance(tree, list | tuple) and tree and isinstance(tree[0], Mapping):
        return [leaf for k, value in enumerate(tree) for leaf in _flat(value, f"{name}.{k}")]
    return [(name, tree)]
