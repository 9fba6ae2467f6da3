"""The report page of a run: readable on any screen, accessible, with a player, and up to date while it is served."""

import json
from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Browser, Page

from splatreel.base.progress import Silent
from splatreel.cli.serve import run_report
from splatreel.evaluation.evaluate import evaluate
from splatreel.play.server import Server
from splatreel.run.run_logs import RecordedProgress
from tests.evaluation import scenes
from tests.player.test_accessibility import AXE, assert_accessible

pytestmark = pytest.mark.browser


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of an evaluated run."""
    out = scenes.write_run(tmp_path_factory.mktemp("report") / "run")
    progress = RecordedProgress(Silent(), out / "work", "", "cpu")
    progress.stage("group 1/1: training the motion", 100)
    for done in range(0, 101, 10):
        progress.update(done, loss=0.1 / (done + 1))
    evaluate(out / "reel", scenes.capture(out), out=out, lpips_every=0)
    return out


@pytest.fixture
def page(browser: Browser) -> Iterator[Page]:
    page = browser.new_page(viewport={"width": 1280, "height": 800})
    yield page
    page.close()


@pytest.mark.parametrize("width", [1280, 390])
def test_page_fits_the_screen_and_is_accessible(page: Page, run: Path, width: int) -> None:
    if not AXE.is_file():
        pytest.skip("axe-core is not installed (npm ci in player/)")
    page.set_viewport_size({"width": width, "height": 800})
    page.goto((run / "report.html").as_uri())
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    assert page.evaluate("[...document.images].every(image => image.complete && image.naturalWidth > 0)")
    assert_accessible(page, f"{width} pixels wide")


def test_player_of_the_file_opens_on_demand(page: Page, run: Path) -> None:
    page.goto((run / "report.html").as_uri())
    page.get_by_text("Play the reel here").click()
    page.frame_locator("iframe").locator("splat-reel").wait_for()
    page.wait_for_function(
        "document.querySelector('iframe').contentDocument.querySelector('splat-reel')?.readyState > 0"
    )


def test_served_page_keeps_itself_up_to_date(browser: Browser, run: Path) -> None:
    page = browser.new_page(bypass_csp=False)
    with Server(run / "reel", pages=run_report(run / "reel")) as server:
        page.clock.install()
        page.goto(f"{server.url}report.html")
        report = json.loads((run / "report.json").read_text())
        (run / "report.json").write_text(json.dumps(report | {"psnr": 12.34}))
        page.clock.run_for(11_000)
        page.get_by_text("12.34 dB", exact=True).wait_for()
    page.close()
