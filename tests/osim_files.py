"""Small OpenSim documents, and OpenSim's own answers about a file."""

from pathlib import Path

import numpy as np
import pytest
import torch

from torchid.model.opensim.model import OsimModel
from torchid.model.opensim.posing import body_poses, coupled, marker_places

NAMES = (
    "arnold2013_synthetic_truth/subject01/subject01.osim",
    "hamner2013_subject04/unscaled_generic.osim",
    "opencap_subject4/Models/manually_scaled.osim",
    "opencap_subject4/Models/optimized_scale_and_markers.osim",
    "opensim_rajagopal_walk/subject_walk_scaled.osim",
    "opensim_subject01_gait2354/reference/opensim-models_subject01_simbody_adjusted.osim",
    "opensim_subject01_gait2354/reference/subject01_RRA_adjusted.osim",
    "opensim_subject01_gait2354/reference/subject01_simbody_scaled.osim",
    "welk007_functional/reference/manually_scaled.osim",
)
"""The laboratories' models among the shared recordings."""
MOTIONS = {1: "rotational", 2: "translational", 3: "coupled"}
"""OpenSim's numbers of the kinds of coordinates."""

BODY = """<Body name="{0}"><mass>2</mass><mass_center>0.01 -0.2 0.03</mass_center>
<inertia>0.02 0.01 0.021 0.001 -0.002 0.0005</inertia></Body>"""
OLD_BODY = """<Body name="{0}"><mass>2</mass><mass_center>0.01 -0.2 0.03</mass_center>
<inertia_xx>0.02</inertia_xx><inertia_yy>0.01</inertia_yy><inertia_zz>0.021</inertia_zz>
<inertia_xy>0.001</inertia_xy><inertia_xz>-0.002</inertia_xz><inertia_yz>0.0005</inertia_yz>
<Joint>{1}</Joint></Body>"""
OLD_JOINT = """<{0} name="{1}"><parent_body>{2}</parent_body><location_in_parent>0.1 0.2 -0.3</location_in_parent>
<orientation_in_parent>0.3 -0.4 0.5</orientation_in_parent><location>0.01 0 0.02</location>
<orientation>-0.2 0.1 0.7</orientation><CoordinateSet><objects>{3}</objects></CoordinateSet>
<reverse>{5}</reverse>{4}</{0}>"""
JOINT = """<{0} name="{1}"><socket_parent_frame>p</socket_parent_frame><socket_child_frame>c</socket_child_frame>
<coordinates>{4}</coordinates><frames>
<PhysicalOffsetFrame name="p"><socket_parent>{2}</socket_parent><translation>0.1 0.2 -0.3</translation>
<orientation>0.3 -0.4 0.5</orientation></PhysicalOffsetFrame>
<PhysicalOffsetFrame name="c"><socket_parent>{3}</socket_parent><translation>0.01 0 0.02</translation>
<orientation>-0.2 0.1 0.7</orientation></PhysicalOffsetFrame></frames>{5}</{0}>"""
MARKER = (
    """<Marker name="{0}"><socket_parent_frame>{1}</socket_parent_frame><location>0.1 0.2 0.3</location></Marker>"""
)
AXES = ("1 0 0", "0 1 0", "0 0 1")


def osim(*joints: str, bodies: str = "a", rest: str = "", version: int = 40500) -> str:
    """A document of OpenSim 4 with bodies of the names given as letters."""
    made = "\n".join(BODY.format(name) for name in bodies)
    return f"""<?xml version="1.0" encoding="UTF-8" ?>
<OpenSimDocument Version="{version}"><Model name="m"><Ground name="ground"/>
<BodySet name="bodyset"><objects>{made}</objects></BodySet>
<JointSet name="jointset"><objects>{"".join(joints)}</objects></JointSet>{rest}</Model></OpenSimDocument>"""


def old_osim(*bodies: str, rest: str = "", version: int = 30000) -> str:
    """A document of OpenSim 2 or 3."""
    return f"""<?xml version="1.0" encoding="UTF-8"?>
<OpenSimDocument Version="{version}"><Model name="m"><gravity>0 -9.80665 0</gravity>
<BodySet><objects><Body name="ground"><mass>0</mass><Joint/></Body>{"".join(bodies)}</objects></BodySet>
{rest}</Model></OpenSimDocument>"""


def coordinates(*names: str) -> str:
    """Elements of coordinates."""
    return "".join(
        f'<Coordinate name="{name}"><default_value>0.{k + 1}</default_value><range>-1.5 1.2</range></Coordinate>'
        for k, name in enumerate(names)
    )


def joint(kind: str, *names: str, parent: str = "/ground", child: str = "/bodyset/a", rest: str = "") -> str:
    """A joint of OpenSim 4 between two offset frames."""
    return JOINT.format(kind, f"{kind}_{child[-1]}", parent, child, coordinates(*names), rest)


def old_joint(kind: str, *names: str, parent: str = "ground", rest: str = "", reverse: str = "false") -> str:
    """A joint of OpenSim 2 or 3 between two offsets."""
    return OLD_JOINT.format(kind, f"{kind}_{parent}", parent, coordinates(*names), rest, reverse)


