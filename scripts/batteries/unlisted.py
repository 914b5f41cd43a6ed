"""Labels taken out of a marker set: are they told by how they move, and is none put on a wrong segment?

    PYTHONPATH=.:scripts python -m batteries.unlisted
    PYTHONPATH=.:scripts python -m batteries.unlisted --seed 1 --sessions hamner2013_subject04

Of each session of the shared recordings, half and a fifth of the labels that its set lists are taken out of the set, by
lot; those on the pelvis stay, without which nobody can be followed. Prints how many of the others were given to the
right segment, to a wrong one, and were left out; without any fit.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from harness.command import ROOT, Among, Command, said_seed

from batteries.folders import FOLDERS
from torchid.config import load_config
from torchid.errors import TorchidError
from torchid.geometry.assign import assign_markers
from torchid.model.marker_set import MarkerSet
from torchid.model.model import Model
from torchid.recording import Trial
from torchid.session.opening import open_trials, setup_of

SHARES = (0.5, 0.2)
"""Of the labels, that are taken out."""


def told(
    model: Model, markers: MarkerSet, trials: tuple[Trial, ...], share: float, draw: np.random.Generator
) -> tuple[int, int, int, list[str]]:
    """How many labels taken out went to their segment, to a wrong one and to none; the wrong ones in words."""
    labels = dict.fromkeys(label for trial in trials for label in trial.markers.labels)
    right = markers.match(tuple(labels)).assigned
    some = sorted(label for label, spec in right.items() if spec.segment != "pelvis")
    out = [str(label) for label in draw.permutation(some)[: round(share * len(some))]]
    own = replace(markers, specs={label: spec for label, spec in right.items() if label not in out}, aliases={})
    found = assigned(model, own, trials)
    hits = [label for label in out if found.get(label) == right[label].segment]
    wrong = [f"{label} on {found[label]}" for label in out if label in found and label not in hits]
    return len(hits), len(wrong), len(out) - len(hits) - len(wrong), wrong


def assigned(model: Model, markers: MarkerSet, trials: tuple[Trial, ...]) -> dict[str, str]:
    """Each label's segment."""
    found = assign_markers(model, markers, trials)
    names, attached = found.model.tree.names, found.attachment
    return {label: names[int(k)] for label, k in zip(attached.labels, attached.body, strict=True)}


def _each(names: list[str]) -> Iterator[tuple[str, Model, MarkerSet, tuple[Trial, ...]]]:
    """Each session's model, set and recordings."""
    for name in names:
        config = load_config(ROOT / "configs" / f"{name}.yaml")
        try:
            setup = setup_of(config)
            yield name, setup.model, setup.markers, tuple(open_trials(setup, config.trials).values())
        except TorchidError as refused:
            print(f"{name:28s} {str(refused)[:100]}", flush=True)


def main() -> None:
    """Print a line for each session and share, and the sums."""
    given = Command(
        __doc__,
        seed=(int, "of the lots (default: drawn)"),
        sessions=(Among(tuple(FOLDERS), None, True, "NAME"), "only these"),
    ).asked()
    draw, sums = np.random.default_rng(said_seed(given.seed)), {share: np.zeros(3, int) for share in SHARES}
    for name, model, markers, trials in _each(given.sessions or list(FOLDERS)):
        for share in SHARES:
            *counts, wrong = told(model, markers, trials, share, draw)
            sums[share] += counts
            print(f"{name:28s} {share}: right, wrong, left out {counts} {', '.join(wrong)}", flush=True)
    for share, counts in sums.items():
        print(f"{share} of the labels: right, wrong, left out {counts.tolist()}")


if __name__ == "__main__":
    main()
