"""The page in a real browser: it draws, picks, moves, and says so."""

import shutil
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest
import small_session
from playwright.sync_api import Browser, Page, ViewportSize, sync_playwright
from test_live import moving, subject

from torchid.live.display.page import Address
from torchid.live.display.page import Page as LivePage
from torchid.live.estimation.pipeline import Pipeline
from torchid.live.sources.stream import Replay
from torchid.report import write_report
from torchid.run.write import write_outcome
from torchid.scene.finished import FinishedRun
from torchid.scene.player import Player
from torchid.scene.replay import replay
from torchid.scene.server import close_page, open_page
from torchid.storage.results import OutputFolder

pytestmark = pytest.mark.slow
CHROMIUM = shutil.which("chromium")
SOFTWARE = ["--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist", "--no-sandbox"]
WIDE = ViewportSize(width=1400, height=850)
PATIENT_MS = 60_000
"""Of a busy machine that draws without a graphics card."""


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    """Chromium, which draws in software."""
    if CHROMIUM is None:
        pytest.skip("no chromium on this machine")
    with sync_playwright() as playwright:
        one = playwright.chromium.launch(executable_path=CHROMIUM, args=SOFTWARE)
        yield one
        one.close()


@pytest.fixture(scope="module")
def out(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a finished run."""
    folder = tmp_path_factory.mktemp("finished") / "out"
    with OutputFolder(folder) as made:
        write_outcome(small_session.outcome(), made, None)
    return folder


def opened(browser: Browser, url: str) -> Page:
    """A page, and what it complains of."""
    page = browser.new_page(viewport=WIDE)
    page.set_default_timeout(PATIENT_MS)
    page.on("console", lambda message: complaints.append(message.text) if message.type == "error" else None)
    complaints.clear()
    page.goto(url)
    return page


complaints: list[str] = []


def picked(page: Page) -> bool:
    """Click where a standing person's trunk and thighs are until a segment says what it is."""
    for x, y in ((500, 460), (500, 400), (480, 500), (520, 500), (500, 330)):
        page.mouse.move(x, y)
        page.wait_for_timeout(300)
        page.mouse.click(x, y, delay=100)
        for _ in range(25):
            page.wait_for_timeout(100)
            if page.get_by_text("kg m²").count():
                return True
    return False


def test_a_finished_run_is_looked_at(browser, out):
    """A click picks a segment, the slider's box moves the run to a frame, and the page says which one it shows."""
    server, address = open_page(19100)
    try:
        run = FinishedRun(out)
        player = Player(server, run)
        threading.Thread(target=player.play, args=(120.0,), daemon=True).start()
        page = opened(browser, address)
        page.get_by_text("Vertical force [N]").wait_for()
        page.wait_for_timeout(4000)
        assert picked(page), "no click on the body picked a segment"
        box = page.locator("input[type=text][inputmode=numeric], input[inputmode=decimal], input[type=number]").first
        box.fill("12")
        box.press("Enter")
        time = run.trial(run.trials[0]).time[12]
        page.get_by_text(f"{time:.2f} s").first.wait_for()
        assert player.frame == 12
        page.close()
    finally:
        close_page(server)
    assert not complaints


def test_a_stream_is_looked_at(browser):
    """The page shows the stream's time and, once there are parameters, every segment's bar."""
    trial = moving()
    assert trial.forces is not None
    with LivePage(subject(), trial.markers.labels, trial.forces.plates, Address(19200, "127.0.0.1")) as shown:
        page = opened(browser, shown.address)
        with Pipeline(subject(), Replay(trial, 0.5)) as pipeline:
            pipeline.run(show=shown.show)
        page.get_by_text("thigh l").first.wait_for()
        page.get_by_text("No frame for").first.wait_for()
        page.close()
    assert not complaints


def test_a_report_replays_a_trial_and_runs_nothing_else(browser, tmp_path, out):
    """The scene draws inside its frame once it is opened; a script that is written into the page does not run."""
    path = tmp_path / "report.html"
    write_report(small_session.outcome(), path, None, replay(FinishedRun(out), "squats"))
    text = path.read_text(encoding="utf-8")
    path.write_text(text.replace("<main>", "<main><script>document.title='taken'</script>"), encoding="utf-8")
    page = opened(browser, path.as_uri())
    assert page.title() != "taken"
    assert len(complaints) == 1 and "Content Security Policy" in complaints[0]
    assert len(page.frames) == 1 or not page.frames[1].locator("canvas").count(), "it is drawn only when asked for"
    page.get_by_text("The motion in three dimensions").click()
    page.frame_locator("iframe").locator("canvas").first.wait_for()
    page.wait_for_timeout(2000)
    assert len(complaints) == 1
    page.close()