def transform(axes: dict[str, tuple[str, str, str]], old: bool = False) -> str:
    """The spatial transform of a custom joint: place: (coordinates, axis, function); the others stay at zero."""
    parts = []
    for kind in ("rotation", "translation"):
        for k, axis in enumerate(AXES, start=1):
            names, unit, function = axes.get(f"{kind}{k}", ("", axis, "<Constant><value>0</value></Constant>"))
            held = f"<function>{function}</function>" if old else function.replace(">", ' name="function">', 1)
            parts.append(
                f'<TransformAxis name="{kind}{k}"><coordinates>{names}</coordinates><axis>{unit}</axis>{held}'
                "</TransformAxis>"
            )
    return f"<SpatialTransform>{''.join(parts)}</SpatialTransform>"


class Twin:
    """OpenSim's model of a file."""

    def __init__(self, path: Path) -> None:
        self.opensim = pytest.importorskip("opensim")
        self.opensim.Logger.setLevelString("Off")
        self.model = self.opensim.Model(str(path))
        self.begin()

    def begin(self) -> None:
        """Make the state anew, after changes."""
        self.state = self.model.initSystem()
        for coordinate in self.coordinates:
            coordinate.setLocked(self.state, False)
            coordinate.setClamped(self.state, False)

    @property
    def coordinates(self) -> list:
        found = self.model.getCoordinateSet()
        return [found.get(k) for k in range(found.getSize())]

    def take(self, model: OsimModel, q: torch.Tensor) -> None:
        """Take one frame of coordinates, as they are."""
        for name, value in zip(model.coordinate_names, q.tolist(), strict=True):
            self.model.getCoordinateSet().get(name).setValue(self.state, value, False)
        self.model.realizePosition(self.state)

    def coupler_error(self) -> float:
        """Largest error of a constraint [rad, m]."""
        errors = self.state.getQErr()
        return float(np.abs(errors.to_numpy()).max()) if errors.size() else 0.0

    def pose(self, body: str) -> torch.Tensor:
        """Pose of a body in ground."""
        X = self.model.getBodySet().get(body).getTransformInGround(self.state)
        out = torch.eye(4, dtype=torch.float64)
        for i in range(3):
            out[i, 3] = X.p().get(i)
            for k in range(3):
                out[i, k] = X.R().get(i, k)
        return out

    def marker(self, name: str) -> torch.Tensor:
        """Place of a marker in ground."""
        p = self.model.getMarkerSet().get(name).getLocationInGround(self.state)
        return torch.tensor([p.get(k) for k in range(3)], dtype=torch.float64)

    def torques(self, speeds: np.ndarray, accelerations: np.ndarray) -> np.ndarray:
        """Inverse dynamics at the pose taken, in OpenSim's order of coordinates."""
        for coordinate, speed in zip(self.coordinates, speeds.tolist(), strict=True):
            coordinate.setSpeedValue(self.state, speed)
        self.model.realizeVelocity(self.state)
        udot = self.opensim.Vector(len(accelerations), 0.0)
        for k, value in enumerate(accelerations.tolist()):
            udot.set(k, value)
        return self.opensim.InverseDynamicsSolver(self.model).solve(self.state, udot).to_numpy().copy()


def draw(model: OsimModel, rng: np.random.Generator, frames: int) -> torch.Tensor:
    """Coordinates within their ranges and a tenth beyond, obeying the couplers."""
    low, high = (np.clip([getattr(one, end) for one in model.coordinates], -4.0, 4.0) for end in ("lower", "upper"))
    beyond = 0.1 * (high - low)
    q = rng.uniform(low - beyond, high + beyond, size=(frames, len(low)))
    return coupled(model, torch.tensor(q))


def largest_errors(model: OsimModel, twin: Twin, q: torch.Tensor) -> dict[str, float]:
    """Largest differences to OpenSim: places [m], turns [rad], markers [m], couplers [rad, m]."""
    poses, places = body_poses(model, q), marker_places(model, q)
    found = {"places": 0.0, "turns": 0.0, "markers": 0.0, "couplers": 0.0}
    for frame in range(len(q)):
        twin.take(model, q[frame])
        found["couplers"] = max(found["couplers"], twin.coupler_error())
        for k, body in enumerate(model.bodies):
            theirs, ours = twin.pose(body), poses[frame, k]
            found["places"] = max(found["places"], float((theirs - ours)[:3, 3].norm()))
            found["turns"] = max(found["turns"], _angle(theirs[:3, :3].T @ ours[:3, :3]))
        for k, marker in enumerate(model.markers):
            found["markers"] = max(found["markers"], float((twin.marker(marker.name) - places[frame, k]).norm()))
    return found


def _angle(R: torch.Tensor) -> float:
    """Angle of a rotation; from its skew part, which is exact where the trace is not."""
    skew = torch.stack([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]]).norm()
    return float(torch.atan2(skew, R.trace() - 1.0))
