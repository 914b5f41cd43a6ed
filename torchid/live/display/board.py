"""The panel and the scene of a stream's page."""

import html
from collections import deque

import numpy as np
import viser
from jaxtyping import Float

from torchid.inertia.fit import InertiaFit
from torchid.model.model import InertialPrior
from torchid.model.pseudo import com, inertia_com, mass
from torchid.scene import colours
from torchid.scene.panel import KNOWN, Cameras, Chart, SegmentCard
from torchid.scene.scene import Ground, Instant, PageScene
from torchid.scene.solids import solids
from torchid.session.tables import segments_table

STALE_S = 0.3
"""Choice. After so long without a frame the page says so: a third of what recovery may take."""
CHART_S, CHART_PERIOD_S = 10.0, 0.5
"""Choice. What the chart of forces holds, and how often it is drawn."""
HISTORY = 3600
"""Choice. Seconds of the chart of the mass."""


class Board:
    """A stream's page."""

    def __init__(
        self, server: viser.ViserServer, ground: Ground, names: tuple[str, ...], prior: InertialPrior
    ) -> None:  # fmt: skip
        """Draw what is known before the first frame."""
        self._server, self._names, self._prior = server, names, prior
        gui = server.gui
        gui.set_panel_label("torchid · live")
        self._advice = gui.add_html("", visible=False)
        self._wrong, self._said = gui.add_html("", visible=False), list[str]()
        self._state = gui.add_markdown("Waiting for the first frame")
        self._frozen = gui.add_checkbox("Freeze the picture", initial_value=False)
        self._cameras = Cameras(server)
        self._bars = gui.add_html(bars({}))
        self._card = SegmentCard(gui)
        curves = (("measured", colours.MEASURED), ("model", colours.PREDICTED))
        self._force = Chart(gui, "Vertical force [N], as identified (delayed)", curves)
        curves = (("mass", colours.PREDICTED), ("low", colours.SCALED), ("high", colours.SCALED))
        self._mass = Chart(gui, "Total mass [kg], and its 95 % bounds", curves)
        gui.add_html(LEGEND)
        self._scene = PageScene(server.scene, ground)
        mean = prior.mean
        some = solids(names, mass(mean).numpy(), com(mean).numpy(), inertia_com(mean).numpy())
        self._scene.set_body(some, np.zeros(len(names)))
        assert self._scene.body is not None
        self._scene.body.on_click(self._clicked)
        self._past: deque[tuple[float, float, float]] = deque()
        self._masses: deque[tuple[float, float, float]] = deque(maxlen=HISTORY)
        self._drawn_s, self._placed = -np.inf, False

    def show(self, now: Instant, time_s: float) -> None:
        """Draw an instant of the stream."""
        if not self._placed and now.X_WB is not None:
            self._placed = True
            self._cameras.look_at(now.X_WB[0, :3, 3])
            self._cameras.turn_all()
        if time_s - self._drawn_s > CHART_PERIOD_S or time_s < self._drawn_s:
            self._drawn_s = time_s
            self._state.content = f"**{time_s:.0f} s** of the stream"
            self._draw_forces()
        if not self._frozen.value:
            with self._server.atomic():
                self._scene.show(now)
            self._server.flush()

    def passed(self, time_s: float, measured: Float[np.ndarray, " 6"], predicted: Float[np.ndarray, " 6"]) -> None:
        """Take up the total forces of an instant: measured, and of the model."""
        self._past.append((time_s, float(measured[2]), float(predicted[2])))
        while self._past[0][0] < time_s - CHART_S:
            self._past.popleft()

    def identified(self, fit: InertiaFit, time_s: float) -> None:
        """Take up new parameters."""
        progress = fit.progress.segment.numpy()
        some = solids(self._names, fit.mass.numpy(), fit.com.numpy(), fit.inertia_com.numpy())
        with self._server.atomic():
            self._scene.set_body(some, progress)
        self._card.update(segments_table(fit, self._prior))
        self._bars.content = bars(dict(zip(self._names, progress.tolist(), strict=True)))
        total, of = float(fit.mass.sum()), fit.covariance[::10, ::10]
        spread = 1.96 * float(of.sum().clamp(min=0.0).sqrt())
        self._masses.append((time_s, total, spread))
        time, value, bound = np.array(self._masses).T
        self._mass.draw(time, (value, value - bound, value + bound))

    def silent(self, seconds: float) -> None:
        """Say that nothing comes."""
        if seconds > STALE_S and self._placed:
            self._state.content = f"**No frame for {seconds:.1f} s.** What was identified stays."

    def warn(self, texts: list[str]) -> None:
        """Say what is wrong, until it is no more."""
        if texts == self._said:
            return
        self._said = texts
        lines = "".join(f"<div>&#9888; {html.escape(one)}</div>" for one in texts)
        style = f"margin:0.4em;padding:0.5em;font-size:1.3em;border-left:6px solid rgb{colours.UNKNOWN}"
        self._wrong.content, self._wrong.visible = f"<div style='{style}'>{lines}</div>", bool(texts)

    def advise(self, text: str, why: str, drawing: Float[np.ndarray, "sticks 2 3"] | None = None) -> None:
        """Tell the subject what to do next, in letters that can be read from where one stands, and draw it."""
        self._advice.visible = True
        self._advice.content = (
            f"<div style='margin:0.4em;font-size:2.2em;font-weight:700;line-height:1.15'>{html.escape(text)}</div>"
            f"<div style='margin:0.4em'>{html.escape(why)}</div>"
        )
        if drawing is not None:
            self._scene.ask_for(drawing)

    def _draw_forces(self) -> None:
        if self._past:
            time, measured, predicted = np.array(self._past).T
            self._force.draw(time, (measured, predicted))

    def _clicked(self, event: viser.SceneNodePointerEvent) -> None:
        if event.instance_index is not None:
            self._card.choose(self._names[event.instance_index])


def bars(progress: dict[str, float]) -> str:
    """Return how much is known of every segment, as bars with figures, left and right side by side."""
    if not progress:
        return "<p style='margin:0.4em'>Nothing is identified yet: stand on the plates and move.</p>"
    tints = colours.by_progress(np.array(list(progress.values())))
    cells = [_bar(name, share, tint) for (name, share), tint in zip(progress.items(), tints, strict=True)]
    return f"<div style='display:grid;grid-template-columns:1fr 1fr;gap:2px 10px;margin:0.4em'>{''.join(cells)}</div>"


def _bar(name: str, share: float, tint: np.ndarray) -> str:
    tick, shown = " ✓" if share >= KNOWN else "", html.escape(name.replace("_", " "))
    return (
        f"<div><div style='display:flex;justify-content:space-between'><span>{shown}</span>"
        f"<span>{share:.0%}{tick}</span></div><div style='background:#e4e4e4;height:7px'>"
        f"<div style='width:{share:.0%};height:7px;background:rgb{tuple(int(c) for c in tint)}'></div></div></div>"
    )


LEGEND = (
    f"<div style='margin:0.4em;line-height:1.5'><span style='color:rgb{colours.MEASURED}'>&#9632;</span> force "
    f"measured: plates now (thin), total as identified (thick)<br><span style='color:rgb{colours.PREDICTED}'>&#9632;"
    "</span> force of the model; ball: centre of mass<br>Segments turn from pale red to solid green.</div>"
)
"""What colours say, in words."""
