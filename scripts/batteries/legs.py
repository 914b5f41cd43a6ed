"""Legs alone against the whole body: what is lost without markers above the pelvis?

    PYTHONPATH=.:scripts python -m batteries.legs
    PYTHONPATH=.:scripts python -m batteries.legs --sessions hamner2013_subject04

Each session of the shared recordings with a whole body in view is run as its config has it, then with the markers of
pelvis and legs alone, both without the diagnosis. Prints the difference of total mass and leg lengths, how far the
centres of hips, knees and ankles lie apart in all frames, and the share of the legs' masses, centres of mass and
inertias that are within two standard deviations of the whole body's.
"""

from pathlib import Path

import torch
from harness.command import ROOT
from harness.rows import Row
from harness.runs import of_sessions, ran

from torchid.errors import DataError
from torchid.kinematics.chain import chain_poses
from torchid.session import Outcome

SESSIONS = (
    "biomechzoo_hc030a",
    "biomechzoo_hc040a",
    "btk_flatfoot",
    "hamner2013_subject04",
    "opencap_subject4",
    "opensim_rajagopal_walk",
    "opensim_subject01_gait2354",
    "schreiber_moissenet_2014001",
    "welk007_functional",
)
"""Configs of sessions with markers on trunk and arms."""
LEGS = ("thigh", "shank", "foot", "toes")
JOINTS = ("thigh_l", "shank_l", "foot_l", "thigh_r", "shank_r", "foot_r")
"""Bodies whose proximal joints are hips, knees and ankles."""


def _performed(out: Path, config: str) -> Row:
    """Run a session whole and with the markers of its legs alone."""
    path = ROOT / "configs" / f"{config}.yaml"
    whole = ran(path, out / "whole" / config)
    few = out / f"{config}_legs.yaml"
    few.write_text(_marker_set(whole), encoding="utf-8")
    try:
        legs = ran(path, out / "legs" / config, f"markers={few.resolve()}")
    except DataError as refused:  # legs that nobody could identify the body from
        return {"key": config, "refused": str(refused)}
    return {"key": config, "legs_kg": float(legs.phi[:, 0].sum()), "whole_kg": float(whole.phi[:, 0].sum())} | _apart(
        whole, legs
    )


def _marker_set(one: Outcome) -> str:
    """The markers of pelvis and legs, as a set of its own."""
    fit = one.fit
    names, marks = fit.model.tree.names, fit.attachment
    own = zip(marks.labels, (names[int(k)] for k in marks.body), marks.landmark, strict=True)
    lines = []
    for label, segment, landmark in own:
        if segment == names[0] or segment.startswith(LEGS):
            said = f", landmark: {landmark}" if landmark else ""
            lines.append(f'"{label}": {{segment: {segment}{said}}}\n')
    return "".join(lines)


def _apart(whole: Outcome, legs: Outcome) -> dict[str, float]:
    """How far two results of the same trials lie apart."""
    at = {way: _centres(one) for way, one in (("whole", whole), ("legs", legs))}
    left = (at["whole"] - at["legs"]).norm(dim=-1)
    lengths = {way: _lengths(one) for way, one in (("whole", whole), ("legs", legs))}
    return {
        "lengths_mm": 1e3 * float((lengths["whole"] - lengths["legs"]).abs().max()),
        "centres_mm": 1e3 * float(left.square().mean(0).sqrt().max()),
        **_inertia(whole, legs),
    }


def _centres(one: Outcome) -> torch.Tensor:
    """Centres of hips, knees and ankles in all frames of all trials, shape (frames, joints, 3)."""
    tree, which = one.fit.model.tree, [one.fit.model.tree.names.index(name) for name in JOINTS]
    q = torch.cat([followed.tracked.q for followed in one.followed.values()])
    poses = chain_poses(tree, q, one.fit.geometry)
    return poses[:, which, :3, 3]


def _lengths(one: Outcome) -> torch.Tensor:
    """Lengths of thighs and shanks."""
    names = one.fit.model.tree.names
    return torch.stack([one.fit.geometry.offset[names.index(n)].norm() for n in JOINTS if not n.startswith("thigh")])


def _inertia(whole: Outcome, legs: Outcome) -> dict[str, float]:
    """Share of the legs' parameters within two standard deviations; largest difference of a mass against its own."""
    assert whole.identified is not None and legs.identified is not None
    a, b = whole.identified.fit, legs.identified.fit
    own = [k for k, name in enumerate(a.names) if name.startswith(LEGS)]
    eye = torch.eye(3, dtype=torch.bool)
    parts = {
        "mass": ((a.mass - b.mass)[own], b.sd.mass[own]),
        "com": ((a.com - b.com)[own], b.sd.com[own]),
        "inertia": ((a.inertia_com - b.inertia_com)[own][:, eye], b.sd.inertia_com[own][:, eye]),
    }
    z = {what: (left / sd).abs() for what, (left, sd) in parts.items()}
    return {f"{what}_within": float((one < 2.0).double().mean()) for what, one in z.items()} | {
        f"{what}_z": float(one.max()) for what, one in z.items()
    }


def _in_a_line(row: Row) -> str:
    if "refused" in row:
        return f"{row['key']:28s} {row['refused'][:120]}"
    mass = f"{row['legs_kg']:.2f} kg ({100 * (row['legs_kg'] / row['whole_kg'] - 1):+.2f} %)"
    where = f"lengths {row['lengths_mm']:.1f} mm, centres {row['centres_mm']:.1f} mm"
    within = ", ".join(
        f"{what} {100 * row[f'{what}_within']:.0f} % (at most {row[f'{what}_z']:.1f} sd)"
        for what in ("mass", "com", "inertia")
    )
    return f"{row['key']:28s} {mass}; {where}; {within}"


def main() -> None:
    """Run what is missing, print a line for each."""
    of_sessions(__doc__, SESSIONS, _performed, _in_a_line, "out/legs")


if __name__ == "__main__":
    main()
