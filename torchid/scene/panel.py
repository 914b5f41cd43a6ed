"""What stands beside the scene: cameras, the numbers of a segment, and charts."""

import html
from collections.abc import Sequence
from typing import Any

import numpy as np
import viser
import viser.uplot
from jaxtyping import Float

from torchid.scene import colours

VIEWS = {"front": (1.0, 0.0, 0.15), "left": (0.0, 1.0, 0.15), "back": (-1.0, 0.0, 0.15), "right": (0.0, -1.0, 0.15),
         "above": (0.02, 0.0, 1.0)}  # fmt: skip
"""Where the camera stands, in the axes of a body that faces along X."""
AWAY_M, FIELD = 4.0, 0.6
"""Choice. Distance of the camera, and its field of view [rad]: a person with raised arms fills the page."""
HEIGHT_M = 0.9
KNOWN = 0.9
"""Cited. Progress at which a segment is called identified (the project's acceptance bound)."""
HEIGHT_PX = 170


class Cameras:
    """Buttons that bring every viewer to a view."""

    def __init__(self, server: viser.ViserServer) -> None:
        """Add the buttons to a server's panel."""
        self._server, self._centre = server, np.zeros(3)
        buttons = server.gui.add_button_group("Camera", tuple(VIEWS))
        buttons.on_click(lambda event: self._turn(event.client, event.target.value))
        server.on_client_connect(lambda client: self._turn(client, "front"))

    def look_at(self, place: Float[np.ndarray, " 3"]) -> None:
        """Say where the subject is [m]."""
        self._centre = np.array([place[0], place[1], HEIGHT_M])

    def turn_all(self, view: str = "front") -> None:
        """Bring everybody who looks to a view."""
        for client in self._server.get_clients().values():
            self._turn(client, view)

    def _turn(self, client: viser.ClientHandle | None, view: str) -> None:
        if client is None:
            return
        x, y, z = VIEWS[view]
        offset = np.array([x * np.cos(0.35) - y * np.sin(0.35), x * np.sin(0.35) + y * np.cos(0.35), z])
        with client.atomic():
            client.camera.position = self._centre + AWAY_M * offset
            client.camera.look_at = self._centre
            client.camera.fov = FIELD


class SegmentCard:
    """The ten parameters of the segment that was clicked, with their standard deviations."""

    def __init__(self, gui: viser.GuiApi) -> None:
        """Add the card to a panel."""
        self._choice: str | None = None
        self._table: dict[str, dict[str, Any]] = {}
        with gui.add_folder("Segment"):
            self._html = gui.add_html(card(None, {}))

    def choose(self, name: str) -> None:
        """Show another segment."""
        self._choice = name
        self._html.content = card(name, self._table)

    def update(self, table: dict[str, dict[str, Any]]) -> None:
        """Take up new figures, keyed as in ``inertia.json``."""
        self._table = table
        self._html.content = card(self._choice, table)


class Chart:
    """Curves over time."""

    def __init__(self, gui: viser.GuiApi, title: str, curves: Sequence[tuple[str, colours.Rgb]]) -> None:
        """Add an empty chart.

        Args:
            gui: panel.
            title: with the unit.
            curves: names and colours; the second and later ones are dashed, for eyes that do not tell colours.
        """
        nothing = np.array([0.0, 1.0])
        series = [viser.uplot.Series(label="t [s]")] + [
            viser.uplot.Series(
                label=name, stroke=f"rgb{tint}", width=2, dash=(2.0 + 4 * k, 4.0) if k else (), spanGaps=False
            )
            for k, (name, tint) in enumerate(curves)
        ]
        self._handle = gui.add_uplot(
            (nothing, *(np.full(2, np.nan) for _ in curves)), tuple(series), title=title,
            scales={"x": viser.uplot.Scale(time=False)}, height=HEIGHT_PX, legend=viser.uplot.Legend(show=True),
        )  # fmt: skip

    def draw(self, time: Float[np.ndarray, " some"], values: Sequence[Float[np.ndarray, " some"]]) -> None:
        """Replace the curves; fewer than two instants make none."""
        nothing = (np.array([0.0, 1.0]), *(np.full(2, np.nan) for _ in values))
        self._handle.data = (time, *values) if len(time) >= 2 else nothing


def card(name: str | None, table: dict[str, dict[str, Any]]) -> str:
    """Return a segment's figures as HTML; without a choice, how to make one."""
    if name is None or name not in table:
        return "<p style='margin:0.4em'>Click a segment to see its mass, centre of mass and inertia.</p>"
    one = table[name]
    sd = one["sd"]
    rows = [("mass", one["mass_kg"], sd["mass_kg"], 1.0, "kg")]
    rows += [(f"centre {axis}", one["com_m"][k], sd["com_m"][k], 1e3, "mm") for k, axis in enumerate("xyz")]
    rows += [
        (f"I {'xyz'[i]}{'xyz'[j]}", one["inertia_kgm2"][i][j], sd["inertia_kgm2"][i][j], 1.0, "kg m²")
        for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
    ]
    share = float(one["progress"])
    state = "identified ✓" if share >= KNOWN else "not yet identified"
    body = "".join(
        f"<tr><td>{label}</td><td style='text-align:right'>{figure(factor * float(value), factor * float(spread))}</td>"
        f"<td>{unit}</td></tr>"
        for label, value, spread, factor, unit in rows
    )
    title = html.escape(name.replace("_", " "))
    return (f"<div style='margin:0.4em'><b style='font-size:1.2em'>{title}</b> {share:.0%}, {state}"
            f"<table style='width:100%'>{body}</table></div>")  # fmt: skip


def figure(value: float, sd: float) -> str:
    """Return a value and its standard deviation, with as many digits as the latter supports."""
    digits = int(np.clip(1 - np.floor(np.log10(sd)), 0, 6)) if sd > 0.0 and np.isfinite(sd) else 2
    return f"{value:.{digits}f} ± {sd:.{digits}f}"
