"""Geometry of the whole body before any motion, and ties between its parameters.

One parameter moves one entry of the raw geometry (a component of a joint centre's offset, or a hinge angle); sideways
ones are measured outwards from the body's midline on both sides. ``tie_sides`` and ``group`` merge columns.
"""

import math

import torch
from torch import Tensor

from torchid.errors import ConfigError
from torchid.model.model import GeometryPrior
from torchid.model.proportions import Proportions
from torchid.model.skeleton import SEGMENTS, SIDES
from torchid.model.tree import Tree

LENGTH_SCATTER = 0.045
"""Standard deviation of a segment's length at given stature, as a fraction of it."""
CENTRE_SD = 0.005
"""Scatter of knee, ankle, elbow and wrist centres across the segment's axis [m]."""
HINGES_DEG = {
    "knee_axis_x": (0.0, 5.0),
    "knee_axis_z": (0.0, 6.0),
    "elbow_axis_x": (0.0, 6.0),
    "elbow_axis_z": (0.0, 7.0),
    "ankle_axis_x": (7.0, 5.0),
    "ankle_axis_z": (-6.0, 7.0),
    "subtalar_axis_y": (42.0, 9.0),
    "subtalar_axis_z": (23.0, 11.0),
}
"""Mean and scatter of hinge angles [deg]: ankle and subtalar axes Inman 1976; knee and elbow axes about straight across
(Churchill et al. 1998, Clin Orthop 356:111; Stokdijk et al. 1999, Clin Biomech 14:177)."""

_LIMB_ROWS = (
    ("shoulder_{s}_x", "upper_arm", 0, "shoulder_x", 0.015),
    ("shoulder_{s}_y", "upper_arm", 1, "shoulder_y", 0.012),
    ("shoulder_{s}_z", "upper_arm", 2, "shoulder_z", 0.020),
    ("upper_arm_{s}_length", "forearm", 2, "upper_arm_length", None),
    ("elbow_{s}_x", "forearm", 0, None, CENTRE_SD),
    ("elbow_{s}_y", "forearm", 1, None, CENTRE_SD),
    ("forearm_{s}_length", "hand", 2, "forearm_length", None),
    ("wrist_{s}_x", "hand", 0, None, CENTRE_SD),
    ("wrist_{s}_y", "hand", 1, None, CENTRE_SD),
    ("thigh_{s}_length", "shank", 2, "thigh_length", None),
    ("knee_{s}_x", "shank", 0, None, CENTRE_SD),
    ("knee_{s}_y", "shank", 1, None, CENTRE_SD),
    ("shank_{s}_length", "foot", 2, "shank_length", None),
    ("ankle_{s}_x", "foot", 0, None, CENTRE_SD),
    ("ankle_{s}_y", "foot", 1, None, CENTRE_SD),
)
"""Name, child body, component of its offset, fraction of stature, scatter [m] (None: of a length)."""
_AXIAL_ROWS = (
    ("lower_spine_x", "abdomen", 0, 0.012),
    ("lower_spine_z", "abdomen", 2, 0.012),
    ("upper_spine_x", "thorax", 0, 0.015),
    ("upper_spine_z", "thorax", 2, 0.012),
    ("neck_x", "head", 0, 0.015),
    ("neck_z", "head", 2, 0.015),
)


class _Columns:
    """Parameters collected one by one."""

    def __init__(self, raw: int) -> None:
        self.raw = raw
        self.names: list[str] = []
        self.units: list[str] = []
        self.mean: list[float] = []
        self.sd: list[float] = []
        self.columns: list[Tensor] = []

    def add(self, name: str, unit: str, mean: float, sd: float, entries: dict[int, float]) -> None:
        column = torch.zeros(self.raw, dtype=torch.float64)
        for row, value in entries.items():
            column[row] = value
        self.names.append(name)
        self.units.append(unit)
        self.mean.append(mean)
        self.sd.append(sd)
        self.columns.append(column)


