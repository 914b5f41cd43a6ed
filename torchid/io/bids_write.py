"""Motion-BIDS out: a table of channels over time, and the files that say what its columns are.

The layout is that of ``torchid.io.bids_motion``, by version 1.11.1 of the specification
(https://bids-specification.readthedocs.io/en/stable/modality-specific-files/motion.html).
"""

import csv
import hashlib
import io
import re
import unicodedata
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from torchid.io.files import MOTION_BIDS, MOTION_BIDS_ABOUT
from torchid.storage.files import atomic_write, write_json, write_text
from torchid.wording import clean

VERSION = "1.11.1"
"""Cited. Of the specification that is followed."""
NONE = "n/a"
"""Cited. What stands for a value that is not known."""
COUNTED = ("ACCEL", "ANGACCEL", "GYRO", "JNTANG", "LATENCY", "MAGN", "ORNT", "POS", "VEL")
"""Cited. Types whose channels are counted under their own name."""
STILL = ("LATENCY", "MISC")
"""Cited. Types that are no motion."""
LONGEST = 40
"""Chosen. Letters of a label, as of names of other files (``safe_name``): paths stay short enough for Windows."""
MARK = 8
"""Chosen. Hexadecimal digits behind labels that would be alike: one pair in four billion still is."""


class BidsChannel(NamedTuple):
    """A column of a ``_motion.tsv``: its row in ``_channels.tsv``, in the order of the specification."""

    name: str
    component: str
    """x, y or z; ``n/a`` for what has no axis."""
    type: str
    tracked_point: str
    units: str
    placement: str = NONE
    """Where on the body the point is."""
    reference_frame: str = NONE
    description: str = NONE


def entity_labels(names: Sequence[str]) -> list[str]:
    """Return a label of letters and digits for each name, as BIDS wants them in names of files.

    Labels differ, also where a disk takes small and large letters for the same: those that would not have a part of
    their name's hash behind them.

    Args:
        names: that differ.
    """
    plain = [re.sub(r"[^A-Za-z0-9]", "", unicodedata.normalize("NFKD", name)) for name in names]
    alike = Counter(label.casefold() for label in plain)
    return [
        label if label and len(label) <= LONGEST and alike[label.casefold()] == 1 else label[:LONGEST] + _mark(name)
        for label, name in zip(plain, names, strict=True)
    ]


def _mark(name: str) -> str:
    return hashlib.sha256(name.encode("utf-8", "surrogatepass")).hexdigest()[:MARK]


def motion_files(stem: str) -> tuple[str, ...]:
    """Return the names of the files of a recording: its table and what describes it.

    Args:
        stem: what they begin with, such as ``sub-01/motion/sub-01_task-walk_tracksys-omc``.
    """
    return tuple(f"{stem}{ending}" for ending in (MOTION_BIDS, *MOTION_BIDS_ABOUT))


def write_bids_motion(
    stem: str, channels: Sequence[BidsChannel], pieces: Iterable[Float[np.ndarray, "frames channels"]],
    stated: Mapping[str, Any], frames: Mapping[str, Any], place: Callable[[str], Path],
) -> None:  # fmt: skip
    """Write a recording: seven digits of each value, six decimals of latencies, ``n/a`` for NaN.

    Args:
        stem: as of ``motion_files``.
        channels: columns, whose names differ.
        pieces: their values, cut along time; only one piece is held at a time.
        stated: of ``_motion.json``, beside the counts of channels.
        frames: what each ``reference_frame`` is.
        place: where a file of a name is to be written.

    Raises:
        InputError: ``results.unwritable``.
    """
    table, columns, meanings, about = map(place, motion_files(stem))
    row = "\t".join("%.6f" if one.type == "LATENCY" else "%.7g" for one in channels) + "\n"
    with atomic_write(table) as file:
        for piece in pieces:
            text = "".join([row % tuple(values) for values in piece.tolist()])
            file.write(text.replace("nan", NONE).encode("ascii"))
    write_tsv(columns, BidsChannel._fields, channels)
    write_json(meanings, {"Description": f"Columns of {Path(stem).name}", "reference_frame": {"Levels": frames}})
    write_json(about, {**stated, "MissingValues": NONE, **_counts(channels)})


def _counts(channels: Sequence[BidsChannel]) -> dict[str, int]:
    """Return how many channels and points there are."""
    types = Counter(one.type for one in channels)
    return {
        "TrackedPointsCount": len({one.tracked_point for one in channels if one.type == "POS"}),
        "MotionChannelCount": sum(count for kind, count in types.items() if kind not in STILL),
        **{f"{kind}ChannelCount": types[kind] for kind in COUNTED},
        "MiscChannelCount": types["MISC"],
    }


def write_tsv(path: Path, head: Sequence[str], rows: Iterable[Sequence[str]]) -> None:
    """Write a table of texts with names above its columns.

    Raises:
        InputError: ``results.unwritable``.
    """
    text = io.StringIO()
    lines = csv.writer(text, delimiter="\t", lineterminator="\n")
    lines.writerow(head)
    lines.writerows([clean(cell) for cell in row] for row in rows)
    write_text(path, text.getvalue())
