"""Labels taken out of a marker set: are they told by how they move, and is none put on a wrong segment?

    PYTHONPATH=.:scripts python -m batteries.unlisted
    PYTHONPATH=.:scripts python -m batteries.unlisted --seed 1 --sessions hamner2013_subject04
    PYTHONPATH=.:scripts python -m batteries.unlisted --apart

Of each session of the shared recordings, all, half and a fifth of the labels that its set lists are taken out of the
set, by lot. Prints how many were given to the right segment, to a wrong one, and were left out, and the first of these
among those whose segment bears three markers at least.
"""

import json
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np
from harness.command import DATA, ROOT, Among, Command, said_seed
from planted_faults.real_sessions import SESSIONS, of_child

from batteries.folders import FOLDERS
from torchid.config import Config, load_config
from torchid.errors import DataError, TorchidError
from torchid.geometry.assign import assign_markers
from torchid.model.marker_set import MarkerSet
from torchid.model.model import Model
from torchid.recording import Trial
from torchid.session.opening import open_trials, setup_of

APART = ("HC031A", "HC033A", "HC038A", "HC044A")
"""Sessions by which no bound of the placing was chosen."""
SHARES = (1.0, 0.5, 0.2)
"""Of the labels, that are taken out."""
FEW = 3
"""Markers of a segment that are told apart from others' by them alone."""


def told(
    model: Model, markers: MarkerSet, trials: tuple[Trial, ...], share: float, draw: np.random.Generator
) -> tuple[np.ndarray, list[str]]:
    """How many labels taken out went to their segment, to a wrong one and to none, and of how many that are on segments
    with three markers how many went there; the wrong ones in words."""
    specs = markers.match(sorted(assigned(model, markers, trials, "leave_out"))).assigned
    right = {label: spec.segment for label, spec in specs.items()}
    out = [str(label) for label in draw.permutation([*right])[: round(share * len(right))]]
    own = replace(markers, specs={label: specs[label] for label in right if label not in out}, aliases={})
    try:
        found = assigned(model, own, trials)
    except DataError:  # the run would be refused
        found = {}
    hits = [label for label in out if found.get(label) == right[label]]
    wrong = [f"{label} on {found[label]}" for label in out if label in found and label not in hits]
    often = Counter(right.values())
    some = [label for label in out if often[right[label]] >= FEW]
    counts = (len(hits), len(wrong), len(out) - len(hits) - len(wrong), len({*some} & {*hits}), len(some))
    return np.array(counts), wrong


def assigned(
    model: Model, markers: MarkerSet, trials: tuple[Trial, ...], unlisted: Literal["assign", "leave_out"] = "assign"
) -> dict[str, str]:
    """Each label's segment."""
    found = assign_markers(model, markers, trials, unlisted)
    names, attached = found.model.tree.names, found.attachment
    return {label: names[int(k)] for label, k in zip(attached.labels, attached.body, strict=True)}


def _each(names: list[str]) -> Iterator[tuple[str, Model, MarkerSet, tuple[Trial, ...]]]:
    """Each session's model, set and recordings."""
    for name in names:
        try:
            config = _of_child(name) if name in APART else load_config(ROOT / "configs" / f"{name}.yaml")
            setup = setup_of(config)
            yield name, setup.model, setup.markers, tuple(open_trials(setup, config.trials).values())
        except TorchidError as refused:
            print(f"{name:28s} {str(refused)[:100]}", flush=True)


def _of_child(name: str) -> Config:
    """A child's standing and two walks, as ``scripts/children`` takes them."""
    own = next(one for one in SESSIONS if one.name == name)
    files = [Path(file.markers).stem for file, _ in own.roles("none")]
    document = of_child(name, zip(files, ("static", "fit", "fit"), strict=True), DATA)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "config.json"
        path.write_text(json.dumps(document))
        return load_config(path)


def main() -> None:
    """Print a line for each session and share, and the sums."""
    given = Command(
        __doc__,
        seed=(int, "of the lots (default: drawn)"),
        sessions=(Among((*FOLDERS, *APART), None, True, "NAME"), "only these"),
        apart=(False, "the sessions by which no bound was chosen, and no others"),
    ).asked()
    draw, sums = np.random.default_rng(said_seed(given.seed)), {share: np.zeros(5, int) for share in SHARES}
    for name, model, markers, trials in _each(given.sessions or list(APART if given.apart else FOLDERS)):
        for share in SHARES:
            start = time.perf_counter()
            counts, wrong = told(model, markers, trials, share, draw)
            sums[share] += counts
            seconds = time.perf_counter() - start
            print(f"{name:28s} {share}: {_words(counts)}, {seconds:.1f} s {', '.join(wrong)}", flush=True)
    for share, counts in sums.items():
        print(f"{share} of the labels: {_words(counts)}")


def _words(counts: np.ndarray) -> str:
    right, wrong, left, often, some = counts.tolist()
    return f"right {right}, wrong {wrong}, left out {left}; where a segment has three, right {often} of {some}"


if __name__ == "__main__":
    main()
