"""The local viewer: a real viser server and a browser."""

import io

import numpy as np
import pytest
from PIL import Image
from playwright.sync_api import Browser

from splatreel.play.timeline import draw_on_cpu, open_reel
from splatreel.play.viewer import Viewer
from tests.golden import GOLDEN
from tests.player.pages import wait_until

pytestmark = pytest.mark.browser


def test_a_browser_sees_what_the_kernels_draw(browser: Browser) -> None:
    pytest.importorskip("viser", reason="the local viewer's test needs splatreel[viewer]")
    reel = open_reel(GOLDEN)
    with Viewer(reel, draw_on_cpu) as viewer:
        page = browser.new_page(viewport={"width": 640, "height": 480})
        page.goto(viewer.url)
        page.get_by_role("button", name="Pause").click()
        field = page.get_by_role("textbox").first
        field.fill("0.3")
        field.press("Enter")
        wait_until(page, lambda: viewer.clock.time == pytest.approx(0.3) and viewer.settled)
        want = np.clip(reel.render(reel.at(0.3), reel.manifest.camera.resized(640, 480)), 0, 1)
        below = slice(240, None)  # the panel and a warning cover what is above
        assert want[below].std() > 0.05

        def error() -> float:
            shot = np.asarray(Image.open(io.BytesIO(page.screenshot())).convert("RGB")) / 255
            return float(np.mean((shot[below] - want[below]) ** 2))

        wait_until(page, lambda: -10 * np.log10(error()) > 30)
        page.get_by_role("button", name="Play").click()
        wait_until(page, lambda: viewer.clock.playing)
        page.close()