def whole_body_geometry(tree: Tree, shape: Proportions, height: float, height_sd: float) -> GeometryPrior:
    """Prior of the joint centres and hinge angles for a stature [m] known to ``height_sd`` [m]."""
    raw = 3 * len(tree.bodies) + len(tree.hinges)
    columns = _Columns(raw)
    common = height_sd / height

    def add(name: str, body: str, component: int, mean: float, sd: float, sign: float) -> None:
        columns.add(name, "m", mean, math.hypot(sd, common * mean), {3 * SEGMENTS.index(body) + component: sign})

    width = shape.pelvis_width * height
    left, right = (3 * SEGMENTS.index(f"thigh_{s}") + 1 for s in SIDES)
    columns.add("pelvis_width", "m", width, math.hypot(0.06, common) * width, {left: 0.5, right: -0.5})
    for name, body, component, sd in _AXIAL_ROWS:
        add(name, body, component, getattr(shape, name) * height, sd, 1.0)
    for side in SIDES:
        outward = 1.0 if side == "l" else -1.0
        for name, body, component, fraction, sd in _LIMB_ROWS:
            mean = getattr(shape, fraction) * height if fraction else 0.0
            sign = outward if component == 1 else -1.0 if sd is None else 1.0
            spread = LENGTH_SCATTER * mean if sd is None else sd
            add(name.format(s=side), f"{body}_{side}", component, mean, spread, sign)
    for k, name in enumerate(tree.hinges):
        mean, sd = (math.radians(v) for v in HINGES_DEG[unsided(name)])
        columns.add(name, "rad", mean, sd, {3 * len(tree.bodies) + k: 1.0})
    return GeometryPrior(
        names=tuple(columns.names),
        units=tuple(columns.units),
        mean=torch.tensor(columns.mean, dtype=torch.float64),
        sd=torch.tensor(columns.sd, dtype=torch.float64),
        map=torch.stack(columns.columns, dim=1),
        constant=torch.zeros(raw, dtype=torch.float64),
        n_hinges=len(tree.hinges),
    )


def unsided(name: str) -> str:
    """Name of a parameter or coordinate without its ``_l`` or ``_r``."""
    parts = name.split("_")
    return "_".join(part for part in parts if part not in SIDES)


def tie_sides(prior: GeometryPrior) -> GeometryPrior:
    """One parameter for each pair of left and right ones, called by the pair's name without its side."""
    for name in prior.names:
        twin = name.replace("_l_", "_r_")
        if twin != name and twin in prior.names:
            prior = group(prior, (name, twin), unsided(name))
    return prior


def group(prior: GeometryPrior, names: tuple[str, ...], into: str) -> GeometryPrior:
    """Merge parameters into one called ``into``, which has the first one's value.

    The others follow in proportion to their means (bones of different length share a scale), equally where a mean is
    zero. Its scatter is the mean of theirs, each on the first one's scale.

    Raises:
        ConfigError: a name is unknown or repeated, ``into`` is taken, or the units differ.
    """
    rows = _rows(prior, names, into)
    first = float(prior.mean[rows[0]])
    ratio = prior.mean[rows] / first if first != 0.0 else torch.ones(len(rows), dtype=prior.mean.dtype)
    ratio = torch.where(ratio == 0.0, torch.ones_like(ratio), ratio)
    shift = prior.map[:, rows] @ (prior.mean[rows] - ratio * first)
    rest = [k for k in range(len(prior.names)) if k not in rows]
    order = sorted([*rest, rows[0]])
    merged, sd = prior.map.clone(), prior.sd.clone()
    merged[:, rows[0]] = prior.map[:, rows] @ ratio
    sd[rows[0]] = (prior.sd[rows] / ratio.abs()).mean()
    return GeometryPrior(
        names=tuple(into if k == rows[0] else prior.names[k] for k in order),
        units=tuple(prior.units[k] for k in order),
        mean=prior.mean[order],
        sd=sd[order],
        map=merged[:, order],
        constant=prior.constant + shift,
        n_hinges=prior.n_hinges,
    )


def _rows(prior: GeometryPrior, names: tuple[str, ...], into: str) -> list[int]:
    unknown = [name for name in names if name not in prior.names]
    if unknown or len(set(names)) != len(names) or not names:
        raise ConfigError(
            "geometry.group", "a group needs different, existing parameters", place=into, found=str(unknown or names),
            remedy=f"known: {', '.join(prior.names)}",
        )  # fmt: skip
    rows = [prior.names.index(name) for name in names]
    if into in prior.names and into not in names:
        raise ConfigError(
            "geometry.group", "a parameter of this name exists already", place=into, remedy="Take another."
        )
    if len({prior.units[k] for k in rows}) > 1:
        raise ConfigError(
            "geometry.group", "parameters of one group need one unit", place=into, found=str(names),
            remedy="Group lengths with lengths, and angles with angles",
        )  # fmt: skip
    return rows
