"""What is drawn: plates, body, markers, forces and the centre of mass, and how they change from instant to instant."""

from dataclasses import dataclass

import numpy as np
import trimesh
import viser
from jaxtyping import Float

from torchid.conventions import LOADED_N
from torchid.scene import colours
from torchid.scene.solids import Solids, centre_of_mass, placed

METRES_PER_N = 1e-3
"""Choice. Length of an arrow: a person's weight is a little less than a person's leg."""
MARKER_M = 0.014
"""Choice. Size of a marker, as laboratories use them."""
BALL_M = 0.045
AMBIENT, LIGHT = 1.1, 1.5
"""Choice. Brightness: colours look as they are named, and still show which side is up."""
SHAFT_M, HEAD_M = 0.012, 0.03
FINENESS = 2
"""Choice. Divisions of an ellipsoid's icosahedron: 320 triangles look round, and are sent once."""
BESIDE_M = {"measured": 0.0, "predicted": 0.03, "extended": -0.03}
"""Choice. How far to the left a total force is drawn, so that equal ones do not hide each other."""
FAR_M = -100.0
"""Where what is not there is drawn: a node that comes and goes costs more than one that is out of sight."""


@dataclass(frozen=True)
class Ground:
    """What does not move."""

    corners: tuple[Float[np.ndarray, "4 3"] | None, ...]
    """Of every plate, in W [m]; None where nobody told them."""
    names: tuple[str, ...]
    """Of the plates."""


@dataclass(frozen=True)
class Instant:
    """What there is to be seen at one instant, in W and SI units; None: not known."""

    X_WB: Float[np.ndarray, "bodies 4 4"] | None = None
    """Poses of the bodies."""
    markers: Float[np.ndarray, "markers 3"] | None = None
    """As measured, NaN where missing [m]."""
    distance: Float[np.ndarray, " markers"] | None = None
    """From the model [m]."""
    plates: Float[np.ndarray, "plates 6"] | None = None
    """Wrenches of the plates about the origin."""
    measured: Float[np.ndarray, " 6"] | None = None
    """Total wrench about the origin, ..."""
    predicted: Float[np.ndarray, " 6"] | None = None
    """... that of the model, ..."""
    extended: Float[np.ndarray, " 6"] | None = None
    """... and that of the extended one."""
    sticks: Float[np.ndarray, "sticks 2 3"] | None = None
    """Of the scaled skeleton [m]."""


