"""Prints how often distances tell a marker that was moved in the shared recordings, and one that was not.

    PYTHONPATH=.:scripts:tests python -m batteries.moved

Each session is read as recorded, and with a marker of a large segment, or of a small one or the chest, moved by 15 to
25 mm. A marker is told in a trial where the middle one of its comparisons is beyond even odds, or as likely as 50 to 1.
"""

import json
import tempfile
from collections import Counter
from pathlib import Path
from statistics import median

from harness.command import DATA, Command
from planted_faults.real_kinds import UNPLANTED
from planted_faults.real_sessions import RealSession, sessions
from planted_faults.real_truth import Inapplicable

from batteries.real import Case, planted
from torchid.checks.marker_tracks.session import readings_of
from torchid.config import load_config
from torchid.errors import TorchidError
from torchid.session.opening import read_session
from torchid.session.session import session_clusters

CHEST = ("thorax", "abdomen", "torso")
SURE_NATS = 4.0


def _told(session: RealSession, kind: str, seed: int, folder: Path) -> list[tuple[str, bool, float]]:
    """Size of the segment, whether it was moved then, and evidence, of each marker in each trial."""
    truth, path = planted(Case(session.name, "none", kind, seed), session, DATA, folder)
    opened = read_session(load_config(path))
    clusters = session_clusters(opened.assignment)
    of = dict(zip(clusters.labels, clusters.segments, strict=True))
    many, known = Counter(clusters.segments), {place for effect, place in session.known if effect == "marker_shift"}
    own: dict[tuple[str, str], list[float]] = {}
    for one in readings_of(opened.trials, clusters):
        if one.nats != 0.0 and one.label not in known:
            own.setdefault((one.trial, one.label), []).append(one.nats)
    moved = {place for answer in truth.right for place in answer.where}
    first = truth.told.split(" from ")[-1].removesuffix(" on")
    rows = []
    for (trial, label), nats in own.items():
        if not moved or (label in moved and trial == first):
            size = "chest" if of[label] in CHEST else f"{min(many[of[label]], 4)}"
            rows.append((size, bool(moved), median(nats)))
    return rows


def main() -> None:
    """Read all sessions, and count."""
    asked = Command(__doc__, seeds=6).asked()
    rows: list[tuple[str, bool, float]] = []
    with tempfile.TemporaryDirectory() as folder:
        for session in sessions(DATA, False).values():
            some = [(kind, seed) for kind in ("marker", "marker_soft") for seed in range(asked.seeds)]
            for kind, seed in [(UNPLANTED, 0), *some]:
                try:
                    rows += _told(session, kind, seed, Path(folder) / "case")
                except (Inapplicable, TorchidError):
                    continue
    for key, count in sorted(Counter(row[:2] for row in rows).items()):
        nats = [row[2] for row in rows if row[:2] == key]
        even, sure = (sum(x > least for x in nats) for least in (0.0, SURE_NATS))
        print(json.dumps({"markers": key[0], "moved": key[1], "of": count, "beyond_even": even, "sure": sure}))


if __name__ == "__main__":
    main()
