"""``torchid view``: the page of a finished run, with a slider over time."""

import threading
import time
from collections.abc import Callable

import numpy as np
import viser

from torchid.scene import colours
from torchid.scene.finished import WRENCHES, FinishedRun, FinishedTrial
from torchid.scene.panel import Cameras, Chart, SegmentCard
from torchid.scene.scene import PageScene

SPEEDS = {"1/4": 0.25, "1/2": 0.5, "1": 1.0, "2": 2.0}
PERIOD_S = 1.0 / 60.0
"""Choice. Between two pictures: what screens show."""
DRAWN = 1500
"""Choice. Instants of a chart: as many as a wide screen has columns."""
STANDING = {"measured": "measured", "predicted": "model", "extended": "extended model"}
"""What curves are called."""


class Player:
    """The page of a finished run."""

    def __init__(self, server: viser.ViserServer, run: FinishedRun) -> None:
        """Draw the first trial's first frame."""
        self._server, self._run, self._playing = server, run, False
        # Browsers change things from threads of their own, while ``play`` moves on in this one.
        self._turns = threading.RLock()
        self._trial = run.trial(run.trials[0])
        gui = server.gui
        gui.set_panel_label(f"torchid · {run.folder.resolve().name}")
        self._cameras = Cameras(server)
        self._choice = gui.add_dropdown("Trial", run.trials) if len(run.trials) > 1 else None
        self._slider = gui.add_slider("Frame", 0, max(len(self._trial) - 1, 1), 1, 0)
        self._clock = gui.add_markdown("")
        self._play = gui.add_button("Play")
        self._speed = gui.add_dropdown("Speed", tuple(SPEEDS), initial_value="1")
        self._scaled = gui.add_checkbox("Scaled template, before any fit", initial_value=False)
        self._legend = gui.add_html(LEGEND)
        self._card = SegmentCard(gui)
        curves = tuple((STANDING[name], getattr(colours, name.upper())) for name in WRENCHES)
        self._chart = Chart(gui, "Vertical force [N]", curves)
        self._scene = self._staged()
        self._listen()
        self._open()

    @property
    def frame(self) -> int:
        """Return the number of the frame that is shown."""
        return max(0, min(int(self._slider.value), len(self._trial) - 1))

    def play(self, seconds: float = float("inf"), clock: Callable[[], float] = time.monotonic) -> None:
        """Keep the page alive, and move on where it plays.

        Args:
            clock: monotonic time [s].
        """
        begun = last = clock()
        ahead = 0.0
        while clock() - begun < seconds:
            time.sleep(PERIOD_S)
            now = clock()
            with self._turns:
                ahead = self._moved_on(ahead, now - last)
            last = now

    def close(self) -> None:
        """Let go of the run's files."""
        self._trial.close()

    def _moved_on(self, ahead: float, seconds: float) -> float:
        """Go on by some seconds, if it plays, and by the part of a frame that was left; return what is left now."""
        if not self._playing or len(self._trial) < 2:
            return 0.0
        step = (self._trial.time[-1] - self._trial.time[0]) / (len(self._trial) - 1)
        whole, rest = divmod(ahead + seconds * SPEEDS.get(self._speed.value, 1.0) / step, 1.0)
        self._slider.value = (self.frame + int(whole)) % len(self._trial)
        return rest

    def _staged(self) -> PageScene:
        scene = PageScene(self._server.scene, self._trial.ground)
        scene.set_body(self._run.segments.solids, self._run.segments.progress)
        assert scene.body is not None
        scene.body.on_click(self._clicked)
        return scene

    def _listen(self) -> None:
        self._card.update(self._run.segments.table)
        self._slider.on_update(lambda _: self._show())
        self._play.on_click(lambda _: self._toggle())
        self._scaled.on_update(lambda _: self._scene.see(self._scaled.value))
        if self._choice is not None:
            self._choice.on_update(lambda event: self._change(event.target.value))

    def _clicked(self, event: viser.SceneNodePointerEvent) -> None:
        if event.instance_index is not None:
            self._card.choose(tuple(self._run.segments.table)[event.instance_index])

    def _toggle(self) -> None:
        self._playing = not self._playing
        self._play.label = "Pause" if self._playing else "Play"

    def _change(self, name: str) -> None:
        other = self._run.trial(name)
        with self._turns:
            self._trial.close()
            self._trial = other
            self._server.scene.reset()
            self._scene = self._staged()
            self._slider.max = max(len(self._trial) - 1, 1)
            self._slider.value = 0
            self._open()

    def _open(self) -> None:
        """Show a trial's first frame and its charts."""
        place = self._trial.instant(0).X_WB
        if place is not None:
            self._cameras.look_at(place[0, :3, 3])
        self._draw_chart(self._trial)
        self._show()

    def _draw_chart(self, trial: FinishedTrial) -> None:
        found = [trial.wrench(name, DRAWN) for name in WRENCHES]
        time = next((one[0] for one in found if one is not None), np.zeros(0))
        self._chart.draw(time, [np.full(len(time), np.nan) if one is None else one[1][:, 2] for one in found])

    def _show(self) -> None:
        with self._turns, self._server.atomic():
            frame = self.frame
            now = self._trial.instant(frame)
            self._scene.show(now)
            self._scene.see(self._scaled.value)
        worst = "" if now.distance is None or not np.isfinite(now.distance).any() else (
            f" · markers {1e3 * np.sqrt(np.nanmean(now.distance**2)):.1f} mm from the model"
        )  # fmt: skip
        self._clock.content = f"**{self._trial.time[frame]:.2f} s**{worst}"


def _key(tint: colours.Rgb, text: str) -> str:
    return f"<span style='color:rgb{tint}'>&#9632;</span> {text}<br>"


LEGEND = "<div style='margin:0.4em;line-height:1.5'>" + "".join([
    _key(colours.MEASURED, "force measured, each plate's thin"),
    _key(colours.PREDICTED, "force of the model; ball: centre of mass"),
    _key(colours.EXTENDED, "force of the extended model"),
    _key(colours.KNOWN, "solid segments are identified, ..."),
    _key(colours.UNKNOWN, "... pale red ones are known from the prior alone; markers: green fit, red are "
         f"{colours.ASTRAY_MM:.0f} mm off"),
]) + "</div>"  # fmt: skip
"""What colours say, in words."""