class PageScene:
    """The nodes of the page's scene."""

    def __init__(self, api: viser.SceneApi, ground: Ground) -> None:
        """Draw floor and plates.

        Args:
            ground: what does not move.
        """
        self._api, self.names = api, ground.names
        api.set_up_direction("+z")
        # Neither shadows nor a mirrored room: they wash colours out, and cost a weak machine half its pictures.
        api.configure_default_lights(enabled=False)
        api.configure_environment_map(None)
        api.add_light_ambient("/light/everywhere", intensity=AMBIENT)
        api.add_light_directional("/light/above", intensity=LIGHT, position=(2.0, 1.0, 4.0), cast_shadow=False)
        api.add_grid("/floor", 6.0, 6.0, plane="xy", cell_size=0.25, section_size=1.0, position=(0.0, 0.0, -0.004))
        for k, (corners, name) in enumerate(zip(ground.corners, ground.names, strict=True)):
            if corners is not None:
                _draw_plate(api, k, corners, name)
        self._solids: Solids | None = None
        self.body: viser.BatchedMeshHandle | None = None
        """The ellipsoids, whose instances are the bodies: for clicks."""
        self._ball = api.add_icosphere("/mass/ball", BALL_M, colours.PREDICTED, position=(0.0, 0.0, FAR_M))
        self._foot = api.add_cylinder("/mass/floor", 0.05, 0.004, colours.PREDICTED, position=(0.0, 0.0, FAR_M))
        self._markers = api.add_point_cloud(
            "/markers", np.zeros((1, 3)), colours.MARKER, point_size=MARKER_M, point_shape="circle",
            precision="float32", position=(0.0, 0.0, FAR_M),
        )  # fmt: skip
        self._plates = _arrows(api, "/forces/plates", colours.MEASURED, 0.6)
        self._totals = {
            name: _arrows(api, f"/forces/{name}", getattr(colours, name.upper()), 1.0)
            for name in ("measured", "predicted", "extended")
        }
        self._sticks: viser.LineSegmentsHandle | None = None
        self._asked: viser.LineSegmentsHandle | None = None

    def set_body(self, some: Solids, progress: Float[np.ndarray, " bodies"]) -> None:
        """Draw a body, or change its shape and colours.

        Args:
            progress: how much of each is known, 0 to 1.
        """
        self._solids = some
        tint, solidity = colours.by_progress(progress), colours.opacity(progress).astype(np.float32)
        if self.body is None:
            ball = trimesh.creation.icosphere(FINENESS)
            away = np.tile([0.0, 0.0, FAR_M], (len(some.names), 1))
            self.body = self._api.add_batched_meshes_simple(
                "/body", np.asarray(ball.vertices), np.asarray(ball.faces),
                np.tile([1.0, 0.0, 0.0, 0.0], (len(some.names), 1)), away, batched_scales=some.radius,
                batched_colors=tint, batched_opacities=solidity, lod="off", cast_shadow=False, receive_shadow=False,
            )  # fmt: skip
            return
        self.body.batched_scales = some.radius.astype(np.float32)
        self.body.batched_colors, self.body.batched_opacities = tint, solidity

    def show(self, now: Instant) -> None:
        """Draw an instant; forces that it does not tell go out of sight, a body and markers stay where they were."""
        self._show_body(now)
        self._show_markers(now)
        self._show_forces(now)
        if now.sticks is not None:
            self._show_sticks(now.sticks)

    def see(self, scaled: bool) -> None:
        """Show the scaled skeleton, or hide it."""
        if self._sticks is not None:
            self._sticks.visible = scaled

    def ask_for(self, drawing: Float[np.ndarray, "sticks 2 3"]) -> None:
        """Draw what the subject is asked to do, in place of what was asked before."""
        if self._asked is not None:
            self._asked.remove()
        self._asked = self._api.add_line_segments("/asked", drawing, colours.PREDICTED, thickness=SHAFT_M)

    def _show_body(self, now: Instant) -> None:
        if now.X_WB is None or self._solids is None or self.body is None:
            return
        centre, wxyz = placed(self._solids, now.X_WB)
        self.body.batched_positions, self.body.batched_wxyzs = centre.astype(np.float32), wxyz.astype(np.float32)
        mass = centre_of_mass(self._solids, now.X_WB)
        self._ball.position, self._foot.position = tuple(mass), (mass[0], mass[1], 0.002)

    def _show_markers(self, now: Instant) -> None:
        if now.markers is None:
            return
        seen = np.isfinite(now.markers).all(1)
        self._markers.position = (0.0, 0.0, 0.0) if seen.any() else (0.0, 0.0, FAR_M)
        if not seen.any():
            return
        tint = np.tile(np.array(colours.MARKER, np.uint8), (int(seen.sum()), 1))
        if now.distance is not None:
            known = np.isfinite(now.distance[seen])
            tint[known] = colours.by_distance(now.distance[seen][known])
        self._markers.points = now.markers[seen].astype(np.float32)
        if not np.array_equal(tint, self._markers.colors):  # what does not change is not sent
            self._markers.colors = tint

    def _show_forces(self, now: Instant) -> None:
        plates = () if now.plates is None else now.plates
        some = np.stack([arrow(wrench) for wrench in plates]).astype(np.float32) if len(plates) else HIDDEN
        if not np.array_equal(some, self._plates.points):
            self._plates.points = some
        for name, handle in self._totals.items():
            wrench = getattr(now, name)
            beside = np.array([0.0, BESIDE_M[name], 0.0], dtype=np.float32)
            points = HIDDEN if wrench is None else arrow(wrench)[None].astype(np.float32) + beside
            if not np.array_equal(points, handle.points):
                handle.points = points

    def _show_sticks(self, sticks: Float[np.ndarray, "sticks 2 3"]) -> None:
        if self._sticks is None:
            self._sticks = self._api.add_line_segments("/scaled", sticks, colours.SCALED, thickness=SHAFT_M)
        self._sticks.points = sticks.astype(np.float32)


HIDDEN = np.array([[[0.0, 0.0, FAR_M], [0.0, 0.0, FAR_M + 1.0]]], dtype=np.float32)
"""An arrow out of sight."""


def arrow(wrench: Float[np.ndarray, " 6"]) -> Float[np.ndarray, "2 3"]:
    """Return foot and tip of a force at its centre of pressure on the floor, out of sight below ``LOADED_N`` [m]."""
    force, moment = wrench[:3], wrench[3:]
    if not np.isfinite(wrench).all() or force[2] < LOADED_N:
        return HIDDEN[0]
    foot = np.array([-moment[1] / force[2], moment[0] / force[2], 0.0])
    return np.stack([foot, foot + METRES_PER_N * force])


def _draw_plate(api: viser.SceneApi, number: int, corners: Float[np.ndarray, "4 3"], name: str) -> None:
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    api.add_mesh_simple(f"/plates/{number}", corners, faces, color=colours.PLATE, side="double", cast_shadow=False)
    api.add_label(f"/plates/{number}/name", name, position=tuple(corners.mean(0)))


def _arrows(api: viser.SceneApi, name: str, tint: colours.Rgb, thickness: float) -> viser.ArrowsHandle:
    return api.add_arrows(
        name, HIDDEN, tint, shaft_radius=thickness * SHAFT_M, head_radius=thickness * HEAD_M,
        head_length=2.0 * thickness * HEAD_M,
    )  # fmt: skip
