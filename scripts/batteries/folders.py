"""A folder alone against the config that somebody wrote for it by hand: the same markers, masses and residuals?

    PYTHONPATH=.:scripts python -m batteries.folders
    PYTHONPATH=.:scripts python -m batteries.folders --sessions hamner2013_subject04

``torchid new`` makes a config of each folder of the shared recordings, with mass, stature and sex given; both configs
are run without the diagnosis. Prints a line for each session, and how much the folder's result differs.
"""

from pathlib import Path
from statistics import mean

from harness.command import DATA, ROOT
from harness.rows import Row
from harness.runs import of_sessions, ran

from torchid.config import load_config
from torchid.errors import DataError
from torchid.folder.config_text import config_text
from torchid.folder.people import Person
from torchid.folder.proposal import propose
from torchid.session import Outcome

FOLDERS = {
    "arnold2013_synthetic_truth": ("arnold2013_synthetic_truth", None),
    "biomechzoo_hc030a": ("biomechzoo_pig", "HC030A"),
    "biomechzoo_hc040a": ("biomechzoo_pig", "HC040A"),
    "btk_flatfoot": ("btk_c3d/PiG", None),
    "btk_functional": ("btk_c3d/others", None),
    "hamner2013_subject04": ("hamner2013_subject04", None),
    "opencap_subject4_all": ("opencap_subject4", None),
    "opensim_rajagopal_walk": ("opensim_rajagopal_walk", None),
    "opensim_subject01_gait2354": ("opensim_subject01_gait2354", None),
    "schreiber_moissenet_2014001": ("schreiber_moissenet_2014001", None),
    "welk007_functional": ("welk007_functional", None),
}
"""Folder of each config written by hand, and who of several it is about."""
FIGURES = {"marker_mm": "mm", "mass_kg": "kg", "force_N": "N", "moment_Nm": "N m"}


def _performed(out: Path, config: str) -> Row:
    """Run both configs of a session."""
    by_hand = ROOT / "configs" / f"{config}.yaml"
    who = load_config(by_hand).subject
    folder, name = FOLDERS[config]
    proposal = propose(DATA / folder, Person(name, who.mass_kg, who.height_m, who.sex, who.age_years))
    path = out / f"{config}.yaml"
    path.write_text(config_text(proposal, out), encoding="utf-8")
    try:
        found = {way: ran(one, out / way / config) for way, one in (("hand", by_hand), ("folder", path))}
    except DataError as refused:  # the config written by hand is refused as well, or its line says so
        return {"key": config, "refused": str(refused)}
    static = {way: sorted(str(t.file) for t in one.config.trials if t.role == "static") for way, one in found.items()}
    return {
        "key": config,
        "markers": [str(found["hand"].config.markers), proposal.markers.name],
        "static": static["hand"] == static["folder"],
        "segments": segments_of(found["hand"]) == segments_of(found["folder"]),
        **{way: figures_of(one, found.values()) for way, one in found.items()},
    }


def figures_of(one: Outcome, both) -> dict[str, float]:
    """Marker RMSE over the recordings that both have, total mass, residual of the fit."""
    files = set.intersection(*({t.file for t in other.config.trials if t.role != "static"} for other in both))
    common = [t.name for t in one.config.trials if t.file in files]
    last = next(r for r in reversed(one.residuals) if r.role == "fit")
    return {
        "marker_mm": 1e3 * mean(one.tracked(name).rmse for name in common),
        "mass_kg": float(one.phi[:, 0].sum()),
        "force_N": last.force_rmse_N,
        "moment_Nm": last.moment_rmse_Nm,
    }


def segments_of(one: Outcome) -> dict[str, str]:
    """Each marker's segment."""
    attachment, tree = one.session.assignment.attachment, one.session.assignment.model.tree
    return {label: tree.names[int(k)] for label, k in zip(attachment.labels, attachment.body, strict=True)}


def _in_a_line(row: Row) -> str:
    if "refused" in row:
        return f"{row['key']:28s} {row['refused'][:120]}"
    hand, folder = row["hand"], row["folder"]
    parts = [f"{folder[f]:.4g} {u} ({100 * (folder[f] / hand[f] - 1):+.1f} %)" for f, u in FIGURES.items()]
    same = ", ".join(f"{what} {'same' if row[what] else 'other'}" for what in ("static", "segments"))
    return f"{row['key']:28s} {row['markers'][1]:25s} {same}; {', '.join(parts)}"


def main() -> None:
    """Run what is missing, print a line for each."""
    of_sessions(__doc__, tuple(FOLDERS), _performed, _in_a_line, "out/folders")


if __name__ == "__main__":
    main()
