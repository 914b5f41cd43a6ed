"""Sessions whose marker sets lack half of their labels or all, run to the end: the same marker RMSE, mass and residual?

    PYTHONPATH=.:scripts python -m batteries.placed
    PYTHONPATH=.:scripts python -m batteries.placed --sessions btk_flatfoot

Each config of the shared recordings is run without the diagnosis: as it is, with half of the labels taken out of its
set, by lot, and with none left in it, as if they were replaced by others that say nothing. Prints how many markers were
placed, how many on another segment, and how much the results differ.
"""

import json
from pathlib import Path

import numpy as np
from harness.command import ROOT
from harness.rows import Row
from harness.runs import of_sessions, ran

from batteries.folders import FIGURES, FOLDERS, figures_of, segments_of
from torchid.errors import TorchidError
from torchid.model.marker_set import MarkerSet, MarkerSpec, load_marker_set
from torchid.session import Outcome

KEPT = {"half": 0.5, "replaced": 0.0}
"""Share of the labels that stay in the set."""
SEED = 101
"""Of the lots; chosen, that of the figures of ``batteries.unlisted``."""


def _performed(out: Path, config: str) -> Row:
    """Run a session with its whole set and with less of it."""
    by_hand = ROOT / "configs" / f"{config}.yaml"
    row: Row = {"key": config}
    try:
        whole = ran(by_hand, out / "whole" / config)
        row["whole"] = figures_of(whole, [whole])
        every = load_marker_set(whole.config.markers)
        right = segments_of(whole)
        specs = every.match(sorted(right)).assigned
        lots = np.random.default_rng(SEED).permutation(sorted(specs)).tolist()
        for way, share in KEPT.items():
            kept = {label: specs[label] for label in lots[: round(share * len(lots))]}
            markers = _written(out / f"{config}_{way}.json", every, kept)
            row[way] = _against(ran(by_hand, out / way / config, f"markers={markers}", "unlisted=assign"), right, kept)
    except TorchidError as refused:
        row["refused"] = str(refused)
    return row


def _written(path: Path, every: MarkerSet, kept: dict[str, MarkerSpec]) -> Path:
    """The file of a set with some labels."""
    entries = {
        label: {"segment": spec.segment} | ({"landmark": spec.landmark} if spec.landmark else {})
        for label, spec in kept.items()
    }
    path.write_text(json.dumps(entries | {"computed": list(every.computed)}), encoding="utf-8")
    return path


def _against(one: Outcome, right: dict[str, str], kept: dict[str, MarkerSpec]) -> Row:
    """Figures of a run, and how many of the labels taken out are on their segments and on others."""
    placed = {label: segment for label, segment in segments_of(one).items() if label in right and label not in kept}
    hits = sum(right[label] == segment for label, segment in placed.items())
    return figures_of(one, [one]) | {"right": hits, "wrong": len(placed) - hits, "out": len(right) - len(kept)}


def _in_a_line(row: Row) -> str:
    parts = []
    if "whole" in row:
        parts.append(", ".join(f"{row['whole'][figure]:.4g} {unit}" for figure, unit in FIGURES.items()))
    for way in KEPT:
        if way in row:
            one = row[way]
            differ = (f"{100 * (one[figure] / row['whole'][figure] - 1):+.1f} %" for figure in FIGURES)
            parts.append(f"{way} {one['right']} right, {one['wrong']} wrong of {one['out']}: {', '.join(differ)}")
    return f"{row['key']:28s} {'; '.join([*parts, *([row['refused'][:120]] if 'refused' in row else [])])}"


def main() -> None:
    """Run what is missing, print a line for each."""
    of_sessions(__doc__, tuple(FOLDERS), _performed, _in_a_line, "out/placed")


if __name__ == "__main__":
    main()
