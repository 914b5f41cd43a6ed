"""Some seconds of a finished run as one page of HTML that needs neither a server nor anything from outside."""

import numpy as np

from torchid.scene.embedded import EmbeddedPage, policy
from torchid.scene.finished import FinishedRun
from torchid.scene.panel import AWAY_M, FIELD, HEIGHT_M
from torchid.scene.scene import PageScene
from torchid.scene.server import LOOPBACK, close_page, open_page

LONGEST_S, RATE_HZ = 8.0, 20.0
"""Choice. What a report holds of a trial: some cycles of any movement, in pictures enough, in a third of a megabyte."""


def replay(run: FinishedRun, name: str) -> EmbeddedPage:
    """Record a trial of a run.

    Args:
        run: that has been written.
    """
    trial = run.trial(name)
    seconds = min(float(trial.time[-1] - trial.time[0]), LONGEST_S)
    times = trial.time[0] + np.arange(0.0, seconds, 1.0 / RATE_HZ)
    frames = np.unique(np.searchsorted(trial.time, times).clip(max=len(trial) - 1))
    server, _ = open_page(port=0, host=LOOPBACK)
    try:
        scene = PageScene(server.scene, trial.ground)
        scene.set_body(run.segments.solids, run.segments.progress)
        first = trial.instant(int(frames[0]))
        assert first.X_WB is not None
        place = np.array([*first.X_WB[0, :2, 3], HEIGHT_M])
        server.initial_camera.position, server.initial_camera.look_at = place + AWAY_M * SEEN_FROM, place
        server.initial_camera.fov = FIELD
        scene.show(first)
        record = server.get_scene_serializer()
        for frame in frames:
            scene.show(trial.instant(int(frame)))
            record.insert_sleep(1.0 / RATE_HZ)
        html = record.as_html()
    finally:
        trial.close()
        close_page(server)
    return EmbeddedPage(html, policy(html), name, seconds)


SEEN_FROM = np.array([0.92, 0.36, 0.12])
"""Where the camera stands: before the subject, a little to the left."""
